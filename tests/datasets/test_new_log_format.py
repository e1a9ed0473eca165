"""A log format is added by one file: an importer in a copy of the tree is found without any other change."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

from datasets.importers.formats import known_importers

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("configs", "datasets", "geometry", "messages")
IMPORTER = '''
"""Wheel speeds as text: `WHEELS` and one line `seconds speed` per sample."""

from datasets.importers.recording import Description, Recording, Sensor
from messages.sensors import WheelSample

NAME = "wheel text"


def sniff(path, head):
    return open_wheels if head.startswith(b"WHEELS\\n") else None


def open_wheels(path, truth):
    about = Description(NAME, (Sensor("wheel/text", "base", "text", NAME),), vehicle="kitti_car")
    return Recording(path, about, lambda: _read(path))


def _read(path):
    for line in path.read_text().splitlines()[1:]:
        stamp_s, speed_mps = map(float, line.split())
        stamp_ns = round(stamp_s * 1e9)
        yield stamp_ns, "wheel/text", WheelSample(stamp_ns, speed_mps, 0.0)
'''
PROGRAM = """
import json, sys
from pathlib import Path
from datasets.importers.formats import open_recording
from datasets.importers.write_recording import write_recording
from datasets.log import LogConfig
from datasets.reader import read_log
from datasets.viewer import ViewerConfig

recording = open_recording(Path(sys.argv[1]))
log = LogConfig(chunk_kib=256, flush_s=1.0, sync_s=9.0, min_free_mb=0.0)
viewer = ViewerConfig(points=9, cloud_s=1, frames_s=1, scene_s=1, static_s=1, image_s=1, image_quality=70)
write_recording(recording, Path(sys.argv[2]), log, viewer)
speeds = [e.message.speed_mps for e in read_log(Path(sys.argv[2]))]
print(json.dumps([recording.description.format, recording.description.vehicle, speeds]))
"""


def test_new_format_by_one_importer_file(tmp_path: Path) -> None:
    for name in PACKAGES:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "datasets" / "importers" / "wheel_text.py").write_text(IMPORTER)
    (tmp_path / "log.txt").write_text("WHEELS\n1.0 2.5\n1.1 2.6\n")
    words = [sys.executable, "-c", PROGRAM, str(tmp_path / "log.txt"), str(tmp_path / "out.mcap")]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)})
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == ["wheel text", "kitti_car", [2.5, 2.6]]


def test_importer_names_are_unique() -> None:
    names = [importer.NAME for importer in known_importers()]
    assert len(set(names)) == len(names) >= 5

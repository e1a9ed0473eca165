"""Damaged folders of every layout: no other error than LogError, the readable part is kept, the reason is named."""

import shutil
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from datasets.importers.formats import open_recording
from messages.errors import LogError
from tests.datasets import folder_samples as samples

FRAMES = 3
Make = Callable[[Path], Path]
# layout → writer, folder of scans, folder or file of labels, calibration, another sensor's file of frame 1
LAYOUTS: dict[str, tuple[Make, str, str, str, str]] = {
    "tracking": (lambda p: samples.write_tracking(p), "training/velodyne/0007", "training/label_02/0007.txt",
                 "training/calib/0007.txt", "training/image_02/0007/000001.png"),
    "raw": (lambda p: samples.write_raw(p), "velodyne_points/data", "oxts/data/0000000001.txt",
            "../calib_velo_to_cam.txt", "image_02/data/0000000001.png"),
    "detection": (lambda p: samples.write_detection(p), "training/velodyne", "training/label_2/000001.txt",
                  "training/calib/000001.txt", "training/image_2/000001.png"),
    "vod": (lambda p: samples.write_view_of_delft(p, FRAMES), "lidar/training/velodyne",
            "lidar/training/label_2/00001.txt", "lidar/training/calib/00001.txt",
            "radar/training/velodyne/00001.bin"),
}  # fmt: skip


def replace_by(content: bytes | None) -> Callable[[Path], None]:
    """Damage of a file: other content, or with None a folder of its name."""

    def damage(path: Path) -> None:
        path.unlink()
        if content is None:
            path.mkdir()
        else:
            path.write_bytes(content)

    return damage


def loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-7])


GARBAGE = np.random.default_rng(3).bytes(999)
DAMAGES: dict[str, Callable[[Path], None]] = {
    "cut": cut,
    "garbage": replace_by(GARBAGE),
    "not UTF-8": replace_by(b"\xff\xfe\x00\xd8" * 9),
    "a folder": replace_by(None),
    "symlink loop": loop,
}


def second_scan(folder: Path) -> Path:
    return sorted(folder.glob("*.bin"))[1]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("part", ["scan", "labels", "calibration", "sensor"])
def test_damaged_file_leaves_the_rest(tmp_path: Path, layout: str, damage: str, part: str) -> None:
    make, scans, labels, calibration, sensor = LAYOUTS[layout]
    root = make(tmp_path)
    places = {"scan": second_scan(root / scans), "labels": root / labels, "calibration": root / calibration}
    whole = Counter(topic for _, topic, _ in open_recording(root).read())
    DAMAGES[damage](places.get(part, root / sensor))
    source = open_recording(root)
    counts = Counter(topic for _, topic, _ in source.read())
    assert counts["lidar/velodyne"] == FRAMES - (part == "scan")
    lost = whole - counts
    noted = bool(source.description.notes) or any(row.skipped != 0 for row in source.table())
    assert not lost or noted
    if part == "scan":
        row = next(row for row in source.table() if row.topic == "lidar/velodyne")
        assert (row.skipped, len(row.reasons)) == (1, 1)
        assert set(lost) == {"lidar/velodyne"}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_empty_folders_and_loops_of_folders(tmp_path: Path, layout: str) -> None:
    make, scans, *_ = LAYOUTS[layout]
    root = make(tmp_path / "a")
    (root / "again").symlink_to(root, target_is_directory=True)
    assert Counter(topic for _, topic, _ in open_recording(root).read())["lidar/velodyne"] == FRAMES
    for path in (root / scans).glob("*.bin"):
        path.unlink()
    counts: Counter[str] = Counter()
    with suppress(LogError):  # where the scans alone tell the layout
        counts.update(topic for _, topic, _ in open_recording(root).read())
    assert "lidar/velodyne" not in counts
    shutil.rmtree(root / scans)
    (root / scans).mkdir()
    for path in root.rglob("*"):
        if path.is_file() and not path.is_symlink():
            path.write_bytes(b"")
    with pytest.raises(LogError):
        list(open_recording(root).read())

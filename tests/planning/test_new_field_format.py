"""A field format is added by one file: a reader in a copy of the tree is found without any other change."""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("configs", "geometry", "messages", "planning")
FORMAT = '''
"""Corners as text: `CORNERS name` and one line `longitude latitude` per corner."""

from planning.field.formats.contents import Feature, FieldFile
from planning.field.formats.coordinates import CoordinateSystem, closed

NAME = "corners"


def sniff(source):
    return (lambda: read_corners(source)) if source.head.startswith(b"CORNERS") else None


def read_corners(source):
    head, *lines = source.read().decode().splitlines()
    ring = [tuple(map(float, line.split())) for line in lines]
    return FieldFile((Feature(head.split()[1], ((closed(CoordinateSystem(None).to_degrees(ring)),),)),))
'''
PROGRAM = """
import sys
from pathlib import Path
from planning.field.field import read_field

outline = read_field(Path(sys.argv[1]))
print(outline.name, round(outline.polygon.area))
"""


def test_new_format_by_one_file(tmp_path: Path) -> None:
    for name in PACKAGES:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "planning/field/formats/corners.py").write_text(FORMAT)
    (tmp_path / "field.txt").write_text("CORNERS North\n6.0 51.0\n6.001 51.0\n6.001 51.001\n")
    words = [sys.executable, "-c", PROGRAM, str(tmp_path / "field.txt")]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)})
    assert done.returncode == 0, done.stderr
    name, area_m2 = done.stdout.split()
    assert name == "North"
    assert 3880 < float(area_m2) < 3920

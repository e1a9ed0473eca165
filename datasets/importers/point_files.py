"""Point files of any format: one file is a scan, a folder of files a sequence of scans of one lidar.

Files are numbered by the last number in their names, else by their order. Coordinates far from zero (map projections)
are moved by a constant, for a scan has float32 coordinates.
"""

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from datasets.importers.frame_streams import (
    MAX_FRAME,
    NO_TIMES,
    FolderContents,
    FrameStream,
    nominal_times,
    read_bytes,
    unread_entries,
)
from datasets.importers.point_clouds import scan_of_points
from datasets.importers.recording import Open, Recording, Sensor, read_head
from geometry.arrays import Float64
from messages.errors import LogError
from messages.sensors import LidarScan

Points = npt.NDArray[Any]
# Errors of parsing a file of arbitrary bytes.
DAMAGED = (LogError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError, struct.error)
# Files whose first bytes are looked at in a folder, and first files from which the origin is taken.
PROBED = 5
# Beyond this distance float32 has steps above 1 mm.
FAR_M = 8192.0
# Largest coordinate of a map projection.
MAX_M = 1e8
# Names of fields in other programs (CloudCompare, VeloView, PDAL) for those of `point_clouds`.
ALIASES = {
    "points:0": "x", "points:1": "y", "points:2": "z", "points_m_xyz:0": "x", "points_m_xyz:1": "y",
    "points_m_xyz:2": "z", "reflectance": "intensity", "gpstime": "time", "gps_time": "time",
}  # fmt: skip


@dataclass(frozen=True)
class PointFormat:
    """A format: `read` gives points with fields x, y, z and more from the bytes of a file, and raises `DAMAGED`.

    `begin_ns` is the time of the first point where the format has such times, else None.
    """

    name: str
    suffixes: tuple[str, ...]
    is_format: Callable[[bytes], bool]
    read: Callable[[bytes], Points]
    begin_ns: Callable[[Path], int | None] = lambda _: None
    notes: tuple[str, ...] = ()

    def sniff(self, path: Path, head: bytes) -> Open | None:
        """Opens a file that begins like the format, or a folder with such a file among its first."""
        if not path.is_dir():
            return self.open if self.is_format(head) else None
        return self.open if any(self.is_format(_head(p)) for p in self._files(path)[:PROBED]) else None

    def open(self, path: Path, _: Path | None = None) -> Recording:
        """The scans of a file or folder; raises LogError."""
        paths = self._files(path)
        files = dict(sorted(zip(_frames(paths), paths, strict=True)))
        sensor = Sensor(f"lidar/{self.name}", self.name, str(path), self.name)
        contents = FolderContents(path, self.name)
        origin_m = self._origin(path, list(files.values()))
        if origin_m.any():
            contents.notes.append(f"coordinates are those of the files minus {origin_m.tolist()} m")
        begins = {frame: self.begin_ns(file) for frame, file in files.items()}
        stamps = {frame: ns for frame, ns in begins.items() if ns is not None}
        if len(set(stamps.values())) < len(files):
            stamps = nominal_times(files)
        contents.notes += [NO_TIMES] if stamps == nominal_times(files) else self.notes
        if path.is_dir():
            contents.ignored += unread_entries(path, (file.name for file in paths))

        def read(frame: int, stamp_ns: int) -> tuple[LidarScan]:
            return (scan_of_points(self._points(files[frame], origin_m), stamp_ns),)

        contents.streams.append(FrameStream((sensor,), stamps, read))
        return contents.recording(None, 180.0, None)

    def _files(self, path: Path) -> list[Path]:
        return sorted(p for p in path.iterdir() if p.suffix.lower() in self.suffixes) if path.is_dir() else [path]

    def _points(self, path: Path, origin_m: Float64) -> Points:
        data = read_bytes(path)
        try:
            points = self.read(data)
            _check_range(points)
            if not origin_m.any():
                return points
            names = points.dtype.names or ()
            moved = points.astype([(n, "f8" if n in ("x", "y", "z") else points.dtype[n]) for n in names])
            for name, offset_m in zip("xyz", origin_m, strict=True):
                moved[name] -= offset_m
            return moved
        except DAMAGED as error:
            raise LogError(f"{path}: no {self.name} scan ({error})") from error

    def _origin(self, path: Path, files: list[Path]) -> Float64:
        """Whole metres (3,) near the first points that can be read; zeros where they are near zero."""
        for file in files[:PROBED]:
            try:
                points = self._points(file, np.zeros(3))
            except LogError:  # one of a folder is counted when the recording is read
                if file == path:
                    raise
                continue
            xyz_m = np.stack([points[name].astype(np.float64) for name in "xyz"], axis=1)
            xyz_m = xyz_m[np.isfinite(xyz_m).all(axis=1)]
            if len(xyz_m):
                return np.floor(xyz_m.min(axis=0)) if np.abs(xyz_m).max() > FAR_M else np.zeros(3)
        return np.zeros(3)


def _check_range(points: Points) -> None:
    for name in "xyz":
        values = points[name][np.isfinite(points[name])]
        if len(values) and max(-float(values.min()), float(values.max())) > MAX_M:
            raise LogError(f"{name} from {values.min()} to {values.max()} m")


def _head(path: Path) -> bytes:
    try:
        return read_head(path)
    except LogError:  # it is counted when the recording is read
        return b""


def _frames(files: Sequence[Path]) -> list[int]:
    """Numbers of files: the last number of each name if these are small and all different, else 0, 1, 2, ..."""
    digits = [re.findall(r"[0-9]+", path.stem)[-1:] for path in files]
    numbers = [int(d[0][:18]) for d in digits if d]
    is_numbered = len(files) > 1 and len(set(numbers)) == len(files) and max(numbers) < MAX_FRAME
    return numbers if is_numbered else list(range(len(files)))


def name_of_field(name: str) -> str:
    """Name of a field as in `point_clouds`."""
    lower = name.strip().strip('"').lower().removeprefix("scalar_")
    return ALIASES.get(lower, lower)


def points_of_text(lines: list[str], fields: list[tuple[str, str]]) -> Points:
    """Points from lines with one value per field (name, numpy type); raises ValueError with the line."""
    rows = [tuple(line.split()) for line in lines]
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(fields):
            raise ValueError(f"{len(row)} values instead of {len(fields)}: {line[:60]!r}")
    return np.array(rows, np.dtype(fields))

"""KITTI scans and their times: float32 files, packed frames, time stamp files, frame numbers."""

import re
import zlib
from calendar import timegm
from collections.abc import Iterable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from datasets.importers.point_clouds import list_scan
from messages.errors import LogError
from messages.sensors import LidarScan

FRAME_NS = 100_000_000
MAX_RANGE_M = 250.0
PACKED_KEYS = {"xyz_5mm", "intensity"}
PACKED_STEP_M = np.float32(0.005)


def read_bin(path: Path, stamp_ns: int) -> LidarScan:
    """A velodyne scan of float32 x, y, z, reflectance (0 to 1); raises LogError."""
    raw = _bytes(path)
    if not raw or len(raw) % 16:
        raise LogError(f"{path}: {len(raw)} bytes are no velodyne scan (4 x float32 per point)")
    rows = np.frombuffer(raw, "<f4").reshape(-1, 4)
    if not np.isfinite(rows).all() or np.abs(rows[:, :3]).max() > MAX_RANGE_M:
        raise LogError(f"{path}: points beyond {MAX_RANGE_M:.0f} m or not finite: this is no velodyne scan")
    intensity = np.round(rows[:, 3] * 255.0).clip(0, 255).astype(np.uint8)
    return list_scan(stamp_ns, rows[:, :3], intensity)


def read_packed(path: Path, stamp_ns: int) -> LidarScan:
    """A packed frame: `xyz_5mm` int16 in steps of 5 mm and `intensity` uint8; raises LogError."""
    try:
        with np.load(path, allow_pickle=False) as frame:
            xyz, intensity = frame["xyz_5mm"], frame["intensity"]
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise LogError(f"{path}: no packed frame ({error})") from error
    if xyz.dtype != np.int16 or xyz.ndim != 2 or xyz.shape[1] != 3 or intensity.shape != (len(xyz),):
        raise LogError(f"{path}: xyz_5mm {xyz.dtype} {xyz.shape} and intensity {intensity.shape} are no packed frame")
    return list_scan(stamp_ns, xyz.astype(np.float32) * PACKED_STEP_M, intensity.astype(np.uint8))


def is_packed(path: Path) -> bool:
    """Whether a file is a packed frame."""
    try:
        with np.load(path, allow_pickle=False) as frame:
            return set(frame.files) >= PACKED_KEYS
    except (OSError, ValueError, EOFError, BadZipFile):
        return False


def numbered_files(files: list[Path]) -> dict[int, Path]:
    """Files by frame number, which is their name; raises LogError."""
    for path in files:
        if not re.fullmatch(r"\d+", path.stem):
            raise LogError(f"{path}: the name of a frame is its number")
    return {int(path.stem): path for path in files}


def nominal_times(frames: Iterable[int]) -> dict[int, int]:
    """Stamps (ns) of frames at 10 Hz."""
    return {number: number * FRAME_NS for number in frames}


def read_times(path: Path, frames: dict[int, Path]) -> dict[int, int]:
    """Stamps (ns, UTC) of the frames from a file with one line per frame number; raises LogError."""
    try:
        lines = path.read_text(encoding="ascii").split("\n")
        return {number: _parse_time(lines[number]) for number in frames}
    except (OSError, UnicodeDecodeError, ValueError, IndexError) as error:
        raise LogError(f"{path}: no time stamps for all {len(frames)} frames ({error})") from error


def _parse_time(line: str) -> int:
    found = re.fullmatch(r"(\d+)-(\d+)-(\d+) (\d+):(\d+):(\d+)(?:\.(\d{1,9}))?", line.strip())
    if found is None:
        raise ValueError(f"{line[:40]!r} is no time")
    parts = [int(g) for g in found.groups()[:6]]
    return timegm((*parts, 0, 0, 0)) * 1_000_000_000 + int((found.group(7) or "0").ljust(9, "0"))


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error

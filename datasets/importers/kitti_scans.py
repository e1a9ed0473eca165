"""KITTI scans: float32 files and packed frames."""

import zlib
from collections.abc import Callable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from datasets.importers.frame_streams import Files, FolderContents, FrameStream, Times, read_bytes
from datasets.importers.point_clouds import list_scan
from datasets.importers.recording import Sensor
from messages.errors import LogError
from messages.sensors import LidarScan

LIDAR_TOPIC, LIDAR_FRAME = "lidar/velodyne", "velodyne"
TRUTH_TOPIC = f"truth_objects/{LIDAR_FRAME}"
MAX_RANGE_M = 250.0
PACKED_KEYS = {"xyz_5mm", "intensity"}
PACKED_STEP_M = np.float32(0.005)
# Errors of numpy for files that are no readable archive of arrays.
_DAMAGED = (OSError, ValueError, KeyError, EOFError, TypeError, RuntimeError, MemoryError, BadZipFile, zlib.error)


def read_bin(path: Path, stamp_ns: int) -> LidarScan:
    """A velodyne scan of float32 x, y, z, reflectance (0 to 1); raises LogError."""
    raw = read_bytes(path)
    if not raw or len(raw) % 16:
        raise LogError(f"{path}: {len(raw)} bytes are no velodyne scan (4 x float32 per point)")
    rows = np.frombuffer(raw, "<f4").reshape(-1, 4)
    if not np.isfinite(rows).all() or np.abs(rows[:, :3]).max() > MAX_RANGE_M:
        raise LogError(f"{path}: points beyond {MAX_RANGE_M:.0f} m or not finite: this is no velodyne scan")
    intensity = np.round(rows[:, 3] * 255.0).clip(0, 255).astype(np.uint8)
    return list_scan(stamp_ns, rows[:, :3], intensity)


def add_scans(
    contents: FolderContents, files: Files, times: Times, read: Callable[[Path, int], LidarScan] = read_bin
) -> None:
    """Adds the lidar, if there is a scan."""
    paths, unread = files
    if paths:
        sensor = Sensor(LIDAR_TOPIC, LIDAR_FRAME, str(next(iter(paths.values())).parent), contents.format)
        unread = (*unread, *times[1])
        contents.streams.append(FrameStream((sensor,), times[0], lambda n, ns: (read(paths[n], ns),), unread))


def read_packed(path: Path, stamp_ns: int) -> LidarScan:
    """A packed frame: `xyz_5mm` int16 in steps of 5 mm and `intensity` uint8; raises LogError."""
    try:
        with np.load(path, allow_pickle=False) as frame:
            xyz, intensity = frame["xyz_5mm"], frame["intensity"]
    except _DAMAGED as error:
        raise LogError(f"{path}: no packed frame ({error})") from error
    if xyz.dtype != np.int16 or xyz.ndim != 2 or xyz.shape[1] != 3 or intensity.shape != (len(xyz),):
        raise LogError(f"{path}: xyz_5mm {xyz.dtype} {xyz.shape} and intensity {intensity.shape} are no packed frame")
    return list_scan(stamp_ns, xyz.astype(np.float32) * PACKED_STEP_M, intensity.astype(np.uint8))


def is_packed(path: Path) -> bool:
    """Whether a file is a packed frame."""
    try:
        with np.load(path, allow_pickle=False) as frame:
            return set(frame.files) >= PACKED_KEYS
    except _DAMAGED:
        return False


def has_frames(folder: Path) -> bool:
    """Whether a folder holds frames with files of their own: scans in `velodyne`, labels or calibrations beside it."""
    has_others = (folder / "calib").is_dir() or (folder / "label_2").is_dir()
    return has_others and any((folder / "velodyne").glob("*.bin"))

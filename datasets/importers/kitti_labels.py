"""KITTI labels and calibration: boxes from the rectified camera frame to the lidar frame.

The position of a label is the bottom centre of its box in rectified camera coordinates (x right, y down, z forward);
its length is along x when `rotation_y`, about the y axis, is zero. Only the camera view is labelled (about ± 40°).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.arrays import Float64
from geometry.transforms import apply, invert
from messages.errors import LogError
from messages.perception import ObstacleClass
from messages.truth import TrueObject, TrueObjects

CLASSES = {
    "Car": ObstacleClass.VEHICLE,
    "Van": ObstacleClass.VEHICLE,
    "Truck": ObstacleClass.VEHICLE,
    "Tram": ObstacleClass.VEHICLE,
    "Pedestrian": ObstacleClass.PERSON,
    "Person": ObstacleClass.PERSON,
    "Person_sitting": ObstacleClass.PERSON,
    "Cyclist": ObstacleClass.PERSON,
    "Misc": ObstacleClass.UNKNOWN,
}
# Image areas without labels: no box.
UNLABELLED = "DontCare"
COLUMNS = 17
_DETECTED = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}


@dataclass(frozen=True)
class Label:
    """One box of a frame as in the file: size (height, width, length), bottom centre and rotation in the camera."""

    frame: int
    track: int
    name: str
    truncated: int
    occluded: int
    size_hwl_m: tuple[float, float, float]
    p_camera_m: tuple[float, float, float]
    rotation_y_rad: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """Poses between the sensors; `T_camera_lidar` maps lidar to rectified camera coordinates."""

    T_camera_lidar: Float64
    T_lidar_imu: Float64


def read_labels(path: Path) -> list[Label]:
    """All boxes of a tracking label file without DontCare; raises LogError with line and value."""
    labels = []
    for number, line in enumerate(_lines(path), start=1):
        words = line.split()
        if len(words) < COLUMNS or (words[2] not in CLASSES and words[2] != UNLABELLED):
            raise LogError(f"{path}:{number}: not a KITTI tracking label: {line[:60]!r}")
        if words[2] != UNLABELLED:
            labels.append(_label(path, number, words))
    return labels


def _label(path: Path, number: int, words: list[str]) -> Label:
    try:
        h, w, length, x, y, z, turn = map(float, words[10:COLUMNS])
        integers = int(words[0]), int(words[1]), words[2], int(float(words[3])), int(float(words[4]))
    except ValueError as error:
        raise LogError(f"{path}:{number}: {error}") from error
    if not all(map(math.isfinite, (h, w, length, x, y, z, turn))) or min(h, w, length) <= 0.0:
        raise LogError(f"{path}:{number}: box of size {h} x {w} x {length} at ({x}, {y}, {z})")
    return Label(*integers, (h, w, length), (x, y, z), turn)


def read_detections(path: Path) -> list[tuple[float, Label]]:
    """Detections with scores in the format of AB3DMOT; `track` is the line number.

    A line holds frame, class (1 pedestrian, 2 car, 3 cyclist), image box (4 values), score, height, width, length,
    bottom centre, rotation, alpha. Raises LogError with line and value.
    """
    found = []
    for number, line in enumerate(_lines(path), start=1):
        words = line.split(",")
        try:
            frame, kind = int(words[0]), _DETECTED[words[1]]
            score, h, w, length, x, y, z, turn, _ = map(float, words[6:])
        except (ValueError, KeyError, IndexError) as error:
            raise LogError(f"{path}:{number}: not a detection: {line[:60]!r}") from error
        found.append((score, Label(frame, number, kind, 0, 0, (h, w, length), (x, y, z), turn)))
    return found


def read_calibration(path: Path) -> Calibration:
    """A calibration file of KITTI tracking; raises LogError naming what is missing."""
    rows = read_rows(path)
    rectify = np.eye(4)
    rectify[:3, :3] = _row(path, rows, ("R0_rect", "R_rect"), 9).reshape(3, 3)
    T_camera_lidar = rectify @ _rigid(_row(path, rows, ("Tr_velo_to_cam", "Tr_velo_cam"), 12))
    return Calibration(T_camera_lidar, _rigid(_row(path, rows, ("Tr_imu_to_velo", "Tr_imu_velo"), 12)))


def read_raw_calibration(folder: Path) -> Calibration | None:
    """Calibration from the three files of KITTI raw; None when one is missing."""
    names = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
    if not all((folder / name).is_file() for name in names):
        return None
    cam, velo, imu = (read_rows(folder / name) for name in names)
    rectify = np.eye(4)
    rectify[:3, :3] = _row(folder / names[0], cam, ("R_rect_00",), 9).reshape(3, 3)
    T_camera_lidar = rectify @ _pose(folder / names[1], velo)
    return Calibration(T_camera_lidar, _pose(folder / names[2], imu))


def _pose(path: Path, rows: dict[str, list[str]]) -> Float64:
    """Pose from separate rows of rotation and translation."""
    return _rigid(np.hstack([_row(path, rows, ("R",), 9).reshape(3, 3), _row(path, rows, ("T",), 3)[:, None]]))


def read_rows(path: Path) -> dict[str, list[str]]:
    """Values by key of `key: values` lines; the colon is optional."""
    rows = {}
    for line in _lines(path):
        key, _, rest = line.replace(":", " ", 1).partition(" ")
        rows[key.strip()] = rest.split()
    return rows


def true_objects(labels: list[Label], stamp_ns: int, T_camera_lidar: Float64) -> TrueObjects:
    """Boxes of one frame in lidar coordinates (x forward, y left, z up); clearance and velocity are NaN."""
    T_lidar_camera = invert(T_camera_lidar)
    return TrueObjects(stamp_ns, tuple(_true_object(label, T_lidar_camera) for label in labels))


def _true_object(label: Label, T_lidar_camera: Float64) -> TrueObject:
    h, w, length = label.size_hwl_m
    x, y, z = label.p_camera_m
    center = np.array([[x, y - 0.5 * h, z]])
    ahead = T_lidar_camera[:3, :3] @ np.array([math.cos(label.rotation_y_rad), 0.0, -math.sin(label.rotation_y_rad)])
    return TrueObject(
        id=label.track,
        label=CLASSES[label.name],
        role=f"{label.name} {label.track}",
        center_map_m=np.asarray(apply(T_lidar_camera, center)[0], np.float64),
        size_m=np.array([length, w, h]),
        yaw_rad=math.atan2(ahead[1], ahead[0]),
        velocity_mps=np.full(2, np.nan),
        clearance_m=math.nan,
    )


def _rigid(values: Float64) -> Float64:
    T = np.eye(4)
    T[:3] = values.reshape(3, 4)
    return T


def _row(path: Path, rows: dict[str, list[str]], names: tuple[str, ...], count: int) -> Float64:
    for name in names:
        if name in rows:
            try:
                return np.array(rows[name], np.float64).reshape(count)
            except ValueError as error:
                raise LogError(f"{path}: {name} is not {count} numbers: {' '.join(rows[name])[:60]!r}") from error
    raise LogError(f"{path}: no row {names[0]!r} (it has {', '.join(rows) or 'none'})")


def _lines(path: Path) -> list[str]:
    try:
        return [line for line in path.read_text(encoding="ascii").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: cannot be read ({error})") from error

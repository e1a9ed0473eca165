"""Calibration files of KITTI: poses between lidar, GNSS/IMU unit and camera 0 (rectified), and the cameras' intrinsics.

Frame `camera` is the rectified camera 0; optical axes (x right, y down, z forward).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.importers.camera_files import Size, camera_stream, common_size
from datasets.importers.frame_streams import Files, FolderContents, Times, read_lines
from datasets.importers.recording import CameraCalibration, Extrinsic
from geometry.arrays import Float64
from geometry.transforms import invert
from messages.errors import LogError

CAMERA_FRAME = "camera"
RAW_FILES = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
NUMBERS = range(4)  # 0 and 1 are grey, 2 and 3 colour
# Largest deviation from a rotation in a file (printed with 6 digits or more).
ROTATION_TOLERANCE = 1e-3
Rows = dict[str, list[str]]


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Intrinsics of camera `number` for images of `size_px` (None: not stated), and its pose in frame `camera`."""

    number: int
    size_px: Size | None
    K: Float64
    distortion: tuple[float, float, float, float, float]
    T_camera_view: Float64


@dataclass(frozen=True, eq=False)
class Calibration:
    """Poses between the sensors, `T_camera_lidar` to rectified camera coordinates; T_lidar_imu None if not stated."""

    T_camera_lidar: Float64
    T_lidar_imu: Float64 | None
    models: tuple[CameraModel, ...] = ()

    def model(self, number: int, size_px: Size) -> CameraModel | None:
        """Model of a camera for images of this size; None if not stated."""
        fitting = (m for m in self.models if m.number == number and m.size_px in (None, size_px))
        return next(fitting, None)

    def extrinsics(self, lidar: str, imu: str) -> list[Extrinsic]:
        """Poses of lidar and GNSS/IMU unit by the names of their frames."""
        mounts = [Extrinsic(CAMERA_FRAME, lidar, self.T_camera_lidar)]
        return mounts if self.T_lidar_imu is None else [*mounts, Extrinsic(lidar, imu, self.T_lidar_imu)]


def add_camera(
    contents: FolderContents,
    number: int,
    files: Files,
    times: Times,
    calibration: Calibration | None,
    is_one_size: bool = True,
) -> None:
    """Adds the images of a camera, with its calibration if there is one for the size of most; others are refused."""
    if not files[0]:
        return
    folder = next(iter(files[0].values())).parent
    name = next(part for part in reversed(folder.parts) if part.startswith("image_"))
    size_px = common_size(files[0])
    contents.streams.append(camera_stream(name, files, times, size_px if is_one_size else None))
    model = calibration.model(number, size_px) if calibration is not None and size_px is not None else None
    if model is None or size_px is None:
        contents.notes.append(f"camera {name}: no calibration for its images")
        return
    K = model.K
    focal, center = (float(K[0, 0]), float(K[1, 1])), (float(K[0, 2]), float(K[1, 2]))
    contents.cameras.append(CameraCalibration(f"camera/{name}", name, size_px, focal, center, model.distortion))
    contents.extrinsics.append(Extrinsic(CAMERA_FRAME, name, model.T_camera_view))


def read_calibration(path: Path) -> Calibration:
    """A calibration file of KITTI tracking or detection, or of View-of-Delft; raises LogError with what is missing."""
    rows = _read_rows(path)
    rectify = _pose(_row(path, rows, ("R0_rect", "R_rect"), 9).reshape(3, 3), np.zeros(3), path)
    T_camera_lidar = rectify @ _rigid(_row(path, rows, ("Tr_velo_to_cam", "Tr_velo_cam"), 12), path)
    imu = next((name for name in ("Tr_imu_to_velo", "Tr_imu_velo") if rows.get(name)), None)
    T_lidar_imu = None if imu is None else _rigid(_row(path, rows, (imu,), 12), path)
    models = tuple(_rectified(path, rows, k, f"P{k}", None) for k in NUMBERS if rows.get(f"P{k}"))
    return Calibration(T_camera_lidar, T_lidar_imu, models)


def read_raw_calibration(folder: Path) -> Calibration | None:
    """Calibration from the files of KITTI raw; None without those of cameras and lidar. Raises LogError."""
    cameras, lidar, imu = (folder / name for name in RAW_FILES)
    if not (cameras.is_file() and lidar.is_file()):
        return None
    rows = _read_rows(cameras)
    rectify = _pose(_row(cameras, rows, ("R_rect_00",), 9).reshape(3, 3), np.zeros(3), cameras)
    models = [
        _rectified(cameras, rows, k, f"P_rect_{k:02d}", _size(cameras, rows, f"S_rect_{k:02d}"))
        for k in NUMBERS
        if rows.get(f"P_rect_{k:02d}")
    ]
    models += [_unrectified(cameras, rows, k, rectify) for k in NUMBERS if rows.get(f"K_{k:02d}")]
    T_lidar_imu = _pose_of_rows(imu, _read_rows(imu)) if imu.is_file() else None
    return Calibration(rectify @ _pose_of_rows(lidar, _read_rows(lidar)), T_lidar_imu, tuple(models))


def _rectified(path: Path, rows: Rows, number: int, name: str, size_px: Size | None) -> CameraModel:
    """Camera of a projection matrix K [I | t]."""
    P = _row(path, rows, (name,), 12).reshape(3, 4)
    K = _checked_intrinsics(path, name, P[:, :3])
    T_camera_view = np.eye(4)
    T_camera_view[:3, 3] = -np.linalg.solve(K, P[:, 3])
    return CameraModel(number, size_px, K, (0.0, 0.0, 0.0, 0.0, 0.0), T_camera_view)


def _unrectified(path: Path, rows: Rows, number: int, rectify: Float64) -> CameraModel:
    """Camera before rectification: `R` and `T` map coordinates of camera 0 to it."""
    end = f"{number:02d}"
    K = _checked_intrinsics(path, f"K_{end}", _row(path, rows, (f"K_{end}",), 9).reshape(3, 3))
    T_view_first = _pose(_row(path, rows, (f"R_{end}",), 9).reshape(3, 3), _row(path, rows, (f"T_{end}",), 3), path)
    k1, k2, p1, p2, k3 = _row(path, rows, (f"D_{end}",), 5).tolist()
    size_px = _size(path, rows, f"S_{end}")
    return CameraModel(number, size_px, K, (k1, k2, p1, p2, k3), rectify @ invert(T_view_first))


def _checked_intrinsics(path: Path, name: str, K: Float64) -> Float64:
    if not (min(K[0, 0], K[1, 1]) > 0.0 and np.array_equal(K[2], (0.0, 0.0, 1.0))):
        raise LogError(f"{path}: {name} is no camera matrix: {K.ravel().tolist()}")
    return K


def _size(path: Path, rows: Rows, name: str) -> Size | None:
    if name not in rows:
        return None
    width, height = _row(path, rows, (name,), 2).tolist()
    return round(width), round(height)


def _pose_of_rows(path: Path, rows: Rows) -> Float64:
    return _pose(_row(path, rows, ("R",), 9).reshape(3, 3), _row(path, rows, ("T",), 3), path)


def _rigid(values: Float64, path: Path) -> Float64:
    return _pose(values.reshape(3, 4)[:, :3], values.reshape(3, 4)[:, 3], path)


def _pose(R: Float64, t: Float64, path: Path) -> Float64:
    if np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0.0:
        raise LogError(f"{path}: {R.ravel().tolist()} is no rotation")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def _row(path: Path, rows: Rows, names: tuple[str, ...], count: int) -> Float64:
    for name in names:
        if name in rows:
            try:
                values = np.array(rows[name], np.float64).reshape(count)
            except ValueError as error:
                raise LogError(f"{path}: {name} is not {count} numbers: {' '.join(rows[name])[:60]!r}") from error
            if not np.isfinite(values).all():
                raise LogError(f"{path}: {name} is not finite: {' '.join(rows[name])[:60]!r}")
            return values
    raise LogError(f"{path}: no row {names[0]!r} (it has {', '.join(rows)[:200] or 'none'})")


def _read_rows(path: Path) -> Rows:
    """Values by key of `key: values` lines; the colon is optional."""
    rows = {}
    for line in read_lines(path):
        key, _, rest = line.replace(":", " ", 1).partition(" ")
        if key.strip():
            rows[key.strip()] = rest.split()
    return rows

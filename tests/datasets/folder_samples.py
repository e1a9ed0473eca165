"""Folders in the layouts of KITTI and View-of-Delft with one labelled box on level ground."""

import json
import math
from pathlib import Path

import cv2
import numpy as np

from configs.strict import CONFIGS, read_yaml
from geometry.arrays import Float64
from geometry.transforms import apply, invert, planar, transform

NS = 1_000_000_000
SIZE_PX = (124, 38)
# The box in `base`: centre, size (length, width, height), yaw.
CENTER_M, SIZE_M, YAW = np.array([12.0, 3.0, 0.9]), (4.0, 1.8, 1.8), 0.4
# Camera 0 in the lidar: optical axes, 0.27 m ahead, 0.08 m below, tilted by 0.5 degrees as in KITTI.
OPTICAL = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
T_CAMERA_LIDAR = OPTICAL @ transform((-0.27, 0.01, 0.08), (0.004, 0.009, -0.003))
T_LIDAR_IMU = transform((-0.81, 0.32, -0.8), (0.007, -0.001, 0.0004))
OXTS = (
    "49.0 8.4 112.0 0.01 -0.02 0.5 1.0 2.0 2.2 0.1 0.0 0.3 0.4 9.8 0.31 0.41 9.81 "
    "0.01 0.02 0.03 0.011 0.022 0.44 0.05 0.06 4 9 6 4 4"
)
P2 = "72.1 0 61.0 4.5 0 72.1 17.0 0.2 0 0 1 0.003"


def lidar_mount(vehicle: str) -> Float64:
    """`T_base_lidar` of the first lidar of a recording vehicle."""
    (lidar, *_) = read_yaml(CONFIGS / f"vehicles/{vehicle}.yaml")["sensors"]["lidar"].values()
    return transform(lidar["mount"]["xyz_m"], np.radians(lidar["mount"].get("rpy_deg", (0.0, 0.0, 0.0))))


def box_points(T_base_lidar: Float64) -> np.ndarray:
    """Returns of the ground and of the box surface, float32 x, y, z, reflectance (N, 4), in the lidar."""
    rng = np.random.default_rng(5)
    half = 0.49 * np.array(SIZE_M)
    surface = rng.uniform(-half, half, (200, 3))
    axis = rng.integers(0, 3, 200)
    surface[np.arange(200), axis] = half[axis] * rng.choice([-1.0, 1.0], 200)
    ground = np.column_stack([rng.uniform(2.0, 30.0, 300), rng.uniform(-10.0, 10.0, 300), np.zeros(300)])
    T_base_box = transform(CENTER_M, (0.0, 0.0, YAW))
    xyz = apply(invert(T_base_lidar), np.vstack([apply(T_base_box, surface), ground]))
    return np.column_stack([xyz, np.full(500, 0.5)]).astype("<f4")


def label_columns(T_base_lidar: Float64, name: str = "Car", occluded: int = 1) -> str:
    """The box as a KITTI label from its class to its rotation."""
    T_camera_base = T_CAMERA_LIDAR @ invert(T_base_lidar)
    x, y, z = (T_camera_base @ [*CENTER_M, 1.0])[:3]
    ahead = T_camera_base[:3, :3] @ [math.cos(YAW), math.sin(YAW), 0.0]
    turn, (length, width, height) = math.atan2(-ahead[2], ahead[0]), SIZE_M
    return f"{name} 0 {occluded} 0 0 0 9 9 {height} {width} {length} {x:.6f} {y + height / 2:.6f} {z:.6f} {turn:.6f}"


def pose_text(T: Float64) -> str:
    """The first three rows of a pose."""
    return " ".join(f"{v:.9f}" for v in T[:3].ravel())


def write_bin(path: Path, rows: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(rows.astype("<f4").tobytes())


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def write_image(path: Path, shade: int, size_px: tuple[int, int] = SIZE_PX) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((size_px[1], size_px[0], 3), (shade, 100, 200), np.uint8))


def calibration_text(T_camera_lidar: Float64 = T_CAMERA_LIDAR, has_imu: bool = True) -> str:
    imu = pose_text(T_LIDAR_IMU) if has_imu else ""
    return (
        f"P0: {P2}\nP2: {P2}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {pose_text(T_camera_lidar)}\n"
        f"Tr_imu_to_velo: {imu}\n"
    )


def write_tracking(root: Path, frames: int = 3) -> Path:
    """KITTI tracking, sequence 0007: the box as track 4 in all frames, with images and OXTS records."""
    training, mount = root / "training", lidar_mount("kitti_car")
    label = label_columns(mount)
    lines = [f"{k} 4 {label}\n{k} -1 DontCare -1 -1 -10 0 0 9 9 -1000 -1000 -1000 -10 -1 -1 -1" for k in range(frames)]
    for k in range(frames):
        write_bin(training / f"velodyne/0007/{k:06d}.bin", box_points(mount))
        write_image(training / f"image_02/0007/{k:06d}.png", k)
    write_text(training / "calib/0007.txt", calibration_text())
    write_text(training / "oxts/0007.txt", "\n".join([OXTS] * frames))
    write_text(training / "label_02/0007.txt", "\n".join(lines) + "\n")
    return root


def write_raw(root: Path, frames: int = 3) -> Path:
    """KITTI raw: a drive with scans, two cameras and OXTS records, 0.1 s apart from 13:02:25.05 on."""
    drive = root / "2011_09_26" / "2011_09_26_drive_0005_sync"
    times = "".join(f"2011-09-26 13:02:25.{k}50000000\n" for k in range(frames))
    for name in ("velodyne_points/timestamps_end", "velodyne_points/timestamps", "oxts/timestamps"):
        write_text(drive / f"{name}.txt", times)
    for k in range(frames):
        write_bin(drive / f"velodyne_points/data/{k:010d}.bin", box_points(lidar_mount("kitti_car")))
        write_text(drive / f"oxts/data/{k:010d}.txt", OXTS + "\n")
    for camera in ("image_00", "image_02"):
        write_text(drive / camera / "timestamps.txt", times.replace("50000000\n", "40000000\n"))
        for k in range(frames):
            write_image(drive / camera / f"data/{k:010d}.png", k)
    size = f"{SIZE_PX[0]} {SIZE_PX[1]}"
    cameras = (
        f"calib_time: 09-Jan-2012\nR_rect_00: 1 0 0 0 1 0 0 0 1\nS_02: 139 51\nK_02: 96 0 69 0 96 24 0 0 1\n"
        f"D_02: -0.3 0.1 0.001 0.002 0\nR_02: 1 0 0 0 1 0 0 0 1\nT_02: 0.06 0 0\nS_rect_02: {size}\nP_rect_02: {P2}\n"
        f"S_rect_00: {size}\nP_rect_00: 72.1 0 61 0 0 72.1 17 0 0 0 1 0\n"
    )
    write_text(root / "2011_09_26/calib_cam_to_cam.txt", cameras)
    for name, T in (("velo_to_cam", T_CAMERA_LIDAR), ("imu_to_velo", T_LIDAR_IMU)):
        rotation, position = " ".join(map(str, T[:3, :3].ravel())), " ".join(map(str, T[:3, 3]))
        write_text(root / f"2011_09_26/calib_{name}.txt", f"calib_time: 25-May-2012\nR: {rotation}\nT: {position}\n")
    return drive


def write_detection(root: Path, frames: int = 3) -> Path:
    """KITTI detection: independent frames, each with the box as its only object besides an image area."""
    training, mount = root / "training", lidar_mount("kitti_car")
    for k in range(frames):
        write_bin(training / f"velodyne/{k:06d}.bin", box_points(mount))
        write_image(training / f"image_2/{k:06d}.png", k, (SIZE_PX[0] + k, SIZE_PX[1]))
        write_text(training / f"calib/{k:06d}.txt", calibration_text())
        dont_care = "DontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1000 -1000 -1000 -10"
        write_text(training / f"label_2/{k:06d}.txt", f"{label_columns(mount)}\n{dont_care}\n")
    return root


# Sensors of View-of-Delft: camera tilted by 6.8 degrees, radar 2.5 m ahead of the lidar and 1.15 m below.
T_LIDAR_RADAR = transform((2.51, 0.06, -1.155), (0.0, 0.0, 0.006))
T_VOD_CAMERA_LIDAR = OPTICAL @ transform((-0.97, 0.15, 0.35), (0.016, -0.119, -0.008))
SPEED_MPS = 5.0


def write_view_of_delft(root: Path, frames: int = 4) -> Path:
    """View-of-Delft: driving straight at 5 m/s past the box, which therefore comes nearer by 0.5 m per frame."""
    mount = lidar_mount("view_of_delft_prius")
    T_camera_base = T_VOD_CAMERA_LIDAR @ invert(mount)
    for k in range(frames):
        nearer = invert(mount) @ planar(-0.5 * k, 0.0, 0.0)
        rows = box_points(mount)
        rows[:, :3] = apply(nearer @ mount, rows[:, :3])
        write_bin(root / f"lidar/training/velodyne/{k:05d}.bin", rows)
        bottom = CENTER_M - (0.5 * k, 0.0, SIZE_M[2] / 2)
        x, y, z = (T_camera_base @ [*bottom, 1.0])[:3]
        length, width, height = SIZE_M
        label = f"{height} {width} {length} {x:.7f} {y:.7f} {z:.7f} {-YAW - math.pi / 2:.7f} 1"
        write_text(root / f"lidar/training/label_2/{k:05d}.txt", f"Car 7 2 0 0 0 9 9 {label}\n")
        write_text(root / f"lidar/training/calib/{k:05d}.txt", calibration_text(T_VOD_CAMERA_LIDAR, False))
        T_camera_radar = T_VOD_CAMERA_LIDAR @ T_LIDAR_RADAR
        write_text(root / f"radar/training/calib/{k:05d}.txt", calibration_text(T_camera_radar, False))
        write_bin(root / f"radar/training/velodyne/{k:05d}.bin", radar_rows(mount, 0.5 * k))
        path = root / f"lidar/training/image_2/{k:05d}.jpg"
        write_image(path, 10 * k)
        T_odom_camera = (
            transform((100.0, 50.0, 0.0), (0.0, 0.0, 1.0)) @ planar(0.5 * k, 0.0, 0.0) @ invert(T_camera_base)
        )
        lines = (json.dumps({f"{name}ToCamera": T_odom_camera.ravel().tolist()}) for name in ("odom", "map", "UTM"))
        write_text(root / f"lidar/training/pose/{k:05d}.json", "\n".join(lines))
    return root


def radar_rows(mount: Float64, moved_m: float) -> np.ndarray:
    """Two detections (N, 7): the centre of the standing box, and a point of an earlier scan."""
    p = (invert(mount @ T_LIDAR_RADAR) @ [*(CENTER_M - (moved_m, 0.0, 0.0)), 1.0])[:3]
    doppler = -SPEED_MPS * float((T_LIDAR_RADAR[:3, :3].T @ [1.0, 0.0, 0.0]) @ p) / float(np.linalg.norm(p))
    return np.array([[*p, 7.5, doppler, 0.0, 0.0], [*p, 7.5, doppler, 0.0, -1.0]], "<f4")

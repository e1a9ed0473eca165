"""KITTI recording car, frames and labels for the perception benchmark; labels are in `base`, boxes bottom-centred.

Labels stand in rectified camera coordinates (y down); they are taken over the calibration into the lidar's frame. Only
what the camera saw is labelled, so that nothing outside ±40° can be called false.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recordings import DATA
from configs.strict import CONFIGS, parse, read_yaml
from configs.vehicle import Lidar, Vehicle
from geometry.arrays import Bool, Float32, Float64
from messages.sensors import LidarScan
from perception.fusion.tracks import TrackerConfig
from perception.lidar.obstacles import LidarConfig

ROOT = Path(__file__).resolve().parent.parent
FRAMES = 40
PERIOD_NS = 100_000_000
START_NS = 1_000_000_000_000
# Velodyne's manual: 32 lasers from +2° by 1/3°, 32 from -8.83° by 1/2°; 0.1728° at 10 Hz
HDL64_DEG = tuple(sorted([2.0 - k / 3 for k in range(32)] + [-8.83 - k / 2 for k in range(32)]))
# KITTI setup: lidar 1.73 m up, 0.76 m before the rear axle; a Passat B6 estate is 4.77 x 1.82 x 1.52 m
LIDAR_XYZ_M = (0.76, 0.0, 1.73)
BUMPER_M = 2.9


@cache
def car() -> Vehicle:
    """The recording car as a vehicle."""
    lidar = {
        "mount": {"xyz_m": LIDAR_XYZ_M},
        "elevation_deg": HDL64_DEG,
        "columns": 2083,
        "rate_hz": 10,
        "range_m": (0.9, 80.0),
        "range_sigma_m": 0.02,
    }
    values = {
        "name": "KITTI Passat",
        "drivetrain": {
            "kind": "ackermann", "wheelbase_m": 2.71, "track_m": 1.55, "wheel_radius_m": 0.32,
            "min_turning_radius_m": 5.7,
        },
        "body": {
            "front_m": LIDAR_XYZ_M[0] + BUMPER_M, "rear_m": 1.1, "width_m": 1.82, "height_m": 1.52, "mass_kg": 1600,
        },
        "steering": {
            "kind": "electric_wheel", "max_wheel_rpm": 60, "wheel_turns_per_steer_rad": 2.6, "dead_time_s": 0.05,
            "lag_s": 0.1, "backlash_deg": 0.1,
        },
        "brake": {"dead_time_s": 0.1, "build_up_s": 0.3, "deceleration_mps2": 8.0},
        "max_speed_kmh": 80,
        "acceleration_mps2": 2.0,
        "sensors": {"lidar": {"top": lidar}},
    }  # fmt: skip
    return parse(Vehicle, values, "KITTI's car")


def sensor() -> Lidar:
    """HDL-64E of the recording car."""
    return car().sensors.lidar["top"]


def configs() -> tuple[LidarConfig, TrackerConfig]:
    """Unchanged configuration of the stack."""
    section = read_yaml(CONFIGS / "stack/perception.yaml")
    return parse(LidarConfig, section["lidar"], "lidar"), parse(TrackerConfig, section["tracker"], "tracker")


def scan_of(points_m: Float32, stamp_ns: int) -> LidarScan:
    """A list of returns as a scan."""
    none = np.zeros(0, np.float64)
    points = np.ascontiguousarray(points_m, np.float32)
    return LidarScan(
        stamp_ns, np.zeros((0, 0), np.uint16), none, none, points, np.zeros(0, np.uint8), np.zeros(0, np.float32)
    )


def has_frames() -> bool:
    """Whether the recording is available."""
    return (DATA / "kitti-seq-pcd" / "frames").is_dir() and (DATA / "kitti-tracking-truth").is_dir()


@cache
def frame(number: int) -> Float32:
    """Returns of one scan in the lidar's frame, (N, 3)."""
    raw = _arrays(number)["xyz_5mm"]
    return np.asarray(raw.astype(np.float32) * np.float32(0.005), np.float32)


@cache
def reflectivity(number: int) -> Float32:
    """Intensity of the returns of one scan from 0 to 1, (N,)."""
    return np.asarray(_arrays(number)["intensity"].astype(np.float32) / np.float32(255.0), np.float32)


def _arrays(number: int) -> Mapping[str, Any]:
    arrays: Mapping[str, Any] = np.load(DATA / "kitti-seq-pcd" / "frames" / f"{number:06d}.npz")
    return arrays


@dataclass(frozen=True)
class Label:
    """A labelled box: `T_box_lidar` (4, 4) takes lidar coordinates to the box's (x along, z up from its bottom)."""

    id: int
    name: str
    length_m: float
    width_m: float
    height_m: float
    T_box_lidar: Float64

    def contains(self, points_m: Float32, grow_m: float = 0.0) -> Bool:
        """Which points (N, 3) of the lidar's frame lie in the box enlarged by `grow_m`."""
        p = points_m @ self.T_box_lidar[:3, :3].T.astype(np.float32) + self.T_box_lidar[:3, 3].astype(np.float32)
        level = (np.abs(p[:, 0]) <= self.length_m / 2 + grow_m) & (np.abs(p[:, 1]) <= self.width_m / 2 + grow_m)
        return np.asarray(level & (p[:, 2] >= -grow_m) & (p[:, 2] <= self.height_m + grow_m))


@cache
def labels() -> dict[int, tuple[Label, ...]]:
    """Labels by frame, without DontCare (which has no box)."""
    T_camera_lidar = _calibration()
    found: dict[int, list[Label]] = {}
    path = DATA / "kitti-tracking-truth" / "scripts" / "KITTI" / "label" / "0000.txt"
    for line in path.read_text().splitlines():
        word = line.split()
        if word[2] != "DontCare" and int(word[0]) < FRAMES:
            found.setdefault(int(word[0]), []).append(_label(int(word[1]), word[2], word[10:17], T_camera_lidar))
    return {number: tuple(those) for number, those in found.items()}


@cache
def detections() -> dict[int, tuple[Label, ...]]:
    """PointRCNN's boxes with score > 0 by frame."""
    T_camera_lidar = _calibration()
    found: dict[int, list[Label]] = {}
    for path in sorted((DATA / "kitti-tracking-truth" / "data" / "KITTI" / "detection").glob("*/0000.txt")):
        for line in path.read_text().splitlines():
            word = line.split(",")
            if float(word[6]) > 0.0 and int(word[0]) < FRAMES:
                found.setdefault(int(word[0]), []).append(_label(-1, word[1], word[7:14], T_camera_lidar))
    return {number: tuple(those) for number, those in found.items()}


def _calibration() -> Float64:
    path = DATA / "kitti-tracking-truth" / "data" / "KITTI" / "mini" / "training" / "calib" / "0000.txt"
    rows = dict(line.split(":") for line in path.read_text().splitlines() if ":" in line)
    R, T = np.eye(4), np.eye(4)
    R[:3, :3] = np.array(rows["R0_rect"].split(), float).reshape(3, 3)
    T[:3] = np.array(rows["Tr_velo_to_cam"].split(), float).reshape(3, 4)
    return np.asarray(R @ T, np.float64)


def _label(number: int, name: str, words: list[str], T_camera_lidar: Float64) -> Label:
    height, width, length, x, y, z, turn = map(float, words)
    c, s = np.cos(turn), np.sin(turn)
    # the box's axes in the camera's: length along (cos, 0, -sin), up is -y, left completes them
    T_camera_box = np.eye(4)
    T_camera_box[:3, :3] = np.array([[c, s, 0.0], [0.0, 0.0, -1.0], [-s, c, 0.0]])
    T_camera_box[:3, 3] = (x, y, z)
    return Label(number, name, length, width, height, np.linalg.inv(T_camera_box) @ T_camera_lidar)

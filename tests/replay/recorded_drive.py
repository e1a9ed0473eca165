"""Synthetic log: a car drives between boxes on flat ground, optionally towards a person, with one lidar."""

import math
from pathlib import Path

import numpy as np

from datasets.log import LogWriter
from geometry.transforms import planar
from messages.message import Envelope
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import LidarScan
from messages.truth import TrueMachine, TrueObject, TrueObjects
from runtime.stack import load_stack

START_NS = 1_700_000_000_000_000_000
ELEVATION_DEG = (-25, -21, -18, -16, -14, -12, -10, -8.5, -7, -6, -5, -4.2, -3.4, -2.7, -2, -1.3, -0.6, 0, 1, 2.5, 5, 8)
COLUMNS = 720
HEIGHT_M = 1.8
LIDAR_X_M = 1.0
VEHICLE = f"""\
name: a test car
body: {{front_m: 3.6, rear_m: 1.0, width_m: 1.8, height_m: 1.5}}
sensors:
  lidar:
    points:
      mount: {{xyz_m: [{LIDAR_X_M}, 0.0, {HEIGHT_M}]}}
      elevation_deg: {list(ELEVATION_DEG)}
      columns: {COLUMNS}
      rate_hz: 10
      range_m: [0.5, 80.0]
      range_sigma_m: 0.02
"""
# x, y, length, width, height in map: houses on both sides at varying distances
HOUSES = [(x, s * (19.0 + 2.0 * math.sin(1.3 * x)), 5.0, 4.0, 4.0) for x in range(-20, 100, 9) for s in (-1, 1)]


def cast(pose: tuple[float, float, float], boxes: list[tuple[float, ...]], rng: np.random.Generator) -> np.ndarray:
    """Ranges (mm), (rings, columns), of the lidar for a pose of the car in map."""
    x, y, yaw = pose
    el = np.radians(ELEVATION_DEG)[:, None]
    az = np.linspace(-math.pi, math.pi, COLUMNS, endpoint=False)[None] + yaw
    d = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) + 0.0 * az], axis=-1)
    origin = np.array([x + LIDAR_X_M * math.cos(yaw), y + LIDAR_X_M * math.sin(yaw), HEIGHT_M])
    with np.errstate(divide="ignore", invalid="ignore"):
        best = np.where(d[..., 2] < 0.0, -HEIGHT_M / d[..., 2], np.inf)
        for bx, by, length, width, height in boxes:
            half = 0.5 * np.array([length, width, height])
            middle = np.array([bx, by, half[2]])
            one, two = (middle - half - origin) / d, (middle + half - origin) / d
            enter, leave = np.minimum(one, two).max(axis=-1), np.maximum(one, two).min(axis=-1)
            best = np.where((enter < leave) & (enter > 0.0), np.minimum(best, enter), best)
    best = best + rng.normal(0.0, 0.01, best.shape)
    return np.where(best < 65.0, np.nan_to_num(best, posinf=0.0) * 1000.0, 0.0).astype(np.uint16)


def scan_of(stamp_ns: int, ranges_mm: np.ndarray) -> LidarScan:
    """LidarScan of the ranges of `cast`."""
    az = np.linspace(-math.pi, math.pi, COLUMNS, endpoint=False)
    return LidarScan(stamp_ns, ranges_mm, np.radians(np.array(ELEVATION_DEG, float)), az,
                     np.zeros((0, 3), np.float32), np.zeros(0, np.uint8), np.zeros(0, np.float32))  # fmt: skip


def drive(
    path: Path,
    person: tuple[float, float] | None,
    seconds: float = 6.0,
    speed_mps: float = 6.0,
    curvature_radpm: float = 0.0,
    period_s: float = 0.1,
    is_person_hidden: bool = False,
    has_truth: bool = True,
    has_odometry: bool = True,
) -> Path:
    """Writes the log of a drive at constant speed and curvature; a hidden person is only in the truth."""
    rng = np.random.default_rng(1)
    stack = load_stack().datasets
    boxes = list(HOUSES)
    if person is not None and not is_person_hidden:
        boxes.append((*person, 0.5, 0.5, 1.75))
    with LogWriter(path, {}, stack.log) as log:
        for k in range(round(seconds / period_s)):
            stamp = START_NS + round(k * period_s * 1e9)
            turn, distance = curvature_radpm * speed_mps * k * period_s, speed_mps * k * period_s
            chord = distance * np.sinc(turn / (2.0 * math.pi))
            pose = (chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn), turn)
            T, rate = planar(*pose), curvature_radpm * speed_mps
            rows = [("lidar/points", scan_of(stamp, cast(pose, boxes, rng)))]
            if has_odometry:
                rows.insert(0, ("odom", Odometry(stamp, T, speed_mps, 0.0, 0.0, rate, curvature_radpm, np.eye(6))))
            if has_truth:
                machine = TrueMachine(stamp, T.copy(), speed_mps, 0.0, rate, 0.0, np.zeros(3), 0.0, 0.0, False, 0, 0)
                objects = () if person is None else (truth_of(person),)
                rows += [("truth_machine", machine), ("truth_objects", TrueObjects(stamp, objects))]
            for topic, message in rows:
                log.write(Envelope(topic, k, stamp, message))
    return path


def truth_of(person: tuple[float, float]) -> TrueObject:
    """Standing person at a position in map."""
    return TrueObject(7, ObstacleClass.PERSON, "person", np.array([*person, 0.875]), np.array([0.5, 0.5, 1.75]), 0.0,
                      np.zeros(2), math.nan)  # fmt: skip


def vehicle_file(folder: Path) -> Path:
    """Vehicle file of the car."""
    file = folder / "car.yaml"
    file.write_text(VEHICLE)
    return file

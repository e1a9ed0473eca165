"""Lidar: ranges of a removed object are replaced by those of the neighbouring columns."""

import math
from dataclasses import replace

import numpy as np

from configs.vehicle import Lidar
from messages.sensors import LidarScan
from validation.obstacle_stop.boxes import Box
from validation.sensors import MARGIN_M


def field_of_view(lidar: Lidar) -> tuple[float, float]:
    """Half the field of view (rad) and the range (m)."""
    return math.radians(lidar.field_of_view_deg) / 2.0, lidar.range_m[1]


def remove_object(scan: LidarScan, box: Box, lidar: Lidar) -> LidarScan:
    """Scan without the returns in the box: they get the range measured beside the box in the same ring.

    The range is the larger of the medians of the nearest columns left and right, 0 without a return.
    """
    T_base_lidar = lidar.mount.T_base_sensor
    points = scan.points_m @ T_base_lidar[:3, :3].T.astype(np.float32) + T_base_lidar[:3, 3].astype(np.float32)
    # returns of the ground around the object stay
    ground_margin_m = box.center_m[2] - 0.5 * box.size_m[2] + 0.05
    mine = box.contains(points, MARGIN_M) & (points[:, 2] > ground_margin_m)
    if not mine.any():
        return scan
    if scan.ranges_mm.size == 0:
        return _turn_to_ground(scan, mine)
    ring, column = np.nonzero(scan.ranges_mm)
    ranges = scan.ranges_mm.copy()
    for r in np.unique(ring[mine]).tolist():
        ranges[r, column[mine & (ring == r)]] = range_behind(scan.ranges_mm[r], np.sort(column[mine & (ring == r)]))
    return replace(scan, ranges_mm=ranges, intensity=np.zeros(0, np.uint8))


def range_behind(row_mm: np.ndarray, columns: np.ndarray) -> int:
    """Range (mm) beside the columns of a ring: the larger median of both sides, 0 without returns."""
    n = len(row_mm)
    beside = (
        [int(row_mm[(columns[0] - k) % n]) for k in (2, 3, 4)],
        [int(row_mm[(columns[-1] + k) % n]) for k in (2, 3, 4)],
    )
    medians = [sorted(values)[1] for values in beside]
    return max(medians)


def _turn_to_ground(scan: LidarScan, gone: np.ndarray) -> LidarScan:
    """Moves the returns of a point list along their direction to the ground, at most 60 m away."""
    xyz = scan.xyz_m.copy()
    direction = xyz[gone] / np.maximum(np.linalg.norm(xyz[gone], axis=1, keepdims=True), 1e-6)
    xyz[gone] = direction * np.where(np.abs(direction[:, 2:]) > 1e-3, ground_range_m(direction), 60.0)
    return replace(scan, xyz_m=xyz.astype(np.float32))


def ground_range_m(direction: np.ndarray, height_m: float = 1.7, max_m: float = 60.0) -> np.ndarray:
    """Distance along each direction (N, 3) to level ground below the sensor, at most `max_m`, (N, 1)."""
    down = np.where(direction[:, 2:] < -math.sin(math.radians(0.5)), -direction[:, 2:], np.nan)
    range_m = np.nan_to_num(height_m / down, nan=max_m)
    return np.minimum(range_m, max_m)

"""An object taken out of scans: its returns replaced by what stands behind it, so that a miss can be provoked."""

import math
from dataclasses import replace

import numpy as np

from messages.message import Float64
from messages.sensors import LidarScan
from validation.obstacle_stop.boxes import Box

MARGIN_M = 0.3


def without(scan: LidarScan, box: Box, T_base_lidar: Float64) -> LidarScan:
    """The scan without the box's returns: each beam goes on to the ground behind, or to nothing.

    Beside a range image's own neighbours nothing is known of what is behind; the median of the nearest columns to the
    left and right of the box in the same ring stands for it.
    """
    points = scan.points_m @ T_base_lidar[:3, :3].T.astype(np.float32) + T_base_lidar[:3, 3].astype(np.float32)
    mine = box.contains(points, MARGIN_M)
    if not mine.any():
        return scan
    if scan.ranges_mm.size == 0:
        return _thinned(scan, ~mine)
    ring, column = np.nonzero(scan.ranges_mm)
    ranges = scan.ranges_mm.copy()
    for r in np.unique(ring[mine]).tolist():
        ranges[r, column[mine & (ring == r)]] = behind(scan.ranges_mm[r], np.sort(column[mine & (ring == r)]))
    return replace(scan, ranges_mm=ranges, intensity=np.zeros(0, np.uint8))


def behind(row_mm: np.ndarray, columns: np.ndarray) -> int:
    """What the beams beside a gap in a ring measure: the farther of both sides, 0 (nothing came back) without any."""
    n = len(row_mm)
    beside = (
        [int(row_mm[(columns[0] - k) % n]) for k in (2, 3, 4)],
        [int(row_mm[(columns[-1] + k) % n]) for k in (2, 3, 4)],
    )
    medians = [sorted(values)[1] for values in beside]
    return max(medians)


def _thinned(scan: LidarScan, keep: np.ndarray) -> LidarScan:
    """A list of points cannot show what is behind: its beams are turned to the ground far off instead of lost."""
    xyz = scan.xyz_m.copy()
    gone = ~keep
    direction = xyz[gone] / np.maximum(np.linalg.norm(xyz[gone], axis=1, keepdims=True), 1e-6)
    xyz[gone] = direction * np.where(np.abs(direction[:, 2:]) > 1e-3, far_m(direction), 60.0)
    return replace(scan, xyz_m=xyz.astype(np.float32))


def far_m(direction: np.ndarray, height_m: float = 1.7, most_m: float = 60.0) -> np.ndarray:
    """Way along each direction (N, 3) to level ground below the sensor, at most `most_m`, (N, 1)."""
    down = np.where(direction[:, 2:] < -math.sin(math.radians(0.5)), -direction[:, 2:], np.nan)
    way = np.nan_to_num(height_m / down, nan=most_m)
    return np.minimum(way, most_m)

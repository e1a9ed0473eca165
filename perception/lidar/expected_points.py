"""Expected number of returns of a cluster: a surface fills its outline with returns, scattered noise does not."""

from dataclasses import dataclass

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Float64


@dataclass(frozen=True)
class Beams:
    """Beams of a lidar: origin in `base`, sorted elevation tangents of its rings, angle between columns."""

    origin_m: Float64
    tangents: Float64
    column_rad: float


def beams_of(lidar: Lidar) -> Beams:
    """Beams of a sensor model at its mount; tilt is neglected, since only densities are needed."""
    tangents = np.sort(np.tan(np.radians(np.array(lidar.elevation_deg))))
    return Beams(lidar.mount.T_base_sensor[:3, 3], tangents, float(np.radians(lidar.field_of_view_deg / lidar.columns)))


def expected_points(beams: Beams, center_m: Float64, size_m: Float64, yaw_rad: Float64) -> Float64:
    """Beams (K,) that cross the outline of boxes as seen from the lidar, at least one ring and one column."""
    offset = center_m - beams.origin_m
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 0.5)
    angle = np.arctan2(offset[:, 1], offset[:, 0]) - yaw_rad
    across = np.abs(size_m[:, 0] * np.sin(angle)) + np.abs(size_m[:, 1] * np.cos(angle))
    low, high = (offset[:, 2] - size_m[:, 2] / 2) / distance, (offset[:, 2] + size_m[:, 2] / 2) / distance
    rings = np.searchsorted(beams.tangents, high) - np.searchsorted(beams.tangents, low)
    return np.asarray(np.maximum(across / distance / beams.column_rad, 1.0) * np.maximum(rings, 1), np.float64)

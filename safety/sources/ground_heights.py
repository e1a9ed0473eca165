"""Heights of the ground near a lidar by cells of odom: the lowest return of each."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int64
from geometry.ground_surface import lowest_of_cells
from geometry.pose2 import to_frame
from safety.sources.multiple_evaluation import cell_keys


@dataclass(frozen=True)
class GroundHeights:
    """Sorted cells (K,) of odom and the height (K,) in base of the lowest return in each, m."""

    cells: Int64
    height_m: Float64


NO_GROUND = GroundHeights(np.empty(0, np.int64), np.empty(0))


def ground_heights(xyz: Float32, origin_m: Float64, range_m: float, pose_odom: Float64, cell_m: float) -> GroundHeights:
    """Heights by the returns (3, N) in base of beams that meet level ground within a range of the sensor."""
    x, y, z = (xyz[row] - origin_m[row] for row in range(3))
    near = xyz.compress(z * range_m <= -origin_m[2] * np.hypot(x, y), axis=1).astype(np.float64)
    keys = cell_keys(np.column_stack([to_frame(pose_odom, near[:2].T), np.zeros(near.shape[1])]), cell_m)
    z = near[2]
    lowest = lowest_of_cells(np.argsort(keys), keys, z)
    return GroundHeights(keys[lowest], z[lowest])

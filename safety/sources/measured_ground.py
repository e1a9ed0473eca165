"""Measured ground: what the bounded plane of the ground filter calls an obstacle must stand above the ground around it.

Waves and crests rise out of the plane through the wheels, and that plane tilts with the machine. The lowest returns of
each cell, raised by a slope with the distance from it, bound the ground from above: the lowest such bound at a place is
its measured ground. Where there is one, more returns can only lower it, and an object is seen above the ground beside
it.

z   bound of A: slope │ × counts: above the lowest bound by the minimum height
    A _____________---│ · does not: the rise from A explains it
    ^ lowest returns of a cell

The wheels stand on the ground: a lidar whose ground beside them lies elsewhere is misaligned, and one whose ground does
not reach there, nor a plane through it, proves nothing. Both keep every return above the plane, as does a place without
ground around it. Beyond `range_m`, where the slope from the nearest ground could explain a small body, planes through
the cells around it bound the ground instead. Such planes also level what the rise explains, for the near field to find
who lies on a slope.
"""

from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import Float32, Float64, Int64, median
from geometry.ground_surface import cells_in_grid, envelope, heights_above_planes, plane_sums
from safety.config import FieldConfig, MeasuredGroundConfig
from safety.sources.ground_filter import WHEELS_X_M, estimate_ground
from safety.zones.footprint import Box

RIDGE = 0.1  # keeps a plane through cells in one row level across it, in squares of cells


@dataclass(frozen=True)
class Cells:
    """Grid about a box: middle of the cells along x (R,) and y (C,), and the cell of each return (N,)."""

    x_m: Float64
    y_m: Float64
    of: Int64

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.x_m), len(self.y_m)

    def low_m(self, z: Float32, returns: int, share: float) -> Float64:
        """Lowest returns of each cell (R, C) as in `estimate_ground`."""
        rows, columns = self.shape
        return estimate_ground(self.of, z, rows * columns, returns, share).reshape(self.shape)


def cells_of(xyz: Float32, box: Box, size_m: float) -> Cells:
    """Cells of returns (3, N); those beyond the box belong to its outermost cells."""
    x0, y0 = np.floor(box.x_m[0] / size_m), np.floor(box.y_m[0] / size_m)
    rows, columns = (int(np.floor(high / size_m) - low) + 1 for high, low in ((box.x_m[1], x0), (box.y_m[1], y0)))
    x_m, y_m = (np.arange(rows) + x0 + 0.5) * size_m, (np.arange(columns) + y0 + 0.5) * size_m
    return Cells(x_m, y_m, cells_in_grid(xyz, (x0, y0), (rows, columns), size_m))


def stands_out(
    xyz: Float32, is_above_plane: np.ndarray, box: Box, field: FieldConfig, config: MeasuredGroundConfig
) -> np.ndarray:
    """Which of the returns (3, N) above the plane, (N,) bool, also stand above the measured ground, (N,) bool."""
    if not is_above_plane.any():
        return is_above_plane
    cells = cells_of(xyz, box, config.cell_m)
    low_m = cells.low_m(xyz[2], config.returns, 0.0)
    bound_m = lowest_bound(low_m, config)
    if not is_below_wheels(low_m, bound_m, cells.x_m - WHEELS_X_M, cells.y_m, config):
        return is_above_plane
    above = np.flatnonzero(is_above_plane)
    x, y, z = some = xyz.take(above, axis=1)
    of = cells.of.take(above)
    ground_m = bound_m.ravel()[of]
    distance_m = np.hypot(x, y)
    least_m, is_far = field.min_height_m + field.min_height_slope * distance_m, distance_m > config.range_m
    if is_far.any():
        far = np.flatnonzero(is_far)
        z[far] = heights_above(low_m, bound_m, replace(cells, of=of.take(far)), some.take(far, axis=1), config)
    is_obstacle = is_above_plane.copy()
    is_obstacle[above] = (z > np.where(is_far, 0.0, ground_m) + least_m) | np.isinf(ground_m)
    return is_obstacle


def is_below_wheels(low_m: Float64, bound_m: Float64, x_m: Float64, y_m: Float64, config: MeasuredGroundConfig) -> bool:
    """Whether the ground of cells (R, C), x (R,) and y (C,) from the wheels, is that on which they stand.

    Where a lidar sees none near them, as from behind the implement, a plane through the ground that it sees reaches
    there; cells above the bound (R, C) are no ground.
    """
    distance_m = np.hypot(x_m[:, None], y_m)
    near = low_m[(distance_m <= config.wheels_m) & np.isfinite(low_m)]
    if len(near) >= config.wheels_cells:
        return abs(median(near)) <= config.wheels_tolerance_m
    x, y = np.nonzero(np.isfinite(low_m) & (low_m <= bound_m) & (distance_m <= config.wheels_plane_m))
    if len(x) < config.plane_cells:
        return False
    places = np.column_stack([np.ones(len(x)), x_m[x], y_m[y]])
    (height_m, *_), _, rank, _ = np.linalg.lstsq(places, low_m[x, y], rcond=None)
    return bool(rank == 3 and abs(height_m) <= config.wheels_tolerance_m)


def lowest_bound(low_m: Float64, config: MeasuredGroundConfig) -> Float64:
    """Lowest of the bounds from each cell (R, C) within reach; infinite without any ground there."""
    return envelope(low_m, config.slope * config.cell_m, config.reach_cells)


def level(xyz: Float32, box: Box, share: float, config: MeasuredGroundConfig) -> Float32:
    """Returns (3, N) with their height above the plane through the low returns of the cells around each.

    `share`: quantile of the heights in a cell that is its ground, unless the cell stands out of those around it: a wall
    would tilt the plane. Unchanged where fewer than `plane_cells` have any.
    """
    cells = cells_of(xyz, box, config.cell_m)
    low_m = cells.low_m(xyz[2], config.returns, share)
    return np.stack([xyz[0], xyz[1], heights_above(low_m, lowest_bound(low_m, config), cells, xyz, config)])


def heights_above(
    low_m: Float64, bound_m: Float64, cells: Cells, xyz: Float32, config: MeasuredGroundConfig
) -> Float32:  # fmt: skip
    """Height (N,) of returns (3, N) above the planes through the low returns (R, C) of the cells around theirs.

    Cells above the bound (R, C) do not count; where fewer than `plane_cells` do, the plane is z = 0.
    """
    sums = plane_sums(low_m, np.isfinite(low_m) & (low_m <= bound_m), config.plane_reach_cells).reshape(-1, 9)
    is_found = np.zeros(len(sums), bool)
    is_found[cells.of] = True
    is_found &= sums[:, 0] >= config.plane_cells
    found, planes = sums[is_found], np.zeros((len(sums), 3))
    normal = found[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) + np.diag([0.0, RIDGE, RIDGE])
    planes[is_found] = np.linalg.solve(normal, found[:, 6:, None])[..., 0]
    middle_m = float(cells.x_m[0]), float(cells.y_m[0])
    return heights_above_planes(xyz, cells.of, planes, middle_m, config.cell_m).astype(np.float32)

"""Near field: low objects on the measured ground around machine and implement.

The ground filter counts from 0.25 m above a plane through the wheels, because the ground itself reaches that height
farther away. Lidars that look down have enough returns near the machine to measure the ground in cells of 0.5 m: one
counts there from 0.12 m above it, or from what the roughness of the ground requires if that is more. Plants and clods
return some of the beams that pass a place, a body most of those of a patch: dense ones in three scans count from 0.12 m
on any ground.
Others have their first ring metres away, and reflections there lie below the ground.
"""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.ground_surface import heights_above_ground
from safety.config import NearFieldConfig
from safety.sources.measured_ground import window_sums
from safety.zones.footprint import Box, Footprint

MIN_CELLS = 2  # in each direction, for interpolation


@dataclass(frozen=True)
class NearField:
    """Whether each return is above the ground, (N,) bool; `min_height_m` is the least height that counts.

    `is_dense` (N,) bool: in a patch where most are above the ground, from the least height on level ground.
    """

    is_obstacle: np.ndarray
    is_dense: np.ndarray
    min_height_m: float


def mark_low_obstacles(xyz: Float32, box: Box, config: NearFieldConfig) -> NearField:
    """Returns (3, N), none of them on the machine itself, that stand out of the ground in the box."""
    (x_low, x_high), (y_low, y_high) = box.x_m, box.y_m
    inside = np.flatnonzero((xyz[0] > x_low) & (xyz[0] < x_high) & (xyz[1] > y_low) & (xyz[1] < y_high))
    is_obstacle, is_dense = np.zeros((2, xyz.shape[1]), bool)
    if len(inside) == 0:
        return NearField(is_obstacle, is_dense, config.min_height_m)
    shape = (cells(x_high - x_low, config.cell_m), cells(y_high - y_low, config.cell_m))
    height_m, tops_m = heights_above_ground(
        np.ascontiguousarray(xyz[:, inside]), (x_low, y_low), shape, config.cell_m, config.ground_quantile,
        config.max_slope, config.max_residual_slope, config.max_roughness_m,
    )  # fmt: skip
    min_height_m = max(config.min_height_m, config.roughness_factor * roughness_m(tops_m, config))
    is_obstacle[inside] = height_m > min_height_m
    is_dense[inside] = in_dense_patch(xyz[:2, inside], height_m, config)
    return NearField(is_obstacle, is_dense, min_height_m)


def in_dense_patch(xy: Float32, height_m: Float64, config: NearFieldConfig) -> np.ndarray:
    """Which returns (2, N) stand out of the mean surface with a share of all those around them, (N,) bool.

    The mean, of their heights above the low ground, is above ruts and furrows, which lower that.
    """
    row, column = np.floor((xy - xy.min(axis=1, keepdims=True)) / config.dense_cell_m).astype(np.int64)
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    cell = row * shape[1] + column

    def sums(values: Float64 | None, reach: int) -> Float64:
        layer = np.bincount(cell, values, shape[0] * shape[1]).astype(np.float64).reshape(1, *shape)
        return np.asarray(window_sums(layer, reach).ravel()[cell])

    mean_m = sums(height_m, config.dense_reach_cells) / sums(None, config.dense_reach_cells)
    is_high = height_m - mean_m > config.dense_rise_m
    around = sums(is_high.astype(np.float64), 1)
    return np.asarray(is_high & (around >= config.dense_returns) & (around >= config.dense_share * sums(None, 1)))


def near_box(footprint: Footprint, config: NearFieldConfig) -> Box:
    """Area around machine and implement in which the ground is measured, whatever the swept field is."""
    front_m, rear_m = footprint.foremost_m(1) + config.range_m, footprint.foremost_m(-1) - config.range_m
    bodies = footprint.rigid if footprint.trailed is None else (*footprint.rigid, footprint.trailed)
    half_m = max(body.half_width_m for body in bodies) + config.aside_m
    return Box((rear_m, front_m), (-half_m, half_m))


def cells(length_m: float, cell_m: float) -> int:
    """Number of cells over a length, enough to interpolate between."""
    return max(MIN_CELLS, int(np.ceil(length_m / cell_m)))


def roughness_m(tops_m: Float64, config: NearFieldConfig) -> float:
    """High quantile of the heights to which the ground reaches in each cell: objects are in few of the cells."""
    return float(np.quantile(tops_m, config.roughness_quantile)) if len(tops_m) else 0.0

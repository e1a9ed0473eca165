"""Near field: low objects on the measured ground around machine and implement.

The ground filter counts from 0.25 m above a plane through the wheels, because the ground itself reaches that height
farther away. Lidars that look down have enough returns near the machine to measure the ground in cells of 0.5 m: one
counts there from 0.12 m above it, or from what the roughness of the ground requires if that is more, and if it is not
one of a few in its cell: noise on single plants. Others have their first ring metres away, and reflections there lie
below the ground.
"""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.ground_surface import heights_above_ground
from safety.config import NearFieldConfig
from safety.zones.footprint import Box, Footprint

MIN_CELLS = 2  # in each direction, for interpolation


@dataclass(frozen=True)
class NearField:
    """Whether each return is above the ground, (N,) bool; `min_height_m` is the least height that counts."""

    is_obstacle: np.ndarray
    min_height_m: float


def mark_low_obstacles(xyz: Float32, box: Box, config: NearFieldConfig) -> NearField:
    """Returns (3, N), none of them on the machine itself, that stand out of the ground in the box."""
    (x_low, x_high), (y_low, y_high) = box.x_m, box.y_m
    inside = np.flatnonzero((xyz[0] > x_low) & (xyz[0] < x_high) & (xyz[1] > y_low) & (xyz[1] < y_high))
    is_obstacle = np.zeros(xyz.shape[1], bool)
    if len(inside) == 0:
        return NearField(is_obstacle, config.min_height_m)
    shape = (cells(x_high - x_low, config.cell_m), cells(y_high - y_low, config.cell_m))
    height_m, tops_m = heights_above_ground(
        np.ascontiguousarray(xyz[:, inside]), (x_low, y_low), shape, config.cell_m, config.ground_quantile,
        config.max_slope, config.max_residual_slope, config.max_roughness_m,
    )  # fmt: skip
    min_height_m = max(config.min_height_m, config.roughness_factor * roughness_m(tops_m, config))
    is_above = height_m > min_height_m
    if is_above.any():
        row, column = ((xyz[k, inside] - low) // config.cell_m for k, low in enumerate((x_low, y_low)))
        cell = (row * shape[1] + column).astype(np.int64)
        is_above &= np.bincount(cell, is_above)[cell] >= config.min_share * np.bincount(cell)[cell]
    is_obstacle[inside] = is_above
    return NearField(is_obstacle, min_height_m)


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

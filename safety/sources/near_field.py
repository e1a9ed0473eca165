"""Near field: low objects on the measured ground around machine and implement.

The ground filter counts from 0.25 m above a plane through the wheels, because the ground itself reaches that height
farther away. Lidars that look down have enough returns near the machine to measure the ground in cells of 0.5 m: one
counts there from 0.12 m above it, or from what the roughness of the ground about it requires if that is more: less
where many returns of its cell are so high, and never if only a few are: noise on single plants. Others, with their
first ring metres away, do so where no lidar that looks down covers.

Plants cover many cells and are about as high in each: what does not stand out of them is no obstacle where the mission
consents to plants of that height.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Float32, Float64, quantile
from geometry.ground_surface import (
    broad_tops,
    cells_in_grid,
    heights_above_ground,
    plant_heights,
    stand_out_of_cell,
    typical_of_blocks,
)
from safety.config import NearFieldConfig, VegetationConfig
from safety.sources.detection_range import covers
from safety.sources.ground_filter import WHEELS_X_M
from safety.zones.footprint import Box, Footprint

BLOCK_CELLS, BLOCK_LEAST = 5, 8  # of the roughness of a place: its cells to either side, and the least that show it
MIN_CELLS = 2  # in each direction, for interpolation


@dataclass(frozen=True)
class NearField:
    """Returns that stand out of the ground.

    `is_obstacle` (N,) bool: above the ground and no plant; `is_plant` (N,) bool: within plants that the mission
    consents to. `is_dense` (N,) bool: obstacle only because many returns of its cell are so high. `is_hidden` (N,)
    bool: higher than counts on smooth ground, but not than on the ground about. `height_m` (N,): above the ground, 0
    beyond the box. `min_height_m`: least height that counts on ground as rough as most of it. `vegetation_m`: height of
    the plants that cover most of the ground.
    """

    is_obstacle: np.ndarray
    is_dense: np.ndarray
    is_plant: np.ndarray
    is_hidden: np.ndarray
    height_m: np.ndarray
    min_height_m: float
    vegetation_m: float


def mark_low_obstacles(
    xyz: Float32, box: Box, config: NearFieldConfig, vegetation: VegetationConfig, consented_m: float
) -> NearField:
    """Returns (3, N), none of them on the machine itself, that stand out of the ground in the box.

    `consented_m`: height of plants up to which the mission consents to objects that they hide.
    """
    (x_low, x_high), (y_low, y_high) = box.x_m, box.y_m
    inside = np.flatnonzero((xyz[0] > x_low) & (xyz[0] < x_high) & (xyz[1] > y_low) & (xyz[1] < y_high))
    is_obstacle, is_dense, is_plant, is_hidden = np.zeros((4, xyz.shape[1]), bool)
    above_m = np.zeros(xyz.shape[1])
    if len(inside) == 0:
        return NearField(is_obstacle, is_dense, is_plant, is_hidden, above_m, config.min_height_m, 0.0)
    near_xyz = xyz.take(inside, axis=1)
    shape = (cells(x_high - x_low, config.cell_m), cells(y_high - y_low, config.cell_m))
    height_m, (top_z_m, tops_m, ground_tops_m) = heights_above_ground(
        near_xyz, (x_low, y_low), shape, config.cell_m, config.ground_quantile,
        config.max_slope, config.max_residual_slope, config.max_roughness_m,
    )  # fmt: skip
    x_m, y_m = (low + config.cell_m * (np.arange(n) + 0.5) for low, n in ((x_low, shape[0]), (y_low, shape[1])))
    is_near = np.hypot(x_m[:, None] - WHEELS_X_M, y_m) <= vegetation.wheels_m
    even_m, plants_m = even_plants_m(tops_m, top_z_m[is_near], vegetation), np.zeros(shape)
    if consented_m > 0.0:
        plants_m = heights_of_plants(tops_m, vegetation, even_m, consented_m)
    is_ground = (plants_m == 0.0) | (even_m == 0.0)  # a few cells may be rough ground just as well
    rough_m = quantile_of(ground_tops_m[is_ground], config.roughness_quantile)
    min_height_m = max(config.min_height_m, config.roughness_factor * rough_m)
    local_m = typical_of_blocks(
        np.where(is_ground, ground_tops_m, np.inf), BLOCK_CELLS, config.roughness_quantile, BLOCK_LEAST
    )
    broad_m = broad_tops(tops_m)
    at = cells_in_grid(near_xyz, (x_low / config.cell_m, y_low / config.cell_m), shape, config.cell_m)
    least_m, dense_m = (
        np.minimum(
            max(config.min_height_m, factor * rough_m), broad_m + np.maximum(config.min_height_m, factor * local_m)
        ).reshape(-1)[at]  # of each return
        for factor in (config.roughness_factor, config.dense_factor)
    )
    if (height_m > dense_m).any() or plants_m.any():
        limits = config.cell_m, least_m, dense_m, vegetation.margin_m
        counts = (config.min_share, config.dense_share), config.dense_returns, config.dense_width_m
        is_obstacle[inside], is_plant[inside] = stand_out_of_cell(
            near_xyz, height_m, plants_m, (x_low, y_low), *limits, *counts
        )
        half_m = 0.5 * config.cell_m  # a body that lies across the edges of cells fills one of shifted cells
        for corner in ((x_low - half_m, y_low), (x_low, y_low - half_m), (x_low - half_m, y_low - half_m)):
            some, _ = stand_out_of_cell(near_xyz, height_m, plants_m, corner, *limits, *counts)
            is_obstacle[inside] |= some & (height_m <= least_m) & ~is_plant[inside]
        is_dense[inside] = is_obstacle[inside] & (height_m <= least_m)
    else:
        is_obstacle[inside] = height_m > least_m
    is_hidden[inside] = (height_m > config.min_height_m) & (height_m <= least_m)
    above_m[inside] = height_m
    return NearField(is_obstacle, is_dense, is_plant, is_hidden, above_m, min_height_m, even_m)


def heights_of_plants(tops_m: Float64, config: VegetationConfig, even_m: float, consented_m: float) -> Float64:
    """Height of the plants about each cell (R, C), from the tops of cells; 0 where there are none or too high ones.

    `even_m`: height of plants that cover most of the cells; they count in all, since plants also hide the ground.
    """
    highest_m = consented_m + config.uncertainty_m
    steps = np.ones(tops_m.shape[1], np.int64)
    found_m = plant_heights(tops_m, config.reach_cells, steps, config.min_height_m, highest_m, config.share)
    return np.maximum(found_m, even_m if even_m <= highest_m else 0.0)


def even_plants_m(tops_m: Float64, near_top_z_m: Float64, config: VegetationConfig) -> float:
    """Height of plants that cover at least a share of the cells (R, C) with the tops; 0 where they are low or too high.

    The ground under dense plants is not seen, and what is found there lies within them: near the wheels (K,) the plane
    on which these stand is the ground, where the plants make the surface rough; waves of the ground are smooth. Few
    cells are no evidence: walls beside a machine in its shed reach to all heights.
    """
    height_m = 0.0
    if np.count_nonzero(np.isfinite(tops_m)) >= config.min_cells:
        height_m = quantile_of(tops_m, 1.0 - config.share)
        is_rough = config.min_texture_m <= height_m <= config.max_height_m
        if is_rough and np.count_nonzero(np.isfinite(near_top_z_m)) >= config.min_near_cells:
            low_m, surface_m = (quantile_of(near_top_z_m, share) for share in (0.25, 1.0 - config.share))
            height_m = max(height_m, surface_m if low_m >= 0.5 * surface_m else 0.0)  # else a slope
    return height_m if config.min_height_m < height_m <= config.max_height_m else 0.0


def ground_lidars(lidars: Mapping[str, Lidar], footprint: Footprint) -> frozenset[str]:
    """Names of the lidars that detect low objects: those that look down, and others where none of these covers."""
    down = {d for one in lidars.values() if one.looks_down for d in (1, -1) if covers(one, footprint, d)}
    return frozenset(
        name for name, one in lidars.items()
        if one.looks_down or any(covers(one, footprint, d) for d in {1, -1} - down)
    )  # fmt: skip


def near_box(footprint: Footprint, config: NearFieldConfig) -> Box:
    """Area around machine and implement in which the ground is measured, whatever the swept field is."""
    front_m, rear_m = footprint.foremost_m(1) + config.range_m, footprint.foremost_m(-1) - config.range_m
    bodies = footprint.rigid if footprint.trailed is None else (*footprint.rigid, footprint.trailed)
    half_m = max(body.half_width_m for body in bodies) + config.aside_m
    return Box((rear_m, front_m), (-half_m, half_m))


def cells(length_m: float, cell_m: float) -> int:
    """Number of cells over a length, enough to interpolate between."""
    return max(MIN_CELLS, int(np.ceil(length_m / cell_m)))


def quantile_of(tops_m: Float64, share: float) -> float:
    """Quantile of the heights to which cells reach, but infinite ones; 0 without any."""
    known = tops_m[np.isfinite(tops_m)]
    return quantile(known, share) if len(known) else 0.0

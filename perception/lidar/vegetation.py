"""Plants that cover the ground: cells around a sensor whose tops are about as high as those of their neighbours.

       ,  ,   o   , ,                 top of a cell: its second highest return above the ground
      ||,|||,/|\\,|||||,|              plants: upper quartile of such tops in the cells around it
    --||||||||||||||||||-- ground      counts: what is higher than the plants by the margin

A body covers few of the cells. The ground between dense plants is not seen, and what is found there lies within them.
"""

import numpy as np
from pydantic import Field
from scipy.ndimage import maximum_filter

from configs.strict import Config
from geometry.arrays import Float32, Float64, Int32
from geometry.ground_surface import plant_heights, second_largest
from perception.lidar.grid import Grid

REACH = 2  # sectors and bins to either side over which plants are even
WIDTH_M = 1.8  # to either side at least, at any distance: a body that lies across covers less than half of it


class VegetationConfig(Config):
    """Heights of plants above the ground that is found, and how much higher than plants an obstacle is."""

    range_m: float = Field(ge=3.0, le=80.0, description="within which plants rise above the ground that is found")
    min_height_m: float = Field(gt=0.0, le=1.0)
    max_height_m: float = Field(gt=0.0, le=2.0)
    margin_m: float = Field(ge=0.0, le=0.5)
    share: float = Field(gt=0.0, le=1.0, description="of the cells around that plants cover, and a body does not")
    min_share: float = Field(ge=0.0, le=1.0, description="of all cells with such tops; fewer are not examined")


def plants(z: Float32, starts: Int32, surface_m: Float64, grid: Grid, config: VegetationConfig) -> Float64 | None:
    """Height (sectors, bins) below which a return above the surface is a plant, 0 where there are none; None: nowhere.

    `z`, `starts`: heights sorted by cell, as of `sort_into_cells`; `surface_m` (sectors, bins): the ground.
    """
    bins = int(np.searchsorted(grid.range_m, config.range_m))
    tops = (second_largest(z, starts, np.inf).reshape(surface_m.shape) - surface_m)[:, :bins]
    known = tops[np.isfinite(tops)]
    is_plant = (known > config.min_height_m) & (known <= config.max_height_m)
    if np.count_nonzero(is_plant) <= config.min_share * len(known):
        return None
    steps = np.ceil(WIDTH_M * grid.sectors / (REACH * 2.0 * np.pi * grid.range_m[:bins])).astype(np.int64)
    steps = np.minimum(steps, grid.sectors // (8 * REACH))  # an eighth of a turn
    wrap = REACH * steps.max()
    around = np.concatenate([tops[-wrap:], tops, tops[:wrap]])
    limits = config.min_height_m, config.max_height_m, config.share
    height_m = plant_heights(around, REACH, steps, *limits)[wrap:-wrap]
    height_m = maximum_filter(height_m, 2 * REACH + 1, mode=("wrap", "nearest"))  # to the edge of the plants
    found = np.zeros(surface_m.shape)
    found[:, :bins] = np.where(height_m > 0.0, height_m + config.margin_m, 0.0)
    return found


def is_within(height_m: Float32, polar: Float32, plants_m: Float64 | None) -> np.ndarray:
    """Whether each return, by its height above the ground and its sector and bin (N, 2), is of plants, (N,) bool."""
    if plants_m is None:
        return np.zeros(len(height_m), bool)
    sector, at = polar[:, 0].astype(np.int64), polar[:, 1].astype(np.int64)
    plant_m = plants_m[sector, np.minimum(at, plants_m.shape[1] - 1)]
    return np.asarray((polar[:, 1] >= 0.0) & (plant_m > 0.0) & (height_m <= plant_m))

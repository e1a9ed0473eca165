"""Height of the ground under every return, propagated outwards from the machine over a polar grid.

    sectors (angle) x bins (range, wider with distance)       per cell, nearest bins first:
                 _.-'|   |     |        |                      1 predict from the cells before it (local plane)
      sensor  o-.----|---|-----|--------|--> range             2 lowest dense layer of returns near the prediction
                 `-._|   |     |        |                      3 accept it as ground, or keep the prediction
                                                               then smooth, rejecting cells off their neighbours' plane

Propagation starts at the plane z = 0 of `base`, the ground under the machine. No ring structure is assumed, so that
unordered or thinned returns of any lidar are treated alike.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.jit import kernel
from perception.lidar.grid import Grid, heights_above, sort_into_cells
from perception.lidar.vegetation import VegetationConfig, is_within, plants

LAYER_M = 0.05  # height resolution of the search for the lowest dense layer
MAX_LAYERS = 64
GROUND_LAYERS = 5  # thickness of ground in layers: furrows, stubble, noise
BINS_BEFORE = 4  # number of nearer bins that predict a cell
SECTORS_ASIDE = 3  # sectors to either side that predict it
SECTOR_WEIGHT = 1.0 / (1.0 + np.arange(-SECTORS_ASIDE, SECTORS_ASIDE + 1.0) ** 2)
SLOPE_RIDGE_M2 = 0.15  # one cell beside another, 1 m off, has 0.3
BLUR = 1.0 / (1.0 + np.arange(-2.0, 3.0)[:, None] ** 2 + 2.0 * np.arange(-1.0, 2.0)[None] ** 2)  # sectors by bins


class GroundConfig(Config):
    """Polar grid, greatest slope of ground, and height above ground of obstacle points."""

    sector_deg: float = Field(ge=0.5, le=10.0)
    first_bin_m: float = Field(ge=0.2, le=5.0)
    bin_growth: float = Field(ge=0.0, le=0.2, description="widening of bins with distance, m/m")
    max_range_m: float = Field(ge=10.0, le=200.0)
    max_slope: float = Field(gt=0.0, le=1.0, description="against the machine's own plane, m/m")
    step_m: float = Field(gt=0.0, le=0.5, description="unevenness taken as ground from cell to cell")
    obstacle_height_m: float = Field(gt=0.05, le=1.0, description="height above ground of an obstacle point")
    obstacle_height_growth: float = Field(ge=0.0, le=0.02, description="added per metre of distance, m/m")
    low_point_depth_m: float = Field(
        gt=0.0, le=0.5, description="depth below ground of low points that may join a cluster"
    )
    vegetation: VegetationConfig


@dataclass(frozen=True)
class Ground:
    """Ground surface: `height_m` (N,) of each return above it (NaN: not used), and the cells of the grid.

    `is_plant` (N,) bool: within plants that cover the ground. `sector` (N,) is the azimuth of each return in sectors,
    counter-clockwise from the rear. `cell_height_m` and `cell_weight` (sectors, bins): height of the ground in `base`,
    and weight of its returns (0 = predicted only).
    """

    height_m: Float32
    is_plant: np.ndarray
    sector: Float32
    cell_height_m: Float64
    cell_weight: Float64


def find_ground(points_base_m: Float32, usable: UInt8, center_m: Float64, grid: Grid, config: GroundConfig) -> Ground:
    """Ground below returns (N, 3) in `base` of a sensor at `center_m` (2,)."""
    polar, starts, z = sort_into_cells(points_base_m, usable, center_m, grid)
    height, weight = np.zeros((2, grid.sectors, grid.bins))
    _propagate(z, starts, grid.range_m, config.max_slope, config.step_m, height, weight)
    smooth = _smooth(height, weight, grid.range_m, config.step_m)
    above = heights_above(points_base_m, polar, smooth)
    is_plant = is_within(above, polar, plants(z, starts, smooth, grid, config.vegetation))
    return Ground(above, is_plant, polar[:, 0], smooth, weight)


def fit_plane(ground: Ground, center_m: Float64, grid: Grid, radius_m: float) -> Float64:
    """Plane (4,) through the ground returns within `radius_m` of the sensor, unit normal upwards.

    Tends to z = 0, the ground under the machine, when there are few returns.
    """
    near = grid.range_m < radius_m
    angle = (np.arange(grid.sectors) + 0.5) * (2 * math.pi / grid.sectors) - math.pi
    x = (center_m[0] + np.cos(angle)[:, None] * grid.range_m[near]).ravel()
    y = (center_m[1] + np.sin(angle)[:, None] * grid.range_m[near]).ravel()
    w = ground.cell_weight[:, near].ravel()
    A = np.stack([x, y, np.ones_like(x)], axis=1)
    # prior of one cell of full weight at 3 m: keeps the fit defined
    prior = np.diag([9.0, 9.0, 1.0])
    Aw = A.T * w
    slope_x, slope_y, offset = np.linalg.solve(Aw @ A + prior, Aw @ ground.cell_height_m[:, near].ravel())
    plane = np.array([-slope_x, -slope_y, 1.0, -offset])
    return np.asarray(plane / np.linalg.norm(plane[:3]), np.float64)


@kernel
def _propagate(
    z: Float32, starts: Int32, range_m: Float64, max_slope: float, step_m: float, height: Float64, weight: Float64
) -> None:
    sectors, bins = height.shape
    measured = np.zeros(sectors)  # range of each sector's last cell with returns
    trust, slope, predicted = np.zeros(sectors), np.zeros(sectors), np.zeros(sectors)
    around = np.arange(-SECTORS_ASIDE, sectors + SECTORS_ASIDE) % sectors
    sums, fit = np.zeros((bins, 3, sectors)), np.empty((6, sectors))
    counts = np.zeros(MAX_LAYERS + GROUND_LAYERS, np.int32)
    for b in range(bins):
        _predict(sums, range_m, b, max_slope, fit, predicted, slope)
        for s in range(sectors):
            gap = range_m[b] - measured[s]
            reach = min(step_m + max_slope * gap, 1.0)
            c = s * bins + b
            low, count = _lowest_layer(
                z, starts[c], starts[c + 1], predicted[s] - reach - step_m, predicted[s] + reach, counts
            )
            height[s, b] = predicted[s]
            trust[s] = 0.02
            if count > 0:
                height[s, b] = low
                weight[s, b] = trust[s] = count / (count + 2.0)
                measured[s] = range_m[b]
        _sum_neighbours(trust[around], height[:, b][around], slope[around], sums[b])


@kernel
def _sum_neighbours(trust: Float64, height: Float64, slope: Float64, sums: Float64) -> None:
    """Per sector, sums over itself and its neighbours by `SECTOR_WEIGHT`: trust, trust · height, trust · slope.

    The inputs are padded by `SECTORS_ASIDE` wrapped sectors at either end.
    """
    for d in range(2 * SECTORS_ASIDE + 1):
        # inner loop over sectors: vectorized
        for s in range(sums.shape[1]):
            w = trust[s + d] * SECTOR_WEIGHT[d]
            sums[0, s] += w
            sums[1, s] += w * height[s + d]
            sums[2, s] += w * slope[s + d]


@kernel
def _predict(
    sums: Float64, range_m: Float64, b: int, max_slope: float, fit: Float64, height: Float64, slope: Float64
) -> None:
    """Height and slope at the cells of bin `b` by line fits through the nearer bins, whose slopes are the prior.

    `fit` (6, sectors) is a buffer.
    """
    fit[:] = 0.0
    fit[0] = 1e-6
    for j in range(max(0, b - BINS_BEFORE), b):
        x = range_m[j] - range_m[b]
        for s in range(height.shape[0]):
            w, h = sums[j, 0, s], sums[j, 1, s]
            fit[0, s] += w
            fit[1, s] += w * x
            fit[2, s] += h
            fit[3, s] += w * x * x
            fit[4, s] += h * x
            fit[5, s] += sums[j, 2, s]
    for s in range(height.shape[0]):
        w_sum, x_sum, h_sum, xx, xh, prior = fit[0, s], fit[1, s], fit[2, s], fit[3, s], fit[4, s], fit[5, s]
        spread = xx - x_sum * x_sum / w_sum
        # prior of 4 m²: two cells alone do not tilt the ground; decays to level where there are no returns
        tilt = (xh - x_sum * h_sum / w_sum + 4.0 * 0.97 * prior / w_sum) / (spread + 4.0)
        slope[s] = min(max(tilt, -max_slope), max_slope)
        height[s] = (h_sum - slope[s] * x_sum) / w_sum


@kernel
def _lowest_layer(z: Float32, first: int, last: int, low: float, high: float, counts: Int32) -> tuple[float, int]:
    """Mean and count of the lowest dense layer of returns that starts between two heights; count 0 without one.

    Dense is a third of the densest layer, so that a few ghosts below the ground are not taken for it. `counts` is a
    buffer.
    """
    if first == last:
        return 0.0, 0
    span = min(int((high - low) / LAYER_M) + 1, MAX_LAYERS)
    counts[: span + GROUND_LAYERS] = 0
    for i in range(first, last):
        k = math.floor((z[i] - low) / LAYER_M)
        if 0 <= k < span + GROUND_LAYERS:
            counts[k] += 1
    best = n = _layer(counts, 0)
    for k in range(1, span):
        n += counts[k + GROUND_LAYERS - 1] - counts[k - 1]
        best = max(best, n)
    if best == 0:
        return 0.0, 0
    for k in range(span):
        n = _layer(counts, k)
        if counts[k] > 0 and 3 * n >= best:
            return _mean_between(z, first, last, low + k * LAYER_M, low + (k + GROUND_LAYERS) * LAYER_M), n
    return 0.0, 0


@kernel
def _layer(counts: Int32, k: int) -> int:
    n = 0
    for j in range(k, k + GROUND_LAYERS):
        n += counts[j]
    return n


@kernel
def _mean_between(z: Float32, first: int, last: int, low: float, high: float) -> float:
    total, n = 0.0, 0
    for i in range(first, last):
        if low <= z[i] < high:
            total += z[i]
            n += 1
    return total / max(n, 1)


@kernel
def _smooth(height: Float64, weight: Float64, range_m: Float64, step_m: float) -> Float64:
    """Lines through neighbouring cells; a second pass down-weights cells off the surface of the first.

    A mean would lie below the nearest ground of a slope that falls away, and above that of a rising one.
    """
    sectors, bins = height.shape
    surface, sums = height.copy(), np.empty((5, bins))
    for iteration in range(2):
        before, trusted = surface.copy(), weight.copy()
        if iteration > 0:
            off = ((height - before) / (0.5 * step_m)) ** 2
            trusted /= 1.0 + off * off
        for s in range(sectors):
            sums[:] = 0.0
            sums[0], sums[1] = 1e-3, 1e-3 * before[s]
            for d in range(-2, 3):
                k = (s + d) % sectors
                for j in range(-1, 2):
                    # inner loop over bins: vectorized
                    for b in range(max(0, -j), min(bins, bins - j)):
                        w, x = trusted[k, b + j] * BLUR[d + 2, j + 1], range_m[b + j] - range_m[b]
                        sums[0, b] += w
                        sums[1, b] += w * height[k, b + j]
                        sums[2, b] += w * x
                        sums[3, b] += w * x * x
                        sums[4, b] += w * x * height[k, b + j]
            for b in range(bins):
                w, h, x = sums[0, b], sums[1, b] / sums[0, b], sums[2, b] / sums[0, b]
                slope = (sums[4, b] - w * x * h) / (sums[3, b] - w * x * x + SLOPE_RIDGE_M2)
                surface[s, b] = h - slope * x
    return surface

"""Height of the ground under every return, carried outwards from the machine over a polar grid.

    sectors (angle) x bins (range, wider with distance)       per cell, nearest bins first:
                 _.-'|   |     |        |                      1 predict from the cells before it (local plane)
      sensor  o-.----|---|-----|--------|--> range             2 lowest dense layer of returns near the prediction
                 `-._|   |     |        |                      3 accept it as ground, or carry the prediction on
                                                               then smooth, refusing cells off their neighbours' plane

The plane z = 0 of `base` is the ground under the machine, which is where the chain starts; nothing is assumed about
rings, so that a list of returns without order, thinned or from any lidar, is treated alike.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from messages.message import Float32, Float64, Int32, UInt8
from perception.kernels import kernel

LAYER_M = 0.05  # height resolution of the search for the lowest dense layer
LAYERS = 5  # so many make the thickness of ground: furrows, stubble, noise
LOOK_BACK = 4  # bins before a cell that predict it
LOOK_ASIDE = 3  # sectors to either side that do
TABLE_M = 0.25  # resolution of the table from range to bin


class GroundConfig(Config):
    """The polar grid, how steep ground may be, and from what height a return is solid."""

    sector_deg: float = Field(ge=0.5, le=10.0)
    first_bin_m: float = Field(ge=0.2, le=5.0)
    bin_growth: float = Field(ge=0.0, le=0.2, description="widening of bins with distance, m/m")
    reach_m: float = Field(ge=10.0, le=200.0)
    max_slope: float = Field(gt=0.0, le=1.0, description="against the machine's own plane, m/m")
    step_m: float = Field(gt=0.0, le=0.5, description="unevenness taken as ground from cell to cell")
    solid_m: float = Field(gt=0.05, le=1.0, description="height from which a return stands for something solid")
    solid_growth: float = Field(ge=0.0, le=0.02, description="added per metre of distance, m/m")
    foot_m: float = Field(gt=0.0, le=0.5, description="depth below ground of returns that join a solid one above")


@dataclass(frozen=True)
class Grid:
    """The polar grid about a sensor: `bin_table` maps range / TABLE_M to fractional bins, `range_m` are bin centres."""

    sectors: int
    bins: int
    bin_table: Float64
    range_m: Float64


def build_grid(config: GroundConfig) -> Grid:
    """The grid that a configuration describes; bin b starts where its share of log range says."""
    ranges = np.arange(0.0, config.reach_m + 2 * TABLE_M, TABLE_M)
    growth = max(config.bin_growth, 1e-6)
    table = np.log1p(growth * ranges / config.first_bin_m) / math.log1p(growth)
    bins = int(table[-2]) + 1
    centers = config.first_bin_m / growth * (np.exp((np.arange(bins) + 0.5) * math.log1p(growth)) - 1.0)
    return Grid(round(360.0 / config.sector_deg), bins, table, centers)


@dataclass(frozen=True)
class Ground:
    """Ground below the returns: `height_m` (N,) of each above it (NaN: not used), and the cells it came from.

    `cell_height_m` and `cell_weight` (sectors, bins): height of the ground in `base`, and how well it was seen
    (0 = carried on from elsewhere).
    """

    height_m: Float32
    cell_height_m: Float64
    cell_weight: Float64


def find_ground(points_base_m: Float32, usable: UInt8, center_m: Float64, grid: Grid, config: GroundConfig) -> Ground:
    """The ground below returns (N, 3) in `base`, seen by a sensor that stands at `center_m` (2,)."""
    n = len(points_base_m)
    place = np.empty((n, 2), np.float32)
    starts = np.zeros(grid.sectors * grid.bins + 1, np.int32)
    z = np.empty(n, np.float32)
    _sort_into_cells(points_base_m, usable, center_m, grid.bin_table, grid.sectors, grid.bins, place, starts, z)
    height = np.zeros((grid.sectors, grid.bins))
    weight = np.zeros((grid.sectors, grid.bins))
    _propagate(z, starts, grid.range_m, config.max_slope, config.step_m, height, weight)
    smooth = _smooth(height, weight, grid.range_m, config.step_m)
    above = np.empty(n, np.float32)
    _heights(points_base_m, place, smooth, above)
    return Ground(above, smooth, weight)


def fit_plane(ground: Ground, center_m: Float64, grid: Grid, radius_m: float) -> Float64:
    """The plane (4,) through the ground seen within `radius_m` of the sensor, unit normal upwards.

    It is z = 0 as far as too little was seen: the machine stands on it.
    """
    near = grid.range_m < radius_m
    angle = (np.arange(grid.sectors) + 0.5) * (2 * math.pi / grid.sectors) - math.pi
    x = (center_m[0] + np.cos(angle)[:, None] * grid.range_m[near]).ravel()
    y = (center_m[1] + np.sin(angle)[:, None] * grid.range_m[near]).ravel()
    w = ground.cell_weight[:, near].ravel()
    A = np.stack([x, y, np.ones_like(x)], axis=1)
    # a prior of one well-seen cell at 3 m keeps the fit defined
    prior = np.diag([9.0, 9.0, 1.0])
    slope_x, slope_y, offset = np.linalg.solve((A.T * w) @ A + prior, (A.T * w) @ ground.cell_height_m[:, near].ravel())
    plane = np.array([-slope_x, -slope_y, 1.0, -offset])
    return np.asarray(plane / np.linalg.norm(plane[:3]), np.float64)


@kernel
def _angle(y: float, x: float) -> float:
    """atan2 to 2e-4 rad, several times faster: it only picks a sector."""
    ax, ay = abs(x), abs(y)
    big = max(ax, ay)
    a = min(ax, ay) / big if big > 0.0 else 0.0
    s = a * a
    r = ((-0.0464964749 * s + 0.15931422) * s - 0.327622764) * s * a + a
    if ay > ax:
        r = 0.5 * math.pi - r
    if x < 0.0:
        r = math.pi - r
    return -r if y < 0.0 else r


@kernel
def _sort_into_cells(
    points: Float32, usable: UInt8, center: Float64, bin_table: Float64, sectors: int, bins: int,
    place: Float32, starts: Int32, z: Float32,
) -> None:  # fmt: skip
    """Fractional sector and bin of each return (bin -1: outside) and the heights sorted by cell."""
    n = points.shape[0]
    cells = np.empty(n, np.int32)
    limit = (bin_table.shape[0] - 2) * TABLE_M
    for i in range(n):
        cells[i] = -1
        place[i, 1] = -1.0
        if usable[i] == 0:
            continue
        x, y = points[i, 0] - center[0], points[i, 1] - center[1]
        r = math.sqrt(x * x + y * y)
        if r >= limit:
            continue
        k = int(r / TABLE_M)
        b = bin_table[k] + (r / TABLE_M - k) * (bin_table[k + 1] - bin_table[k])
        s = (_angle(y, x) + math.pi) * (sectors / (2.0 * math.pi))
        place[i, 0], place[i, 1] = s, b
        cells[i] = min(int(s), sectors - 1) * bins + min(int(b), bins - 1)
        starts[cells[i] + 1] += 1
    for c in range(starts.shape[0] - 1):
        starts[c + 1] += starts[c]
    fill = starts[:-1].copy()
    for i in range(n):
        if cells[i] >= 0:
            z[fill[cells[i]]] = points[i, 2]
            fill[cells[i]] += 1


@kernel
def _propagate(
    z: Float32, starts: Int32, range_m: Float64, max_slope: float, step_m: float, height: Float64, weight: Float64
) -> None:
    sectors, bins = height.shape
    seen = np.zeros(sectors)  # range up to which each sector's chain rests on returns
    trust = np.zeros((sectors, bins))
    for b in range(bins):
        for s in range(sectors):
            predicted = _predict(height, trust, range_m, s, b, max_slope)
            gap = range_m[b] - seen[s]
            reach = min(step_m + max_slope * gap, 1.0)
            c = s * bins + b
            low, count = _lowest_layer(z, starts[c], starts[c + 1], predicted - reach - step_m, predicted + reach)
            height[s, b] = predicted
            trust[s, b] = 0.02
            if count > 0:
                height[s, b] = low
                weight[s, b] = trust[s, b] = count / (count + 2.0)
                seen[s] = range_m[b]


@kernel
def _predict(height: Float64, trust: Float64, range_m: Float64, s: int, b: int, max_slope: float) -> float:
    """Height at a cell by the plane through the cells before it; the machine's plane is their prior."""
    sectors = height.shape[0]
    w_sum, x_sum, h_sum, xx, xh = 1e-6, 0.0, 0.0, 0.0, 0.0
    for j in range(max(0, b - LOOK_BACK), b):
        x = range_m[j] - range_m[b]
        for d in range(-LOOK_ASIDE, LOOK_ASIDE + 1):
            k = (s + d) % sectors
            w = trust[k, j] / (1.0 + d * d)
            w_sum += w
            x_sum += w * x
            h_sum += w * height[k, j]
            xx += w * x * x
            xh += w * x * height[k, j]
    spread = xx - x_sum * x_sum / w_sum
    # 4 m² of prior at slope 0: two cells alone do not tilt the ground
    slope = (xh - x_sum * h_sum / w_sum) / (spread + 4.0)
    slope = min(max(slope, -max_slope), max_slope)
    return (h_sum - slope * x_sum) / w_sum


@kernel
def _lowest_layer(z: Float32, first: int, last: int, low: float, high: float) -> tuple[float, int]:
    """Mean and count of the lowest dense layer of returns that starts between two heights; count 0 when there is none.

    Dense is a third of the densest layer, so that a few ghosts below the ground do not pass for it.
    """
    span = min(int((high - low) / LAYER_M) + 1, 64)
    counts = np.zeros(64 + LAYERS, np.int32)
    for i in range(first, last):
        k = math.floor((z[i] - low) / LAYER_M)
        if 0 <= k < span + LAYERS:
            counts[k] += 1
    best = 0
    for k in range(span):
        best = max(best, _layer(counts, k))
    if best == 0:
        return 0.0, 0
    for k in range(span):
        n = _layer(counts, k)
        if counts[k] > 0 and 3 * n >= best:
            return _mean_between(z, first, last, low + k * LAYER_M, low + (k + LAYERS) * LAYER_M), n
    return 0.0, 0


@kernel
def _layer(counts: Int32, k: int) -> int:
    n = 0
    for j in range(k, k + LAYERS):
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
    """Each cell by its neighbours; a second round refuses those that stand off the first round's surface."""
    sectors, bins = height.shape
    surface = height.copy()
    for turn in range(2):
        before = surface.copy()
        for s in range(sectors):
            for b in range(bins):
                w_sum, h_sum = 1e-3, 1e-3 * before[s, b]
                for d in range(-2, 3):
                    k = (s + d) % sectors
                    for j in range(max(0, b - 1), min(bins, b + 2)):
                        w = weight[k, j] / (1.0 + d * d + 2 * (j - b) * (j - b))
                        off = (height[k, j] - before[k, j]) / step_m
                        if turn > 0:
                            w /= 1.0 + off * off * off * off * 16.0
                        w_sum += w
                        h_sum += w * height[k, j]
                surface[s, b] = h_sum / w_sum
    return surface


@kernel
def _heights(points: Float32, place: Float32, surface: Float64, above: Float32) -> None:
    """Height of each return above the surface, bilinear between cell centres; NaN outside the grid."""
    sectors, bins = surface.shape
    for i in range(points.shape[0]):
        if place[i, 1] < 0.0:
            above[i] = np.nan
            continue
        s, b = place[i, 0] - 0.5, max(place[i, 1] - 0.5, 0.0)
        j = min(int(b), bins - 2)
        v = min(b - j, 1.0)
        k = math.floor(s)
        u = s - k
        k0, k1 = k % sectors, (k + 1) % sectors
        near = (1.0 - u) * surface[k0, j] + u * surface[k1, j]
        far = (1.0 - u) * surface[k0, j + 1] + u * surface[k1, j + 1]
        above[i] = points[i, 2] - ((1.0 - v) * near + v * far)

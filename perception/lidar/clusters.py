"""Clusters of obstacle points: cells of a horizontal grid, joined within a distance that grows with range.

Points above the machine are left out. Low points join only a cell that holds obstacle points, so that feet and wheels
belong to their obstacle and furrows to none.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Bool, Float32, Float64, Int32, UInt8
from geometry.jit import kernel
from geometry.near_points import root


class ClusterConfig(Config):
    """Grid, joining distance and the minimum evidence for a cluster."""

    cell_m: float = Field(ge=0.05, le=1.0)
    max_range_m: float = Field(ge=10.0, le=200.0)
    join_distance_m: float = Field(gt=0.0, le=2.0)
    join_growth: float = Field(ge=0.0, le=0.1, description="added per metre of distance, m/m")
    min_returns: int = Field(ge=1, le=50)
    min_fill: float = Field(ge=0.0, le=1.0, description="returns over beams that cross the outline")
    sufficient_returns: int = Field(
        ge=1, le=1000, description="number from which `min_fill` is not required: wire, twigs"
    )
    min_height_m: float = Field(gt=0.0, le=1.0, description="lower clusters are uneven ground")
    overhead_margin_m: float = Field(
        ge=0.0, le=3.0, description="above the machine's height; higher points are left out"
    )
    min_top_m: float = Field(gt=0.0, le=5.0, description="assumed height of a machine that is lower")


@dataclass(frozen=True)
class Clusters:
    """The returns of cluster k are `indices[offsets[k]:offsets[k + 1]]`."""

    offsets: Int32
    indices: Int32


def select(clusters: Clusters, wanted: Bool) -> Clusters:
    """The clusters selected by the mask `wanted` (K,)."""
    sizes = np.diff(clusters.offsets)
    offsets = np.concatenate([[0], np.cumsum(sizes[wanted])]).astype(np.int32)
    return Clusters(offsets, clusters.indices[np.repeat(wanted, sizes)])


def new_cell_grid(config: ClusterConfig) -> Int32:
    """Empty grid of cell numbers (-1), reused from scan to scan since clearing it costs more than using it."""
    width = 2 * math.ceil(config.max_range_m / config.cell_m) + 1
    return np.full((width, width), -1, np.int32)


def find_clusters(
    points_base_m: Float32, point_class: UInt8, center_m: Float64, config: ClusterConfig, cell_grid: Int32
) -> Clusters:
    """Clusters of returns (N, 3) in `base`; `point_class` (N,): 3 floating obstacle, 2 obstacle,
    1 low (joins a cell occupied by obstacles that do not float), 0 unused.

    `cell_grid` is from `new_cell_grid` and is all -1 again on return.
    """
    width = cell_grid.shape[0]
    number = cell_grid.reshape(-1)
    cell = np.empty(len(points_base_m), np.int32)
    cells, centroid = _fill_cells(points_base_m, point_class, center_m, width, config.cell_m, number, cell)
    label, count = _join_cells(
        cells, number, centroid, center_m, width, config.cell_m, config.join_distance_m, config.join_growth
    )
    number[cells] = -1
    offsets, indices = _collect(cell, point_class, label, count, config.min_returns)
    return Clusters(offsets, indices)


@kernel
def _indices_of(point_class: UInt8, lowest: int, highest: int) -> Int32:
    """Ascending indices of the classes from `lowest` to `highest`; branches are costly for unordered ones."""
    indices, n = np.empty(point_class.shape[0] + 1, np.int32), 0
    for i in range(point_class.shape[0]):
        indices[n] = i
        n += (point_class[i] >= lowest) & (point_class[i] <= highest)
    return indices[:n]


@kernel
def _fill_cells(
    points: Float32, point_class: UInt8, center: Float64, width: int, cell_m: float, number: Int32, cell: Int32
) -> tuple[Int32, Float64]:
    """Keys (K,) of occupied cells in the order found, and means (K, 2) of their obstacle points.

    Sets `number` (width²,) to k in cell k, and `cell` (N,) to k, or to -1 for points in none of them.
    """
    u0 = np.float32(width // 2 + 0.5 - center[0] / cell_m)
    v0 = np.float32(width // 2 + 0.5 - center[1] / cell_m)
    scale, end, span = np.float32(1.0 / cell_m), np.float32(width), np.int32(width)
    for i in range(points.shape[0]):
        u, v = points[i, 0] * scale + u0, points[i, 1] * scale + v0
        inside = (point_class[i] > 0) & (u >= 0.0) & (u < end) & (v >= 0.0) & (v < end)
        cell[i] = np.int32(u) * span + np.int32(v) if inside else np.int32(-1)
    obstacle_points, k = _indices_of(point_class, 2, 3), 0
    keys, total = np.empty(obstacle_points.shape[0], np.int32), np.empty((obstacle_points.shape[0] + 1, 4))
    for i in obstacle_points:
        key = cell[i]
        if key < 0:
            continue
        c = number[key]
        if c < 0:
            c = number[key] = k
            keys[k], total[k] = key, 0.0
            k += 1
        cell[i] = c
        total[c, 0] += points[i, 0]
        total[c, 1] += points[i, 1]
        total[c, 2] += 1.0
        total[c, 3] += point_class[i] == 2
    for i in _indices_of(point_class, 1, 1):
        c = number[cell[i]] if cell[i] >= 0 else -1
        # a single return may be noise and would turn the ground below it into an obstacle
        cell[i] = c if c >= 0 and total[c, 3] > 1.0 else -1
    return keys[:k].copy(), total[:k, :2] / total[:k, 2:3]


@kernel
def _join_cells(
    keys: Int32, number: Int32, centroid: Float64, center: Float64, width: int, cell_m: float, join_distance_m: float,
    growth: float,
) -> tuple[Int32, int]:  # fmt: skip
    """Label (K,) of each cell, numbered in the order of the cells, and the number of labels."""
    n = keys.shape[0]
    parent = np.arange(n + 1).astype(np.int32)  # the last entry is the empty cell -1
    farthest = math.ceil((join_distance_m + growth * width * cell_m) / cell_m)  # upper bound
    near = np.empty((farthest + 1) * (2 * farthest + 1), np.int32)
    for k in range(n):
        x, y = centroid[k, 0], centroid[k, 1]
        reach = join_distance_m + growth * math.hypot(x - center[0], y - center[1])
        steps = math.ceil(reach / cell_m)
        u, v = keys[k] // width, keys[k] % width
        own = parent[n] = root(parent, k)
        count = 0
        # candidates first, without branches: occupancy is not predictable
        for w in range(u, min(u + steps, width - 1) + 1):
            first = v + 1 if w == u else max(v - steps, 0)
            for place in range(w * width + first, w * width + min(v + steps, width - 1) + 1):
                near[count] = number[place]
                count += parent[number[place]] != own
        for j in near[:count]:
            if parent[j] == own:
                continue
            dx, dy = centroid[j, 0] - x, centroid[j, 1] - y
            if dx * dx + dy * dy <= reach * reach:
                other = root(parent, j)
                if other != own:
                    parent[max(own, other)] = own = min(own, other)
                parent[j] = own
    label = np.empty(n, np.int32)
    count = 0
    for k in range(n):
        r = root(parent, k)
        if r == k:
            label[k] = count
            count += 1
        else:
            label[k] = label[r]
    return label, count


@kernel
def _collect(cell: Int32, point_class: UInt8, label: Int32, count: int, min_returns: int) -> tuple[Int32, Int32]:
    """Offsets and indices of the clusters with enough obstacle points, in the order of their labels."""
    size, obstacle_count = np.zeros(count, np.int32), np.zeros(count, np.int32)
    members, n = np.empty(cell.shape[0] + 1, np.int32), 0
    for i in range(cell.shape[0]):
        members[n] = i
        n += cell[i] >= 0
    for i in members[:n]:
        c = label[cell[i]]
        size[c] += 1
        obstacle_count[c] += point_class[i] >= 2
    offsets = np.zeros(count + 1, np.int32)
    kept = np.full(count, -1, np.int32)
    k = 0
    for c in range(count):
        if obstacle_count[c] >= min_returns:
            kept[c] = k
            offsets[k + 1] = offsets[k] + size[c]
            k += 1
    fill = offsets[: k + 1].copy()
    indices = np.empty(offsets[k], np.int32)
    for i in members[:n]:
        c = kept[label[cell[i]]]
        if c >= 0:
            indices[fill[c]] = i
            fill[c] += 1
    return offsets[: k + 1].copy(), indices

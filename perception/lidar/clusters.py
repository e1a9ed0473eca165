"""Solid returns gathered into clusters: cells of a level grid, joined within a distance that grows with range.

What hangs above the machine joins nothing; what is low joins only where something solid stands in the same cell, so
that feet and wheels belong to their owner and furrows to nobody.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
from messages.message import Float32, Float64, Int32, UInt8
from perception.kernels import kernel


class ClusterConfig(Config):
    """Grid, joining distance and the least evidence for a cluster."""

    cell_m: float = Field(ge=0.05, le=1.0)
    reach_m: float = Field(ge=10.0, le=200.0)
    join_m: float = Field(gt=0.0, le=2.0)
    join_growth: float = Field(ge=0.0, le=0.1, description="added per metre of distance, m/m")
    min_returns: int = Field(ge=1, le=50)
    least_height_m: float = Field(gt=0.0, le=1.0, description="a cluster that is nowhere higher is uneven ground")
    overhead_m: float = Field(ge=0.0, le=3.0, description="above the machine's height, from where nothing matters")
    least_top_m: float = Field(gt=0.0, le=5.0, description="what stands this high is taken whole before a low machine")


@dataclass(frozen=True)
class Clusters:
    """The returns of cluster k are `indices[offsets[k]:offsets[k + 1]]`."""

    offsets: Int32
    indices: Int32


def keep(clusters: Clusters, wanted: npt.NDArray[np.bool_]) -> Clusters:
    """Only the clusters that are wanted, (K,)."""
    sizes = np.diff(clusters.offsets)
    offsets = np.concatenate([[0], np.cumsum(sizes[wanted])]).astype(np.int32)
    return Clusters(offsets, clusters.indices[np.repeat(wanted, sizes)])


def find_clusters(points_base_m: Float32, level: UInt8, center_m: Float64, config: ClusterConfig) -> Clusters:
    """Clusters of returns (N, 3) in `base`; `level` (N,): 2 solid, 1 low (joins what stands in its cell), 0 neither."""
    width = 2 * math.ceil(config.reach_m / config.cell_m) + 1
    cell = np.empty(len(points_base_m), np.int32)
    cells, centroid = _occupy(points_base_m, level, center_m, width, config.cell_m, cell)
    label, count = _join(cells, centroid, center_m, width, config.cell_m, config.join_m, config.join_growth)
    offsets, indices = _gather(cell, label, count, config.min_returns)
    return Clusters(offsets, indices)


@kernel
def _occupy(
    points: Float32, level: UInt8, center: Float64, width: int, cell_m: float, cell: Int32
) -> tuple[Int32, Float64]:
    """Occupied cells (K,) of the grid in the order found, their mean returns (K, 2); `cell` (N,) gets k or -1."""
    n = points.shape[0]
    number = np.full(width * width, -1, np.int32)
    keys = np.empty(n, np.int32)
    total = np.zeros((n, 3))
    half, k = width // 2, 0
    for i in range(n):
        cell[i] = -1
        if level[i] != 2:
            continue
        u = math.floor((points[i, 0] - center[0]) / cell_m + 0.5) + half
        v = math.floor((points[i, 1] - center[1]) / cell_m + 0.5) + half
        if u < 0 or v < 0 or u >= width or v >= width:
            continue
        key = u * width + v
        if number[key] < 0:
            number[key] = k
            keys[k] = key
            k += 1
        c = number[key]
        cell[i] = c
        total[c, 0] += points[i, 0]
        total[c, 1] += points[i, 1]
        total[c, 2] += 1.0
    for i in range(n):
        if level[i] != 1:
            continue
        u = math.floor((points[i, 0] - center[0]) / cell_m + 0.5) + half
        v = math.floor((points[i, 1] - center[1]) / cell_m + 0.5) + half
        if 0 <= u < width and 0 <= v < width:
            cell[i] = number[u * width + v]
    centroid = np.empty((k, 2))
    for c in range(k):
        centroid[c, 0], centroid[c, 1] = total[c, 0] / total[c, 2], total[c, 1] / total[c, 2]
    return keys[:k].copy(), centroid


@kernel
def _root(parent: Int32, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def _join(
    keys: Int32, centroid: Float64, center: Float64, width: int, cell_m: float, join_m: float, growth: float
) -> tuple[Int32, int]:
    """Label (K,) of each cell, numbered in the order of the cells, and how many labels there are."""
    n = keys.shape[0]
    number = np.full(width * width, -1, np.int32)
    for k in range(n):
        number[keys[k]] = k
    parent = np.arange(n).astype(np.int32)
    for k in range(n):
        x, y = centroid[k, 0], centroid[k, 1]
        reach = join_m + growth * math.hypot(x - center[0], y - center[1])
        steps = math.ceil(reach / cell_m)
        u, v = keys[k] // width, keys[k] % width
        for du in range(min(steps, width - 1 - u) + 1):
            for dv in range(-min(steps, v), min(steps, width - 1 - v) + 1):
                if du == 0 and dv <= 0:
                    continue
                j = number[(u + du) * width + v + dv]
                if j < 0:
                    continue
                dx, dy = centroid[j, 0] - x, centroid[j, 1] - y
                if dx * dx + dy * dy <= reach * reach:
                    a, b = _root(parent, k), _root(parent, j)
                    if a != b:
                        parent[max(a, b)] = min(a, b)
    label = np.empty(n, np.int32)
    count = 0
    for k in range(n):
        r = _root(parent, k)
        if r == k:
            label[k] = count
            count += 1
        else:
            label[k] = label[r]
    return label, count


@kernel
def _gather(cell: Int32, label: Int32, count: int, min_returns: int) -> tuple[Int32, Int32]:
    """Offsets and indices of the clusters with enough returns, in the order of their labels."""
    size = np.zeros(count, np.int32)
    for i in range(cell.shape[0]):
        if cell[i] >= 0:
            size[label[cell[i]]] += 1
    offsets = np.zeros(count + 1, np.int32)
    kept = np.full(count, -1, np.int32)
    k = 0
    for c in range(count):
        if size[c] >= min_returns:
            kept[c] = k
            offsets[k + 1] = offsets[k] + size[c]
            k += 1
    fill = offsets[: k + 1].copy()
    indices = np.empty(offsets[k], np.int32)
    for i in range(cell.shape[0]):
        if cell[i] >= 0 and kept[label[cell[i]]] >= 0:
            c = kept[label[cell[i]]]
            indices[fill[c]] = i
            fill[c] += 1
    return offsets[: k + 1].copy(), indices

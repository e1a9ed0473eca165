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
from geometry.jit import kernel
from messages.message import Float32, Float64, Int32, UInt8


class ClusterConfig(Config):
    """Grid, joining distance and the least evidence for a cluster."""

    cell_m: float = Field(ge=0.05, le=1.0)
    reach_m: float = Field(ge=10.0, le=200.0)
    join_m: float = Field(gt=0.0, le=2.0)
    join_growth: float = Field(ge=0.0, le=0.1, description="added per metre of distance, m/m")
    min_returns: int = Field(ge=1, le=50)
    least_fill: float = Field(ge=0.0, le=1.0, description="returns over beams that cross the outline")
    sure_returns: int = Field(ge=1, le=1000, description="so many need not fill their outline: wire, twigs")
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


def new_board(config: ClusterConfig) -> Int32:
    """An empty grid to number cells on, kept from scan to scan since clearing it costs more than using it."""
    width = 2 * math.ceil(config.reach_m / config.cell_m) + 1
    return np.full((width, width), -1, np.int32)


def find_clusters(
    points_base_m: Float32, level: UInt8, center_m: Float64, config: ClusterConfig, board: Int32
) -> Clusters:
    """Clusters of returns (N, 3) in `base`; `level` (N,): 2 solid, 1 low (joins what stands in its cell), 0 neither.

    `board` is from `new_board`; it is clean again afterwards.
    """
    width = board.shape[0]
    number = board.reshape(-1)
    cell = np.empty(len(points_base_m), np.int32)
    cells, centroid = _occupy(points_base_m, level, center_m, width, config.cell_m, number, cell)
    label, count = _join(cells, number, centroid, center_m, width, config.cell_m, config.join_m, config.join_growth)
    number[cells] = -1
    offsets, indices = _gather(cell, level, label, count, config.min_returns)
    return Clusters(offsets, indices)


@kernel
def _where(level: UInt8, wanted: int) -> Int32:
    """Where a level stands, ascending; without branches, which returns in no order make costly."""
    places, n = np.empty(level.shape[0] + 1, np.int32), 0
    for i in range(level.shape[0]):
        places[n] = i
        n += level[i] == wanted
    return places[:n]


@kernel
def _occupy(
    points: Float32, level: UInt8, center: Float64, width: int, cell_m: float, number: Int32, cell: Int32
) -> tuple[Int32, Float64]:
    """Places (K,) of occupied cells in the order found, and means (K, 2) of their solid returns.

    `number` (width²,) gets k where -1 stood, `cell` (N,) gets k, or -1 for what lies in none of them.
    """
    u0 = np.float32(width // 2 + 0.5 - center[0] / cell_m)
    v0 = np.float32(width // 2 + 0.5 - center[1] / cell_m)
    scale, end, span = np.float32(1.0 / cell_m), np.float32(width), np.int32(width)
    for i in range(points.shape[0]):
        u, v = points[i, 0] * scale + u0, points[i, 1] * scale + v0
        inside = (level[i] > 0) & (u >= 0.0) & (u < end) & (v >= 0.0) & (v < end)
        cell[i] = np.int32(u) * span + np.int32(v) if inside else np.int32(-1)
    solids, k = _where(level, 2), 0
    keys, total = np.empty(solids.shape[0], np.int32), np.empty((solids.shape[0] + 1, 3))
    for i in solids:
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
    for i in _where(level, 1):
        c = number[cell[i]] if cell[i] >= 0 else -1
        # one return alone may be noise, and would make an object of the ground below it
        cell[i] = c if c >= 0 and total[c, 2] > 1.0 else -1
    return keys[:k].copy(), total[:k, :2] / total[:k, 2:]


@kernel
def _root(parent: Int32, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def _join(
    keys: Int32, number: Int32, centroid: Float64, center: Float64, width: int, cell_m: float, join_m: float,
    growth: float,
) -> tuple[Int32, int]:  # fmt: skip
    """Label (K,) of each cell, numbered in the order of the cells, and how many labels there are."""
    n = keys.shape[0]
    parent = np.arange(n + 1).astype(np.int32)  # the last stands for the empty cell -1
    farthest = math.ceil((join_m + growth * width * cell_m) / cell_m)  # more than ever comes
    near = np.empty((farthest + 1) * (2 * farthest + 1), np.int32)
    for k in range(n):
        x, y = centroid[k, 0], centroid[k, 1]
        reach = join_m + growth * math.hypot(x - center[0], y - center[1])
        steps = math.ceil(reach / cell_m)
        u, v = keys[k] // width, keys[k] % width
        own = parent[n] = _root(parent, k)
        count = 0
        # gathered first, without branches: which of them are occupied cannot be foretold
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
                other = _root(parent, j)
                if other != own:
                    parent[max(own, other)] = own = min(own, other)
                parent[j] = own
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
def _gather(cell: Int32, level: UInt8, label: Int32, count: int, min_returns: int) -> tuple[Int32, Int32]:
    """Offsets and indices of the clusters with enough solid returns, in the order of their labels."""
    size, solid = np.zeros(count, np.int32), np.zeros(count, np.int32)
    members, n = np.empty(cell.shape[0] + 1, np.int32), 0
    for i in range(cell.shape[0]):
        members[n] = i
        n += cell[i] >= 0
    for i in members[:n]:
        c = label[cell[i]]
        size[c] += 1
        solid[c] += level[i] == 2
    offsets = np.zeros(count + 1, np.int32)
    kept = np.full(count, -1, np.int32)
    k = 0
    for c in range(count):
        if solid[c] >= min_returns:
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

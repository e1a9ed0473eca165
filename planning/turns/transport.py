"""Ways of the folded rig through passages that are narrower than the rig at work.

The cheapest path over a grid, which keeps away from edges, gives poses to pass; neighbouring ones are joined by turns.
"""

import math

import numpy as np
import shapely
from scipy.ndimage import distance_transform_edt, uniform_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64
from geometry.polygon import shrink
from geometry.polyline import headings, resample
from geometry.pose2 import Pose2
from planning.turns.free_space import FreeSpace
from planning.turns.search import Connection, ConnectionRequest, TurnTimes, find_turn

MIN_CELL_M, MAX_CELLS = 0.5, 250_000
EDGE_COST = 4.0  # of a cell at an edge, in cells far from edges
SMOOTHED_M, SPACING_M = 6.0, 6.0
SKIPPED = 6  # poses to the next one that is joined, at most
NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1))


def transport_way(start: Pose2, goal: Pose2, space: FreeSpace, times: TurnTimes) -> Connection | None:
    """Way of the bodies of `space` from one pose to another, or None."""
    points = _guide(start, goal, space)
    if points is None:
        return None
    poses = [start, *_poses(points), goal]
    ways: list[tuple[float, tuple[Connection, ...]] | None] = [(0.0, ())]
    for k, pose in enumerate(poses[1:], 1):
        found = []
        for n in range(max(0, k - SKIPPED), k):
            way = ways[n]
            turn = None if way is None else find_turn(ConnectionRequest(poses[n], pose, 0.0, 0.0), space, times)
            if way is not None and turn is not None:
                found.append((way[0] + turn.time_s, (*way[1], turn)))
        ways.append(min(found, key=lambda f: f[0], default=None))
    last = ways[-1]
    return None if last is None else Connection(tuple(leg for turn in last[1] for leg in turn.legs), last[0])


def _poses(points: Float64) -> list[Pose2]:
    """Poses along a polyline between its ends, `SPACING_M` apart."""
    count = int(SMOOTHED_M / MIN_CELL_M)
    line = resample(points, MIN_CELL_M)
    line = resample(uniform_filter1d(line, count, axis=0, mode="nearest"), MIN_CELL_M)
    every = int(SPACING_M / MIN_CELL_M)
    heading = headings(line)
    return [Pose2(*map(float, (*line[k], heading[k]))) for k in range(every, len(line) - every // 2, every)]


def _guide(start: Pose2, goal: Pose2, space: FreeSpace) -> Float64 | None:
    """Cheapest way over the grid from one pose to another, (N, 2), or None."""
    half_m = max(b.half_width_m for b in space.bodies)
    cell_m = max(MIN_CELL_M, math.sqrt(space.allowed.area / MAX_CELLS))
    x0, y0, x1, y1 = space.allowed.bounds
    x, y = np.arange(x0, x1 + cell_m, cell_m), np.arange(y0, y1 + cell_m, cell_m)
    is_free = _is_within(shrink(space.allowed, half_m - cell_m / 2.0), x, y)
    away_m = distance_transform_edt(np.pad(is_free, 1))[1:-1, 1:-1] * cell_m
    cost = 1.0 + EDGE_COST * np.clip(1.0 - away_m / space.radius_m, 0.0, 1.0)
    ends = [_nearest(is_free, (pose.x_m - x0) / cell_m, (pose.y_m - y0) / cell_m) for pose in (start, goal)]
    if None in ends:
        return None
    before = dijkstra(_graph(is_free, cost), directed=False, indices=ends[0], return_predecessors=True)[1]
    cells = [ends[1]]
    while cells[-1] != ends[0]:
        cells.append(before[cells[-1]])
        if cells[-1] < 0:
            return None
    column, row = np.divmod(np.array(cells[::-1]), len(y))
    return np.vstack([start[:2], np.column_stack([x[column], y[row]]), goal[:2]])


def _is_within(area: BaseGeometry, x: Float64, y: Float64) -> Bool:
    shapely.prepare(area)
    return np.asarray(shapely.contains_xy(area, *np.meshgrid(x, y, indexing="ij")), np.bool_)


def _nearest(is_free: Bool, column: float, row: float) -> int | None:
    """Index of the free cell nearest to a place."""
    free = np.argwhere(is_free)
    if not len(free):
        return None
    i, j = free[int(np.argmin(np.hypot(free[:, 0] - column, free[:, 1] - row)))]
    return int(i * is_free.shape[1] + j)


def _graph(is_free: Bool, cost: Float64) -> coo_array:
    """Costs between free neighbouring cells."""
    columns, rows = is_free.shape
    index = np.arange(columns * rows).reshape(columns, rows)
    first, second, weight = [], [], []
    for i, j in NEIGHBOURS:
        a = np.s_[: columns - i, max(0, -j) : rows - max(0, j)]
        b = np.s_[i:, max(0, j) : rows - max(0, -j)]
        both = is_free[a] & is_free[b]
        first.append(index[a][both])
        second.append(index[b][both])
        weight.append(math.hypot(i, j) * 0.5 * (cost[a][both] + cost[b][both]))
    ends = np.concatenate(first), np.concatenate(second)
    return coo_array((np.concatenate(weight), ends), shape=(index.size, index.size)).tocsr()

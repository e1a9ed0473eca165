"""Ways of the folded rig through passages that are too narrow for the rig at work.

Cheapest paths over a grid, which keep away from edges, give poses to pass; near ones are joined by turns.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
from scipy.ndimage import distance_transform_edt, uniform_filter1d
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from geometry.arrays import Bool, Float64, Int32, Int64
from geometry.polygon import shrink
from geometry.polyline import arc_length, at_length, headings
from geometry.pose2 import Pose2
from planning.turns.free_space import FreeSpace
from planning.turns.search import STEP_M as LEG_STEP_M
from planning.turns.search import Connection, ConnectionRequest, Leg, TurnTimes, find_turn

MIN_CELL_M, MAX_CELLS = 0.5, 1_000_000
EDGE_COST = 4.0  # of a cell at an edge, in cells far from edges
STEP_M, SMOOTHED_M, SPACING_M = 0.5, 6.0, 6.0
SKIPPED = 6  # poses to the next one that is joined, at most
TURNED = Pose2(0.0, 0.0, math.pi)
NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1))


@dataclass(frozen=True)
class TransportWays:
    """Ways of the bodies of `space` from a pose `hub` to others, and back to it.

    Ways that begin alike pass the same poses, and share the turns between them.
    """

    hub: Pose2
    space: FreeSpace
    times: TurnTimes
    _turns: dict[tuple[Pose2, Pose2], Connection | None] = field(default_factory=dict, init=False, repr=False)

    def to(self, pose: Pose2) -> tuple[Leg, ...] | None:
        """Way to a pose, or None; with reversing also the way back from it backwards, where no other is found."""
        return self._there(pose) or self._backwards(self._back(pose))

    def back(self, pose: Pose2) -> tuple[Leg, ...] | None:
        """Way from a pose back, or None; with reversing also the way to it backwards, where no other is found."""
        return self._back(pose) or self._backwards(self._there(pose))

    def time_s(self, legs: Iterable[Leg]) -> float:
        """Time of legs, without changes of direction."""
        speed_mps = {1: self.times.forward_mps, -1: self.times.reverse_mps}
        return sum(LEG_STEP_M * len(leg.p_map_m) / speed_mps[leg.direction] for leg in legs)

    def turn(self, start: Pose2, goal: Pose2) -> Connection | None:
        """Turn from a pose to another, or None."""
        straight_m = self.space.smoothing_m / 2.0  # no step of curvature
        if (start, goal) not in self._turns:
            request = ConnectionRequest(start, goal, straight_m, straight_m)
            self._turns[start, goal] = find_turn(request, self.space, self.times)
        return self._turns[start, goal]

    def _there(self, pose: Pose2) -> tuple[Leg, ...] | None:
        return self._first_way([self.hub, *passed, pose] for passed in self._passed(pose))

    def _back(self, pose: Pose2) -> tuple[Leg, ...] | None:
        return self._first_way([pose, *(p @ TURNED for p in passed[::-1]), self.hub] for passed in self._passed(pose))

    def _first_way(self, some: Iterable[Sequence[Pose2]]) -> tuple[Leg, ...] | None:
        return next((way for way in map(self._way, some) if way is not None), None)

    def _backwards(self, way: tuple[Leg, ...] | None) -> tuple[Leg, ...] | None:
        return None if way is None or not self.times.has_reverse else tuple(leg.backwards for leg in reversed(way))

    def _way(self, poses: Sequence[Pose2]) -> tuple[Leg, ...] | None:
        """Fastest way from the first of some poses to the last that passes others between them."""
        ways: list[tuple[float, tuple[Connection, ...]] | None] = [(0.0, ())]
        for k, pose in enumerate(poses[1:], 1):
            found = [
                (way[0] + turn.time_s, (*way[1], turn))
                for n in range(max(0, k - SKIPPED), k)
                if (way := ways[n]) is not None and (turn := self.turn(poses[n], pose)) is not None
            ]
            ways.append(min(found, key=lambda f: f[0], default=None))
        last = ways[-1]
        return None if last is None else tuple(leg for turn in last[1] for leg in turn.legs)

    def _passed(self, goal: Pose2) -> Iterator[list[Pose2]]:
        """Poses on the cheapest path over the grid to a pose, `SPACING_M` apart from the hub on, then those between
        them; none where no path leads there."""
        points = self._guide(goal)
        if points is None:
            return
        smooth = uniform_filter1d(_every(points, STEP_M), int(SMOOTHED_M / STEP_M), axis=0, mode="nearest")
        line, every = _every(smooth, STEP_M), int(SPACING_M / STEP_M)
        heading = headings(line)
        for first in (every, every // 2):
            yield [Pose2(*map(float, (*line[k], heading[k]))) for k in range(first, len(line) - every // 2, every)]

    def _guide(self, goal: Pose2) -> Float64 | None:
        """Cheapest path over the grid to a pose, (N, 2), or None."""
        x, y, _ = self._grid
        first, last = self._cell(self.hub), self._cell(goal)
        cells = [last]
        while cells[-1] != first:
            cells.append(int(self._before[cells[-1]]))
            if cells[-1] < 0:
                return None
        column, row = np.divmod(np.array(cells[::-1]), len(y))
        return np.vstack([self.hub[:2], np.column_stack([x[column], y[row]]), goal[:2]])

    @cached_property
    def _grid(self) -> tuple[Float64, Float64, Bool]:
        """Coordinates of columns and rows, and where the middle of the rig may be, (columns, rows)."""
        cell_m = max(MIN_CELL_M, math.sqrt(self.space.allowed.area / MAX_CELLS))
        x0, y0, x1, y1 = self.space.allowed.bounds
        x, y = np.arange(x0, x1 + cell_m, cell_m), np.arange(y0, y1 + cell_m, cell_m)
        area = shrink(self.space.allowed, max(b.half_width_m for b in self.space.bodies) - MIN_CELL_M / 2.0)
        shapely.prepare(area)
        return x, y, np.asarray(shapely.contains_xy(area, *np.meshgrid(x, y, indexing="ij")), np.bool_)

    @cached_property
    def _before(self) -> Int32:
        """Cell before each cell on the cheapest path from the hub, negative where there is none."""
        x, _, is_free = self._grid
        away_m = distance_transform_edt(np.pad(is_free, 1))[1:-1, 1:-1] * (x[1] - x[0])
        cost = 1.0 + EDGE_COST * np.clip(1.0 - away_m / self.space.radius_m, 0.0, 1.0)
        first = np.array([self._cell(self.hub)])
        found = dijkstra(_graph(is_free, cost), directed=False, indices=first, return_predecessors=True)[1]
        return np.asarray(found[0], np.int32)

    def _cell(self, pose: Pose2) -> int:
        """Number of the free cell nearest to a pose, -1 without any."""
        tree, cells = self._free_cells
        return int(cells[tree.query(pose[:2])[1]]) if len(cells) else -1

    @cached_property
    def _free_cells(self) -> tuple[KDTree, Int64]:
        """Middles and numbers of the free cells."""
        x, y, is_free = self._grid
        columns, rows = np.nonzero(is_free)
        return KDTree(np.column_stack([x[columns], y[rows]])), columns * len(y) + rows


def _every(points_m: Float64, step_m: float) -> Float64:
    """Points of a polyline (N, 2) at whole multiples of a distance from its beginning, and its end."""
    length_m = float(arc_length(points_m)[-1])
    return at_length(points_m, np.append(np.arange(0.0, length_m, step_m), length_m))


def _graph(is_free: Bool, cost: Float64) -> "csr_array[np.float64, tuple[int, int]]":
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

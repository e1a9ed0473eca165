"""Free space of a rig: do its bodies, at poses along a path, touch an edge of the allowed area? Compiled, exact.

A trailed implement follows its hitch along the poses, which are in driving order, from a known hitch angle.

Edges lie in the lists of all cells of a grid from which the bodies could reach them, so one list is read for each pose.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64, Int32
from geometry.drawbar import Trailer, hitch_poses
from geometry.footprint import Bodies
from geometry.jit import kernel

CELL_M = 2.5
MAX_EDGE_M = 10.0
SIMPLER_M = 0.001


class EdgeGrid(NamedTuple):
    """Edges (E, 4) as x, y of both ends; those near cell k are `items[first[k]:first[k + 1]]`."""

    edges_m: Float64
    west_m: float
    south_m: float
    columns: int
    rows: int
    first: Int32
    items: Int32


@dataclass(frozen=True)
class FreeSpace:
    """Allowed area of the bodies, smallest turning radius, and length over which curvature changes."""

    allowed: BaseGeometry
    bodies: Bodies
    radius_m: float
    smoothing_m: float
    trailer: Trailer | None = None

    @cached_property
    def grid(self) -> EdgeGrid:
        """Edges of the allowed area."""
        return edge_grid(edges_of(self.allowed), self.reach_m)

    @property
    def reach_m(self) -> float:
        """Greatest distance of a body point from the origin of its carrier, `base` or hitch."""
        bodies = self.bodies if self.trailer is None else (*self.bodies, self.trailer.body)
        return max(math.hypot(max(b.front_m, -b.rear_m), b.half_width_m) for b in bodies)

    @cached_property
    def boxes_m(self) -> Float64:
        """Bodies as (B, 3): rear, front and half width."""
        return np.array([[b.rear_m, b.front_m, b.half_width_m] for b in self.bodies])

    @cached_property
    def trailed_m(self) -> Float64:
        """Trailed implement as (1, 5): rear, front and half width, hitch along x of `base`, axle; (0, 5) without."""
        if self.trailer is None:
            return np.empty((0, 5))
        body, drawbar = self.trailer.body, self.trailer.drawbar
        return np.array([[body.rear_m, body.front_m, body.half_width_m, drawbar.hitch_m, drawbar.axle_m]])

    def __post_init__(self) -> None:
        shapely.prepare(self.allowed)

    def contains(self, x_m: float, y_m: float) -> bool:
        """Whether a point is inside."""
        return bool(shapely.contains_xy(self.allowed, x_m, y_m))

    def is_free(self, p_map_m: Float64, heading_rad: Float64, hitch_rad: float = 0.0) -> bool:
        """Whether all bodies are inside at all N poses, (N, 2) and (N,), dense enough to pass no edge between two."""
        if not self.contains(*p_map_m[0]):
            return False
        if first_touching(p_map_m, heading_rad, self.boxes_m, *self.grid) < len(p_map_m):
            return False
        return self.trailer is None or not self._trailed_touching(p_map_m, heading_rad, hitch_rad).any()

    def touching(self, p_map_m: Float64, heading_rad: Float64, hitch_rad: float = 0.0, is_closed: bool = False) -> Bool:
        """Poses at which a body is not completely inside, (N,).

        `hitch_rad` is the hitch angle at the first pose; a closed line is driven around.
        """
        outside = ~shapely.contains_xy(self.allowed, p_map_m[:, 0], p_map_m[:, 1])
        outside = outside | touching(p_map_m, heading_rad, self.boxes_m, *self.grid)
        if self.trailer is None:
            return np.asarray(outside, np.bool_)
        return np.asarray(outside | self._trailed_touching(p_map_m, heading_rad, hitch_rad, is_closed), np.bool_)

    def hitch_after(self, p_map_m: Float64, heading_rad: Float64, hitch_rad: float) -> float:
        """Hitch angle of a trailed implement at the last of N poses, from that at the first; 0 without one."""
        if self.trailer is None:
            return 0.0
        yaw = hitch_poses(self.trailer.drawbar, p_map_m, heading_rad, hitch_rad)[-1, 2]
        return math.remainder(float(yaw - heading_rad[-1]), 2.0 * math.pi)

    def _trailed_touching(
        self, p_map_m: Float64, heading_rad: Float64, hitch_rad: float, is_closed: bool = False
    ) -> Bool:
        assert self.trailer is not None
        found = hitch_poses(self.trailer.drawbar, p_map_m, heading_rad, hitch_rad, is_closed)
        return touching(found[:, :2].copy(), found[:, 2].copy(), self.trailed_m[:, :3].copy(), *self.grid)


def edges_of(area: BaseGeometry) -> Float64:
    """Boundary as edges (E, 4) no longer than `MAX_EDGE_M`."""
    plain = shapely.segmentize(area.simplify(SIMPLER_M), MAX_EDGE_M)
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(plain))]
    found = [np.hstack([ring[:-1], ring[1:]]) for ring in rings]
    return np.vstack(found) if found else np.empty((0, 4))


def edge_grid(edges_m: Float64, reach_m: float) -> EdgeGrid:
    """Edges (E, 4) by the cells of a grid: those of a cell include all within `reach_m` of each point in it."""
    if not len(edges_m):
        return EdgeGrid(edges_m, 0.0, 0.0, 0, 0, np.zeros(1, np.int32), np.zeros(0, np.int32))
    low = np.minimum(edges_m[:, :2], edges_m[:, 2:]).min(axis=0)
    high = np.maximum(edges_m[:, :2], edges_m[:, 2:]).max(axis=0)
    columns, rows = (int(n) for n in np.ceil((high - low) / CELL_M) + 1)
    west, south = float(low[0]), float(low[1])
    counts = _entries(edges_m, west, south, columns, rows, reach_m, np.zeros(0, np.int32), np.zeros(0, np.int32))
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    items = np.empty(int(first[-1]), np.int32)
    _entries(edges_m, west, south, columns, rows, reach_m, first, items)
    return EdgeGrid(edges_m, west, south, columns, rows, first, items)


@kernel
def _entries(
    edges_m: Float64, west_m: float, south_m: float, columns: int, rows: int, reach_m: float, first: Int32, items: Int32
) -> Int32:
    """Number of edges near each cell; with `first` also fills `items`."""
    counts = np.zeros(columns * rows, np.int32)
    near = reach_m + CELL_M * 0.7072
    for e in range(len(edges_m)):
        ax, ay, bx, by = edges_m[e]
        i0 = max(0, int((min(ax, bx) - near - west_m) / CELL_M))
        i1 = min(columns - 1, int((max(ax, bx) + near - west_m) / CELL_M))
        j0 = max(0, int((min(ay, by) - near - south_m) / CELL_M))
        j1 = min(rows - 1, int((max(ay, by) + near - south_m) / CELL_M))
        dx, dy = bx - ax, by - ay
        square = max(dx * dx + dy * dy, 1e-12)
        for j in range(j0, j1 + 1):
            y = south_m + (j + 0.5) * CELL_M - ay
            for i in range(i0, i1 + 1):
                x = west_m + (i + 0.5) * CELL_M - ax
                share = min(max((x * dx + y * dy) / square, 0.0), 1.0)
                if (x - share * dx) ** 2 + (y - share * dy) ** 2 <= near * near:
                    k = j * columns + i
                    if len(items) > 0:
                        items[first[k] + counts[k]] = e
                    counts[k] += 1
    return counts


@kernel
def is_touching(
    x: float, y: float, heading_rad: float, boxes_m: Float64, edges_m: Float64, west_m: float, south_m: float,
    columns: int, rows: int, first: Int32, items: Int32,
) -> bool:  # fmt: skip
    """Whether an edge meets a body at one pose; True outside the grid."""
    i, j = math.floor((x - west_m) / CELL_M), math.floor((y - south_m) / CELL_M)
    if i < 0 or j < 0 or i >= columns or j >= rows:
        return True
    k = j * columns + i
    if first[k] == first[k + 1]:
        return False
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    for n in range(first[k], first[k + 1]):
        e = items[n]
        dx, dy = edges_m[e, 0] - x, edges_m[e, 1] - y
        ax, ay = c * dx + s * dy, c * dy - s * dx
        dx, dy = edges_m[e, 2] - x, edges_m[e, 3] - y
        bx, by = c * dx + s * dy, c * dy - s * dx
        for b in range(len(boxes_m)):
            if _meets(ax, ay, bx, by, boxes_m[b, 0], boxes_m[b, 1], boxes_m[b, 2]):
                return True
    return False


@kernel
def _meets(ax: float, ay: float, bx: float, by: float, rear: float, front: float, half: float) -> bool:
    """Whether an edge meets the rectangle from `rear` to `front` and `half` to either side (Liang and Barsky 1984)."""
    low, high = 0.0, 1.0
    for axis in range(2):
        a, d = (ax, bx - ax) if axis == 0 else (ay, by - ay)
        least, most = (rear, front) if axis == 0 else (-half, half)
        if abs(d) < 1e-12:
            if a < least or a > most:
                return False
            continue
        t0, t1 = (least - a) / d, (most - a) / d
        low, high = max(low, min(t0, t1)), min(high, max(t0, t1))
        if low > high:
            return False
    return True


@kernel
def first_touching(
    p_map_m: Float64, heading_rad: Float64, boxes_m: Float64, edges_m: Float64, west_m: float, south_m: float,
    columns: int, rows: int, first: Int32, items: Int32,
) -> int:  # fmt: skip
    """Index of the first pose that touches an edge, else N."""
    for k in range(len(p_map_m)):
        if is_touching(
            p_map_m[k, 0], p_map_m[k, 1], heading_rad[k], boxes_m, edges_m, west_m, south_m, columns, rows, first, items
        ):
            return k
    return len(p_map_m)


@kernel
def touching(
    p_map_m: Float64, heading_rad: Float64, boxes_m: Float64, edges_m: Float64, west_m: float, south_m: float,
    columns: int, rows: int, first: Int32, items: Int32,
) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":  # fmt: skip
    """Poses that touch an edge, (N,)."""
    found = np.zeros(len(p_map_m), np.bool_)
    for k in range(len(p_map_m)):
        found[k] = is_touching(
            p_map_m[k, 0], p_map_m[k, 1], heading_rad[k], boxes_m, edges_m, west_m, south_m, columns, rows, first, items
        )
    return found

"""Worked area: strips that the lowered implement has passed, and their area without what was passed twice."""

import math
from array import array
from collections.abc import Iterable

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.pose2 import Pose2

STEP_M = 0.5
MAX_STEP_M = 5.0  # a larger one is a jump of the pose, or a gap in the messages


class Rows:
    """Rows of `width` numbers, 8 bytes each: a drive of a day has 200,000 of them."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._values) // self._width

    def append(self, row: Iterable[float]) -> None:
        """Adds a row, rounded to 1 cm."""
        self._values.extend(round(float(value), 2) for value in row)

    def since(self, first: int) -> list[list[float]]:
        """The rows from number `first` on."""
        return np.array(self._values[first * self._width :]).reshape(-1, self._width).tolist()


class Coverage:
    """Worked cells of the field, and `edges` of the working width: strip, left x, left y, right x, right y."""

    def __init__(self, field: BaseGeometry, width_m: float, working_point_m: float, cell_m: float) -> None:
        self._field = field
        shapely.prepare(field)
        self._width_m, self._point_m, self._cell_m = width_m, working_point_m, cell_m
        bounds = np.array([0.0, 0.0, 0.0, 0.0] if field.is_empty else field.bounds) / cell_m
        self._first = np.floor(bounds[:2]).astype(int)
        self._is_worked = np.zeros(np.ceil(bounds[2:]).astype(int) - self._first, bool)
        self._edge: Float64 | None = None
        self._strip = 0
        self.area_m2 = 0.0
        self.edges = Rows(5)

    def update(self, pose: Pose2, is_working: bool) -> None:
        """Adds the strip between the last pose and this one, at a pose of `base` in `map`."""
        if not is_working:
            self._edge = None
            return
        center, half = pose.ahead(self._point_m), 0.5 * self._width_m
        ends = center.beside(half), center.beside(-half)
        edge = np.array([[end.x_m, end.y_m] for end in ends])
        if self._edge is None:
            self._strip += 1
        else:
            moved_m = float(np.abs(edge - self._edge).max())
            if moved_m < STEP_M:
                return
            if moved_m > MAX_STEP_M:
                self._strip += 1
            else:
                self._mark(np.vstack([self._edge, edge[::-1]]))
        self._edge = edge
        self.edges.append([self._strip, *edge.ravel()])

    def _mark(self, corners: Float64) -> None:
        """Marks the cells whose centre lies in a quadrilateral with corners (4, 2), by the even-odd rule.

        In a tight turn the inner end moves back and two sides cross: the parts on both sides of the crossing count.
        """
        cell = self._cell_m
        low = np.maximum(np.floor(corners.min(axis=0) / cell).astype(int) - self._first, 0)
        high = np.maximum(np.ceil(corners.max(axis=0) / cell).astype(int) - self._first, 0)
        worked = self._is_worked[low[0] : high[0], low[1] : high[1]]
        if not worked.size:
            return
        ix, iy = (np.arange(n) for n in worked.shape)
        origin = (self._first + low + 0.5) * cell
        x, y = np.meshgrid(origin[0] + ix * cell, origin[1] + iy * cell, indexing="ij")
        nxt = np.roll(corners, -1, axis=0)
        inside = np.zeros(x.shape, bool)
        for a, b in zip(corners, nxt, strict=True):
            if a[1] != b[1]:
                is_between = (a[1] > y) != (b[1] > y)
                inside ^= is_between & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
        inside &= shapely.contains_xy(self._field, x, y) & ~worked
        worked |= inside
        self.area_m2 += int(np.count_nonzero(inside)) * cell**2


class Trail:
    """Driven track of `base` in `map`, thinned to `STEP_M`."""

    def __init__(self) -> None:
        self.points = Rows(2)
        self._last: tuple[float, float] | None = None

    def update(self, pose: Pose2) -> None:
        """Adds a pose if it is far enough from the last one."""
        if self._last is None or math.dist(self._last, pose[:2]) >= STEP_M:
            self._last = pose.x_m, pose.y_m
            self.points.append(self._last)

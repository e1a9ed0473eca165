"""Worked area: strips that the lowered implement has passed, and their area without what was passed twice."""

import math

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.pose2 import Pose2

STEP_M = 0.5
MAX_STEP_M = 5.0  # a larger one is a jump of the pose, or a gap in the messages


class Coverage:
    """Worked cells of the field, and `edges` of the working width: [strip, left x, left y, right x, right y]."""

    def __init__(self, field: BaseGeometry, width_m: float, working_point_m: float, cell_m: float) -> None:
        self._field = field
        self._width_m, self._point_m, self._cell_m = width_m, working_point_m, cell_m
        self._cells: set[tuple[int, int]] = set()
        self._edge: Float64 | None = None
        self._strip = 0
        self.edges: list[list[float]] = []

    @property
    def area_m2(self) -> float:
        """Worked area."""
        return len(self._cells) * self._cell_m**2

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
        self.edges.append([self._strip, *(round(float(value), 2) for value in edge.ravel())])

    def _mark(self, corners: Float64) -> None:
        """Marks the cells whose centre lies in a quadrilateral with corners (4, 2), by the even-odd rule.

        In a tight turn the inner end moves back and two sides cross: the parts on both sides of the crossing count.
        """
        cell = self._cell_m
        low, high = np.floor(corners.min(axis=0) / cell), np.ceil(corners.max(axis=0) / cell)
        ix, iy = (np.arange(int(a), int(b) + 1) for a, b in zip(low, high, strict=True))
        x, y = np.meshgrid((ix + 0.5) * cell, (iy + 0.5) * cell, indexing="ij")
        nxt = np.roll(corners, -1, axis=0)
        inside = np.zeros(x.shape, bool)
        for a, b in zip(corners, nxt, strict=True):
            if a[1] != b[1]:
                is_between = (a[1] > y) != (b[1] > y)
                inside ^= is_between & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
        inside &= shapely.contains_xy(self._field, x, y)
        self._cells.update((int(ix[i]), int(iy[j])) for i, j in zip(*np.nonzero(inside), strict=True))


class Trail:
    """Driven track of `base` in `map`, thinned to `STEP_M`."""

    def __init__(self) -> None:
        self.points: list[list[float]] = []

    def update(self, pose: Pose2) -> None:
        """Adds a pose if it is far enough from the last one."""
        if not self.points or math.dist(self.points[-1], pose[:2]) >= STEP_M:
            self.points.append([round(pose.x_m, 2), round(pose.y_m, 2)])

"""Static structure of a log: where returns outside of all true boxes stay over time, in odom."""

import math
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Bool, Float64, Int64
from geometry.pose2 import to_frame
from validation.obstacle_stop.recorded_motion import Section

CELL_M = 0.5
HEIGHTS_M = (0.4, 3.0)  # above the ground at the machine: neither ground nor branches above it
REACH_M = 40.0
MIN_SCANS = 3
MIN_SPAN_NS = 1_000_000_000
NEAR_M = 1.0  # of the hidden object: its own returns beside its box
MERGE_ROWS = 200_000
OFFSET = 1 << 30
RAY_STEP_M = 0.25


@dataclass
class Structure:
    """Cells of `CELL_M` with the first and last time, number of scans, and height (above base) of their returns."""

    keys: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    values: Float64 = field(default_factory=lambda: np.empty((0, 4)))
    _new: list[tuple[Int64, Float64]] = field(default_factory=list)
    _rows: int = 0

    def add(self, stamp_ns: int, points_base_m: Float64, pose_odom: Float64) -> None:
        """Adds the returns (N, 3) of a scan, without those in true boxes."""
        low, high = HEIGHTS_M
        flat = np.hypot(points_base_m[:, 0], points_base_m[:, 1])
        p = points_base_m[(points_base_m[:, 2] > low) & (points_base_m[:, 2] < high) & (flat < REACH_M)]
        keys, where = np.unique(cell_keys(to_frame(pose_odom, p[:, :2])), return_inverse=True)
        tops = np.full(len(keys), -np.inf)
        np.maximum.at(tops, where, p[:, 2])
        n = len(keys)
        self._new.append((keys, np.column_stack([np.full(n, stamp_ns), np.full(n, stamp_ns), np.ones(n), tops])))
        self._rows += n
        if self._rows > MERGE_ROWS:
            self.merge()

    def merge(self) -> None:
        """Merges the rows of scans into cells."""
        keys = np.concatenate([self.keys, *(k for k, _ in self._new)])
        rows = np.concatenate([self.values, *(v for _, v in self._new)])
        self._new, self._rows = [], 0
        if not len(keys):
            return
        order = np.argsort(keys, kind="stable")
        keys, rows = keys[order], rows[order]
        starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
        by = [np.minimum, np.maximum, np.add, np.maximum]
        self.values = np.column_stack([f.reduceat(rows[:, k], starts) for k, f in enumerate(by)])
        self.keys = keys[starts]

    def cells(self, sections: tuple[Section, ...]) -> "StaticCells":
        """Cells with returns in several scans over a second, except where the machine drove."""
        self.merge()
        if not len(self.keys):
            return StaticCells(self.keys, np.empty(0))
        first, last, count, top = self.values.T
        is_static = (count >= MIN_SCANS) & (last - first >= MIN_SPAN_NS)
        driven = np.unique(np.concatenate([cell_keys(_covered(section)) for section in sections]))
        is_static &= ~np.isin(self.keys, driven)
        return StaticCells(self.keys[is_static], top[is_static])


@dataclass(frozen=True, eq=False)
class StaticCells:
    """Occupied cells by increasing key (N,), with the height (N,) of their highest return."""

    keys: Int64
    top_m: Float64

    def around(self, pose_odom: Float64, box_xy_m: Float64, box_radius_m: float) -> "StaticSolid":
        """What hides an object (position (2,) and radius in base) for base at a pose (3,) in odom."""
        return StaticSolid(self, pose_odom, box_xy_m, box_radius_m)


@dataclass(frozen=True, eq=False)
class StaticSolid:
    """The cells as seen from one pose, without those at the object itself."""

    cells: StaticCells
    pose_odom: Float64
    box_xy_m: Float64
    box_radius_m: float

    def blocks(self, origin_m: Float64, points_m: Float64) -> Bool:
        """Mask (N,): whether an occupied cell lies between the origin and each point, in base."""
        if not len(self.cells.keys):
            return np.zeros(len(points_m), bool)
        far = float(np.hypot(*(points_m[:, :2] - origin_m[:2]).T).max())
        share = np.linspace(0.0, 1.0, max(2, math.ceil(far / RAY_STEP_M)))[None, :, None]
        rays = (origin_m + share * (points_m[:, None] - origin_m)).reshape(-1, 3)
        keys = cell_keys(to_frame(self.pose_odom, rays[:, :2]))
        k = np.minimum(np.searchsorted(self.cells.keys, keys), len(self.cells.keys) - 1)
        is_hit = (self.cells.keys[k] == keys) & (rays[:, 2] < self.cells.top_m[k])
        is_hit &= np.hypot(*(rays[:, :2] - self.box_xy_m).T) > self.box_radius_m + NEAR_M
        return np.asarray(is_hit.reshape(len(points_m), -1).any(axis=1))


def cell_keys(xy_m: Float64) -> Int64:
    """Key (N,) of the cell of each point (N, 2) in odom."""
    k = np.floor(xy_m / CELL_M).astype(np.int64) + OFFSET
    return np.asarray((k[:, 0] << 32) | k[:, 1])


def _covered(section: Section) -> Float64:
    """Points (N, 2) on the ground that the machine covered in a section."""
    out = []
    rows = section.path.s_m <= section.end_m
    for body in section.path.bodies:
        poses, (a, b) = body.poses[rows], body.half_m
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        for x in np.linspace(-a, a, max(2, math.ceil(4.0 * a / CELL_M))):
            for y in np.linspace(-b, b, max(2, math.ceil(4.0 * b / CELL_M))):
                out += [np.column_stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y])]
    return np.concatenate(out)

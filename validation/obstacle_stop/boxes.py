"""True objects as boxes in base, and which returns belong to them, pass them or end before them."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from geometry.arrays import Float32, Float64
from messages.truth import TrueObject

Mask = npt.NDArray[np.bool_]
LEVELS = 5


@dataclass(frozen=True, eq=False)
class Box:
    """A box in base: centre (3,), size (3,) and yaw."""

    id: int
    label: str
    role: str
    center_m: Float64
    size_m: Float64
    yaw_rad: float

    def local(self, points_m: Float32 | Float64) -> Float64:
        """Points (N, 3) in the box's own axes, from its centre."""
        d = np.asarray(points_m, np.float64) - self.center_m
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]])

    def contains(self, points_m: Float32 | Float64, grow_m: float = 0.0) -> Mask:
        """Which points (N, 3) lie in the box grown to all sides."""
        return np.asarray((np.abs(self.local(points_m)) <= 0.5 * self.size_m + grow_m).all(axis=1))

    def away_m(self, xy_m: Float64) -> Float64:
        """Level distance of points (N, 2) from the box, 0 inside."""
        local = self.local(np.column_stack([xy_m, np.full(len(xy_m), self.center_m[2])]))
        out = np.maximum(np.abs(local[:, :2]) - 0.5 * self.size_m[:2], 0.0)
        return np.asarray(np.hypot(out[:, 0], out[:, 1]))

    def footprint_m(self) -> Float64:
        """Points (25, 2) all over its base."""
        x, y = (np.linspace(-0.5, 0.5, LEVELS) * side for side in self.size_m[:2])
        grid = np.array([(a, b) for a in x for b in y])
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.column_stack([c * grid[:, 0] - s * grid[:, 1], s * grid[:, 0] + c * grid[:, 1]]) + self.center_m[:2]

    def corners_m(self) -> Float64:
        """Its outline (4, 2)."""
        return self.footprint_m()[[0, LEVELS - 1, LEVELS * LEVELS - 1, LEVELS * (LEVELS - 1)]]


def box_of(thing: TrueObject, T_base_truth: Float64) -> Box:
    """A true object brought to base."""
    center = T_base_truth[:3, :3] @ thing.center_map_m + T_base_truth[:3, 3]
    yaw = thing.yaw_rad + math.atan2(T_base_truth[1, 0], T_base_truth[0, 0])
    return Box(thing.id, thing.label.value, thing.role or f"{thing.label.value} {thing.id}", center, thing.size_m, yaw)


def near(points_m: Float32, box: Box, margin_m: float) -> npt.NDArray[np.int64]:
    """Indices of the points (N, 3) about a box."""
    reach = 0.5 * float(np.linalg.norm(box.size_m)) + margin_m
    d = np.abs(points_m[:, :2] - box.center_m[:2].astype(np.float32))
    return np.flatnonzero((d[:, 0] < reach) & (d[:, 1] < reach))


def beams_at(points_m: Float32, origin_m: Float64, box: Box) -> tuple[int, int]:
    """How many beams that meet the box go on behind it, and how many end before it."""
    start, d = box.local(origin_m[None])[0], box.local(points_m) - box.local(origin_m[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-0.5 * box.size_m - start) / d, (0.5 * box.size_m - start) / d
    enter, leave = np.fmax.reduce(np.fmin(one, two), axis=1), np.fmin.reduce(np.fmax(one, two), axis=1)
    is_met = (enter < leave) & (leave > 0.0)
    return int(np.count_nonzero(is_met & (leave < 1.0))), int(np.count_nonzero(is_met & (enter > 1.0)))


def towards(points_m: Float32, origin_m: Float64, box: Box) -> npt.NDArray[np.int64]:
    """Indices of the points whose level direction from the origin is about that of the box."""
    d = box.center_m[:2] - origin_m[:2]
    distance = max(float(np.hypot(*d)), 1e-6)
    half = math.asin(min(1.0, 0.5 * float(np.hypot(*box.size_m[:2])) / distance)) if distance > 0.0 else math.pi
    rel = points_m[:, :2] - origin_m[:2].astype(np.float32)
    c, s = math.cos(math.atan2(d[1], d[0])), math.sin(math.atan2(d[1], d[0]))
    along, across = rel[:, 0] * c + rel[:, 1] * s, rel[:, 1] * c - rel[:, 0] * s
    return np.flatnonzero((along > 0.0) & (np.abs(across) <= along * math.tan(min(half, 1.5)) + 1e-6))

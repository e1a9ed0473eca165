"""True objects as boxes in base, and their returns."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Bool, Float32, Float64, Int64
from geometry.jit import kernel
from messages.truth import TrueObject

NEAR_M = 0.1  # margin of the preselection of points
GRID = 5  # points along each side of a footprint
UNIT_GRID = np.array([(x, y) for x in np.linspace(-0.5, 0.5, GRID) for y in np.linspace(-0.5, 0.5, GRID)])
MIN_SIDE_M = 0.05
GROUND_M, SLOPE = 1.0, 0.15  # height of a box over the ground at the machine: noise, and slope of the ground


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
        """Points (N, 3) in box axes, origin at the centre."""
        d = np.asarray(points_m, np.float64) - self.center_m
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]])

    def contains(self, points_m: Float32 | Float64, grow_m: float = 0.0) -> Bool:
        """Mask (N,) of the points (N, 3) inside the box, grown by `grow_m` on all sides."""
        half = 0.5 * self.size_m + grow_m
        return _contains(points_m, self.center_m, half, math.cos(self.yaw_rad), math.sin(self.yaw_rad))

    def returns(self, points_m: Float32) -> Int64:
        """Indices of the points (N, 3) inside the box."""
        reach = 0.5 * float(np.linalg.norm(self.size_m)) + NEAR_M
        x, y = np.float32(self.center_m[0]), np.float32(self.center_m[1])
        near = _near(points_m, x, y, reach)
        return near[self.contains(points_m[near])]

    def distance_m(self, xy_m: Float64) -> Float64:
        """Horizontal distance of points (N, 2) from the box, 0 inside."""
        local = self.local(np.column_stack([xy_m, np.full(len(xy_m), self.center_m[2])]))
        out = np.maximum(np.abs(local[:, :2]) - 0.5 * self.size_m[:2], 0.0)
        return np.asarray(np.hypot(out[:, 0], out[:, 1]))

    def footprint_m(self) -> Float64:
        """Grid of points (25, 2) over the base of the box."""
        grid = UNIT_GRID * self.size_m[:2]
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.column_stack([c * grid[:, 0] - s * grid[:, 1], s * grid[:, 0] + c * grid[:, 1]]) + self.center_m[:2]

    def corners_m(self) -> Float64:
        """Corners of the base (4, 2)."""
        return self.footprint_m()[[0, GRID - 1, GRID * GRID - 1, GRID * (GRID - 1)]]


def box_fault(box: Box) -> str | None:
    """Why a labelled box in base cannot be an object on the ground; None for a possible one."""
    if not np.isfinite([*box.center_m, *box.size_m, box.yaw_rad]).all():
        return "place, size or yaw is not a number"
    if box.size_m.min() < MIN_SIDE_M:
        return f"size {' × '.join(f'{side:g}' for side in box.size_m)} m"
    low, high = box.center_m[2] + np.array([-0.5, 0.5]) * box.size_m[2]
    away = float(low if low > 0.0 else min(high, 0.0))
    limit = GROUND_M + SLOPE * float(np.hypot(*box.center_m[:2]))
    return f"{abs(away):.1f} m {'above' if away > 0.0 else 'below'} the ground" if abs(away) > limit else None


def box_of(true: TrueObject, T_base_truth: Float64) -> Box:
    """Box of a true object in base."""
    center = T_base_truth[:3, :3] @ true.center_map_m + T_base_truth[:3, 3]
    yaw = true.yaw_rad + math.atan2(T_base_truth[1, 0], T_base_truth[0, 0])
    return Box(true.id, true.label.value, true.role or f"{true.label.value} {true.id}", center, true.size_m, yaw)


@kernel
def _contains(points_m: Float32 | Float64, center_m: Float64, half_m: Float64, c: float, s: float) -> Bool:
    inside = np.empty(len(points_m), np.bool_)
    for i in range(len(points_m)):
        x, y, z = points_m[i, 0] - center_m[0], points_m[i, 1] - center_m[1], points_m[i, 2] - center_m[2]
        inside[i] = abs(c * x + s * y) <= half_m[0] and abs(c * y - s * x) <= half_m[1] and abs(z) <= half_m[2]
    return inside


@kernel
def _near(points_m: Float32, x_m: np.float32, y_m: np.float32, reach_m: float) -> Int64:
    """Indices of the points (N, 3) in a square."""
    found, n = np.empty(len(points_m), np.int64), 0
    for i in range(len(points_m)):
        if abs(points_m[i, 0] - x_m) < reach_m and abs(points_m[i, 1] - y_m) < reach_m:
            found[n] = i
            n += 1
    return found[:n].copy()

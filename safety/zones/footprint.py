"""Footprint of machine and implement as rectangles, in working and in transport width; pose of a trailed implement.

 front_m ┌──┐ 0 = base        each rectangle lies in the frame of its carrier:
         │  │                 `base`, or the hitch of a trailed implement (x forward, y left)
┌────────┴──┴────────┐
└────────────────────┘ rear_m
"""

import math
from dataclasses import dataclass

import numpy as np

from configs.vehicle import FOLDED, MountedImplement, TrailedImplement, Vehicle, outlines
from geometry.arrays import Float32, Float64
from geometry.drawbar import Drawbar, hitch_poses, steady_angle
from geometry.rectangle import Rectangle
from messages.command import MachineState
from safety.hitch_angle import angles_between

Floats = Float32 | Float64
ON_GROUND_M = 0.2  # lowest point of a wheel


@dataclass(frozen=True)
class Box:
    """Axis-aligned area of a level frame: limits (low, high) along x and y."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]

    def contains(self, xy: Floats) -> np.ndarray:
        """Whether each point (N, 2) lies in it, (N,) bool; NaN counts as inside."""
        (x_low, x_high), (y_low, y_high) = self.x_m, self.y_m
        x, y = xy[:, 0], xy[:, 1]
        return np.asarray(~((x < x_low) | (x > x_high) | (y < y_low) | (y > y_high)))

    def enlarged(self, by_m: float) -> "Box":
        """Box with `by_m` more on every side."""
        (x_low, x_high), (y_low, y_high) = self.x_m, self.y_m
        return Box((x_low - by_m, x_high + by_m), (y_low - by_m, y_high + by_m))

    def in_parent(self, pose: Float64) -> "Box":
        """Box in the parent frame that contains this one, whose frame has the pose (3,) there."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = 0.5 * (self.x_m[0] + self.x_m[1]), 0.5 * (self.y_m[0] + self.y_m[1])
        half_x, half_y = self.x_m[1] - x, self.y_m[1] - y
        wide, deep = abs(c) * half_x + abs(s) * half_y, abs(s) * half_x + abs(c) * half_y
        x, y = pose[0] + c * x - s * y, pose[1] + s * x + c * y
        return Box((x - wide, x + wide), (y - deep, y + deep))


def enclosing(box: Box, other: Box) -> Box:
    """Smallest box about two."""
    low_x, low_y = min(box.x_m[0], other.x_m[0]), min(box.y_m[0], other.y_m[0])
    high_x, high_y = max(box.x_m[1], other.x_m[1]), max(box.y_m[1], other.y_m[1])
    return Box((low_x, high_x), (low_y, high_y))


def bounding_box(points: Float64) -> Box:
    """Box about points (N, 2), at least one."""
    (x_low, y_low), (x_high, y_high) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return Box((x_low, x_high), (y_low, y_high))


@dataclass(frozen=True)
class Footprint:
    """Rectangles rigid to base, and a trailed one with its drawbar.

    `parts` are those of the machine in plan, wheels that steer at every angle; places between them are free. Without
    parts the machine fills its rectangle. `height_m` is that of the machine, `mounted_height_m` that of a raised
    implement on its hitch. `hitch_rad` are the bounds of the hitch angle that can be (`safety/hitch_angle.py`); None:
    that of steady driving on a curvature.
    """

    rigid: tuple[Rectangle, ...]
    trailed: Rectangle | None
    drawbar: Drawbar | None
    height_m: float
    mounted_height_m: float = math.inf
    hitch_rad: tuple[float, float] | None = None
    parts: tuple[Box, ...] = ()

    @property
    def tops_m(self) -> tuple[float, ...]:
        """Height above the ground that each body reaches; a trailed one is taken to be as high as the machine."""
        mounted = (min(self.height_m, self.mounted_height_m),) * (len(self.rigid) - 1)
        return (self.height_m, *mounted, *(() if self.trailed is None else (self.height_m,)))

    def foremost_m(self, direction: int) -> float:
        """Coordinate along x of base of the foremost edge, driving straight in the direction."""
        return direction * max(self._leading_edges(direction))

    def leads_m(self, direction: int) -> tuple[float, ...]:
        """Distance of each body's leading edge behind the foremost point, driving straight."""
        edges = self._leading_edges(direction)
        return tuple(max(edges) - edge for edge in edges)

    def _leading_edges(self, direction: int) -> tuple[float, ...]:
        rigid = tuple(body.front_m if direction > 0 else -body.rear_m for body in self.rigid)
        if self.trailed is None or self.drawbar is None:
            return rigid
        end_m = self.trailed.front_m if direction > 0 else self.trailed.rear_m
        return (*rigid, direction * (self.drawbar.hitch_m + end_m))


def footprint_of(vehicle: Vehicle, implement: MountedImplement | TrailedImplement | None) -> Footprint:
    """Footprint of a vehicle with its mounted or trailed implement."""
    height_m, parts = vehicle.body.height_m, parts_of(vehicle)
    if not isinstance(implement, TrailedImplement):
        mounted_m = math.inf if implement is None else implement.height_m + implement.lift_m
        return Footprint(outlines(vehicle.body, implement), None, None, height_m, mounted_m, parts=parts)
    drawbar = Drawbar(implement.hitch_m, implement.axle_length_m)
    trailed = Rectangle(-implement.total_length_m, 0.0, implement.width_m)
    return Footprint(outlines(vehicle.body, None), trailed, drawbar, height_m, parts=parts)


def parts_of(vehicle: Vehicle) -> tuple[Box, ...]:
    """The solids of a machine in plan; a wheel on the steered axle as the square about all its angles."""
    parts = []
    for solid in vehicle.body.solids.values():
        (rear, front), (right, left) = solid.x_m, solid.y_m
        x, y = 0.5 * (rear + front), 0.5 * (right + left)
        is_steered = solid.z_m[0] < ON_GROUND_M and rear < vehicle.drivetrain.wheelbase_m < front
        reach = math.hypot(front - x, left - y)
        box = Box((x - reach, x + reach), (y - reach, y + reach)) if is_steered else Box(solid.x_m, solid.y_m)
        parts.append(box)
    return tuple(parts)


@dataclass(frozen=True)
class FootprintSet:
    """Footprints with the implement in working and in transport width; the same object when it does not fold.

    `pto_stop_s` is the run-down of the implement's PTO, `max_hitch_rad` the largest angle of a trailed one.
    """

    working: Footprint
    transport: Footprint
    pto_stop_s: float
    max_hitch_rad: float = 0.0

    @property
    def is_foldable(self) -> bool:
        """Whether the two differ."""
        return self.working is not self.transport

    def at(self, fold: float | None) -> Footprint:
        """Footprint at a measured fold position; that of the working width when it is unknown."""
        return self.transport if fold is not None and fold >= FOLDED else self.working


def footprints_of(vehicle: Vehicle, implement: MountedImplement | TrailedImplement | None) -> FootprintSet:
    """Both footprints of a vehicle with its implement."""
    working = footprint_of(vehicle, implement)
    transport = working if implement is None else footprint_of(vehicle, implement.folded)
    pto_stop_s = implement.pto_stop_s if implement is not None and implement.uses_pto else 0.0
    max_hitch_rad = math.radians(implement.max_hitch_deg) if isinstance(implement, TrailedImplement) else 0.0
    return FootprintSet(working, working if transport == working else transport, pto_stop_s, max_hitch_rad)


def fold_of(machine: MachineState | None, max_group_age_s: float) -> float | None:
    """Measured fold position; None without a machine state or when its implement group is too old."""
    if machine is None or machine.stamp_ns - machine.implement_stamp_ns > max_group_age_s * 1e9:
        return None
    return machine.fold_position


def hitch_of(machine: MachineState | None, max_group_age_s: float) -> float:
    """Measured hitch position; that of the raised implement when unknown: low objects then appear higher, not lower."""
    if machine is None or machine.stamp_ns - machine.implement_stamp_ns > max_group_age_s * 1e9:
        return 1.0
    return machine.hitch if math.isfinite(machine.hitch) else 1.0


def is_between(fold: float) -> bool:
    """Whether an implement is locked in neither end position of its fold."""
    return not (fold <= 1.0 - FOLDED or fold >= FOLDED)


def carriers(footprint: Footprint, poses: Float64, curvature_radpm: float) -> tuple[tuple[Rectangle, Float64], ...]:
    """Each rectangle with the poses (M, 3) of its carrier, for poses of base (M, 3: x, y, yaw) along a path.

    A trailed one once for each of the angles that it may have at the first pose, close to each other.
    """
    rigid = tuple((body, poses) for body in footprint.rigid)
    if footprint.trailed is None or footprint.drawbar is None:
        return rigid
    angles = _angles(footprint.drawbar, footprint.hitch_rad, curvature_radpm)
    return (*rigid, *((footprint.trailed, trailer_poses(footprint.drawbar, poses, angle)) for angle in angles))


def trailer_poses(drawbar: Drawbar, poses: Float64, hitch_rad: float) -> Float64:
    """Poses (M, 3) of the hitch with the implement's heading, for poses of base, from a hitch angle at the first."""
    return hitch_poses(drawbar, poses[:, :2], poses[:, 2], hitch_rad)


def _angles(drawbar: Drawbar, bounds_rad: tuple[float, float] | None, curvature_radpm: float) -> list[float]:
    return [steady_angle(drawbar, curvature_radpm)] if bounds_rad is None else angles_between(bounds_rad)


def outline(body: Rectangle) -> Float64:
    """Corners and side midpoints, (8, 2)."""
    x = (body.rear_m, 0.5 * (body.rear_m + body.front_m), body.front_m)
    w = body.half_width_m
    return np.array([(a, b) for a in x for b in (-w, 0.0, w) if not (a == x[1] and b == 0.0)])


def is_inside(body: Rectangle, x_m: Floats, y_m: Floats, margin_m: float) -> np.ndarray:
    """Whether each point of the carrier's frame lies within the rectangle enlarged by a margin, (N,) bool."""
    along = (x_m >= body.rear_m - margin_m) & (x_m <= body.front_m + margin_m)
    return np.asarray(along & (np.abs(y_m) <= body.half_width_m + margin_m))


def is_own(xyz: Floats, footprint: Footprint, curvature_radpm: float, margin_m: float) -> np.ndarray:
    """Whether each point (3, N) in base lies on machine or implement, (N,) bool; not what stands between their parts.

    A trailed one has the middle of the angles that can be: where it has another, its returns count as an obstacle.
    """
    machine, *mounted = footprint.rigid
    own = is_inside(machine, xyz[0], xyz[1], margin_m)
    if footprint.parts:
        within = np.flatnonzero(own)
        xy = xyz[:2, within].T
        own[within] = np.logical_or.reduce([part.enlarged(margin_m).contains(xy) for part in footprint.parts])
    for body in mounted:
        own |= is_inside(body, xyz[0], xyz[1], margin_m)
    if footprint.trailed is not None and footprint.drawbar is not None:
        angles = _angles(footprint.drawbar, footprint.hitch_rad, curvature_radpm)
        x, y, yaw = trailer_poses(footprint.drawbar, np.zeros((1, 3)), angles[len(angles) // 2])[0]
        c, s, dx, dy = np.cos(yaw), np.sin(yaw), xyz[0] - x, xyz[1] - y
        own |= is_inside(footprint.trailed, c * dx + s * dy, c * dy - s * dx, margin_m)
    return own

"""Machine and implement as rectangles, and where a trailed implement goes.

 front_m ┌──┐ 0 = base        each rectangle lies in the frame of its carrier:
         │  │                 `base`, or the hitch of a trailed implement (x forward, y left)
┌────────┴──┴────────┐
└────────────────────┘ rear_m
"""

import math
from dataclasses import dataclass

import numpy as np

from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from messages.message import Float32, Float64

Floats = Float32 | Float64


@dataclass(frozen=True)
class Rectangle:
    """Extent along x from `rear_m` to `front_m`, and to either side."""

    rear_m: float
    front_m: float
    half_width_m: float


@dataclass(frozen=True)
class Drawbar:
    """Hitch of a trailed implement along x of base, and its axle behind the hitch."""

    hitch_m: float
    axle_m: float


@dataclass(frozen=True)
class Footprint:
    """All that moves: the rigid rectangles, and a trailed one with its drawbar."""

    rigid: tuple[Rectangle, ...]
    trailed: Rectangle | None
    drawbar: Drawbar | None
    height_m: float

    def foremost_m(self, direction: int) -> float:
        """The edge that leads when driving straight in the direction, along x of base."""
        return direction * max(self._leading_edges(direction))

    def leads_m(self, direction: int) -> tuple[float, ...]:
        """How far the leading edge of each body lies behind the foremost point, driving straight."""
        edges = self._leading_edges(direction)
        return tuple(max(edges) - edge for edge in edges)

    def _leading_edges(self, direction: int) -> tuple[float, ...]:
        rigid = tuple(body.front_m if direction > 0 else -body.rear_m for body in self.rigid)
        if self.trailed is None or self.drawbar is None:
            return rigid
        end_m = self.trailed.front_m if direction > 0 else self.trailed.rear_m
        return (*rigid, direction * (self.drawbar.hitch_m + end_m))


def footprint_of(vehicle: Vehicle, implement: MountedImplement | TrailedImplement | None) -> Footprint:
    """The outline of a vehicle with what it carries or pulls."""
    body = vehicle.body
    machine = Rectangle(-body.rear_m, body.front_m, 0.5 * body.width_m)
    if implement is None:
        return Footprint((machine,), None, None, body.height_m)
    half_m = 0.5 * implement.width_m
    if isinstance(implement, MountedImplement):
        carried = Rectangle(implement.rear_end_m, implement.front_end_m, half_m)
        return Footprint((machine, carried), None, None, body.height_m)
    drawbar = Drawbar(implement.hitch_m, implement.axle_length_m)
    return Footprint((machine,), Rectangle(-implement.total_length_m, 0.0, half_m), drawbar, body.height_m)


def carriers(footprint: Footprint, poses: Float64, curvature_radpm: float) -> tuple[tuple[Rectangle, Float64], ...]:
    """Each rectangle with the poses (M, 3) of its carrier, for poses of base (M, 3: x, y, yaw) along a way."""
    rigid = tuple((body, poses) for body in footprint.rigid)
    if footprint.trailed is None or footprint.drawbar is None:
        return rigid
    return (*rigid, (footprint.trailed, trailer_poses(footprint.drawbar, poses, curvature_radpm)))


def trailer_poses(drawbar: Drawbar, poses: Float64, curvature_radpm: float) -> Float64:
    """Poses of the hitch with the implement's heading, following poses of base (tractrix of the drawbar).

    The angle at the hitch is not measured: it is taken as that of steady driving on the present curvature.
    """
    hitch = np.column_stack([
        poses[:, 0] + drawbar.hitch_m * np.cos(poses[:, 2]), poses[:, 1] + drawbar.hitch_m * np.sin(poses[:, 2])
    ])  # fmt: skip
    yaw = np.empty(len(poses))
    yaw[0] = poses[0, 2] + steady_angle(drawbar, curvature_radpm)
    for k in range(1, len(poses)):
        dx, dy = hitch[k] - hitch[k - 1]
        across = dy * math.cos(yaw[k - 1]) - dx * math.sin(yaw[k - 1])
        yaw[k] = yaw[k - 1] + across / drawbar.axle_m
    return np.column_stack([hitch, yaw])


def steady_angle(drawbar: Drawbar, curvature_radpm: float) -> float:
    """Heading of a trailed implement against the machine when driving steadily on a curvature."""
    swing = math.atan(curvature_radpm * drawbar.hitch_m)
    return swing - math.asin(max(-1.0, min(1.0, drawbar.axle_m * curvature_radpm * math.cos(swing))))


def outline(body: Rectangle) -> Float64:
    """Corners and middles of the sides, (8, 2)."""
    x = (body.rear_m, 0.5 * (body.rear_m + body.front_m), body.front_m)
    w = body.half_width_m
    return np.array([(a, b) for a in x for b in (-w, 0.0, w) if not (a == x[1] and b == 0.0)])


def is_inside(body: Rectangle, x_m: Floats, y_m: Floats, margin_m: float) -> np.ndarray:
    """Which points of the carrier's frame lie within the rectangle and a margin, (N,) bool."""
    along = (x_m >= body.rear_m - margin_m) & (x_m <= body.front_m + margin_m)
    return np.asarray(along & (np.abs(y_m) <= body.half_width_m + margin_m))

"""The area that machine and implement will sweep, and how far they get before they touch something.

 pose 0        pose 1        pose 2            a body at pose k owns its rectangle, lengthened in the direction
┌──────┐      ┌──────┐      ┌──────┐           of travel by one step, so that nothing lies between two poses
└──────┘------└──────┘------└──────┘   ×       travel to contact = way to pose k + what is left to the point
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.arrays import Float64
from messages.plan import Path
from safety.config import FieldConfig
from safety.zones.footprint import Box, Footprint, Rectangle, carriers, outline


@dataclass(frozen=True)
class SweptArea:
    """Bodies along a way: `s_m` (M,) from now on, each body with its carrier's poses (M, 3) in base now.

    `lateral_m` (M,) is the margin to either side; `step_m` the spacing of `s_m`, `length_m` the whole way. `leads_m`
    says how far each body's leading edge lies behind the foremost point; all 0 when ways count for each body itself.
    """

    direction: int
    s_m: Float64
    poses: Float64
    bodies: tuple[tuple[Rectangle, Float64], ...]
    leads_m: tuple[float, ...]
    lateral_m: Float64
    step_m: float
    length_m: float

    @cached_property
    def box(self) -> Box:
        """Holds all bodies: circles about the carriers by the reach of their bodies and the margin."""
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for body, poses in self.bodies:
            end_m = max(abs(body.front_m), abs(body.rear_m))
            reach = math.hypot(end_m, body.half_width_m) + float(self.lateral_m[-1])
            low = np.minimum(low, poses[:, :2].min(axis=0) - reach)
            high = np.maximum(high, poses[:, :2].max(axis=0) + reach)
        return Box((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))

    def up_to(self, distance_m: float) -> "SweptArea":
        """Its part up to a way."""
        last = max(1, int(np.searchsorted(self.s_m, distance_m, side="right")))
        s_m, poses, lateral_m = self.s_m[:last], self.poses[:last], self.lateral_m[:last]
        bodies = tuple((body, places[:last]) for body, places in self.bodies)
        length_m = float(s_m[-1])
        return replace(self, s_m=s_m, poses=poses, bodies=bodies, lateral_m=lateral_m, length_m=length_m)


def spaced(length_m: float, step_m: float) -> Float64:
    """Places along a way, from 0 by `step_m`, at most 60 (longer ways get longer steps)."""
    step = max(step_m, length_m / 60.0)
    return np.arange(0.0, length_m + 0.5 * step, step)


def arc_poses(curvature_radpm: float, direction: int, s_m: Float64) -> Float64:
    """Poses (M, 3) of base on the circle of a curvature."""
    signed = direction * s_m
    turn = curvature_radpm * signed
    half = 0.5 * turn
    chord = signed * np.sinc(half / math.pi)
    return np.column_stack([chord * np.cos(half), chord * np.sin(half), turn])


def path_poses(path: Path, start_m: float, pose_map: Float64, s_m: Float64, blend_m: float) -> Float64:
    """Poses (M, 3) of base now along a path from `start_m` on, for the present pose (3,: x, y, yaw in map).

    The present deviation from the path is carried along and fades within `blend_m`.
    """
    at = np.clip(start_m + s_m, path.s_m[0], path.s_m[-1])
    last = min(len(path.s_m), int(np.searchsorted(path.s_m, at[-1])) + 2)
    first = max(0, int(np.searchsorted(path.s_m, at[0])) - 1)
    s = path.s_m[first:last]
    x = np.interp(at, s, path.p_map_m[first:last, 0]) - pose_map[0]
    y = np.interp(at, s, path.p_map_m[first:last, 1]) - pose_map[1]
    yaw = np.interp(at, s, unwrapped(path.heading_rad[first:last])) - pose_map[2]
    c, n = math.cos(pose_map[2]), math.sin(pose_map[2])
    poses = np.column_stack([c * x + n * y, c * y - n * x, yaw])
    poses[:, 2] -= 2.0 * math.pi * round(poses[0, 2] / (2.0 * math.pi))
    return np.asarray(poses - poses[0] * np.maximum(0.0, 1.0 - s_m / blend_m)[:, None])


def unwrapped(heading_rad: Float64) -> Float64:
    """Headings without jumps of a whole turn; there is seldom one to take out."""
    is_smooth = bool((np.abs(heading_rad[1:] - heading_rad[:-1]) < math.pi).all())
    return heading_rad if is_smooth else np.unwrap(heading_rad)


def sweep_along(
    footprint: Footprint,
    direction: int,
    s_m: Float64,
    poses: Float64,
    curvature_radpm: float,
    field: FieldConfig,
    is_from_foremost: bool,
) -> SweptArea:
    """What is swept along poses of base; the margin to the sides grows with the way, as what is not known does.

    `is_from_foremost`: gaps count from the foremost point of machine and implement, whichever body will touch.
    """
    lateral = np.minimum(field.lateral_margin_far_m, field.lateral_margin_near_m + field.lateral_growth * s_m)
    step = float(s_m[1] - s_m[0]) if len(s_m) > 1 else field.step_m
    bodies = carriers(footprint, poses, curvature_radpm)
    leads = footprint.leads_m(direction) if is_from_foremost else (0.0,) * len(bodies)
    return SweptArea(direction, s_m, poses, bodies, leads, lateral, step, float(s_m[-1]))


def distance_to_contact_m(
    points_xy: Float64, sweep: SweptArea, extra_m: Float64 | float = 0.0, aside_m: Float64 | float = 0.0
) -> Float64:
    """Gap to each point (N, 2) in base now along the sweep, (N,), infinite without.

    `extra_m` lengthens and widens all bodies; `aside_m` widens (below 0: narrows) their margins to the sides.
    """
    travel = np.full(len(points_xy), np.inf)
    near = np.flatnonzero(_is_near(points_xy, sweep, extra_m, aside_m))
    if len(near):
        extra, aside = (np.broadcast_to(np.asarray(m, np.float64), len(travel))[near] for m in (extra_m, aside_m))
        travel[near] = _contact_near(points_xy[near], sweep, extra[:, None], (extra + aside)[:, None])
    return travel


def _is_near(points_xy: Float64, sweep: SweptArea, extra_m: Float64 | float, aside_m: Float64 | float) -> np.ndarray:
    """Which points could touch at all, (N,) bool: nearly all hits lie beside, and are done with here.

    What is no number is not left out here.
    """
    slack = sweep.step_m + 2.0 * extra_m + np.maximum(aside_m, 0.0)
    (x_low, x_high), (y_low, y_high) = sweep.box.x_m, sweep.box.y_m
    x, y = points_xy[:, 0], points_xy[:, 1]
    is_beyond = (x < x_low - slack) | (x > x_high + slack) | (y < y_low - slack) | (y > y_high + slack)
    return np.asarray(~is_beyond)


def _contact_near(points_xy: Float64, sweep: SweptArea, extra: Float64, beside: Float64) -> Float64:
    travel = np.full(len(points_xy), np.inf)
    carrier: Float64 | None = None
    for (body, poses), lead_m in zip(sweep.bodies, sweep.leads_m, strict=True):
        if poses is not carrier:
            carrier, (ahead, left) = poses, _seen_from(poses, points_xy, sweep.direction)
            closing, across = _closing(poses, left, sweep), np.abs(left)
        own = _body_contact(ahead, across, closing, body, sweep, extra, beside)
        travel = np.minimum(travel, np.maximum(own - lead_m, 0.0))
    return travel


def _seen_from(poses: Float64, points_xy: Float64, direction: int) -> tuple[Float64, Float64]:
    """How far ahead in the direction of travel and how far to the left each point (N,) is of each pose (M,), (N, M)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    forward, left = np.column_stack([c, s]), np.column_stack([-s, c])
    ahead = points_xy @ forward.T - np.einsum("ij,ij->i", forward, poses[:, :2])
    across = points_xy @ left.T - np.einsum("ij,ij->i", left, poses[:, :2])
    return direction * ahead, across


def _closing(poses: Float64, left: Float64, sweep: SweptArea) -> Float64:
    """The way that a body's part beside each point makes on the way of base, (N, M): more on the outside of a bend."""
    turns = np.append(np.diff(unwrapped(poses[:, 2])), 0.0) / sweep.step_m
    return np.maximum(1.0, 1.0 - sweep.direction * turns * left)


def _body_contact(
    ahead: Float64,
    across: Float64,
    closing: Float64,
    body: Rectangle,
    sweep: SweptArea,
    extra: Float64,
    beside: Float64,
) -> Float64:
    front, rear = (body.front_m, body.rear_m) if sweep.direction > 0 else (-body.rear_m, -body.front_m)
    left = (ahead - (front + extra)) / closing
    is_met = (left <= sweep.step_m) & (ahead >= rear - extra) & (across <= body.half_width_m + sweep.lateral_m + beside)
    point, pose = np.nonzero(is_met)
    travel = np.full(len(ahead), np.inf)
    np.minimum.at(travel, point, sweep.s_m[pose] + np.maximum(left[point, pose], 0.0))
    return np.where(travel <= sweep.length_m, travel, np.inf)


def outline_points(sweep: SweptArea, every_m: float) -> tuple[Float64, Float64]:
    """Outline points (P, 2) in base now of all bodies at places about `every_m` apart, and their way (P,)."""
    stride = max(1, round(every_m / sweep.step_m))
    points, distances = [], []
    for body, poses in sweep.bodies:
        box_points, some = outline(body), poses[::stride]
        c, s = np.cos(some[:, 2])[:, None], np.sin(some[:, 2])[:, None]
        x = some[:, :1] + c * box_points[:, 0] - s * box_points[:, 1]
        y = some[:, 1:2] + s * box_points[:, 0] + c * box_points[:, 1]
        points.append(np.column_stack([x.ravel(), y.ravel()]))
        distances.append(np.repeat(sweep.s_m[::stride], len(box_points)))
    return np.concatenate(points), np.concatenate(distances)


def outline_of(sweep: SweptArea) -> Float64:
    """A ring (M, 2) in base about the swept field, for the eye: left edge out, right edge back."""
    lead = sweep.bodies[0][0].front_m if sweep.direction > 0 else sweep.bodies[0][0].rear_m
    half = max(body.half_width_m for body, _ in sweep.bodies) + sweep.lateral_m
    c, s = np.cos(sweep.poses[:, 2]), np.sin(sweep.poses[:, 2])
    x, y = sweep.poses[:, 0] + lead * c, sweep.poses[:, 1] + lead * s
    left, right = np.column_stack([x - half * s, y + half * c]), np.column_stack([x + half * s, y - half * c])
    return np.concatenate([left, right[::-1]])

"""Area swept by machine and implement, and travel distance to contact with a point.

 pose 0        pose 1        pose 2            a body at pose k covers its rectangle, lengthened in the direction
┌──────┐      ┌──────┐      ┌──────┐           of travel by one step, so that no point lies between two poses
└──────┘------└──────┘------└──────┘   ×       travel to contact = distance to pose k + rest to the point
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.arrays import Float64
from geometry.rectangle import Rectangle
from messages.plan import Path
from safety.config import FieldConfig
from safety.zones.footprint import Box, Footprint, carriers, outline


@dataclass(frozen=True)
class SweptArea:
    """Bodies along a path: distances `s_m` (M,) from now, each body with its carrier's poses (M, 3) in base now.

    `lateral_m` (M,) is the margin on either side, `step_m` the spacing of `s_m`, `length_m` the total distance.
    `leads_m` is the distance of each body's leading edge behind the foremost point; all 0 when distances are measured
    from each body's own edge. `tops_m` are the heights above which nothing touches each body.
    """

    direction: int
    s_m: Float64
    poses: Float64
    bodies: tuple[tuple[Rectangle, Float64], ...]
    leads_m: tuple[float, ...]
    tops_m: tuple[float, ...]
    lateral_m: Float64
    step_m: float
    length_m: float

    @cached_property
    def box(self) -> Box:
        """Box about all bodies: circles about the carriers with the reach of their bodies and the margin."""
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for body, poses in self.bodies:
            end_m = max(abs(body.front_m), abs(body.rear_m))
            reach = math.hypot(end_m, body.half_width_m) + float(self.lateral_m[-1])
            low = np.minimum(low, poses[:, :2].min(axis=0) - reach)
            high = np.maximum(high, poses[:, :2].max(axis=0) + reach)
        return Box((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))

    def up_to(self, distance_m: float) -> "SweptArea":
        """Part up to a distance."""
        last = max(1, int(np.searchsorted(self.s_m, distance_m, side="right")))
        s_m, poses, lateral_m = self.s_m[:last], self.poses[:last], self.lateral_m[:last]
        bodies = tuple((body, places[:last]) for body, places in self.bodies)
        length_m = float(s_m[-1])
        return replace(self, s_m=s_m, poses=poses, bodies=bodies, lateral_m=lateral_m, length_m=length_m)


def spaced(length_m: float, step_m: float) -> Float64:
    """Distances from 0 by `step_m`; at most 60 steps (a greater length gets longer steps)."""
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

    The present deviation from the path decreases linearly to 0 within `blend_m`.
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
    """Headings without jumps of 2π; a copy is made only when there is one."""
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
    """Area swept along poses of base (M, 3); the lateral margin grows with the distance, as the uncertainty does.

    `is_from_foremost`: distances are measured from the foremost point of machine and implement for all bodies.
    """
    lateral = np.minimum(field.lateral_margin_far_m, field.lateral_margin_near_m + field.lateral_growth * s_m)
    step = float(s_m[1] - s_m[0]) if len(s_m) > 1 else field.step_m
    bodies = carriers(footprint, poses, curvature_radpm)
    leads = footprint.leads_m(direction) if is_from_foremost else (0.0,) * len(footprint.tops_m)
    tops = tuple(top_m + field.overhead_margin_m for top_m in footprint.tops_m)
    more = len(bodies) - len(tops)  # a trailed body counts once for each angle
    leads, tops = (*leads, *leads[-1:] * more), (*tops, *tops[-1:] * more)
    return SweptArea(direction, s_m, poses, bodies, leads, tops, lateral, step, float(s_m[-1]))


def distance_to_contact_m(
    points_xy: Float64, area: SweptArea, extra_m: Float64 | float = 0.0, aside_m: Float64 | float = 0.0,
    height_m: Float64 | float = 0.0,
) -> Float64:  # fmt: skip
    """Distance travelled until contact with each point (N, 2) in base now, (N,); infinite without contact.

    `extra_m` lengthens and widens all bodies; `aside_m` widens (below 0: narrows) their lateral margins. `height_m` of
    the points in base: a body does not touch what is above its top.
    """
    travel = np.full(len(points_xy), np.inf)
    near = np.flatnonzero(_is_near(points_xy, area, extra_m, aside_m))
    if len(near):
        every = (np.broadcast_to(np.asarray(m, np.float64), len(travel))[near] for m in (extra_m, aside_m, height_m))
        extra, aside, height = every
        travel[near] = _contact_near(points_xy[near], area, extra[:, None], (extra + aside)[:, None], height)
    return travel


def _is_near(points_xy: Float64, area: SweptArea, extra_m: Float64 | float, aside_m: Float64 | float) -> np.ndarray:
    """Whether each point lies in the enlarged box of the area, (N,) bool: a fast rejection; NaN is not rejected."""
    slack = area.step_m + 2.0 * extra_m + np.maximum(aside_m, 0.0)
    (x_low, x_high), (y_low, y_high) = area.box.x_m, area.box.y_m
    x, y = points_xy[:, 0], points_xy[:, 1]
    is_beyond = (x < x_low - slack) | (x > x_high + slack) | (y < y_low - slack) | (y > y_high + slack)
    return np.asarray(~is_beyond)


def _contact_near(points_xy: Float64, area: SweptArea, extra: Float64, beside: Float64, height_m: Float64) -> Float64:
    travel = np.full(len(points_xy), np.inf)
    carrier: Float64 | None = None
    for (body, poses), lead_m, top_m in zip(area.bodies, area.leads_m, area.tops_m, strict=True):
        if poses is not carrier:
            carrier, (ahead, left) = poses, _relative_to(poses, points_xy, area.direction)
            closing, across = _closing(poses, left, area), np.abs(left)
        own = _body_contact(ahead, across, closing, body, area, extra, beside)
        own[height_m > top_m] = np.inf
        travel = np.minimum(travel, np.maximum(own - lead_m, 0.0))
    return travel


def _relative_to(poses: Float64, points_xy: Float64, direction: int) -> tuple[Float64, Float64]:
    """Coordinates (N, M) of each point (N,) ahead in the direction of travel and to the left of each pose (M,)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    forward, left = np.column_stack([c, s]), np.column_stack([-s, c])
    ahead = points_xy @ forward.T - np.einsum("ij,ij->i", forward, poses[:, :2])
    across = points_xy @ left.T - np.einsum("ij,ij->i", left, poses[:, :2])
    return direction * ahead, across


def _closing(poses: Float64, left: Float64, area: SweptArea) -> Float64:
    """Travel beside each point per travel of base, (N, M): above 1 on the outside of a curve."""
    turns = np.append(np.diff(unwrapped(poses[:, 2])), 0.0) / area.step_m
    return np.maximum(1.0, 1.0 - area.direction * turns * left)


def _body_contact(
    ahead: Float64,
    across: Float64,
    closing: Float64,
    body: Rectangle,
    area: SweptArea,
    extra: Float64,
    beside: Float64,
) -> Float64:
    front, rear = (body.front_m, body.rear_m) if area.direction > 0 else (-body.rear_m, -body.front_m)
    rest = (ahead - (front + extra)) / closing
    is_met = (rest <= area.step_m) & (ahead >= rear - extra) & (across <= body.half_width_m + area.lateral_m + beside)
    point, pose = np.nonzero(is_met)
    travel = np.full(len(ahead), np.inf)
    np.minimum.at(travel, point, area.s_m[pose] + np.maximum(rest[point, pose], 0.0))
    return np.where(travel <= area.length_m, travel, np.inf)


def outline_points(area: SweptArea, every_m: float) -> tuple[Float64, Float64]:
    """Outline points (P, 2) in base now of all bodies at poses about `every_m` apart, and their distances (P,)."""
    stride = max(1, round(every_m / area.step_m))
    points, distances = [], []
    for body, poses in area.bodies:
        rim, some = outline(body), poses[::stride]
        c, s = np.cos(some[:, 2])[:, None], np.sin(some[:, 2])[:, None]
        x = some[:, :1] + c * rim[:, 0] - s * rim[:, 1]
        y = some[:, 1:2] + s * rim[:, 0] + c * rim[:, 1]
        points.append(np.column_stack([x.ravel(), y.ravel()]))
        distances.append(np.repeat(area.s_m[::stride], len(rim)))
    return np.concatenate(points), np.concatenate(distances)


def outline_of(area: SweptArea) -> Float64:
    """Polygon (M, 2) in base about the swept area for display: left edge outward, right edge back."""
    lead = area.bodies[0][0].front_m if area.direction > 0 else area.bodies[0][0].rear_m
    half = max(body.half_width_m for body, _ in area.bodies) + area.lateral_m
    c, s = np.cos(area.poses[:, 2]), np.sin(area.poses[:, 2])
    x, y = area.poses[:, 0] + lead * c, area.poses[:, 1] + lead * s
    left, right = np.column_stack([x - half * s, y + half * c]), np.column_stack([x + half * s, y - half * c])
    return np.concatenate([left, right[::-1]])

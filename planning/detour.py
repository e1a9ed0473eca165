"""A way round something that stays: back out, past it, on to the line again, and back up to where work goes on.

path ─────────────■ stop        ┌──────┐                    rejoin
         ◄────────┘ 1 back      │ what │   4 work goes on   ╭────────► path
         ╰──╮                   │ stays│   ┌────────────────╯
            ╰── 2 round ────────┴──────┴───╯ ◄───── 3 back up on the line, so that little is left out
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from geometry.footprint import place
from geometry.polyline import Float64, arc_length, project
from messages.plan import Path
from planning.configuration import MissionConfig
from planning.curve import Pose
from planning.rig import Rig
from planning.turn import Space, Wanted, curve_between, is_free

ASIDE_STEP_M, ASIDE_STEPS = 0.5, 5
REVERSE_STEP_M, REJOIN_STEP_M = 1.0, 1.0
FARTHEST_REJOIN_M = 25.0
REVERSE_COST = 2.0  # a metre back is slow, and is driven again
STRAIGHT_M = 1.0  # at both ends of a curve, so that smoothing does not move them


@dataclass(frozen=True)
class Detour:
    """Points of `base` to drive back (empty if none) and then round; where on the path they leave it and end."""

    back_m: Float64
    round_m: Float64
    leave_s_m: float
    rejoin_s_m: float


def pose_at(path: Path, s_m: float) -> Pose:
    """The pose on a path at an arc length."""
    x, y = (float(np.interp(s_m, path.s_m, path.p_map_m[:, k])) for k in range(2))
    return Pose(x, y, float(np.interp(s_m, path.s_m, np.unwrap(path.heading_rad))))


def part_of(path: Path, first_m: float, last_m: float) -> Float64:
    """The points of a path from one arc length to another (backwards when the second is less)."""
    low, high = sorted((first_m, last_m))
    inside = (path.s_m > low + 1e-6) & (path.s_m < high - 1e-6)
    ends = [pose_at(path, s) for s in (low, high)]
    points = np.vstack([[[ends[0].x_m, ends[0].y_m]], path.p_map_m[inside], [[ends[1].x_m, ends[1].y_m]]])
    return points if last_m >= first_m else points[::-1]


def extent_m(path: Path, s_m: float, outline: Polygon, reach_m: float = 60.0) -> tuple[float, float, float, float]:
    """First and last arc length of an outline along the path from `s_m` on, and its offsets to the right and left."""
    ahead = part_of(path, s_m, min(s_m + reach_m, float(path.s_m[-1])))
    places = [project(ahead, p) for p in np.asarray(outline.exterior.coords)]
    along, aside = [s_m + s for s, _ in places], [d for _, d in places]
    return min(along), max(along), min(aside), max(aside)


def plan_detour(
    path: Path,
    s_m: float,
    cause: Polygon,
    allowed: BaseGeometry,
    rig: Rig,
    config: MissionConfig,
    earliest_m: float = 0.0,
) -> Detour | None:
    """The shortest detour to either side, or None.

    It is free in `allowed` (the ground less all that stands, grown) and back on the path after `earliest_m`.
    """
    space = Space(allowed, rig.bodies, rig.radius_m, rig.config.smoothing_m)
    first, last, right, left = extent_m(path, s_m, cause)
    half = rig.width_m / 2.0 + config.clearance_m
    found = []
    for aside in _sides(right - half, left + half):
        middle = pose_at(path, min(0.5 * (first + last), float(path.s_m[-1]))).beside(aside)
        out = _way_out(path, s_m, middle, space, config)
        back_on = _way_on(path, max(last, earliest_m), middle, space) if out is not None else None
        if out is not None and back_on is not None:
            back, leave, onward = out
            length = REVERSE_COST * (s_m - leave) + float(arc_length(onward)[-1] + arc_length(back_on[0])[-1])
            onward = np.vstack([onward, back_on[0][1:]])
            found.append((round(length, 3), Detour(back, onward, leave, back_on[1])))
    return min(found, key=lambda f: f[0])[1] if found else None


def _sides(right_m: float, left_m: float) -> list[float]:
    steps = [k * ASIDE_STEP_M for k in range(ASIDE_STEPS)]
    return [right_m - d for d in steps] + [left_m + d for d in steps]


def _way_out(
    path: Path, s_m: float, middle: Pose, space: Space, config: MissionConfig
) -> tuple[Float64, float, Float64] | None:
    for back in np.arange(0.0, min(config.most_reverse_m, s_m) + 1e-9, REVERSE_STEP_M):
        wanted = Wanted(pose_at(path, s_m - float(back)), middle, STRAIGHT_M, STRAIGHT_M)
        way = curve_between(wanted, space, 3)
        if way is not None and _turn_of(way) < np.pi:
            points = part_of(path, s_m, s_m - float(back)) if back > 0.0 else np.empty((0, 2))
            if back == 0.0 or _is_free_backwards(points, space):
                return points, s_m - float(back), way
    return None


def _way_on(path: Path, last_m: float, middle: Pose, space: Space) -> tuple[Float64, float] | None:
    for on in np.arange(1.0, FARTHEST_REJOIN_M, REJOIN_STEP_M):
        s = last_m + float(on)
        if s > float(path.s_m[-1]):
            return None
        way = curve_between(Wanted(middle, pose_at(path, s), STRAIGHT_M, STRAIGHT_M), space, 3)
        if way is not None and _turn_of(way) < np.pi:
            return way, s
    return None


def _turn_of(way: Float64) -> float:
    """By how much a way turns in all; a detour with a full circle in it is none."""
    d = np.diff(way, axis=0)
    heading = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
    return float(np.abs(np.diff(heading)).sum())


def _is_free_backwards(points: Float64, space: Space) -> bool:
    """Driving back along what was driven: the same sweep as forwards."""
    return len(points) < 2 or is_free(points[::-1], space)


def resume_s_m(path: Path, rejoin_s_m: float, cause: Polygon, s_m: float, rig: Rig, config: MissionConfig) -> float:
    """Where work can go on: as near behind the obstacle as the rig may back up, not after the rejoining place."""
    _, last, _, _ = extent_m(path, s_m, cause)
    return min(rejoin_s_m, last + config.rear_clearance_m - rig.rear_m)


def left_out(path: Path, first_m: float, last_m: float, rig: Rig) -> Float64:
    """Outline (N, 2) of the strip between two places of `base` on the path where the implement was to work."""
    inside = np.flatnonzero((path.s_m >= first_m) & (path.s_m <= last_m) & (path.is_work > 0))
    if len(inside) < 2:
        return np.empty((0, 2))
    keep = np.unique(np.append(inside[::5], inside[-1]))
    h = rig.working_width_m / 2.0
    ends = np.array([[rig.working_x_m, h], [rig.working_x_m, -h]])
    edges = place(ends, path.p_map_m[keep], path.heading_rad[keep])
    return np.vstack([edges[:, 0], edges[::-1, 1]])


def ground_without(allowed: BaseGeometry, outlines: Sequence[Polygon], clearance_m: float) -> BaseGeometry:
    """The allowed ground less all that stands, grown by the clearance."""
    grown = [o.buffer(clearance_m, quad_segs=4) for o in outlines]
    return allowed.difference(shapely.union_all(grown)) if grown else allowed

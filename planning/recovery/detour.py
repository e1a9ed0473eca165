"""Detour around a static obstacle: reverse, pass it, rejoin the line, and reverse to where work resumes.

path ─────────────■ stop        ┌──────┐                    rejoin
         ◄────────┘ 1 reverse   │static│   4 work resumes   ╭────────► path
         ╰──╮                   │obst. │   ┌────────────────╯
            ╰── 2 pass ─────────┴──────┴───╯ ◄───── 3 reverse on the line, to leave little of it out
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.footprint import place
from geometry.polyline import arc_length, headings, project
from geometry.pose2 import Pose2
from messages.plan import Path
from planning.config import MissionConfig
from planning.rig import Rig
from planning.turns.free_space import FreeSpace
from planning.turns.search import ConnectionRequest
from planning.turns.turn import STEP_M, dubins_connection, smoothed

LATERAL_STEP_M, LATERAL_STEPS = 0.3, 8
REVERSE_STEP_M = 1.0
NEAR_START_M = 1.5  # reversed on the path just driven before the clearance is asked for
SHIFTS_M, SHIFT_FROM_M = (0.0, 0.7, -0.7), 7.0  # a lateral shift in reverse keeps the tail off a near edge
REJOINS_M = (*range(1, 13), *range(14, 41, 2))
REVERSE_COST = 2.0  # per metre: reversing is slow, and is driven again forward
REACH_M, AROUND_M = 60.0, 2.0  # search distance ahead; path length added around an obstacle
MAX_TURN_RAD = 1.5 * np.pi  # rejects full circles
MIN_UNCOVERED_POINTS = 4  # points
STRAIGHT_M = 1.8  # at both ends of a connection, so that smoothing does not move them


@dataclass(frozen=True)
class Detour:
    """Points (N, 2) in reverse (may be empty) and around; arc lengths on the path where they leave and rejoin."""

    reverse_m: Float64
    around_m: Float64
    leave_s_m: float
    rejoin_s_m: float


def pose_at(path: Path, s_m: float) -> Pose2:
    """Pose on a path at an arc length."""
    x, y = (float(np.interp(s_m, path.s_m, path.p_map_m[:, k])) for k in range(2))
    return Pose2(x, y, float(np.interp(s_m, path.s_m, np.unwrap(path.heading_rad))))


def part_of(path: Path, first_m: float, last_m: float) -> Float64:
    """Points of a path between two arc lengths (reversed if the second is less)."""
    low, high = sorted((first_m, last_m))
    inside = (path.s_m > low + 1e-6) & (path.s_m < high - 1e-6)
    ends = [pose_at(path, s) for s in (low, high)]
    points = np.vstack([[[ends[0].x_m, ends[0].y_m]], path.p_map_m[inside], [[ends[1].x_m, ends[1].y_m]]])
    return points if last_m >= first_m else points[::-1]


def extent_m(path: Path, s_m: float, outline: Polygon, width_m: float) -> tuple[float, float, float, float]:
    """First and last arc length of an outline where the path first passes it, and its rightmost and leftmost offset."""
    ahead = np.flatnonzero((path.s_m >= s_m) & (path.s_m <= s_m + REACH_M))
    gap = shapely.distance(np.asarray(shapely.points(path.p_map_m[ahead])), outline)
    near = np.flatnonzero(gap < max(width_m / 2.0 + 1.0, float(gap.min()) + 0.1))
    run = near[: int(np.argmax(np.append(np.diff(near) > 1, True))) + 1]
    low, high = float(path.s_m[ahead[run[0]]]) - AROUND_M, float(path.s_m[ahead[run[-1]]]) + AROUND_M
    low, high = max(low, s_m), min(high, float(path.s_m[-1]))
    places = [project(part_of(path, low, high), p) for p in np.asarray(outline.exterior.coords)]
    along, offset = [low + s for s, _ in places], [d for _, d in places]
    return min(along), max(along), min(offset), max(offset)


def plan_detour(
    path: Path,
    s_m: float,
    cause: Polygon,
    allowed: BaseGeometry,
    rig: Rig,
    config: MissionConfig,
    earliest_m: float = 0.0,
) -> Detour | None:
    """Shortest detour to either side, or None.

    It is free in `allowed` (drivable area less inflated obstacles) and rejoins the path after `earliest_m`.
    """
    space = rig.space(allowed)
    first, last, right, left = extent_m(path, s_m, cause, rig.width_m)
    half = rig.width_m / 2.0 + config.clearance_m
    found = []
    for offset in _offsets(right - half, left + half):
        middle = pose_at(path, min(0.5 * (first + last), float(path.s_m[-1]))).beside(offset)
        leaving = _leaving(path, s_m, middle, space, config)
        rejoining = _rejoining(path, max(last, earliest_m), middle, space) if leaving is not None else None
        if leaving is not None and rejoining is not None:
            reverse, leave, onward = leaving
            length = REVERSE_COST * (s_m - leave) + float(arc_length(onward)[-1] + arc_length(rejoining[0])[-1])
            onward = np.vstack([onward, rejoining[0][1:]])
            found.append((round(length, 3), Detour(reverse, onward, leave, rejoining[1])))
    return min(found, key=lambda f: f[0])[1] if found else None


def _offsets(right_m: float, left_m: float) -> list[float]:
    steps = [k * LATERAL_STEP_M for k in range(LATERAL_STEPS)]
    return [right_m - d for d in steps] + [left_m + d for d in steps]


def _leaving(
    path: Path, s_m: float, middle: Pose2, space: FreeSpace, config: MissionConfig
) -> tuple[Float64, float, Float64] | None:
    for back in np.arange(0.0, min(config.max_reverse_m, s_m) + 1e-9, REVERSE_STEP_M):
        for shift in SHIFTS_M if back >= SHIFT_FROM_M else (0.0,):
            start = pose_at(path, s_m - float(back)).beside(shift)
            connection = dubins_connection(ConnectionRequest(start, middle, STRAIGHT_M, STRAIGHT_M), space, 3)
            if connection is None or _total_turn(connection) >= MAX_TURN_RAD:
                continue
            points = _shifted(part_of(path, s_m, s_m - float(back)), -shift) if back > 0.0 else np.empty((0, 2))
            if back == 0.0 or _is_left(points, space):
                return points, s_m - float(back), connection
    return None


def _is_left(reverse_m: Float64, space: FreeSpace) -> bool:
    """Whether the rig, reversing, is free after at most `NEAR_START_M`: before, it may be near the obstacle."""
    p, heading = smoothed(reverse_m[::-1], space.smoothing_m)
    return not space.touching(p, heading)[: -1 - round(NEAR_START_M / STEP_M)].any()


def _shifted(points: Float64, to_left_m: float) -> Float64:
    """Points shifted laterally with a smooth transition, by `to_left_m` at their end."""
    share = arc_length(points) / max(float(arc_length(points)[-1]), 1e-6)
    heading = headings(points)
    push = to_left_m * (0.5 - 0.5 * np.cos(np.pi * share))
    return np.asarray(points + push[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)]), np.float64)


def _rejoining(path: Path, last_m: float, middle: Pose2, space: FreeSpace) -> tuple[Float64, float] | None:
    for on in REJOINS_M:
        s = last_m + on
        if s > float(path.s_m[-1]):
            return None
        connection = dubins_connection(ConnectionRequest(middle, pose_at(path, s), STRAIGHT_M, STRAIGHT_M), space, 3)
        if connection is not None and _total_turn(connection) < MAX_TURN_RAD:
            return connection, s
    return None


def _total_turn(connection: Float64) -> float:
    """Sum of absolute heading changes, rad."""
    d = np.diff(connection, axis=0)
    heading = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
    return float(np.abs(np.diff(heading)).sum())


def resume_s_m(path: Path, rejoin_s_m: float, cause: Polygon, s_m: float, rig: Rig, config: MissionConfig) -> float:
    """Arc length where work resumes: as near behind the obstacle as the rig may reverse, not after `rejoin_s_m`."""
    _, last, _, _ = extent_m(path, s_m, cause, rig.width_m)
    return min(rejoin_s_m, last + config.rear_clearance_m - rig.rear_m)


def uncovered_areas(path: Path, first_m: float, last_m: float, rig: Rig) -> list[Float64]:
    """Outlines (N, 2) of the strips between two arc lengths of `base` where the implement was to work."""
    inside = np.flatnonzero((path.s_m >= first_m) & (path.s_m <= last_m) & (path.is_working > 0))
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    h = rig.working_width_m / 2.0
    ends = np.array([[rig.working_x_m, h], [rig.working_x_m, -h]])
    outlines = []
    for run in runs:
        if len(run) >= MIN_UNCOVERED_POINTS:
            keep = np.unique(np.append(run[::5], run[-1]))
            edges = place(ends, path.p_map_m[keep], path.heading_rad[keep])
            outlines.append(np.vstack([edges[:, 0], edges[::-1, 1]]))
    return outlines


def area_without_obstacles(allowed: BaseGeometry, outlines: Sequence[Polygon], clearance_m: float) -> BaseGeometry:
    """Drivable area less the obstacles inflated by the clearance."""
    grown = [o.buffer(clearance_m, quad_segs=4) for o in outlines]
    return allowed.difference(shapely.union_all(grown)) if grown else allowed

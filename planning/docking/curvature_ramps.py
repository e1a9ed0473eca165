"""Steerable form of a Reeds-Shepp path: curvature is ramped while driving and steps only at standstill.

Within one direction each curvature step becomes a ramp. That moves the end point, so the lengths of the segments are
corrected (Newton's method) until the path ends at its goal.
"""

import math
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import Pose2
from planning.docking.reeds_shepp import ReedsSheppPath, Segment

STEP_M = 0.1
CORRECTIONS = 8
DIFFERENCE_M = 1e-3
TOLERANCE_M = 1e-5


@dataclass(frozen=True)
class Run:
    """Part of a path in one direction (+1 or -1): N points (N, 2) with heading, curvature and arc length (N,)."""

    direction: int
    p_map_m: Float64
    heading_rad: Float64
    curvature_radpm: Float64
    s_m: Float64


def runs_of(segments: ReedsSheppPath, start: Pose2, ramp_m: float) -> list[Run]:
    """The path from a pose, one run per direction."""
    found: list[Run] = []
    for is_forward, group in groupby(segments, key=lambda t: t.length_m > 0.0):
        run = _run(list(group), start, 1 if is_forward else -1, ramp_m)
        found.append(run)
        start = Pose2(float(run.p_map_m[-1, 0]), float(run.p_map_m[-1, 1]), float(run.heading_rad[-1]))
    return found


def solve_endpoint(segments: ReedsSheppPath, start: Pose2, goal: Pose2, ramp_m: float) -> ReedsSheppPath | None:
    """The path with lengths corrected so that it ends at the goal with ramped curvature; None without solution."""
    lengths = np.array([t.length_m for t in segments])
    curvatures = [t.curvature_radpm for t in segments]
    arm_m = 1.0 / max(*map(abs, curvatures), 1e-3)  # metres per radian of heading error

    def segments_with(values: Float64) -> ReedsSheppPath:
        return tuple(Segment(float(u), k) for u, k in zip(values, curvatures, strict=True))

    def residual(values: Float64) -> Float64:
        end = runs_of(segments_with(values), start, ramp_m)[-1]
        turn = math.remainder(float(end.heading_rad[-1]) - goal.yaw_rad, 2.0 * math.pi)
        return np.array([end.p_map_m[-1, 0] - goal.x_m, end.p_map_m[-1, 1] - goal.y_m, turn * arm_m])

    for _ in range(CORRECTIONS):
        error = residual(lengths)
        if np.abs(error).max() < TOLERANCE_M:
            return segments_with(lengths)
        shifted = [residual(lengths + difference) for difference in DIFFERENCE_M * np.eye(len(lengths))]
        slopes = (np.stack(shifted, axis=1) - error[:, None]) / DIFFERENCE_M
        step = np.linalg.lstsq(slopes, -error, rcond=None)[0]
        if np.any((lengths + step) * lengths <= 0.0):
            return None
        lengths = lengths + step
    return None


def _run(segments: list[Segment], start: Pose2, direction: int, ramp_m: float) -> Run:
    """Curvature is the mean over `ramp_m` around each point; both ends are continued."""
    half = 0.5 * ramp_m
    lengths = [abs(t.length_m) for t in segments]
    total = sum(lengths)
    curvatures = np.array(
        [segments[0].curvature_radpm, *(t.curvature_radpm for t in segments), segments[-1].curvature_radpm]
    )
    knots = np.cumsum([-half, half, *lengths, half])
    heading_change = np.concatenate([[0.0], np.cumsum(np.diff(knots) * curvatures)])
    s = np.linspace(0.0, total, max(2, math.ceil(total / STEP_M) + 1))

    def mean(at: Float64) -> Float64:
        both = np.interp(np.stack([at - half, at + half]), knots, heading_change)
        return np.asarray((both[1] - both[0]) / ramp_m, np.float64)

    step = direction * float(s[1] - s[0])
    heading = start.yaw_rad + np.concatenate([[0.0], np.cumsum(step * mean(0.5 * (s[:-1] + s[1:])))])
    course = 0.5 * (heading[:-1] + heading[1:])
    moves = np.vstack([[[start.x_m, start.y_m]], step * np.column_stack([np.cos(course), np.sin(course)])])
    return Run(direction, np.cumsum(moves, axis=0), heading, mean(s), s)

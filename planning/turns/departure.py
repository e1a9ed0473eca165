"""Curve by which a rig leaves a line right beside an edge, or comes onto it: what swings out stays inside.

The distance from the line grows by a constant factor for each length of the tail, so that heading and swing grow with
it. After about 14 m the rig can turn with its smallest radius. The mirror image, with the length of the nose, leads
onto a bent line, whose tangent leaves the field.
"""

import math

import numpy as np

from geometry.polyline import arc_length, at_length, curvatures
from planning.turns.search import STEP_M, Leg

SHARE = 0.8  # of the slack beside the edge that the swing takes
LAST_SLOPE = 0.5  # 27°: there the rear corner no longer swings out in an arc of twice the length of the tail


def departure_of(tail_m: float, slack_m: float) -> Leg:
    """The curve to the left from the origin, for a tail behind `base` that may swing out by less than `slack_m`."""
    swing_m = SHARE * slack_m
    x = np.linspace(0.0, tail_m * math.log(LAST_SLOPE * tail_m / swing_m), 2000)
    away_m = swing_m * np.exp(x / tail_m)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(away_m)))])
    at = np.linspace(0.0, s[-1], math.ceil(s[-1] / STEP_M) + 1)
    x, away_m = np.interp(at, s, x), np.interp(at, s, away_m)
    slope = away_m / tail_m
    return Leg(1, np.column_stack([x, away_m - swing_m]), np.arctan(slope), slope / tail_m / (1.0 + slope**2) ** 1.5)


def straightened(curve: Leg, ramp_m: float) -> Leg:
    """A curve, and on from it while its curvature falls to 0 over `ramp_m`: then a turn to either side may follow."""
    s = STEP_M * np.arange(1, math.ceil(ramp_m / STEP_M) + 1)
    bend = curve.curvature_radpm[-1] * np.maximum(1.0 - s / ramp_m, 0.0)
    heading = curve.heading_rad[-1] + STEP_M * np.cumsum(bend + 0.5 * curve.curvature_radpm[-1] * STEP_M / ramp_m)
    middle = 0.5 * (heading + np.append(curve.heading_rad[-1], heading[:-1]))
    p = curve.p_map_m[-1] + STEP_M * np.cumsum(np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)
    return Leg(
        1, np.vstack([curve.p_map_m, p]), np.append(curve.heading_rad, heading), np.append(curve.curvature_radpm, bend)
    )


def along(curve: Leg, line: Leg) -> Leg:
    """A curve that leaves the x axis at the origin, beside a line instead, from its first pose on.

    Where the line is shorter the curve ends.
    """
    s, (x, away_m) = arc_length(line.p_map_m), curve.p_map_m.T
    kept = x <= s[-1]
    x, away_m, turn = x[kept], away_m[kept], curve.heading_rad[kept]
    heading, bend = np.interp(x, s, np.unwrap(line.heading_rad)), np.interp(x, s, line.curvature_radpm)
    inwards = np.column_stack([-np.sin(heading), np.cos(heading)])
    heading = heading + np.arctan2(np.sin(turn), np.cos(turn) * (1.0 - away_m * bend))
    p = at_length(line.p_map_m, x) + away_m[:, None] * inwards
    return Leg(1, p, heading, curvatures(heading, arc_length(p)))


def arrival_along(curve: Leg, line: Leg) -> Leg:
    """The way onto the end of a line that is the mirror image of a curve along which it would be left to the left."""
    mirrored = Leg(1, curve.p_map_m * np.array([1.0, -1.0]), -curve.heading_rad, -curve.curvature_radpm)
    return along(mirrored, line.back).back

"""Curve by which a rig leaves a line right beside an edge: its tail, which swings out, stays inside.

The distance from the line grows by a constant factor for each length of the tail, so that heading and swing grow with
it. After about 14 m the rig can turn with its smallest radius.
"""

import math

import numpy as np

from geometry.pose2 import Pose2, to_frame
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


def placed(leg: Leg, start: Pose2) -> Leg:
    """A leg from the origin, from a pose."""
    return Leg(leg.direction, to_frame(start, leg.p_map_m), leg.heading_rad + start.yaw_rad, leg.curvature_radpm)

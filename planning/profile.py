"""Speed along a path: limits of leg, side force and steering rate, joined by speeding up and slowing down."""

import numpy as np

from geometry.arrays import Float64
from planning.rig import Rig

TURN_SHARE = 0.4  # of the plan's tightest curvature: from here on the turning speed holds, whatever the leg
START_MPS = 0.5  # a limit of 0 would hold the machine for ever
LEAST_MPS = 0.05


def speed_profile(s_m: Float64, curvature_radpm: Float64, leg_mps: Float64, rig: Rig) -> Float64:
    """Upper limit of speed at each point, (N,), 0 at the end; from standstill it may be reached at once."""
    limit = np.minimum(leg_mps, curve_limit(s_m, curvature_radpm, rig))
    limit[-1] = 0.0
    gaps = np.diff(s_m)
    for k in range(len(limit) - 2, -1, -1):
        limit[k] = min(limit[k], np.sqrt(limit[k + 1] ** 2 + 2.0 * rig.config.deceleration_mps2 * gaps[k]))
    limit = speeding_up(limit, s_m, rig)
    limit[:-1] = np.maximum(limit[:-1], LEAST_MPS)
    return limit


def speeding_up(limit_mps: Float64, s_m: Float64, rig: Rig) -> Float64:
    """The limit lowered to what can be reached from standstill at the first point, (N,)."""
    limit, gaps = limit_mps.copy(), np.diff(s_m)
    limit[0] = min(limit[0], START_MPS)
    for k in range(1, len(limit) - 1):
        limit[k] = min(limit[k], np.sqrt(limit[k - 1] ** 2 + 2.0 * rig.acceleration_mps2 * gaps[k - 1]))
    return limit


def curve_limit(s_m: Float64, curvature_radpm: Float64, rig: Rig) -> Float64:
    """What curvature and its change allow, (N,)."""
    curvature = np.abs(curvature_radpm)
    side = np.sqrt(rig.config.lateral_acceleration_mps2 / np.maximum(curvature, 1e-6))
    steer = np.arctan(rig.wheelbase_m * curvature_radpm)
    rate = np.abs(np.gradient(steer, s_m))
    steering = rig.steer_rate_radps / np.maximum(rate, 1e-6)
    limit = np.minimum(side, steering)
    is_turn = curvature > TURN_SHARE / rig.radius_m
    return np.asarray(np.where(is_turn, np.minimum(limit, rig.turn_mps), limit), np.float64)

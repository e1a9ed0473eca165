"""Speed profile of a path: section, lateral acceleration and steering rate limits, joined by constant accelerations."""

import math

import numpy as np

from geometry.arrays import Float64
from geometry.jit import kernel
from planning.rig import Rig

TURN_SHARE = 0.4  # of the plan's maximum curvature: above it the turning speed applies in every section
START_MPS = 0.5  # a limit of 0 would never start
MIN_MPS = 0.05


def speed_profile(s_m: Float64, curvature_radpm: Float64, section_mps: Float64, rig: Rig) -> Float64:
    """Speed limit at each point, (N,), m/s; 0 at the end. The first limit is reached from standstill at once."""
    limit = np.minimum(section_mps, curve_limit(s_m, curvature_radpm, rig))
    limit[-1] = 0.0
    _limit(limit[::-1], np.diff(s_m)[::-1], rig.config.deceleration_mps2)
    limit = limit_acceleration(limit, s_m, rig)
    limit[:-1] = np.maximum(limit[:-1], MIN_MPS)
    return limit


def limit_acceleration(limit_mps: Float64, s_m: Float64, rig: Rig) -> Float64:
    """The limit lowered to what is reached from standstill at the first point, (N,)."""
    limit = limit_mps.copy()
    limit[0] = min(limit[0], START_MPS)
    _limit(limit[:-1], np.diff(s_m), rig.acceleration_mps2)
    return limit


@kernel
def _limit(limit_mps: Float64, gaps_m: Float64, acceleration_mps2: float) -> None:
    """Lowers limits (N,) in place to what is reached from the one before, `gaps_m` away."""
    for k in range(1, len(limit_mps)):
        limit_mps[k] = min(limit_mps[k], math.sqrt(limit_mps[k - 1] ** 2 + 2.0 * acceleration_mps2 * gaps_m[k - 1]))


def curve_limit(s_m: Float64, curvature_radpm: Float64, rig: Rig) -> Float64:
    """Limit by curvature and its rate of change, (N,): lateral acceleration and steering rate."""
    curvature = np.abs(curvature_radpm)
    lateral = np.sqrt(rig.config.lateral_acceleration_mps2 / np.maximum(curvature, 1e-6))
    steer = np.arctan(rig.wheelbase_m * curvature_radpm)
    rate = np.abs(np.gradient(steer, s_m))
    steering = rig.steer_rate_radps / np.maximum(rate, 1e-6)
    limit = np.minimum(lateral, steering)
    is_turn = curvature > TURN_SHARE / rig.radius_m
    return np.asarray(np.where(is_turn, np.minimum(limit, rig.turn_mps), limit), np.float64)

"""Stopping distance, required range, and highest speed for a range (docs/requirements.md, section 4; cf. ISO 13855)."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64

GRAVITY_MPS2 = 9.80665
BISECTIONS = 40


@dataclass(frozen=True)
class Braking:
    """Dead time τ before the brake acts, linear build-up t_b and deceleration a; a ≤ 0: the machine cannot stop."""

    reaction_s: float
    build_up_s: float
    deceleration_mps2: float


def on_grade(flat: Braking, downhill_rad: float, min_mps2: float) -> Braking:
    """Braking on a slope that falls by `downhill_rad` in the direction of travel.

    Downhill subtracts g·sin θ. Uphill adds nothing, because the crest may be near. Below `min_mps2` the machine counts
    as unable to stop (deceleration 0).
    """
    a = flat.deceleration_mps2 - GRAVITY_MPS2 * max(0.0, math.sin(downhill_rad))
    return Braking(flat.reaction_s, flat.build_up_s, a if a >= min_mps2 else 0.0)


def stopping_distance(speed_mps: float, braking: Braking) -> float:
    """S: distance from the first moment the obstacle is detectable to standstill; infinite if the brake cannot stop."""
    v, tau, t_b, a = speed_mps, braking.reaction_s, braking.build_up_s, braking.deceleration_mps2
    if v <= 0.0:
        return 0.0
    if a <= 0.0:
        return math.inf
    if v >= 0.5 * a * t_b:
        return v * tau + v * t_b - a * t_b**2 / 6.0 + (v - 0.5 * a * t_b) ** 2 / (2.0 * a)
    return v * tau + (2.0 / 3.0) * v * math.sqrt(2.0 * v * t_b / a)


def stopping_time(speed_mps: float, braking: Braking) -> float:
    """T_stop: time from the first moment the obstacle is detectable to standstill."""
    v, t_b, a = speed_mps, braking.build_up_s, braking.deceleration_mps2
    if v <= 0.0:
        return braking.reaction_s
    if a <= 0.0:
        return math.inf
    braked_s = 0.5 * t_b + v / a if v >= 0.5 * a * t_b else math.sqrt(2.0 * v * t_b / a)
    return braking.reaction_s + braked_s


def braking_travel_m(speed_mps: float, braking: Braking, times_s: Float64) -> Float64:
    """Travel after each time (N,), (N,), of a machine that brakes from now on; half of the build-up is dead time."""
    a, dead_s = braking.deceleration_mps2, braking.reaction_s + 0.5 * braking.build_up_s
    braked_s = np.clip(times_s - dead_s, 0.0, speed_mps / a if a > 0.0 else 0.0)
    driven_s = np.minimum(times_s, dead_s) + braked_s if a > 0.0 else times_s
    return np.asarray(speed_mps * driven_s - 0.5 * a * braked_s**2)


def required_range(speed_mps: float, braking: Braking, allowance_m: float, obstacle_mps: float = 0.0) -> float:
    """Required range: S + v_obstacle·T_stop + allowance (k·σ_range + σ_position + margin, and L_front if ranges are not
    measured from the foremost point)."""
    distance_m = stopping_distance(speed_mps, braking)
    approach_m = obstacle_mps * stopping_time(speed_mps, braking) if obstacle_mps > 0.0 else 0.0
    return distance_m + approach_m + allowance_m


def highest_speed(range_m: float, braking: Braking, allowance_m: float, obstacle_mps: float = 0.0) -> float:
    """Highest speed whose required range is at most `range_m`; 0 when standstill already needs more."""
    if math.isinf(range_m) and range_m > 0.0:
        return math.inf
    if math.isnan(range_m) or braking.deceleration_mps2 <= 0.0:
        return 0.0
    if required_range(0.0, braking, allowance_m, obstacle_mps) > range_m:
        return 0.0
    knee_mps = 0.5 * braking.deceleration_mps2 * braking.build_up_s
    if required_range(knee_mps, braking, allowance_m, obstacle_mps) <= range_m:
        return _above_knee(range_m - allowance_m, braking, obstacle_mps, knee_mps)
    return _bisect(range_m, braking, allowance_m, obstacle_mps, knee_mps)


def needed_deceleration(speed_mps: float, clearance_m: float, dead_time_s: float, max_mps2: float) -> float:
    """Constant deceleration that stops within `clearance_m` after a dead time of `dead_time_s`; at most `max_mps2`."""
    distance_m = clearance_m - speed_mps * dead_time_s
    if speed_mps <= 0.0:
        return 0.0
    return max_mps2 if distance_m <= 0.0 else min(max_mps2, speed_mps**2 / (2.0 * distance_m))


def _above_knee(range_m: float, braking: Braking, obstacle_mps: float, knee_mps: float) -> float:
    """Root of v²/2a + v·(τ + t_b/2 + v_o/a) + v_o·(τ + t_b/2) − a·t_b²/24 = range, where the brake is built up."""
    a, t_b = braking.deceleration_mps2, braking.build_up_s
    dead_s = braking.reaction_s + 0.5 * t_b
    half_b = 0.5 * (dead_s + obstacle_mps / a)
    c = obstacle_mps * dead_s - a * t_b**2 / 24.0 - range_m
    root = 2.0 * a * (math.sqrt(max(0.0, half_b**2 - c / (2.0 * a))) - half_b)
    return max(knee_mps, root * (1.0 - 1e-12))


def _bisect(range_m: float, braking: Braking, allowance_m: float, obstacle_mps: float, knee_mps: float) -> float:
    low, high = 0.0, knee_mps
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if required_range(middle, braking, allowance_m, obstacle_mps) <= range_m:
            low = middle
        else:
            high = middle
    return low

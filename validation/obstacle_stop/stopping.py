"""Stopping distance of docs/requirements.md section 4; independent of safety/, which it evaluates."""

import math

from validation.obstacle_stop.conditions import BrakingValues

GRAVITY_MPS2 = 9.80665


def stopping_distance_m(speed_mps: float, reaction_s: float, braking: BrakingValues) -> float:
    """S (m) at a speed, with `reaction_s` until the brake begins to act."""
    v, a, t_b = abs(speed_mps), braking.deceleration_mps2, braking.build_up_s
    if v < 0.5 * a * t_b:
        return v * reaction_s + (2.0 / 3.0) * v * math.sqrt(2.0 * v * t_b / a)
    return v * reaction_s + v * t_b - a * t_b**2 / 6.0 + (v - 0.5 * a * t_b) ** 2 / (2.0 * a)


def on_grade(braking: BrakingValues, downhill: float) -> BrakingValues:
    """Braking where the ground falls by the sine `downhill` in the direction of travel; uphill adds nothing."""
    a_mps2 = braking.deceleration_mps2 - GRAVITY_MPS2 * max(0.0, downhill)
    return BrakingValues.model_validate(braking.model_dump() | {"deceleration_mps2": a_mps2})


def safe_speed_mps(range_m: float, factor: float, braking: BrakingValues) -> float:
    """Highest speed (m/s) at which `factor` × S is within a range (BD-5.2.4)."""
    low, high = 0.0, 100.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        if factor * stopping_distance_m(middle, braking.reaction_s, braking) <= range_m:
            low = middle
        else:
            high = middle
    return low

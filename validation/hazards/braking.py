"""Closed form of a stop: reaction time, linear build-up of the brake, constant deceleration (docs/requirements.md)."""

import math

from validation.obstacle_stop.conditions import BrakingValues

BRAKING = BrakingValues(reaction_s=0.6, build_up_s=0.4, deceleration_mps2=2.5, dead_time_s=0.3)
PTO_S = BRAKING.reaction_s + 2.4  # until the PTO stands: it runs down from 540 1/min with a lag of 0.5 s
MIN_SPEED_MPS = 3.0 / 3.6  # past an occlusion, slower is not demanded


def speed_after(speed_mps: float, t_s: float, braking: BrakingValues = BRAKING) -> float:
    """Speed (m/s) a time after the obstacle could be known."""
    u = t_s - braking.reaction_s
    a, t_b = braking.deceleration_mps2, braking.build_up_s
    if u <= 0.0:
        return speed_mps
    lost = 0.5 * a * u * u / t_b if u < t_b else a * (u - 0.5 * t_b)
    return max(0.0, speed_mps - lost)


def travel_after(speed_mps: float, t_s: float, braking: BrakingValues = BRAKING) -> float:
    """Distance (m) driven by then."""
    a, t_b = braking.deceleration_mps2, braking.build_up_s
    u = min(t_s - braking.reaction_s, stopping_time(speed_mps, braking) - braking.reaction_s)
    if u <= 0.0:
        return speed_mps * max(0.0, t_s)
    before = speed_mps * braking.reaction_s
    if u < t_b:
        return before + speed_mps * u - a * u**3 / (6.0 * t_b)
    rest = u - t_b
    return before + speed_mps * t_b - a * t_b**2 / 6.0 + (speed_mps - 0.5 * a * t_b) * rest - 0.5 * a * rest * rest


def stopping_time(speed_mps: float, braking: BrakingValues = BRAKING) -> float:
    """Time (s) until standstill."""
    a, t_b = braking.deceleration_mps2, braking.build_up_s
    if speed_mps < 0.5 * a * t_b:
        return braking.reaction_s + math.sqrt(2.0 * speed_mps * t_b / a)
    return braking.reaction_s + t_b + (speed_mps - 0.5 * a * t_b) / a

"""Limiters of the safe command: speed, acceleration, braking, jerk and curvature."""

import math
from dataclasses import dataclass

from messages.command import ControlCommand
from safety.config import BrakingConfig
from safety.stopping_distance import Braking, needed_deceleration

TOLERANCE_MPS = 0.05  # measured speed above the limit at which braking begins
CORRECTION_S = 0.5  # time constant of the correction of excess speed


@dataclass(frozen=True)
class SpeedDemand:
    """Commanded signed speed and demanded deceleration."""

    speed_mps: float
    deceleration_mps2: float


def curve_deceleration(speed_mps: float, braking: Braking) -> float:
    """Deceleration along the curve v(gap) at a speed: from dv/dt = −v / (dS/dv), dS/dv = τ + t_b/2 + v/a."""
    if braking.deceleration_mps2 <= 0.0:
        return 0.0
    dead_s = braking.reaction_s + 0.5 * braking.build_up_s
    return speed_mps / (dead_s + speed_mps / braking.deceleration_mps2)


def target_speed(
    control_command: ControlCommand | None, allowed_mps: float, measured_mps: float, creep_mps: float, direction: int
) -> float:
    """The commanded signed speed within the limit; 0 below the creep speed, when not finite or on reversal at speed.

    Also 0 against the direction in which obstacles are looked for.
    """
    if control_command is None or not math.isfinite(control_command.speed_mps) or allowed_mps < creep_mps:
        return 0.0
    if control_command.speed_mps * direction < 0.0:
        return 0.0
    is_turning_round = control_command.speed_mps * measured_mps < 0.0 and abs(measured_mps) > 2.0 * creep_mps
    return (
        0.0
        if is_turning_round
        else math.copysign(min(abs(control_command.speed_mps), allowed_mps), control_command.speed_mps)
    )


def limit_acceleration(target_mps: float, before_mps: float, measured_mps: float, step_mps: float) -> float:
    """The target speed, at most one step above the previous command; decreases are not limited."""
    if target_mps == 0.0:
        return 0.0
    sign = math.copysign(1.0, target_mps)
    start = max(before_mps * sign, min(measured_mps * sign, abs(target_mps)), 0.0)
    return sign * min(abs(target_mps), start + step_mps)


def braking_demand(
    control_command: ControlCommand | None,
    allowed_mps: float,
    measured_mps: float,
    clearance_m: float,
    braking: Braking,
    config: BrakingConfig,
) -> float:
    """Deceleration demanded while driving, m/s²: of the control command or needed for the limit, at most full."""
    asked = (
        max(0.0, -control_command.acceleration_mps2)
        if control_command is not None and math.isfinite(control_command.acceleration_mps2)
        else 0.0
    )
    excess = measured_mps - allowed_mps
    if excess <= TOLERANCE_MPS:
        return min(asked, config.full_mps2)
    needed = curve_deceleration(measured_mps, braking) + excess / CORRECTION_S
    if math.isfinite(clearance_m):
        needed = max(needed, needed_deceleration(measured_mps, clearance_m, config.dead_time_s, config.full_mps2))
    return min(max(asked, needed), config.full_mps2)


def stopping_deceleration(measured_mps: float, clearance_m: float, config: BrakingConfig) -> float:
    """Deceleration of a controlled stop, m/s²: the controlled one, or more if the clearance needs it."""
    if not math.isfinite(clearance_m):
        return config.controlled_mps2
    needed = needed_deceleration(measured_mps, clearance_m, config.dead_time_s, config.full_mps2)
    return max(config.controlled_mps2, needed)


def limit_jerk(asked_mps2: float, before_mps2: float, gentle_mps2: float, step_mps2: float) -> float:
    """Rise of gentle braking limited to one step; hard braking is not limited."""
    return asked_mps2 if asked_mps2 > gentle_mps2 else min(asked_mps2, before_mps2 + step_mps2)


def limit_curvature(
    control_command: ControlCommand | None, before_radpm: float, most_radpm: float, step_radpm: float
) -> float:
    """The commanded curvature within the limit and rate of the machine; without a command the previous one."""
    wanted = (
        before_radpm
        if control_command is None or not math.isfinite(control_command.curvature_radpm)
        else control_command.curvature_radpm
    )
    wanted = max(-most_radpm, min(most_radpm, wanted))
    return before_radpm + max(-step_radpm, min(step_radpm, wanted - before_radpm))

"""Hand on the steering wheel: ≥ 50 °/s, or > 30°, or forced for > 1 s; system off, driver mode (BD-5.5.2e)."""

import math

from pydantic import Field

from configs.strict import Config
from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "driver_override"
ROUNDING = 1e-9  # 50 °/s is not exact in radians


class DriverOverrideLimits(Config):
    """BD-5.5.2e: any one is enough; the bounds are those of the clause."""

    rate_dps: float = Field(gt=0.0, le=50.0)
    angle_deg: float = Field(gt=0.0, le=30.0)
    forced_s: float = Field(gt=0.0, le=1.0)


def evaluate(situation: Situation, limits: DriverOverrideLimits) -> RuleResult:
    """Stop on rate, angle or time; the machine reports the motion imposed by the driver, net of the motor's own."""
    machine, forced_s = situation.machine, situation.vehicle.driver_override_s
    if machine is None:
        return no_objection(CODE)
    rate_dps, angle_deg = math.degrees(abs(machine.driver_rate_radps)), math.degrees(abs(machine.driver_angle_rad))
    if not rate_dps < limits.rate_dps - ROUNDING:
        return stop(CODE, f"wheel turned by hand at {rate_dps:.0f} °/s")
    if not angle_deg <= limits.angle_deg + ROUNDING:
        return stop(CODE, f"wheel turned by hand by {angle_deg:.0f}°")
    if forced_s > limits.forced_s:
        return stop(CODE, f"wheel held by hand for {forced_s:.1f} s")
    return no_objection(CODE)


RULE = Rule(
    order=20,
    clauses=("BD-5.5.2e",),
    effect=Effect.FAULT | Effect.TAKEOVER,
    evaluate=evaluate,
    limits=DriverOverrideLimits,
    config_keys=("limits.driver_torque_nm",),
    texts_zh={CODE: "手握方向盘：驾驶员接管"},
)

"""Hand on the wheel: ≥ 50 °/s, or > 30°, or forced for > 1 s; system off, driver mode (BD-5.5.2e)."""

import math

from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.situation import Situation

CODE = "driver_override"
ROUNDING = 1e-9  # 50 °/s is not exact in radians


def evaluate(situation: Situation) -> RuleResult:
    """Any of the three is enough; what the machine reports is the motion that the hand imposes, net of the motor's."""
    machine, limits = situation.machine, situation.config.driver_override
    if machine is None:
        return no_objection(CODE)
    rate_dps, angle_deg = math.degrees(abs(machine.driver_rate_radps)), math.degrees(abs(machine.driver_angle_rad))
    if not rate_dps < limits.rate_dps - ROUNDING:
        return stop(CODE, f"wheel turned by hand at {rate_dps:.0f} °/s")
    if not angle_deg <= limits.angle_deg + ROUNDING:
        return stop(CODE, f"wheel turned by hand by {angle_deg:.0f}°")
    if situation.driver_override_s > limits.forced_s:
        return stop(CODE, f"wheel held by hand for {situation.driver_override_s:.1f} s")
    return no_objection(CODE)

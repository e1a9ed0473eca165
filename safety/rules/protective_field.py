"""Raw protective field: the machine stands the margin before whatever stands in its way."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed, stopping_distance

CODE = "protective_field"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as both gaps allow; brake at once when one lies inside the stopping distance."""
    clearance = situation.clearance
    if clearance is None:
        return limit("protective_field.no_scan", 0.0, "no lidar has looked ahead yet")
    nearest_m = min(clearance.main_m, clearance.arc_m)
    if math.isinf(nearest_m):
        return no_objection(CODE)
    if situation.is_moving and stopping_distance(situation.speed_mps, situation.braking) > nearest_m:
        return stop(CODE, f"obstacle {nearest_m:.1f} m ahead, inside the stopping distance")
    main = highest_speed(clearance.main_m, situation.braking, situation.allowance_m)
    arc = highest_speed(clearance.arc_m, situation.braking, situation.config.field.arc_margin_m)
    return limit(CODE, min(main, arc), f"obstacle {nearest_m:.1f} m ahead")

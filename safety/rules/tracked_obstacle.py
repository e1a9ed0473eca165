"""Tracked obstacles: whoever will be in the way before the machine can have stopped counts already."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed, stopping_distance

CODE = "tracked_obstacle"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as the predicted gap allows; brake at once when it lies inside the stopping distance."""
    nearest = situation.critical_object
    if math.isinf(nearest.clearance_m):
        return no_objection(CODE)
    text = f"{nearest.label} {nearest.clearance_m:.1f} m ahead"
    if situation.is_moving and stopping_distance(situation.speed_mps, situation.braking) > nearest.clearance_m:
        return stop(CODE, f"{text}, inside the stopping distance")
    return limit(CODE, highest_speed(nearest.clearance_m, situation.braking, situation.allowance_m), text)

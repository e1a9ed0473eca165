"""Docking: machine and implement stay clear of surveyed walls and posts by what the pose leaves open."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed

CODE = "wall_clearance"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as the way left allows; the clearance is already taken off it."""
    if math.isinf(situation.wall_distance_m):
        return no_objection(CODE)
    speed = highest_speed(situation.wall_distance_m, situation.braking, 0.0)
    return limit(CODE, speed, f"wall or post of the shed in {situation.wall_distance_m:.2f} m")

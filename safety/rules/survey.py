"""Docking: machine and implement stay clear of surveyed walls and posts by what the pose leaves open."""

import math

from messages.command import RuleResult
from safety.rules.verdict import free, limit
from safety.situation import Situation
from safety.stopping import highest_speed

CODE = "dock.wall"


def judge(situation: Situation) -> RuleResult:
    """Slow as the way left allows; the clearance is already taken off it."""
    if math.isinf(situation.survey_m):
        return free(CODE)
    speed = highest_speed(situation.survey_m, situation.braking, 0.0)
    return limit(CODE, speed, f"wall or post of the shed in {situation.survey_m:.2f} m")

"""Wall clearance: while docking, machine and implement keep clear of surveyed walls and posts."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed

CODE = "wall_clearance"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as the distance allows, from which clearance and position uncertainty are already subtracted."""
    if math.isinf(situation.wall_distance_m):
        return no_objection(CODE)
    speed = highest_speed(situation.wall_distance_m, situation.braking, 0.0)
    return limit(CODE, speed, f"wall or post of the shed in {situation.wall_distance_m:.2f} m")


RULE = Rule(
    order=170,
    effect=Effect.LIMIT,
    evaluate=evaluate,
    config_keys=("docking.clearance_m", "docking.sigmas"),
    texts_zh={CODE: "接近机库墙或立柱"},
)

"""Tracked obstacles: the predicted path of a track meets that of machine or implement before it can stop."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed, stopping_distance

CODE = "tracked_obstacle"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as the predicted clearance allows; brake at once when it is within the stopping distance."""
    critical_object = situation.critical_object
    if math.isinf(critical_object.clearance_m):
        return no_objection(CODE)
    text = f"{critical_object.label} {critical_object.clearance_m:.1f} m ahead"
    if situation.is_moving and stopping_distance(situation.speed_mps, situation.braking) > critical_object.clearance_m:
        return stop(CODE, f"{text}, inside the stopping distance")
    return limit(CODE, highest_speed(critical_object.clearance_m, situation.braking, situation.allowance_m), text)


RULE = Rule(
    order=140,
    clauses=("BD-5.2.4", "BD-5.2.5b"),
    effect=Effect.OBSTACLE,
    evaluate=evaluate,
    config_keys=(
        "tracked.min_horizon_s",
        "tracked.max_horizon_s",
        "bystanders.away_m",
        "bystanders.lost_m",
        "field.margin_m",
        "braking.reaction_s",
        "braking.build_up_s",
        "braking.deceleration_mps2",
    ),
    texts_zh={CODE: "跟踪目标进入行驶路径"},
)

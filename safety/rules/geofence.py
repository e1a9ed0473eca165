"""Geofence: machine and implement stay within the allowed area (ISO 18497-3: autonomous operating zone)."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed

CODE, UNKNOWN, OUTSIDE = "geofence", "geofence.unknown", "geofence.outside"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as the distance left inside allows; stop when any part is outside; stand while the position is unknown."""
    distance_m = situation.geofence_distance_m
    if distance_m is None:
        return limit(UNKNOWN, 0.0, "position within the field unknown")
    if math.isinf(distance_m):
        return no_objection(CODE)
    if distance_m < 0.0:
        return stop(OUTSIDE, "machine or implement outside the allowed area")
    speed = highest_speed(distance_m, situation.braking, situation.config.limits.geofence_margin_m)
    return limit(CODE, speed, f"edge of the allowed area in {distance_m:.1f} m")


RULE = Rule(
    order=110,
    effect=Effect.FAULT,
    effects={UNKNOWN: Effect.FAULT | Effect.BLOCKS_START},
    evaluate=evaluate,
    config_keys=("limits.geofence_margin_m",),
    texts_zh={CODE: "接近作业区边界", UNKNOWN: "田块内位置未知", OUTSIDE: "机器或机具超出允许区域"},
)

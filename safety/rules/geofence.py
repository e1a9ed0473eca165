"""The geofence: machine and implement stand before the edge of what they may use, and outside it they do not drive."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed

CODE, UNKNOWN = "geofence", "geofence.unknown"


def evaluate(situation: Situation) -> RuleResult:
    """Slow as the way left inside allows; stop when some part is outside."""
    distance_m = situation.geofence_distance_m
    if distance_m is None:
        return limit(UNKNOWN, 0.0, "place within the field not known")
    if math.isinf(distance_m):
        return no_objection(CODE)
    if distance_m < 0.0:
        return stop("geofence.outside", "machine or implement outside the allowed area")
    speed = highest_speed(distance_m, situation.braking, situation.config.limits.geofence_margin_m)
    return limit(CODE, speed, f"edge of the allowed area in {distance_m:.1f} m")

"""Proven range: no faster than what is seen to be free allows (BD-5.2.4: twice the stopping distance)."""

from messages.command import RuleResult
from safety.rules.results import limit
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed


def evaluate(situation: Situation) -> RuleResult:
    """The lower of two speeds: S within the range over the factor, and the whole range needed within it."""
    range_m, config = situation.detection_range_m, situation.config.field
    if situation.blind and range_m <= 0.0:
        return limit(f"{situation.blind[0]}.blind", 0.0, f"{situation.blind[0]} is blind")
    twice = highest_speed(range_m / config.slow_range_factor, situation.braking, 0.0)
    whole = highest_speed(range_m, situation.braking, situation.allowance_m)
    return limit("detection_range.limit", min(twice, whole), f"proven free for {range_m:.0f} m")

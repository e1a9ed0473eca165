"""Detection range: the speed follows the range proven free (BD-5.2.4: twice the stopping distance)."""

from messages.command import RuleResult
from safety.rules.results import limit
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.stopping_distance import highest_speed

CODE = "detection_range.limit"


def evaluate(situation: Situation) -> RuleResult:
    """The lower of two speeds: S within the range over the factor, and the required range within the range.

    Any blind lidar stops the machine: each covers places that no other covers.
    """
    range_m, config = situation.detection_range_m, situation.config.field
    if situation.blind:
        return limit(f"{situation.blind[0]}.blind", 0.0, f"{situation.blind[0]} is blind")
    by_factor = highest_speed(range_m / config.slow_range_factor, situation.braking, 0.0)
    by_range = highest_speed(range_m, situation.braking, situation.allowance_m)
    return limit(CODE, min(by_factor, by_range), f"proven free for {range_m:.0f} m")


RULE = Rule(
    order=150,
    clauses=("BD-5.2.4",),
    effect=Effect.DETECTION,
    evaluate=evaluate,
    config_keys=(
        "field.slow_range_factor",
        "detection_range.cap_m",
        "detection_range.half_cone_deg",
        "detection_range.blind_ratio",
        "detection_range.good_ratio",
    ),
    texts_zh={CODE: "可靠探测距离限速", "*.blind": "{} 被遮挡"},
)

"""Lidar agreement: a lidar that contradicts the others, or is not the configured one, stops the machine."""

from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "lidar_agreement"


def evaluate(situation: Situation) -> RuleResult:
    """Stop on the first failed lidar that covers the direction of travel: where it looks, no other may see."""
    if not situation.lidar_failures:
        return no_objection(CODE)
    first = situation.lidar_failures[0]
    return stop(first.code, first.text)


RULE = Rule(
    order=55,
    clauses=("BD-5.2.4", "BD-5.5.2d"),
    effect=Effect.FAULT,
    evaluate=evaluate,
    config_keys=(
        "lidar_agreement.cell_m",
        "lidar_agreement.range_m",
        "lidar_agreement.min_cells",
        "lidar_agreement.max_difference_m",
        "lidar_agreement.max_height_m",
        "lidar_agreement.max_interval_s",
        "lidar_agreement.hold_s",
    ),
    texts_zh={"*.contradicted": "{} 所测地面与其他激光雷达不一致", "*.foreign": "{} 线数与配置不符"},
)

"""Standing body: past a person or animal that stands beside the path only as fast as it could still be stopped for."""

import math

from messages.command import RuleResult
from safety.rules.results import limit, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "standing_body"


def evaluate(situation: Situation) -> RuleResult:
    """Limit beside the path; at the shed every speed is that low."""
    body = situation.standing_body
    if situation.is_docking or math.isinf(body.speed_mps):
        return no_objection(CODE)
    return limit(CODE, body.speed_mps, f"{body.label} stands {body.gap_m:.1f} m beside the path")


RULE = Rule(
    order=145,
    clauses=("BD-5.2.4",),
    effect=Effect.LIMIT,
    evaluate=evaluate,
    config_keys=("standing_body.walk_mps", "standing_body.notice_s", "standing_body.min_mps"),
    texts_zh={CODE: "路径旁有人或动物站立"},
)

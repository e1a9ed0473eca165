"""Implement fold: it moves only at standstill, and the machine drives only while it is locked at one end."""

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation
from safety.zones.footprint import is_between

CODE, SILENT = "implement_fold", "machine.implement.silent"


def evaluate(situation: Situation) -> RuleResult:
    """Stop while the width is unknown; stand while the fold is between its ends."""
    fold = situation.inputs.fold
    if not situation.is_foldable or situation.machine is None:
        return no_objection(CODE)
    if fold is None:
        return stop(SILENT, "the machine's implement frames are missing")
    if is_between(fold):
        return limit(CODE, 0.0, f"implement {fold:.0%} folded, locked at neither end")
    return no_objection(CODE)


RULE = Rule(
    order=120,
    effect=Effect.FAULT,
    evaluate=evaluate,
    config_keys=("limits.max_group_age_s",),
    texts_zh={CODE: "机具折叠未到位", SILENT: "机具无消息"},
)

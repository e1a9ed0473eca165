"""Overspeed: the machine is faster than it was commanded to be."""

from configs.strict import Config
from configs.vehicle import Seconds
from messages.command import RuleResult
from safety.rules.results import emergency, no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "overspeed"


class OverspeedLimits(Config):
    """How long it may last."""

    debounce_s: Seconds


def evaluate(situation: Situation, limits: OverspeedLimits) -> RuleResult:
    """Emergency stop: drive or bus no longer obey the supervisor."""
    if situation.vehicle.overspeed_s > limits.debounce_s:
        return emergency(CODE, "the machine is faster than commanded")
    return no_objection(CODE)


RULE = Rule(
    order=85,
    clauses=("BD-5.2.5a",),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=OverspeedLimits,
    config_keys=("limits.overspeed_mps", "limits.min_slowing_mps2"),
    texts_zh={CODE: "车速高于指令"},
)

"""Faults reported by other nodes: each asks for the response of its own table."""

from configs.vehicle import kmh
from messages.command import RuleResult
from messages.faults import Response
from safety.rules.results import advisory, emergency, limit, no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "reported_fault"


def evaluate(situation: Situation) -> RuleResult:
    """The most severe of the active faults, the earliest of equals."""
    worst = max(situation.faults, key=lambda fault: fault.response, default=None)
    if worst is None:
        return no_objection(CODE)
    text = f"{worst.source}: {worst.text_en}"
    if worst.response is Response.EMERGENCY_STOP:
        return emergency(worst.code, text)
    if worst.response is Response.CONTROLLED_STOP:
        return stop(worst.code, text)
    if worst.response is Response.LIMIT:
        return limit(worst.code, kmh(situation.config.limits.reduced_kmh), text)
    return advisory(worst.code, text)


RULE = Rule(
    order=40,
    effect=Effect.FAULT,
    evaluate=evaluate,
    config_keys=("limits.reduced_kmh",),
    texts_zh={"*": "部件报告故障：{}"},
)

"""Faults that other parts report ask for what their table says."""

from messages.command import RuleResult
from messages.faults import Response
from safety.rules.results import advisory, emergency, limit, no_objection, stop
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """The worst of the active faults, the earliest of equals."""
    worst = max(situation.faults, key=lambda fault: fault.response, default=None)
    if worst is None:
        return no_objection("reported_fault")
    text = f"{worst.source}: {worst.text_en}"
    if worst.response is Response.EMERGENCY_STOP:
        return emergency(worst.code, text)
    if worst.response is Response.CONTROLLED_STOP:
        return stop(worst.code, text)
    if worst.response is Response.LIMIT:
        return limit(worst.code, situation.config.localization.slow_mps, text)
    return advisory(worst.code, text)

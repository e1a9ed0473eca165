"""Clock step: message ages are unknown, so the machine stops and the monitors restart."""

from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "clock_step"


def evaluate(situation: Situation) -> RuleResult:
    """Stop in the one step at which the clock jumped; the fault stop that follows is latched."""
    if situation.clock_step_s == 0.0:
        return no_objection(CODE)
    return stop(CODE, f"clock stepped by {situation.clock_step_s:+.1f} s")


RULE = Rule(
    order=30,
    effect=Effect.FAULT,
    evaluate=evaluate,
    config_keys=("limits.clock_step_s",),
    texts_zh={CODE: "系统时钟跳变"},
)

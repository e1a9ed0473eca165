"""A clock that steps makes every age a guess: stop, and look anew."""

from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """Said once, at the step; the stop it causes waits for a person."""
    if situation.clock_step_s == 0.0:
        return no_objection("clock_step")
    return stop("clock_step", f"clock stepped by {situation.clock_step_s:+.1f} s")

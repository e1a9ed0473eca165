"""Steering must be ready and do what it is told."""

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """Stop when it is lost under way or does not follow; wait while it is not ready at standstill."""
    if situation.machine is None:
        return no_objection("steering")
    debounce_s = situation.config.limits.steering_debounce_s
    if situation.steering_deviation_s > debounce_s:
        return stop("steering.not_following", "steering does not follow its command")
    if situation.machine.is_steering_ready:
        return no_objection("steering")
    if situation.steering_unavailable_s > debounce_s:
        return stop("steering.not_ready", f"steering not ready (exit code {situation.machine.steering_exit_code})")
    return limit("steering.not_ready", 0.0, "steering not ready")

"""The brake must be felt when it is asked for."""

from messages.command import RuleResult
from safety.rules.verdict import emergency, free
from safety.situation import Situation


def judge(situation: Situation) -> RuleResult:
    """All that the machine has, when less than a share of the asked deceleration is felt after some time."""
    if situation.brake_weak_s > situation.config.limits.brake_grace_s:
        return emergency("brake.weak", "the machine does not slow as asked")
    return free("brake.weak")

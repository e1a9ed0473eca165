"""The brake must be felt when it is asked for, and is tried before the first metre."""

from configs.vehicle import kmh
from messages.command import RuleResult
from safety.monitors.brake_test import Phase
from safety.rules.results import emergency, limit, no_objection
from safety.rules.situation import Situation

WEAK, TEST = "brake.weak", "brake.test"


def evaluate(situation: Situation) -> RuleResult:
    """All that the machine has, when less than a share of the asked deceleration is felt or the trial was too long."""
    if situation.brake_ineffective_s > situation.config.limits.brake_debounce_s:
        return emergency(WEAK, "the machine does not slow as asked")
    phase = situation.brake_test
    if phase is Phase.FAILED:
        return emergency("brake.test_failed", "the brake did not stop the machine within its stopping distance")
    if phase is Phase.BRAKE:
        return limit(TEST, 0.0, "the brake is tried")
    if phase is Phase.CREEP:
        return limit(TEST, kmh(situation.config.brake_test.speed_kmh), "slow until the brake has been tried")
    return no_objection(WEAK)

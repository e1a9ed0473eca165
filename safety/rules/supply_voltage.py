"""Supply voltage 9 to 36 V (BD-5.6.1a): outside, the machine stops while it still can."""

from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.situation import Situation


def evaluate(situation: Situation) -> RuleResult:
    """Both ends belong to the range; NaN does not."""
    if situation.machine is None:
        return no_objection("supply_voltage")
    low, high = situation.config.limits.supply_v
    if low <= situation.machine.supply_v <= high:
        return no_objection("supply_voltage")
    return stop("supply_voltage", f"supply at {situation.machine.supply_v:.1f} V, not within {low:g} to {high:g} V")

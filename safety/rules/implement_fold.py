"""The fold moves only while the machine stands, and the machine only while the fold is locked at one end."""

from messages.command import RuleResult
from safety.rules.results import limit, no_objection, stop
from safety.rules.situation import Situation
from safety.zones.footprint import is_between

CODE = "implement_fold"


def evaluate(situation: Situation) -> RuleResult:
    """Stop when nobody knows how wide the implement is; stand while the fold is between."""
    if not situation.is_foldable or situation.machine is None:
        return no_objection(CODE)
    if situation.fold is None:
        return stop("machine.implement.silent", "the machine's implement frames are missing")
    if is_between(situation.fold):
        return limit(CODE, 0.0, f"implement {situation.fold:.0%} folded, locked at neither end")
    return no_objection(CODE)

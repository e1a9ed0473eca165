"""Supply voltage 9 to 36 V (BD-5.6.1a): outside, the machine stops while it still can."""

from pydantic import Field

from configs.strict import Config
from messages.command import RuleResult
from safety.rules.results import no_objection, stop
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

CODE = "supply_voltage"


class SupplyVoltageLimits(Config):
    """Lowest and highest supply voltage."""

    range_v: tuple[float, float] = Field(description="BD-5.6.1a: 9 to 36 V")


def evaluate(situation: Situation, limits: SupplyVoltageLimits) -> RuleResult:
    """Stop outside the closed range, and on NaN."""
    if situation.machine is None:
        return no_objection(CODE)
    low, high = limits.range_v
    if low <= situation.machine.supply_v <= high:
        return no_objection(CODE)
    return stop(CODE, f"supply at {situation.machine.supply_v:.1f} V, not within {low:g} to {high:g} V")


RULE = Rule(
    order=60,
    clauses=("BD-5.6.1a", "BD-5.1d"),
    effect=Effect.FAULT,
    evaluate=evaluate,
    limits=SupplyVoltageLimits,
    texts_zh={CODE: "供电电压超出范围"},
)

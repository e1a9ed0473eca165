"""All rules asked, and what follows from their answers together."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from messages.command import RuleResult
from messages.faults import Response
from safety.config import FieldConfig
from safety.rules import BLOCKING_RULES, RULES
from safety.rules.driver_override import CODE as HAND
from safety.rules.geofence import UNKNOWN as FENCE_UNKNOWN
from safety.rules.results import no_objection
from safety.rules.situation import Situation

NOTHING = no_objection("")


@dataclass(frozen=True)
class Decision:
    """The results by rule, in their order.

    `binding` is the most restrictive of all; `blocking` that of the rules on what lies ahead, which allow
    `passable_mps`; `fault` the first that speaks against driving at all. `clearance_m` is the least of both channels.
    """

    named: Mapping[str, RuleResult]
    binding: RuleResult
    blocking: RuleResult
    fault: RuleResult
    clearance_m: float

    @property
    def results(self) -> tuple[RuleResult, ...]:
        """What every rule said."""
        return tuple(self.named.values())

    @property
    def allowed_mps(self) -> float:
        """The highest speed that every rule allows."""
        return self.binding.speed_limit_mps

    @property
    def passable_mps(self) -> float:
        """The highest speed that the rules on what lies ahead allow."""
        return self.blocking.speed_limit_mps

    @property
    def binding_is_obstacle(self) -> bool:
        """Whether what lies ahead binds."""
        return self.binding is self.blocking and self.blocking is not NOTHING

    @property
    def is_obstacle_inside(self) -> bool:
        """Whether an obstacle lies inside the stopping distance."""
        return self.blocking.response >= Response.CONTROLLED_STOP

    @property
    def is_emergency(self) -> bool:
        """Whether a rule asks for an emergency stop."""
        return self.fault.response is Response.EMERGENCY_STOP

    @property
    def is_takeover(self) -> bool:
        """Whether a hand is on the wheel."""
        return any(result.code == HAND and result.response >= Response.CONTROLLED_STOP for result in self.results)

    @property
    def is_fault(self) -> bool:
        """Whether a rule asks for a stop that a person must end."""
        return self.fault.response >= Response.CONTROLLED_STOP

    @property
    def is_ready(self) -> bool:
        """Whether nothing speaks against starting."""
        return self.fault is NOTHING

    @property
    def advisories(self) -> list[RuleResult]:
        """What is to be told though it does not bind: a lost sensor, and what its rule only wants said."""
        return [
            result
            for name, result in self.named.items()
            if result.text and (result.response is Response.NONE or name == "sensor_loss")
        ]


def evaluate_rules(situation: Situation, disabled: frozenset[str]) -> Decision:
    """Every rule that is not disabled, asked."""
    named = {name: rule(situation) for name, rule in RULES.items() if name not in disabled}
    ahead = [result for name, result in named.items() if name in BLOCKING_RULES]
    others = [result for name, result in named.items() if name not in BLOCKING_RULES]
    against = [r for r in others if r.response >= Response.CONTROLLED_STOP or r.code == FENCE_UNKNOWN]
    clearances = () if situation.clearance is None else (situation.clearance.main_m, situation.clearance.arc_m)
    return Decision(
        named,
        most_restrictive([*named.values()]),
        most_restrictive(ahead),
        most_restrictive(against),
        min(*clearances, situation.critical_object.clearance_m, math.inf),
    )


def most_restrictive(results: list[RuleResult]) -> RuleResult:
    """The strongest response, then the lowest speed, then the first."""
    return min(results, key=severity, default=NOTHING)


def severity(result: RuleResult) -> tuple[bool, int, float]:
    """Sorts the most restrictive first: a stop by its response, all else by its speed."""
    is_stop = result.response >= Response.CONTROLLED_STOP
    return not is_stop, -int(result.response) if is_stop else 0, result.speed_limit_mps


def allowance_m(field: FieldConfig, range_sigma_m: float, position_sigma_m: float) -> float:
    """What is added to the stopping distance: k·σ_range + σ_position + margin."""
    return field.sigma_factor * range_sigma_m + position_sigma_m + field.margin_m

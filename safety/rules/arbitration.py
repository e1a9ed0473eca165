"""Arbitration: evaluates all rules and combines their results by effect."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from messages.command import RuleResult
from messages.faults import Response
from safety.config import FieldConfig
from safety.rules.results import no_objection
from safety.rules.rule import Effect, Rule
from safety.rules.situation import Situation

NOTHING = no_objection("")


@dataclass(frozen=True)
class Decision:
    """All results in the order of the rules, and what follows from them.

    `binding` is the most restrictive of all, `blocking` that of the rules on obstacles and their detection, `fault`
    the most restrictive of those that prevent a start. `advisories` are reported to the operator though they do not
    bind. `clearance_m` is the smaller of both obstacle channels.
    """

    results: tuple[RuleResult, ...]
    binding: RuleResult
    blocking: RuleResult
    fault: RuleResult
    is_takeover: bool
    advisories: tuple[RuleResult, ...]
    clearance_m: float

    @property
    def allowed_mps(self) -> float:
        """The highest speed that every rule allows."""
        return self.binding.speed_limit_mps

    @property
    def passable_mps(self) -> float:
        """The highest speed that obstacles and their detection allow."""
        return self.blocking.speed_limit_mps

    @property
    def binding_is_obstacle(self) -> bool:
        """Whether an obstacle or its detection binds."""
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
    def is_fault(self) -> bool:
        """Whether a rule asks for a stop that a person must end."""
        return self.fault.response >= Response.CONTROLLED_STOP

    @property
    def is_ready(self) -> bool:
        """Whether nothing prevents a start."""
        return self.fault is NOTHING


def evaluate_rules(situation: Situation, rules: Mapping[str, Rule]) -> Decision:
    """The decision of these rules."""
    found = [(rule, rule(situation)) for rule in rules.values()]
    objections = [(r, rule.effect_of(r.code)) for rule, r in found if r.response is not Response.NONE]
    stops = [(result, effect) for result, effect in objections if result.response >= Response.CONTROLLED_STOP]
    faults = [result for result, effect in stops if Effect.FAULT in effect]
    faults += [result for result, effect in objections if Effect.BLOCKS_START in effect]
    reported = [id(result) for result, effect in objections if Effect.ADVISORY in effect]
    gaps = () if situation.clearance is None else (situation.clearance.main_m, situation.clearance.arc_m)
    return Decision(
        tuple(result for _, result in found),
        most_restrictive([result for _, result in found]),
        most_restrictive([result for rule, result in found if rule.is_obstacle_rule]),
        most_restrictive(faults),
        any(Effect.TAKEOVER in effect for _, effect in stops),
        tuple(r for _, r in found if r.text and (r.response is Response.NONE or id(r) in reported)),
        min(*gaps, situation.critical_object.clearance_m, math.inf),
    )


def most_restrictive(results: list[RuleResult]) -> RuleResult:
    """The strongest response, then the lowest speed, then the first."""
    return min(results, key=severity, default=NOTHING)


def severity(result: RuleResult) -> tuple[bool, int, float]:
    """Sorts the most restrictive first: a stop by its response, all else by its speed."""
    is_stop = result.response >= Response.CONTROLLED_STOP
    return not is_stop, -int(result.response) if is_stop else 0, result.speed_limit_mps


def allowance_m(field: FieldConfig, range_sigma_m: float, position_sigma_m: float) -> float:
    """The part of the required range beyond the stopping distance: k·σ_range + σ_position + margin."""
    return field.sigma_factor * range_sigma_m + position_sigma_m + field.margin_m

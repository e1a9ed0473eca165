"""Constructors of rule results."""

import math
from functools import cache

from messages.command import RuleResult
from messages.faults import Response


@cache
def no_objection(code: str) -> RuleResult:
    """No limit and nothing to report."""
    return RuleResult(code, Response.NONE, math.inf, "")


def advisory(code: str, text: str) -> RuleResult:
    """No limit, but a text for the operator."""
    return RuleResult(code, Response.NONE, math.inf, text)


def limit(code: str, speed_mps: float, text: str) -> RuleResult:
    """A speed limit; 0 stops the machine for as long as the result holds."""
    return RuleResult(code, Response.LIMIT, max(0.0, speed_mps), text)


def stop(code: str, text: str) -> RuleResult:
    """A controlled stop, for an obstacle as hard as necessary."""
    return RuleResult(code, Response.CONTROLLED_STOP, 0.0, text)


def emergency(code: str, text: str) -> RuleResult:
    """An emergency stop with all brakes."""
    return RuleResult(code, Response.EMERGENCY_STOP, 0.0, text)

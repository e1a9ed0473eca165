"""The few shapes that a rule's result takes."""

import math
from functools import cache

from messages.command import RuleResult
from messages.faults import Response


@cache
def no_objection(code: str) -> RuleResult:
    """No objection."""
    return RuleResult(code, Response.NONE, math.inf, "")


def advisory(code: str, text: str) -> RuleResult:
    """No objection, but something to be told."""
    return RuleResult(code, Response.NONE, math.inf, text)


def limit(code: str, speed_mps: float, text: str) -> RuleResult:
    """No faster than this; a speed of 0 stops for as long as it is said."""
    return RuleResult(code, Response.LIMIT, max(0.0, speed_mps), text)


def stop(code: str, text: str) -> RuleResult:
    """Stop under control; for an obstacle as hard as needed."""
    return RuleResult(code, Response.CONTROLLED_STOP, 0.0, text)


def emergency(code: str, text: str) -> RuleResult:
    """Stop as fast as the machine can."""
    return RuleResult(code, Response.EMERGENCY_STOP, 0.0, text)

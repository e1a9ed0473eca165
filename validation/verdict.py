"""What a check says about a log."""

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """No trial, no topic, never in automatic mode is *not shown*, never passed."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_SHOWN = "not_shown"


@dataclass(frozen=True)
class Verdict:
    """One clause judged: `n` trials, what was measured against which limit, and where to see it."""

    clause: str
    state: State
    n: int
    measured: float | None
    limit: float | None
    unit: str
    evidence: str


def judge(clause: str, measured: float | None, limit: float, unit: str, n: int, evidence: str) -> Verdict:
    """Passed when something was measured at least once and is not above the limit."""
    if n == 0 or measured is None:
        return Verdict(clause, State.NOT_SHOWN, n, None, limit, unit, f"nothing to judge: {evidence}")
    return Verdict(clause, State.PASSED if measured <= limit else State.FAILED, n, measured, limit, unit, evidence)

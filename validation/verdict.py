"""Verdict of a check on a log."""

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """Without a trial, a topic or automatic mode the state is *not shown*, never passed."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_SHOWN = "not_shown"


@dataclass(frozen=True)
class Verdict:
    """Result for one clause: `n` trials, measured value, limit, and evidence."""

    clause: str
    state: State
    n: int
    measured: float | None
    limit: float | None
    unit: str
    evidence: str


def verdict_of(clause: str, measured: float | None, limit: float, unit: str, n: int, evidence: str) -> Verdict:
    """Passed when there is a trial and the measured value is not above the limit."""
    if n == 0 or measured is None:
        return Verdict(clause, State.NOT_SHOWN, n, None, limit, unit, f"no trial: {evidence}")
    return Verdict(clause, State.PASSED if measured <= limit else State.FAILED, n, measured, limit, unit, evidence)

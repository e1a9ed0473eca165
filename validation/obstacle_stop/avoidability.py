"""Outcome of one encounter from plain numbers; the same for recorded logs and for simulated drives.

The gap is the distance along the swept path to the true box, S the stopping distance with the reaction time. The
request is *due* when the gap falls below S.

request ─┬─ ghost stops before contact, with the margin ───► in time
         └─ not ─┬─ excused, and requested promptly then ──► censored, cut-in, occluded
                 └─ else ──────────────────────────────────► late
none ────┬─ due ─┬─ recording ends before a prompt one ────► censored
         │       └─ else ──────────────────────────────────► missed
         ├─ due only without the driver's braking ─────────► not shown (driver)
         └─ never due ─────────────────────────────────────► no demand

Excused is only what could not be known while the gap was at least S: in the path within S at the first known moment
(censored); neither in the path nor predicted into it at constant velocity (cut-in); not visible (occluded).
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from geometry.arrays import Bool, Float64

STANDING_MPS = 0.1
START_S = 0.25  # a request cannot be due earlier after the first known moment
DRIVER_S = 3.0  # braking of the driver within this time before counts


class Outcome(StrEnum):
    """Outcome of an encounter; not shown without truth, or when the machine never moved."""

    IN_TIME = "in time"
    LATE = "late"
    MISSED = "missed"
    CUT_IN = "cut-in"
    OCCLUDED = "occluded"
    CENSORED = "censored"
    NO_DEMAND = "no demand"
    DRIVER = "not shown (driver)"
    NOT_SHOWN = "not shown"


@dataclass(frozen=True, eq=False)
class Approach:
    """One object over M moments.

    `t_s` (M,), `gap_m` (M,) (infinite: not in the swept path), `stopping_distance_m` (M,) is S of the `speed_mps` (M,);
    `predicted_gap_m` (M,): greatest gap at which the constant-velocity prediction meets the path (negative: never);
    `is_visible` (M,). `is_open`: the recording ends with the object in the path.
    """

    t_s: Float64
    gap_m: Float64
    stopping_distance_m: Float64
    speed_mps: Float64
    predicted_gap_m: Float64
    is_visible: Bool
    is_open: bool


@dataclass(frozen=True)
class Limits:
    """Times (s) up to which a request is prompt: after what could not be known, and after the start of the truth."""

    prompt_s: float
    settling_s: float


def due_index(gap_m: Float64, stopping_distance_m: Float64, speed_mps: Float64) -> int | None:
    """Index of the first moment at which a moving machine has the object in its path within S; None: never."""
    found = np.flatnonzero((gap_m < stopping_distance_m) & (speed_mps > STANDING_MPS))
    return int(found[0]) if len(found) else None


def excuse(approach: Approach, due: int) -> tuple[Outcome, float] | None:
    """Why the request could not be made when it was due, and the time from which it could; None without an excuse."""
    a, until = approach, slice(0, due + 1)
    known_gap = np.where(np.isfinite(a.gap_m[until]), a.gap_m[until], a.predicted_gap_m[until])
    is_met = known_gap >= a.stopping_distance_m[until]
    if np.isfinite(a.gap_m[0]) and a.t_s[due] - a.t_s[0] <= START_S:
        return Outcome.CENSORED, float(a.t_s[0])
    if not is_met.any():
        return Outcome.CUT_IN, float(a.t_s[due])
    if not (is_met & a.is_visible[until]).any():
        seen = np.flatnonzero(a.is_visible[due:])
        return Outcome.OCCLUDED, float(a.t_s[due + seen[0]]) if len(seen) else math.inf
    return None


def driver_came_first(approach: Approach) -> bool:
    """Whether the request would have been due at the highest speed of the last seconds, but not at the driven one."""
    a = approach
    for k in np.flatnonzero(np.isfinite(a.gap_m)):
        recent = (a.t_s >= a.t_s[k] - DRIVER_S) & (a.t_s <= a.t_s[k])
        if a.gap_m[k] < a.stopping_distance_m[recent].max() and a.speed_mps[recent].max() > STANDING_MPS:
            return True
    return False


def outcome_of(
    approach: Approach, due: int | None, request_s: float | None, is_avoided: bool, limits: Limits, is_manual: bool
) -> Outcome:
    """Outcome; `request_s` is the delivery of the first request, `is_avoided`: the ghost stops in time."""
    if due is None and is_manual and driver_came_first(approach):
        return Outcome.DRIVER
    if due is None and request_s is None:
        return Outcome.NO_DEMAND
    if request_s is not None and is_avoided:
        return Outcome.IN_TIME
    if due is None:
        return Outcome.LATE
    reason, end_s = excuse(approach, due), float(approach.t_s[-1])
    if reason is not None:
        outcome, since_s = reason
        until_s = since_s + (limits.settling_s if outcome is Outcome.CENSORED else limits.prompt_s)
        if request_s is not None and request_s <= until_s:
            return outcome
        if request_s is None and end_s <= until_s:
            return Outcome.OCCLUDED if math.isinf(since_s) else Outcome.CENSORED
    if request_s is not None:
        return Outcome.LATE
    is_cut = approach.is_open and end_s <= approach.t_s[due] + limits.prompt_s
    return Outcome.CENSORED if is_cut else Outcome.MISSED

"""Encounters: objects that entered the driving corridor, with the outcome of each.

               entry within S?
               ├─ at the start of the log ────────────────► censored (missed without a request for a second)
               ├─ occluded before, always in the corridor ► occluded
               ├─ from the side ──────────────────────────► cut-in
stop request ──┤ no: requested while it could still stop? ► in time, else late
no request ────┴─ needed, or not detected within 10 m ────► missed; else in time (no request was necessary)
"""

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.observation import LogObservation, ObjectObservation, StopRequest
from validation.obstacle_stop.ranges import confirmed, range_without_failure
from validation.obstacle_stop.stopping import stopping_distance_m
from validation.obstacle_stop.visibility import clearance_of, in_forward_region, is_in_corridor

EARLY_NS = 1_000_000_000  # a tracked obstacle may cause a request before its entry
START_S = 0.25


class Outcome(StrEnum):
    """Outcome of an encounter; not shown without truth."""

    IN_TIME = "in time"
    LATE = "late"
    MISSED = "missed"
    CUT_IN = "cut-in"
    OCCLUDED = "occluded"
    CENSORED = "censored"
    NOT_SHOWN = "not shown"


@dataclass(frozen=True)
class Encounter:
    """One object in the driving corridor.

    `clearance_m`, `stopping_distance_m` (S alone), `required_range_m` and `margin_m` (clearance − S) hold at
    `decision_s`: the entry for cut-in, occluded and censored, the stop request if there is one, else the smallest
    margin. `request_delay_s` counts from the entry; ranges are from the front of the vehicle.
    """

    log: str
    id: int
    label: str
    role: str
    outcome: Outcome
    entry_s: float
    decision_s: float
    clearance_m: float
    stopping_distance_m: float
    required_range_m: float
    margin_m: float
    entry_clearance_m: float
    entry_speed_mps: float
    entry_stopping_distance_m: float
    least_margin_m: float
    relative_speed_mps: float | None
    first_range_m: float | None
    confirmed_range_m: float | None
    stop_requested_s: float | None
    request_delay_s: float | None
    is_stop_requested: bool

    @property
    def as_dict(self) -> dict[str, Any]:
        """Object of `--json`; missing numbers are null."""
        values = asdict(self)
        values["class"] = values.pop("label")
        values["outcome"] = self.outcome.value
        return {k: _plain(v) for k, v in values.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 3) if math.isfinite(value) else None
    return value


@dataclass(frozen=True)
class Moment:
    """An object in the corridor at one scan."""

    stamp_ns: int
    clearance_m: float
    speed_mps: float
    stopping_distance_m: float
    required_range_m: float

    @property
    def margin_m(self) -> float:
        """Clearance beyond S."""
        return self.clearance_m - self.stopping_distance_m


def find_encounters(log: str, observed: LogObservation, conditions: Conditions) -> list[Encounter]:
    """All encounters of a log in order of entry."""
    least = conditions.corridor.min_returns
    found = []
    for observations in observed.observations.values():
        rows = sorted(observations, key=lambda s: s.stamp_ns)
        if any(is_in_corridor(s, least) for s in rows):
            found.append(_encounter(log, rows, observed, conditions))
    return sorted(found, key=lambda e: (e.entry_s, e.id))


def _encounter(log: str, rows: list[ObjectObservation], observed: LogObservation, conditions: Conditions) -> Encounter:
    inside = [s for s in rows if is_in_corridor(s, conditions.corridor.min_returns)]
    moments = [moment_of(s, observed, conditions) for s in inside]
    entry, least = moments[0], min(moments, key=lambda m: m.margin_m)
    request = first_request(rows[0].id, entry.stamp_ns, moments[-1].stamp_ns, observed)
    outcome = classify(rows, moments, request, observed, conditions)
    decision = entry
    if outcome in (Outcome.IN_TIME, Outcome.LATE):
        decision = least if request is None else moment_at(moments, request.stamp_ns)
    elif outcome is Outcome.MISSED:
        decision = least
    countable = in_forward_region(rows, conditions.recall.min_returns)
    stop_requested_s = None if request is None else observed.time_s(request.stamp_ns)
    entry_s = observed.time_s(entry.stamp_ns)
    return Encounter(
        log, rows[0].id, rows[0].label, rows[0].role, outcome, entry_s, observed.time_s(decision.stamp_ns),
        decision.clearance_m, decision.stopping_distance_m, decision.required_range_m, decision.margin_m,
        entry.clearance_m, entry.speed_mps,
        entry.stopping_distance_m, least.margin_m, relative_speed(moments),
        range_without_failure([(s.front_distance_m, s.is_detected) for s in countable]),
        range_without_failure(confirmed([(s.front_distance_m, s.is_detected) for s in countable])),
        stop_requested_s, None if stop_requested_s is None else stop_requested_s - entry_s,
        any(a.is_stop for a in requests_for(rows[0].id, observed)),
    )  # fmt: skip


def classify(
    rows: list[ObjectObservation],
    moments: list[Moment],
    request: StopRequest | None,
    observed: LogObservation,
    conditions: Conditions,
) -> Outcome:
    """Outcome by the decision tree above."""
    entry = moments[0]
    is_inside = entry.clearance_m < entry.stopping_distance_m
    after_s = math.inf if request is None else (request.stamp_ns - entry.stamp_ns) * 1e-9
    if is_inside and observed.time_s(entry.stamp_ns) <= START_S:
        return Outcome.CENSORED if after_s <= conditions.settling_s else Outcome.MISSED
    if request is None:
        is_needed = any(m.margin_m < 0.0 for m in moments)
        return Outcome.MISSED if is_needed or is_undetected(rows, moments, conditions) else Outcome.IN_TIME
    if is_inside:
        braking = conditions.braking
        allowed_s = max(braking.reaction_s - braking.dead_time_s, observed.period_s) + 0.02
        if after_s > allowed_s:
            return Outcome.LATE
        return Outcome.OCCLUDED if was_occluded(rows, entry.stamp_ns, conditions) else Outcome.CUT_IN
    if request.stamp_ns < entry.stamp_ns:
        return Outcome.IN_TIME
    then = moment_at(moments, request.stamp_ns)
    left_m = stopping_distance_m(then.speed_mps, conditions.braking.dead_time_s, conditions.braking)
    return Outcome.IN_TIME if then.clearance_m >= left_m else Outcome.LATE


def is_undetected(rows: list[ObjectObservation], moments: list[Moment], conditions: Conditions) -> bool:
    """Whether it was never detected although it came within the required recognition range."""
    near_m = min(m.clearance_m - max(m.required_range_m, conditions.recognition_m) for m in moments)
    return near_m < 0.0 and not any(s.is_detected for s in rows)


def was_occluded(rows: list[ObjectObservation], entry_ns: int, conditions: Conditions) -> bool:
    """Whether its box was in the corridor in the scans before entry, with beams ending in front of it."""
    previous = [s for s in rows if s.stamp_ns < entry_ns][-3:]
    least = conditions.corridor.min_returns
    return any(s.above_ground < least <= s.beams_before and math.isfinite(s.box_clearance_m) for s in previous)


def moment_of(observation: ObjectObservation, observed: LogObservation, conditions: Conditions) -> Moment:
    """Clearance and required distances at one observation."""
    speed = observed.motion.max_speed_at(observation.stamp_ns)
    stopping = stopping_distance_m(speed, conditions.braking.reaction_s, conditions.braking)
    return Moment(
        observation.stamp_ns,
        clearance_of(observation),
        speed,
        stopping,
        stopping + allowance_at(observation.stamp_ns, observed),
    )


def allowance_at(stamp_ns: int, observed: LogObservation) -> float:
    """Margin and uncertainties that the supervisor added to S at that time."""
    nearest = min(observed.requests, key=lambda a: abs(a.stamp_ns - stamp_ns), default=None)
    return 0.0 if nearest is None or not math.isfinite(nearest.allowance_m) else nearest.allowance_m


def moment_at(moments: list[Moment], stamp_ns: int) -> Moment:
    """Values at a time, linear between scans."""
    stamps = np.array([m.stamp_ns for m in moments], np.float64)
    rows = np.array([(m.clearance_m, m.speed_mps, m.stopping_distance_m, m.required_range_m) for m in moments])
    at = [float(np.interp(float(stamp_ns), stamps, rows[:, k])) for k in range(4)]
    return Moment(min(max(stamp_ns, moments[0].stamp_ns), moments[-1].stamp_ns), at[0], at[1], at[2], at[3])


def requests_for(object_id: int, observed: LogObservation) -> list[StopRequest]:
    """Stop requests caused by an object."""
    return [a for a in observed.requests if a.is_braking and object_id in a.touched]


def first_request(object_id: int, entry_ns: int, left_ns: int, observed: LogObservation) -> StopRequest | None:
    """First request from 1 s before entry until shortly after exit."""
    late_ns = left_ns + round((observed.period_s + 0.2) * 1e9)
    mine = [a for a in requests_for(object_id, observed) if entry_ns - EARLY_NS <= a.stamp_ns <= late_ns]
    return mine[0] if mine else None


def relative_speed(moments: list[Moment]) -> float | None:
    """Closing speed in the first second (m/s, positive: closing); None for a single scan."""
    some = [m for m in moments if m.stamp_ns - moments[0].stamp_ns <= 1_000_000_000]
    if len(some) < 2:
        return None
    t = np.array([(m.stamp_ns - some[0].stamp_ns) * 1e-9 for m in some])
    return -float(np.polynomial.polynomial.polyfit(t, np.array([m.clearance_m for m in some]), 1)[1])


def encounters_without_truth(log: str, observed: LogObservation, conditions: Conditions) -> list[Encounter]:
    """Encounters of a log without truth: confirmed tracks in the corridor, outcome not shown."""
    out = []
    for rows in observed.tracks.values():
        if not any(r.is_confirmed for r in rows):
            continue
        moments = []
        for r in rows:
            speed = observed.motion.max_speed_at(r.stamp_ns)
            s = stopping_distance_m(speed, conditions.braking.reaction_s, conditions.braking)
            moments.append(Moment(r.stamp_ns, r.clearance_m, speed, s, s + allowance_at(r.stamp_ns, observed)))
        entry, least = moments[0], min(moments, key=lambda m: m.margin_m)
        first = max(r.clearance_m for r in rows)
        confirmed_range_m = max(r.clearance_m for r in rows if r.is_confirmed)
        stops = [
            a for a in observed.requests
            if a.is_braking and abs(a.clearance_m - moment_at(moments, a.stamp_ns).clearance_m) < 2.0
            and moments[0].stamp_ns <= a.stamp_ns <= moments[-1].stamp_ns
        ]  # fmt: skip
        stop_requested_s = observed.time_s(stops[0].stamp_ns) if stops else None
        entry_s = observed.time_s(entry.stamp_ns)
        out.append(Encounter(
            log, rows[0].id, rows[-1].label, f"track {rows[0].id}", Outcome.NOT_SHOWN, entry_s,
            observed.time_s(least.stamp_ns), least.clearance_m, least.stopping_distance_m, least.required_range_m,
            least.margin_m, entry.clearance_m,
            entry.speed_mps, entry.stopping_distance_m, least.margin_m, relative_speed(moments), first,
            confirmed_range_m,
            stop_requested_s, None if stop_requested_s is None else stop_requested_s - entry_s,
            any(a.is_stop for a in stops),
        ))  # fmt: skip
    return sorted(out, key=lambda e: (e.entry_s, e.id))

"""Encounters: objects that entered the tube, and how each went.

             entered the tube inside S?
             ├─ at the log's start ────────────────► censored (or missed, when nothing is said for a second)
             ├─ hidden before, in the tube all along ► occluded
             ├─ from the side ──────────────────────► cut-in inside the stopping distance
asked? ──────┤ no: asked while it could still stop? ─► in time, else late
never ───────┴─ needed, or never seen within 10 m ──► missed; else in time (nothing had to be asked)
"""

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.observation import Asked, Observation, Sighting
from validation.obstacle_stop.ranges import confirmed, range_without_failure
from validation.obstacle_stop.stopping import stopping_distance_m
from validation.obstacle_stop.visibility import ahead, gap_of, is_in_tube

EARLY_NS = 1_000_000_000  # a tracked obstacle may be answered before it enters
START_S = 0.25


class Outcome(StrEnum):
    """How an encounter went; without truth it is not shown."""

    IN_TIME = "in time"
    LATE = "late"
    MISSED = "missed"
    CUT_IN = "cut-in"
    OCCLUDED = "occluded"
    CENSORED = "censored"
    NOT_SHOWN = "not shown"


@dataclass(frozen=True)
class Encounter:
    """One object in the tube.

    `clearance_m`, `stopping_distance_m` (S alone), `required_range_m` and `margin_m` (gap − S) are of one moment,
    `decided_s`: that of entering for cut-in, occluded, missed and censored, of the asking when a stop was asked, else
    of the least margin. Those of entering stand beside it. `asked_after_s` counts from entering; ranges are from the
    vehicle's front.
    """

    log: str
    id: int
    label: str
    role: str
    outcome: Outcome
    entered_s: float
    decided_s: float
    clearance_m: float
    stopping_distance_m: float
    required_range_m: float
    margin_m: float
    entry_gap_m: float
    entry_speed_mps: float
    entry_stopping_m: float
    least_margin_m: float
    relative_speed_mps: float | None
    first_range_m: float | None
    confirmed_range_m: float | None
    asked_s: float | None
    asked_after_s: float | None
    is_stop_asked: bool

    @property
    def as_dict(self) -> dict[str, Any]:
        """The keys of `--json`; numbers that do not exist are null."""
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
    """An object in the tube at one scan: gap, S, whole range needed."""

    stamp_ns: int
    clearance_m: float
    speed_mps: float
    stopping_distance_m: float
    required_range_m: float

    @property
    def margin_m(self) -> float:
        """What is left beyond S."""
        return self.clearance_m - self.stopping_distance_m


def find_encounters(log: str, seen: Observation, conditions: Conditions) -> list[Encounter]:
    """All encounters of a log in order of entering."""
    least = conditions.tube.least_returns
    found = []
    for sightings in seen.sightings.values():
        rows = sorted(sightings, key=lambda s: s.stamp_ns)
        if any(is_in_tube(s, least) for s in rows):
            found.append(_encounter(log, rows, seen, conditions))
    return sorted(found, key=lambda e: (e.entered_s, e.id))


def _encounter(log: str, rows: list[Sighting], seen: Observation, conditions: Conditions) -> Encounter:
    inside = [s for s in rows if is_in_tube(s, conditions.tube.least_returns)]
    moments = [moment_of(s, seen, conditions) for s in inside]
    entry, least = moments[0], min(moments, key=lambda m: m.margin_m)
    asked = first_asked(rows[0].id, entry.stamp_ns, moments[-1].stamp_ns, seen)
    outcome = judge(rows, moments, asked, seen, conditions)
    decided = entry
    if outcome in (Outcome.IN_TIME, Outcome.LATE):
        decided = least if asked is None else moment_at(moments, asked.stamp_ns)
    elif outcome is Outcome.MISSED:
        decided = least
    countable = ahead(rows, conditions.recall.least_returns)
    asked_s = None if asked is None else seen.time_s(asked.stamp_ns)
    entered_s = seen.time_s(entry.stamp_ns)
    return Encounter(
        log, rows[0].id, rows[0].label, rows[0].role, outcome, entered_s, seen.time_s(decided.stamp_ns),
        decided.clearance_m, decided.stopping_distance_m, decided.required_range_m, decided.margin_m,
        entry.clearance_m, entry.speed_mps,
        entry.stopping_distance_m, least.margin_m, relative_speed(moments),
        range_without_failure([(s.edge_m, s.is_seen) for s in countable]),
        range_without_failure(confirmed([(s.edge_m, s.is_seen) for s in countable])),
        asked_s, None if asked_s is None else asked_s - entered_s,
        any(a.is_stop for a in asks_for(rows[0].id, seen)),
    )  # fmt: skip


def judge(
    rows: list[Sighting], moments: list[Moment], asked: Asked | None, seen: Observation, conditions: Conditions
) -> Outcome:
    """How it went; see the sketch above."""
    entry = moments[0]
    is_inside = entry.clearance_m < entry.stopping_distance_m
    after_s = math.inf if asked is None else (asked.stamp_ns - entry.stamp_ns) * 1e-9
    if is_inside and seen.time_s(entry.stamp_ns) <= START_S:
        return Outcome.CENSORED if after_s <= conditions.grace_s else Outcome.MISSED
    if asked is None:
        is_needed = any(m.margin_m < 0.0 for m in moments)
        return Outcome.MISSED if is_needed or is_overlooked(rows, moments, conditions) else Outcome.IN_TIME
    if is_inside:
        braking = conditions.braking
        allowed_s = max(braking.reaction_s - braking.dead_time_s, seen.period_s) + 0.02
        if after_s > allowed_s:
            return Outcome.LATE
        return Outcome.OCCLUDED if was_hidden(rows, entry.stamp_ns, conditions) else Outcome.CUT_IN
    if asked.stamp_ns < entry.stamp_ns:
        return Outcome.IN_TIME
    then = moment_at(moments, asked.stamp_ns)
    left_m = stopping_distance_m(then.speed_mps, conditions.braking.dead_time_s, conditions.braking)
    return Outcome.IN_TIME if then.clearance_m >= left_m else Outcome.LATE


def is_overlooked(rows: list[Sighting], moments: list[Moment], conditions: Conditions) -> bool:
    """Whether perception never showed it though it came nearer than what must be recognized."""
    near_m = min(m.clearance_m - max(m.required_range_m, conditions.recognition_m) for m in moments)
    return near_m < 0.0 and not any(s.is_seen for s in rows)


def was_hidden(rows: list[Sighting], entered_ns: int, conditions: Conditions) -> bool:
    """Whether its box stood in the tube before, with nothing of it to be seen."""
    before = [s for s in rows if s.stamp_ns < entered_ns][-3:]
    least = conditions.tube.least_returns
    return any(s.solid < least <= s.before and math.isfinite(s.box_gap_m) for s in before)


def moment_of(sighting: Sighting, seen: Observation, conditions: Conditions) -> Moment:
    """Gap and needs at one sighting."""
    speed = seen.motion.fastest_at(sighting.stamp_ns)
    stopping = stopping_distance_m(speed, conditions.braking.reaction_s, conditions.braking)
    return Moment(
        sighting.stamp_ns, gap_of(sighting), speed, stopping, stopping + allowance_at(sighting.stamp_ns, seen)
    )


def allowance_at(stamp_ns: int, seen: Observation) -> float:
    """What the supervisor added to S at that time: margin and uncertainties."""
    nearest = min(seen.asked, key=lambda a: abs(a.stamp_ns - stamp_ns), default=None)
    return 0.0 if nearest is None or not math.isfinite(nearest.allowance_m) else nearest.allowance_m


def moment_at(moments: list[Moment], stamp_ns: int) -> Moment:
    """The encounter at any time, straight between its scans."""
    stamps = np.array([m.stamp_ns for m in moments], np.float64)
    rows = np.array([(m.clearance_m, m.speed_mps, m.stopping_distance_m, m.required_range_m) for m in moments])
    at = [float(np.interp(float(stamp_ns), stamps, rows[:, k])) for k in range(4)]
    return Moment(min(max(stamp_ns, moments[0].stamp_ns), moments[-1].stamp_ns), at[0], at[1], at[2], at[3])


def asks_for(object_id: int, seen: Observation) -> list[Asked]:
    """All that was asked because of an object."""
    return [a for a in seen.asked if a.is_braking and object_id in a.touched]


def first_asked(object_id: int, entered_ns: int, left_ns: int, seen: Observation) -> Asked | None:
    """The first asking from shortly before an object entered until it left."""
    late_ns = left_ns + round((seen.period_s + 0.2) * 1e9)
    mine = [a for a in asks_for(object_id, seen) if entered_ns - EARLY_NS <= a.stamp_ns <= late_ns]
    return mine[0] if mine else None


def relative_speed(moments: list[Moment]) -> float | None:
    """How fast the gap closed in the first second (positive: closing); None from one scan alone."""
    some = [m for m in moments if m.stamp_ns - moments[0].stamp_ns <= 1_000_000_000]
    if len(some) < 2:
        return None
    t = np.array([(m.stamp_ns - some[0].stamp_ns) * 1e-9 for m in some])
    return -float(np.polynomial.polynomial.polyfit(t, np.array([m.clearance_m for m in some]), 1)[1])


def perceived(log: str, seen: Observation, conditions: Conditions) -> list[Encounter]:
    """For a log without truth: what was perceived in the tube, with gaps and margins, and no outcome."""
    out = []
    for rows in seen.seen.values():
        if not any(r.is_confirmed for r in rows):
            continue
        moments = []
        for r in rows:
            speed = seen.motion.fastest_at(r.stamp_ns)
            s = stopping_distance_m(speed, conditions.braking.reaction_s, conditions.braking)
            moments.append(Moment(r.stamp_ns, r.clearance_m, speed, s, s + allowance_at(r.stamp_ns, seen)))
        entry, least = moments[0], min(moments, key=lambda m: m.margin_m)
        first = max(r.clearance_m for r in rows)
        sure = max(r.clearance_m for r in rows if r.is_confirmed)
        stops = [
            a for a in seen.asked
            if a.is_braking and abs(a.clearance_m - moment_at(moments, a.stamp_ns).clearance_m) < 2.0
            and moments[0].stamp_ns <= a.stamp_ns <= moments[-1].stamp_ns
        ]  # fmt: skip
        asked_s = seen.time_s(stops[0].stamp_ns) if stops else None
        entered_s = seen.time_s(entry.stamp_ns)
        out.append(Encounter(
            log, rows[0].id, rows[-1].label, f"track {rows[0].id}", Outcome.NOT_SHOWN, entered_s,
            seen.time_s(least.stamp_ns), least.clearance_m, least.stopping_distance_m, least.required_range_m,
            least.margin_m, entry.clearance_m,
            entry.speed_mps, entry.stopping_distance_m, least.margin_m, relative_speed(moments), first, sure, asked_s,
            None if asked_s is None else asked_s - entered_s, any(a.is_stop for a in stops),
        ))  # fmt: skip
    return sorted(out, key=lambda e: (e.entered_s, e.id))

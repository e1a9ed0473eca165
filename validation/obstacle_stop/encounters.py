"""Encounters: true objects in the swept path, judged by truth and physics (avoidability.py, ghost.py)."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from geometry.arrays import Bool, Float64
from validation.obstacle_stop.approaches import Approaches, Course
from validation.obstacle_stop.avoidability import STANDING_MPS, Approach, Limits, Outcome, due_index, outcome_of
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.ghost import STEP_S, GhostDrive, drive_ghost
from validation.obstacle_stop.observation import LogObservation, ObjectObservation
from validation.obstacle_stop.ranges import IN_A_ROW, confirmed, range_without_failure
from validation.obstacle_stop.recorded_motion import RecordedMotion, Section
from validation.obstacle_stop.requests import limits_for
from validation.obstacle_stop.stopping import stopping_distance_m
from validation.obstacle_stop.true_tracks import TrueTrack

EARLY_NS = 5_000_000_000  # requests so long before the object is in the path belong to it
AFTER_NS = 300_000_000
MIN_DRIVEN_M = 1.0  # a machine that drives less is no trial
AHEAD_RAD = math.radians(45.0)  # BD-5.4.1b: the region on the working path is 90 degrees wide
GAP_EVERY = 10  # steps of the ghost between two gaps


@dataclass(frozen=True)
class Encounter:
    """One object in the swept path of the recorded drive.

    `entry_*`: first moment in the path. `due_s`: the gap falls below S (None: never). `decision_s`: the first request,
    else `due_s`, else the smallest margin; `clearance_m` is the gap to the true box then and `stopping_distance_m` S.
    `margin_m` belongs to the ghost with the worst-case brake: its smallest gap up to `standstill_s`, negative: how far
    it drives on after it reaches the object; None without a request, without standstill, or out of the path.
    `has_contact` and `impact_speed_mps`: the outline itself touches, of the ghost, without a request of the recording.
    `gaps`: time, gap and S at each label in the path.
    """

    log: str
    id: int
    label: str
    role: str
    outcome: Outcome
    direction: int
    entry_s: float
    exit_s: float
    due_s: float | None
    decision_s: float
    clearance_m: float
    stopping_distance_m: float
    margin_m: float | None
    standstill_s: float | None
    has_contact: bool
    impact_speed_mps: float | None
    entry_clearance_m: float
    entry_speed_mps: float
    entry_stopping_distance_m: float
    least_margin_m: float
    relative_speed_mps: float | None
    visible_s: float | None
    visible_range_m: float | None
    first_range_m: float | None
    confirmed_range_m: float | None
    stop_requested_s: float | None
    request_delay_s: float | None
    is_stop_requested: bool
    gaps: tuple[tuple[float, float, float], ...]

    @property
    def as_dict(self) -> dict[str, Any]:
        """Object of `--json`; missing numbers are null."""
        values = asdict(self)
        values["class"] = values.pop("label")
        values["outcome"] = self.outcome.value
        values["gaps"] = [[plain(v) for v in row] for row in self.gaps]
        return {k: plain(v) for k, v in values.items()}


def plain(value: Any) -> Any:
    """Value of `--json`: rounded, null for infinite and unknown."""
    if isinstance(value, float):
        return round(value, 3) if math.isfinite(value) else None
    return value


@dataclass(frozen=True)
class Result:
    """Result of a ghost for one object; `margin_m` as in `Encounter`; `is_avoided`: it stops in time."""

    has_contact: bool
    impact_speed_mps: float | None
    margin_m: float | None
    standstill_ns: int | None
    is_avoided: bool


def find_encounters(
    log: str, observed: LogObservation, conditions: Conditions, approaches: Approaches | None = None
) -> list[Encounter]:
    """All encounters of a log with truth in order of entry; `approaches` are those of the log, if already known."""
    if observed.recorded is None:
        return []
    approaches = approaches or Approaches(observed, observed.recorded, conditions)
    judge = _Judge(log, observed, observed.recorded, conditions, approaches)
    found = [judge(course, *interval) for course in approaches.courses.values() for interval in course.intervals()]
    return sorted(found, key=lambda e: (e.entry_s, e.id))


@dataclass(frozen=True, eq=False)
class _Judge:
    log: str
    observed: LogObservation
    recorded: RecordedMotion
    conditions: Conditions
    approaches: Approaches

    def __call__(self, course: Course, first: int, last: int) -> Encounter:
        """The encounter of one interval of a course."""
        observed, track, section = self.observed, course.track, course.sections[first]
        a, rows = self.approaches.approach(course, first, last)
        due = due_index(a.gap_m, a.stopping_distance_m, a.speed_mps)
        due_ns = None if due is None else course.stamps_ns[rows[due]]
        from_ns, until_ns = self._interval_ns(course, first, last)
        requests = limits_for(
            track.id,
            lambda t: self.approaches.ids_before(track.id, t) if due is not None else set(),
            observed.requests,
            from_ns,
            until_ns,
        )
        request_ns = next((t for t, limit in requests if limit < math.inf), None)
        drive = self._ghost(course, requests, due_ns, request_ns, from_ns, until_ns)
        result = judge_ghost(drive, from_ns, request_ns, track, section, self.conditions)
        is_avoided = result.is_avoided and not self._is_released(drive, course, from_ns)
        outcome = self._outcome(a, due, _effective_ns(drive, from_ns, request_ns), is_avoided, track.id)
        if outcome is Outcome.IN_TIME and due is None and a.is_open and drive.is_requested[-1] and not drive.stands:
            outcome = Outcome.CENSORED  # a limit of the speed was requested; what follows is not in the recording
        return self._encounter(a, outcome, result, course, last, due_ns, request_ns, section.direction)

    def _interval_ns(self, course: Course, first: int, last: int) -> tuple[int, int]:
        """From when requests count, and until when: not beyond the section of the drive."""
        section, sections, end_ns = course.sections[first], self.recorded.sections, int(self.recorded.stamps_ns[-1])
        follows = [s.start_ns for s in sections if s.start_ns > section.start_ns]
        from_ns = max(section.start_ns, course.stamps_ns[first] - EARLY_NS)
        return from_ns, min(course.stamps_ns[last] + AFTER_NS, follows[0] if follows else end_ns, end_ns)

    def _ghost(
        self, course: Course, requests: list[tuple[int, float]], due_ns: int | None, request_ns: int | None,
        from_ns: int, until_ns: int,
    ) -> GhostDrive:  # fmt: skip
        """The ghost of the interval; braking of a driver after the request was due does not help it."""
        count = max(2, math.ceil((until_ns - from_ns) * 1e-9 / STEP_S) + 1)
        stamps = from_ns + (np.arange(count) * STEP_S * 1e9).astype(np.int64)
        s, v = self.recorded.at(stamps)
        if due_ns is not None and request_ns is not None and request_ns > due_ns:
            s_due, v_due = self.recorded.at(due_ns)
            is_after = (stamps > due_ns) & (stamps <= request_ns)
            steady = s_due + v_due * (stamps - due_ns) * 1e-9
            s, v = np.where(is_after, np.maximum(s, steady), s), np.where(is_after, np.maximum(v, v_due), v)
        times = np.array([t for t, _ in requests], np.int64)
        values = np.array([math.inf, *(limit for _, limit in requests)])
        limits = values[np.searchsorted(times, stamps, side="right")]
        t_s = STEP_S * np.arange(count, dtype=np.float64)
        return drive_ghost(t_s, s, v, limits, course.gaps_between(stamps), self.conditions.braking)

    def _is_released(self, drive: GhostDrive, course: Course, from_ns: int) -> bool:
        """Whether the request was taken back although it was still due then or later."""
        if drive.is_requested[-1]:
            return False
        own = np.flatnonzero(drive.is_requested)
        since_ns = from_ns + round(float(drive.t_s[own[-1]]) * 1e9) if len(own) else from_ns
        end_ns = from_ns + round((float(drive.t_s[-1]) + STEP_S) * 1e9)
        later = [i for i, t in enumerate(course.stamps_ns) if since_ns <= t <= end_ns]
        braking = self.conditions.braking
        speeds = [float(self.recorded.at(course.stamps_ns[i])[1]) for i in later]
        return any(
            v > STANDING_MPS and course.gaps_m[i] < stopping_distance_m(v, braking.reaction_s, braking)
            for i, v in zip(later, speeds, strict=True)
        )

    def _outcome(
        self, a: Approach, due: int | None, request_ns: int | None, is_avoided: bool, object_id: int
    ) -> Outcome:
        if self.observed.driven_m < MIN_DRIVEN_M:
            return Outcome.NOT_SHOWN
        braking = self.conditions.braking
        prompt_s = max(braking.reaction_s - braking.dead_time_s, self.observed.period_s) + 0.02
        request_s = None if request_ns is None else self.observed.time_s(request_ns)
        limits = Limits(prompt_s, self.conditions.settling_s)
        outcome = outcome_of(a, due, request_s, is_avoided, limits, self.observed.setting.is_manual)
        # a request before any was due may be that of another object
        is_unjudged = due is None and outcome in (Outcome.NO_DEMAND, Outcome.DRIVER, Outcome.IN_TIME)
        return Outcome.MISSED if is_unjudged and self._is_unrecognized(a, object_id) else outcome

    def _is_unrecognized(self, a: Approach, object_id: int) -> bool:
        """BD-5.4.1b: visible ahead in the path within the recognition range in three moments, and never detected."""
        rows = list(self.observed.observations.get(object_id, ()))
        ahead = [r for r in rows if abs(r.bearing_rad) <= AHEAD_RAD]
        times = np.array([self.observed.time_s(r.stamp_ns) for r in ahead])
        is_near = (a.gap_m <= self.conditions.recognition_m) & a.is_visible
        is_seen = [bool(len(times)) and float(np.abs(times - t).min()) < 0.1 for t in a.t_s[is_near].tolist()]
        return sum(is_seen) >= IN_A_ROW and not any(r.is_detected for r in rows)

    def _encounter(
        self, a: Approach, outcome: Outcome, result: Result, course: Course, last: int,
        due_ns: int | None, request_ns: int | None, direction: int,
    ) -> Encounter:  # fmt: skip
        observed, track = self.observed, course.track
        inside = np.flatnonzero(np.isfinite(a.gap_m))
        margins = a.gap_m - a.stopping_distance_m
        entry, least = int(inside[0]), int(inside[np.argmin(margins[inside])])
        requested_s = None if request_ns is None else observed.time_s(request_ns)
        due_s = None if due_ns is None else observed.time_s(due_ns)
        decision_s = requested_s if requested_s is not None else due_s if due_s is not None else float(a.t_s[least])
        at = int(inside[np.argmin(np.abs(a.t_s[inside] - decision_s))])
        seen = np.flatnonzero(a.is_visible & np.isfinite(a.gap_m))
        rows = in_forward_region(observed.observations.get(track.id, ()), self.conditions.recall.min_returns)
        entry_s = float(a.t_s[entry])
        touching = [r for r in observed.requests if track.id in r.touched]
        return Encounter(
            self.log, track.id, track.label, track.role, outcome, direction, entry_s,
            observed.time_s(course.stamps_ns[last]), due_s, decision_s, _at(a.t_s, a.gap_m, inside, decision_s),
            float(a.stopping_distance_m[at]), result.margin_m if request_ns is not None else None,
            None if result.standstill_ns is None else observed.time_s(result.standstill_ns), result.has_contact,
            result.impact_speed_mps, float(a.gap_m[entry]), float(a.speed_mps[entry]),
            float(a.stopping_distance_m[entry]), float(margins[least]), closing_speed(a.t_s[inside], a.gap_m[inside]),
            float(a.t_s[seen[0]]) if len(seen) else None, float(a.gap_m[seen[0]]) if len(seen) else None,
            range_without_failure([(s.front_distance_m, s.is_detected) for s in rows]),
            range_without_failure(confirmed([(s.front_distance_m, s.is_detected) for s in rows])),
            requested_s, None if requested_s is None else requested_s - entry_s, any(r.is_stop for r in touching),
            tuple((float(a.t_s[k]), float(a.gap_m[k]), float(a.stopping_distance_m[k])) for k in inside),
        )  # fmt: skip


def _at(t_s: Float64, gap_m: Float64, inside: np.ndarray, at_s: float) -> float:
    """Gap at a time, linear between moments in the path."""
    return float(np.interp(at_s, t_s[inside], gap_m[inside]))


def _effective_ns(drive: GhostDrive, from_ns: int, request_ns: int | None) -> int | None:
    """Delivery of the request that the ghost obeys in the end: an earlier one that was released counts for nothing."""
    starts = np.flatnonzero(np.diff(drive.is_own.astype(np.int8)) > 0) + 1
    return request_ns if not len(starts) else from_ns + round(float(drive.t_s[starts[-1]]) * 1e9)


def judge_ghost(
    drive: GhostDrive, from_ns: int, request_ns: int | None, track: TrueTrack, section: Section, conditions: Conditions
) -> Result:
    """Contact, impact speed and margin of a ghost that starts at `from_ns`."""
    stamps = from_ns + np.round(drive.t_s * 1e9).astype(np.int64)
    poses, path = track.poses_at(stamps), section.path
    is_counted = (drive.speed_mps > STANDING_MPS) & (stamps >= track.stamps_ns[0])
    touch = _first_touch(path.separations_m(drive.s_m, poses, track.half_m), drive, is_counted)
    standstill_ns = int(stamps[-1]) if drive.stands else None
    if touch is not None:
        contact = _first_touch(section.body_path.separations_m(drive.s_m, poses, track.half_m), drive, is_counted)
        margin = touch[0] - float(drive.s_m[-1]) if drive.stands else None
        return Result(contact is not None, None if contact is None else contact[1], margin, standstill_ns, False)
    chosen = [*range(0, len(stamps), GAP_EVERY), len(stamps) - 1]
    if request_ns is not None:
        chosen = [k for k in chosen if stamps[k] >= request_ns] or [len(stamps) - 1]
    gaps = [path.gap_m(float(drive.s_m[k]), poses[k], track.half_m, conditions.corridor.length_m) for k in chosen]
    braking, least = conditions.braking, min(gaps)
    left = stopping_distance_m(float(drive.speed_mps[-1]), braking.dead_time_s, braking)
    is_avoided = least >= conditions.margin_m and (drive.stands or gaps[-1] >= left)
    margin = least if drive.stands and math.isfinite(least) else None
    return Result(False, None, margin, standstill_ns, is_avoided)


def _first_touch(apart_m: Float64, drive: GhostDrive, is_counted: Bool) -> tuple[float, float] | None:
    """Distance and speed of a ghost at the first contact; None without one."""
    hits = np.flatnonzero((apart_m < 0.0) & is_counted)
    if not len(hits):
        return None
    k = int(hits[0])
    if k == 0 or apart_m[k - 1] <= 0.0:
        return float(drive.s_m[k]), float(drive.speed_mps[k])
    share = float(apart_m[k - 1] / (apart_m[k - 1] - apart_m[k]))
    return float(drive.s_m[k - 1] + share * (drive.s_m[k] - drive.s_m[k - 1])), float(drive.speed_mps[k])


def in_forward_region(rows: Iterable[ObjectObservation], min_returns: int) -> list[ObjectObservation]:
    """Observations with enough returns in the 90° region ahead, from which detection ranges are computed."""
    return [s for s in rows if abs(s.bearing_rad) <= AHEAD_RAD and s.returns >= min_returns]


def closing_speed(t_s: Float64, gap_m: Float64) -> float | None:
    """Closing speed in the first second (m/s, positive: closing); None for a single moment."""
    some = t_s <= t_s[0] + 1.0
    if np.count_nonzero(some) < 2:
        return None
    return -float(np.polynomial.polynomial.polyfit(t_s[some] - t_s[0], gap_m[some], 1)[1])

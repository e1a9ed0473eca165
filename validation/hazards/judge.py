"""Judgement of one drive: a row for each object, and the totals of the drive."""

import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from configs.odd import OddConfig, Promise
from messages.command import Mode
from messages.plan import MissionState
from validation.drive.detections import DetectionSample
from validation.drive.stops import STOPS
from validation.hazards.avoidability import Avoidability, avoidability_of
from validation.hazards.conditions import conditions_of
from validation.hazards.contacts import approach_of
from validation.hazards.log import HazardLog, ground_m
from validation.hazards.stops import STANDING_REACH_M, is_justified
from validation.hazards.tracks import Drive, ObjectTrack

STARTED_M = 0.5  # driven less: it never set off


@dataclass(frozen=True)
class ObjectRow:
    """What happened with one object; times in s since the start, NaN where something did not happen."""

    name: str
    kind: str
    is_static: bool
    must_avoid: bool
    is_promised: bool
    first_sensor: str
    first_detection_s: float
    first_range_m: float
    margin_m: float
    margin_s: float
    nearest_part: str
    is_near_miss: bool
    is_contact: bool
    is_walked_into: bool
    contact_s: float
    part: str
    x_m: float
    y_m: float
    z_m: float
    impact_mps: float
    machine_mps: float
    is_unavoidable: bool
    reason: str
    closed_form_mps: float
    mode: str
    section: str


@dataclass(frozen=True)
class StopRow:
    """One transition into a stop mode; `is_false`: nothing solid was near the path."""

    t_s: float
    cause: str
    is_false: bool


@dataclass(frozen=True)
class Judgement:
    """Judgement of one drive; `outside_odd` names quantities beyond the domain."""

    objects: tuple[ObjectRow, ...]
    stops: tuple[StopRow, ...]
    outcome: str
    driven_m: float
    simulated_s: float
    outside_odd: tuple[str, ...]

    @property
    def contacts(self) -> tuple[ObjectRow, ...]:
        """Contacts with a machine of which something moved."""
        return tuple(row for row in self.objects if row.is_contact)

    @property
    def false_stops(self) -> tuple[StopRow, ...]:
        """Stops without cause, inside of the operational design domain."""
        return () if self.outside_odd else tuple(stop for stop in self.stops if stop.is_false)

    @property
    def totals(self) -> dict[str, Any]:
        """Counts of the drive."""
        hits = self.contacts
        return {
            "outcome": self.outcome,
            "contacts": len(hits),
            "avoidable_contacts": sum(not row.is_unavoidable for row in hits),
            "unpromised_contacts": sum(not row.is_promised for row in hits),
            "walked_into": sum(row.is_walked_into for row in self.objects),
            "near_misses": sum(row.is_near_miss for row in self.objects),
            "stops": len(self.stops),
            "false_stops": len(self.false_stops),
            "driven_m": round(self.driven_m, 2),
            "simulated_s": round(self.simulated_s, 2),
        }


def judge(log: HazardLog, odd: OddConfig) -> Judgement:
    """Judgement of a drive."""
    drive, promise = log.drive, odd.promise(conditions_of(log.scenario))
    rows = tuple(_row(log, one, promise) for one in drive.objects)
    kept = tuple(row for row in rows if not row.is_static or row.is_contact)
    driven = float(drive.machine.path_m[-1])
    stops = (*_stops(log), *_refusals(log, driven))
    return Judgement(kept, stops, _outcome(log, driven), driven, log.record.seconds, promise.outside)


def _row(log: HazardLog, one: ObjectTrack, promise: Promise) -> ObjectRow:
    drive, found = log.drive, approach_of(log.drive, one)
    touched = found.contact or found.walked_into
    is_contact = found.contact is not None and one.must_avoid
    avoidability = Avoidability(False, "")
    if is_contact and found.contact is not None:
        avoidability = avoidability_of(drive, one, found.contact)
    mode, section = _situation(log, touched.t_s if touched else found.margin_s)
    sample = first_detection(log.samples, one.name)
    point = touched.point_map_m if touched else (math.nan,) * 3
    return ObjectRow(
        one.name, one.kind, one.is_static, one.must_avoid,
        one.is_static or promise.covers(*one.top_and_width_m(ground_m(drive, one))),
        sample.sensor if sample else "", log.record.time_s(sample.stamp_ns) if sample else math.nan,
        sample.range_m if sample else math.nan,
        found.margin_m, found.margin_s, found.part,
        found.is_near_miss and one.must_avoid and not one.is_static, is_contact,
        found.walked_into is not None and not is_contact and one.must_avoid,
        touched.t_s if touched else math.nan, touched.part if touched else "", *point,
        touched.relative_mps if touched else math.nan, touched.machine_mps if touched else math.nan,
        avoidability.is_unavoidable, avoidability.reason, avoidability.closed_form_mps, mode, section,
    )  # fmt: skip


def first_detection(samples: list[DetectionSample], name: str) -> DetectionSample | None:
    """Earliest detection of an object by any sensor."""
    mine = (s for s in samples if s.role == name and s.is_detected)
    return min(mine, key=lambda s: s.stamp_ns, default=None)


def _situation(log: HazardLog, t_s: float) -> tuple[str, str]:
    """Mode of the supervisor and section of the path at a time."""
    stamp = log.record.first_ns + round(t_s * 1e9)
    states = [m for m in log.record.supervisor if m.stamp_ns <= stamp]
    mission = [m for m in log.record.mission if m.stamp_ns <= stamp]
    return str(states[-1].mode) if states else "", str(mission[-1].section_type) if mission else ""


def _stops(log: HazardLog) -> tuple[StopRow, ...]:
    states, found = log.record.supervisor, []
    for before, now in pairwise(states):
        if now.mode in STOPS and before.mode not in STOPS:
            t = log.record.time_s(now.stamp_ns)
            found.append(StopRow(t, now.reason, not is_justified(log.drive, t)))
    return tuple(found)


def _refusals(log: HazardLog, driven_m: float) -> tuple[StopRow, ...]:
    """A machine that never sets off without cause, and without another stop, is one false stop."""
    states = log.record.supervisor
    if driven_m >= STARTED_M or not states or any(s.mode in STOPS for s in states):
        return ()
    t = float(log.drive.machine.t_s[-1])
    is_near = any(_is_near(log.drive, one, t) for one in log.drive.objects if one.must_avoid and not one.is_static)
    return (StopRow(t, f"never started: {states[-1].reason}", not is_near),)


def _is_near(drive: Drive, one: ObjectTrack, t_s: float) -> bool:
    return one.is_present(t_s) and drive.gap(drive.machine.at(t_s), one.shape_at(t_s)).distance_m < STANDING_REACH_M


def _outcome(log: HazardLog, driven_m: float) -> str:
    mission, states = log.record.mission, log.record.supervisor
    if driven_m < STARTED_M:
        return "never started"
    if mission and mission[-1].state in (MissionState.FINISHED, MissionState.ABORTED):
        return mission[-1].state.name.lower()
    return str(states[-1].mode) if states and states[-1].mode is not Mode.AUTOMATIC else "driving"


def row_dict(row: ObjectRow) -> dict[str, Any]:
    """A row as plain values, numbers rounded to 0.1 mm, ms and mm/s or finer; NaN becomes None."""
    return {k: _plain(v) if isinstance(v, float) else v for k, v in asdict(row).items()}


def _plain(value: float) -> float | None:
    return None if math.isnan(value) or math.isinf(value) else round(float(value), 4)

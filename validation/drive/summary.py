"""All measures of one drive, for `run --json` and the report."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from configs.site import Bay
from geometry.arrays import Bool, Float64
from messages.plan import MissionState, PathSectionType
from validation.drive.coverage import Coverage, measure_coverage, worked_area
from validation.drive.docking import Docking, measure_docking
from validation.drive.positioning import PositionError, measure_position
from validation.drive.record import DriveRecord, true_poses
from validation.drive.stops import Stop, false_stops, find_stops
from validation.drive.tracking import CrossTrack, measure_cross_track, statistics
from validation.verdict import Verdict, verdict_of

CONSENTED = "vegetation.consented"  # code of the supervisor


@dataclass(frozen=True)
class Planned:
    """Planned values; `expected_stops` by role of the scenario, `bay` for the end of the mission (None: the yard)."""

    area: BaseGeometry
    field_area_m2: float
    working_width_m: float
    expected_stops: dict[str, int]
    bay: Bay | None = None


@dataclass(frozen=True)
class Summary:
    """Measures of one drive; `line_shift_m` is the largest sideways shift of the line by the operator."""

    outcome: str
    distance_m: float
    planned_share: float
    coverage: Coverage
    cross_track: CrossTrack
    position: PositionError
    stops: tuple[Stop, ...]
    unexpected: tuple[Stop, ...]
    contacts: int
    zone_exits: int
    simulated_s: float
    in_plants_m: float
    line_shift_m: float
    docking: Docking | None = None

    @property
    def as_dict(self) -> dict[str, Any]:
        """The part of `run --json` that follows from the log."""
        return {
            "outcome": self.outcome,
            "simulated_s": round(self.simulated_s, 2),
            "distance_m": round(self.distance_m, 2),
            "in_plants_m": round(self.in_plants_m, 2),
            "line_shift_m": round(self.line_shift_m, 3),
            "worked_m2": round(self.coverage.worked_m2, 1),
            "planned_share": round(self.planned_share, 4),
            "coverage": round(self.coverage.share, 5),
            "uncovered": [asdict(piece) for piece in self.coverage.uncovered],
            "xte_m": statistics(self.cross_track.on(PathSectionType.SWATH)),
            "stops": [stop.as_dict for stop in self.stops],
            "false_stops": len(self.unexpected),
            "contacts": self.contacts,
            "zone_exits": self.zone_exits,
            "dock_error_m": None if self.docking is None else round(self.docking.error_m, 4),
            "dock_error_deg": None if self.docking is None else round(abs(math.degrees(self.docking.error_rad)), 3),
        }

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts on the clauses that a drive can show."""
        swath = statistics(self.cross_track.on(PathSectionType.SWATH))
        n = len(self.cross_track.on(PathSectionType.SWATH))
        obstacle = [s.margin_m for s in self.stops if s.role]
        contact = float(self.contacts) if self.stops else None
        missing, is_planned = 1.0 - self.coverage.share, int(self.coverage.planned_m2 > 0.0)
        dock, docks = self.docking, int(self.docking is not None)
        off, turned = (None, None) if dock is None else (dock.error_m, abs(math.degrees(dock.error_rad)))
        return (
            verdict_of(
                "BD-5.2.3", swath["sigma"] if swath else None, 0.025, "m", n, "sigma of the true error on the swaths"
            ),
            verdict_of("BD-5.2.4", contact, 0.0, "contacts", len(obstacle), "contacts over all encounters"),
            verdict_of(
                "demo-zone-exits", float(self.zone_exits), 0.0, "zone exits", 1, "machine or implement outside the site"
            ),
            verdict_of(
                "demo-false-stops", float(len(self.unexpected)), 0.0, "stops", 1, "not announced by the scenario"
            ),
            verdict_of(
                "demo-coverage",
                missing,
                0.01,
                "share",
                is_planned,
                "planned area neither worked nor listed as uncovered",
            ),
            verdict_of("dock-error", off, 0.10, "m", docks, "true distance from the dock pose at the end"),
            verdict_of("dock-heading", turned, 2.0, "°", docks, "true heading against the dock pose at the end"),
        )


def summarize(record: DriveRecord, planned: Planned) -> Summary:
    """Measures of a drive from its record."""
    truth, mission = record.truth, record.mission
    stops = tuple(find_stops(record))
    worked = worked_area(truth, planned.working_width_m)
    uncovered_areas = mission[-1].uncovered_areas if mission else ()
    driven_m = steps_m(true_poses(truth))
    return Summary(
        outcome=_outcome(mission[-1].state if mission else MissionState.WAITING, planned.bay is not None),
        distance_m=float(driven_m.sum()),
        planned_share=planned.area.area / planned.field_area_m2 if planned.field_area_m2 else 0.0,
        coverage=measure_coverage(planned.area, worked, uncovered_areas),
        cross_track=measure_cross_track(record),
        position=measure_position(record),
        stops=stops,
        unexpected=tuple(false_stops(list(stops), planned.expected_stops)),
        contacts=truth[-1].contacts if truth else 0,
        zone_exits=truth[-1].zone_exits if truth else 0,
        simulated_s=record.seconds,
        in_plants_m=float(driven_m[is_in_plants(record)].sum()),
        line_shift_m=max((math.hypot(m.shift_x_m, m.shift_y_m) for m in mission), default=0.0),
        docking=measure_docking(record, planned.bay),
    )


def steps_m(poses: Float64) -> Float64:
    """Distance (N,) from each pose (N, 3) to the one before; 0 for the first."""
    return np.asarray(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T))


def is_in_plants(record: DriveRecord) -> Bool:
    """Whether the supervisor reported plants that hide who lies there, with consent, at each true pose (N,)."""
    stamps = np.array([state.stamp_ns for state in record.supervisor], np.int64)
    found = [any(rule.code == CONSENTED and rule.text for rule in state.rules) for state in record.supervisor]
    last = np.searchsorted(stamps, [true.stamp_ns for true in record.truth], side="right") - 1
    return np.where(last >= 0, np.array([*found, False])[last], False)


def _outcome(state: MissionState, has_bay: bool) -> str:
    if state is MissionState.FINISHED:
        return "docked" if has_bay else "finished"
    return "aborted" if state is MissionState.ABORTED else "stopped"

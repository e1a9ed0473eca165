"""All measures of one drive, as `run --json` gives them and the report shows them."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from messages.plan import Leg, MissionState
from validation.coverage import Coverage, measure_coverage, worked_area
from validation.positioning import PositionError, measure_position
from validation.record import DriveRecord, true_poses
from validation.stops import Stop, false_stops, find_stops
from validation.tracking import CrossTrack, measure_cross_track, statistics
from validation.verdict import Verdict, judge


@dataclass(frozen=True)
class Planned:
    """What the plan promised, from the log's metadata; widths in metres, `expected_stops` by the scenario's roles."""

    area: BaseGeometry
    field_area_m2: float
    working_width_m: float
    expected_stops: dict[str, int]


@dataclass(frozen=True)
class Summary:
    """One drive judged."""

    outcome: str
    distance_m: float
    planned_share: float
    coverage: Coverage
    cross_track: CrossTrack
    position: PositionError
    stops: tuple[Stop, ...]
    unexpected: tuple[Stop, ...]
    contacts: int
    exits: int
    simulated_s: float

    @property
    def as_dict(self) -> dict[str, Any]:
        """The keys of `run --json` that a log can answer."""
        return {
            "outcome": self.outcome,
            "simulated_s": round(self.simulated_s, 2),
            "distance_m": round(self.distance_m, 2),
            "worked_m2": round(self.coverage.worked_m2, 1),
            "planned_share": round(self.planned_share, 4),
            "coverage": round(self.coverage.share, 5),
            "uncovered": [asdict(piece) for piece in self.coverage.uncovered],
            "xte_m": statistics(self.cross_track.on(Leg.SWATH)),
            "stops": [stop.as_dict for stop in self.stops],
            "false_stops": len(self.unexpected),
            "contacts": self.contacts,
            "exits": self.exits,
            "dock_error_m": None,
            "dock_error_deg": None,
        }

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The clauses that one drive can show something about."""
        swath = statistics(self.cross_track.on(Leg.SWATH))
        n = len(self.cross_track.on(Leg.SWATH))
        obstacle = [s.margin_m for s in self.stops if s.role]
        contact = float(self.contacts) if self.stops else None
        missing = 1.0 - self.coverage.share
        return (
            judge(
                "BD-5.2.3", swath["sigma"] if swath else None, 0.025, "m", n, "sigma of the true error on the swaths"
            ),
            judge("BD-5.2.4", contact, 0.0, "contacts", len(obstacle), "contacts over all encounters"),
            judge("demo-exits", float(self.exits), 0.0, "exits", 1, "machine or implement outside the site"),
            judge("demo-false-stops", float(len(self.unexpected)), 0.0, "stops", 1, "not announced by the scenario"),
            judge("demo-coverage", missing, 0.01, "share", 1, "planned area neither worked nor listed as left out"),
        )


def summarize(record: DriveRecord, planned: Planned) -> Summary:
    """Judge a drive from its record."""
    truth, mission = record.truth, record.mission
    stops = tuple(find_stops(record))
    worked = worked_area(truth, planned.working_width_m)
    left_out = mission[-1].left_out if mission else ()
    poses = true_poses(truth)
    return Summary(
        outcome=_outcome(mission[-1].state if mission else MissionState.WAITING),
        distance_m=float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) if len(poses) > 1 else 0.0,
        planned_share=planned.area.area / planned.field_area_m2 if planned.field_area_m2 else 0.0,
        coverage=measure_coverage(planned.area, worked, left_out),
        cross_track=measure_cross_track(record),
        position=measure_position(record),
        stops=stops,
        unexpected=tuple(false_stops(list(stops), planned.expected_stops)),
        contacts=truth[-1].contacts if truth else 0,
        exits=truth[-1].exits if truth else 0,
        simulated_s=record.seconds,
    )


def _outcome(state: MissionState) -> str:
    if state is MissionState.FINISHED:
        return "finished"
    return "aborted" if state is MissionState.ABORTED else "stopped"

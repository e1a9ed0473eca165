"""Measures of a drive on records with known results."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from shapely import box

from geometry.transforms import planar
from messages.command import ControlCommand, Mode, RuleResult, SupervisorState
from messages.errors import LogError
from messages.faults import Response
from messages.message import Envelope, Message
from messages.motion import MapPose, PositionSource
from messages.perception import ObstacleClass
from messages.plan import MissionState, MissionStatus, Path, PathSection, PathSectionType, UncoveredArea
from messages.truth import TrueMachine, TrueObject, TrueObjects
from validation.drive.coverage import measure_coverage, worked_area
from validation.drive.positioning import measure_position
from validation.drive.record import DriveRecord, collect
from validation.drive.stops import false_stops, find_stops
from validation.drive.summary import Planned, summarize
from validation.drive.tracking import measure_cross_track, statistics
from validation.verdict import State, verdict_of

STEP_NS = 50_000_000
SPEED_MPS = 2.0


def straight_path(heading_rad: float, length_m: float = 60.0) -> Path:
    s = np.arange(0.0, length_m, 0.1)
    n = len(s)
    return Path(
        1, 0, 1, np.outer(s, [math.cos(heading_rad), math.sin(heading_rad)]), np.full(n, heading_rad), np.zeros(n), s,
        np.full(n, SPEED_MPS), np.ones(n, np.uint8), (PathSection(PathSectionType.SWATH, 0, 0, n - 1),), np.zeros(n,
        np.int32), True,
    )  # fmt: skip


def machine(t_ns: int, x_m: float, y_m: float, yaw_rad: float, contacts: int = 0, speed: float = 2.0) -> TrueMachine:
    return TrueMachine(
        t_ns,
        planar(x_m, y_m, yaw_rad),
        speed,
        0.0,
        0.0,
        0.0,
        np.array([x_m, y_m, 0.0]),
        yaw_rad,
        0.0,
        True,
        contacts,
        0,
    )


def drive(heading_rad: float, offset_m: float, seconds: float = 20.0) -> DriveRecord:
    """Drive along a straight line with a constant offset to the left."""
    across = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    along = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    rows: list[tuple[str, Message]] = [("path", straight_path(heading_rad))]
    for k in range(1, int(seconds * 1e9 / STEP_NS)):
        t_ns, s_m = k * STEP_NS, SPEED_MPS * k * STEP_NS * 1e-9
        x, y = along * s_m + across * offset_m
        rows.append(("control_command", ControlCommand(t_ns, 2.0, 0.0, 0.0, True, True, 0, s_m, 0.0, 0.0, False)))
        rows.append(("truth_machine", machine(t_ns, x, y, heading_rad)))
    return collect(Envelope(topic, i, m.stamp_ns, m) for i, (topic, m) in enumerate(rows))


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, 2.5, -2.0])
@pytest.mark.parametrize("offset_m", [-0.03, 0.0, 0.05])
def test_cross_track_sign_left_positive(heading_rad: float, offset_m: float) -> None:
    found = statistics(measure_cross_track(drive(heading_rad, offset_m)).on(PathSectionType.SWATH))
    assert found is not None
    assert found["mean"] == pytest.approx(offset_m, abs=1e-9)
    assert found["sigma"] == pytest.approx(0.0, abs=1e-9)
    assert found["max_abs"] == pytest.approx(abs(offset_m), abs=1e-9)


def test_no_statistics_without_samples() -> None:
    track = measure_cross_track(drive(0.0, 0.0))
    assert statistics(track.on(PathSectionType.HEADLAND)) is None


def test_worked_area_and_list_of_uncovered_areas() -> None:
    record = drive(0.0, 0.0)
    length = record.truth[-1].T_map_base[0, 3] - record.truth[0].T_map_base[0, 3]
    worked = worked_area(record.truth, 6.0)
    assert worked.area == pytest.approx(6.0 * length, rel=1e-6)
    planned = box(1.0, -3.0, 50.0, 3.0)
    coverage = measure_coverage(planned, worked, ())
    assert coverage.share == pytest.approx((record.truth[-1].T_map_base[0, 3] - 1.0) / 49.0, rel=1e-6)
    assert [piece.reason for piece in coverage.uncovered] == ["not worked"]
    gone = UncoveredArea("parked vehicle", 72.0, np.array([[38.0, -4.0], [51.0, -4.0], [51.0, 4.0], [38.0, 4.0]]))
    listed = measure_coverage(planned, worked, (gone,))
    assert listed.share == pytest.approx(1.0)
    assert [piece.reason for piece in listed.uncovered] == ["parked vehicle"]


def supervisor(t_ns: int, mode: Mode, reason: str, clearance_m: float, hits: np.ndarray) -> SupervisorState:
    return SupervisorState(
        t_ns,
        mode,
        reason,
        (),
        ObstacleClass.PERSON,
        clearance_m,
        2.3,
        5.0,
        30.0,
        0.0,
        hits.astype(np.float32),
        np.zeros((0, 2)),
    )


def with_stop(
    role: str, place_m: tuple[float, float], cause: Callable[[int], str] = lambda k: "protective_field"
) -> DriveRecord:
    """A stop from 2 s to 4 s with triggering points 5 m ahead of a machine at the origin; `cause` by 0.1 s."""
    rows: list[tuple[str, Message]] = []
    hits = np.array([[5.0, 0.0, 1.0]])
    for k in range(1, 60):
        t_ns = k * 100_000_000
        person = TrueObject(
            7,
            ObstacleClass.PERSON,
            role,
            np.array([*place_m, 0.9]),
            np.array([0.5, 0.5, 1.8]),
            0.0,
            np.zeros(2),
            1.5 + 0.01 * k,
        )
        is_limited, is_stopped = 10 <= k < 40, 20 <= k < 40
        mode = Mode.OBSTACLE_STOP if is_stopped else Mode.AUTOMATIC
        clearance_m = max(8.0 - 0.5 * (k - 10), 3.0) if is_limited else math.inf
        rows.append(("truth_machine", machine(t_ns, 0.0, 0.0, 0.0)))
        rows.append(("truth_objects", TrueObjects(t_ns, (person,))))
        reason = cause(k) if is_limited else ""
        rows.append(("supervisor", supervisor(t_ns, mode, reason, clearance_m, hits if is_limited else hits[:0])))
    return collect(Envelope(topic, i, m.stamp_ns, m) for i, (topic, m) in enumerate(rows))


def test_stop_cause_first_range_and_true_margin() -> None:
    (stop,) = find_stops(with_stop("person", (5.2, 0.3)))
    assert (stop.role, stop.cause, stop.label) == ("person", "protective_field", "person")
    assert stop.t_s == pytest.approx(1.9)
    assert stop.range_m == pytest.approx(8.0)
    assert stop.margin_m == pytest.approx(1.7)
    assert false_stops([stop], {"person": 1}) == []


@pytest.mark.parametrize("first", ["tracked_obstacle", "protective_field"])
def test_stop_begins_with_the_first_of_both_obstacle_channels(first: str) -> None:
    (stop,) = find_stops(with_stop("person", (5.2, 0.3), lambda k: first if k < 18 else "protective_field"))
    assert stop.cause == "protective_field"
    assert stop.range_m == pytest.approx(8.0)


def test_stop_does_not_begin_with_another_cause() -> None:
    (stop,) = find_stops(with_stop("person", (5.2, 0.3), lambda k: "speed_limit" if k < 15 else "tracked_obstacle"))
    assert stop.range_m == pytest.approx(5.5)


@pytest.mark.parametrize(
    ("role", "place_m", "expected"),
    [("person", (9.0, 0.0), {"person": 1}), ("", (5.0, 0.0), {}), ("person", (5.0, 0.0), {})],
)
def test_unannounced_stop_is_false(role: str, place_m: tuple[float, float], expected: dict[str, int]) -> None:
    stops = find_stops(with_stop(role, place_m))
    assert false_stops(stops, expected) == stops


def test_second_stop_for_same_object_is_false() -> None:
    (stop,) = find_stops(with_stop("person", (5.0, 0.0)))
    assert false_stops([stop, stop], {"person": 1}) == [stop]


def test_position_error_along_and_across() -> None:
    record = drive(0.5, 0.0)
    truth = record.truth[100]
    T = truth.T_map_base.copy()
    T[:2, 3] += 0.1 * np.array([math.cos(0.5), math.sin(0.5)]) + 0.02 * np.array([-math.sin(0.5), math.cos(0.5)])
    pose = MapPose(truth.stamp_ns, np.eye(4), T, np.diag([1e-4] * 6), PositionSource.RTK_FIXED, 0.1, 0.0, True)
    record.messages["map_pose"].append(pose)
    error = measure_position(record)
    assert error.along_m == pytest.approx([0.1])
    assert error.across_m == pytest.approx([0.02])
    assert error.sigma_across_m == pytest.approx([0.01])
    assert error.nees == pytest.approx([100.0 + 4.0])


def test_summary_of_complete_drive() -> None:
    record = drive(0.0, 0.02)
    status = MissionStatus(1, MissionState.FINISHED, PathSectionType.SWATH, 0, 0, 40.0, 40.0, 40.0, "done", ())
    record.messages["mission"].append(status)
    planned = Planned(box(1.0, -3.0, 39.0, 3.0), 240.0, 6.0, {"person": 1})
    plants = RuleResult("vegetation.consented", Response.NONE, math.inf, "plants of 0.30 m")
    for at_s, rules in ((5.0, (plants,)), (8.0, (replace(plants, text=""),))):
        state = supervisor(round(at_s * 1e9), Mode.AUTOMATIC, "", 9.0, np.empty((0, 3), np.float32))
        record.messages["supervisor"].append(replace(state, rules=rules))
    summary = summarize(record, planned)
    assert summary.outcome == "finished"
    assert summary.in_plants_m == pytest.approx(3.0 * SPEED_MPS)
    assert summary.planned_share == pytest.approx(38.0 * 6.0 / 240.0)
    verdicts = {v.clause: v.state for v in summary.verdicts}
    assert verdicts["BD-5.2.3"] is State.PASSED
    assert verdicts["BD-5.2.4"] is State.NOT_SHOWN


def test_empty_log_refused() -> None:
    with pytest.raises(LogError, match="no message"):
        collect([])


@pytest.mark.parametrize(
    ("measured", "n", "state"),
    [
        (0.02, 5, State.PASSED),
        (0.025, 5, State.PASSED),
        (0.02501, 5, State.FAILED),
        (0.0, 0, State.NOT_SHOWN),
        (None, 3, State.NOT_SHOWN),
    ],
)
def test_verdict_states(measured: float | None, n: int, state: State) -> None:
    assert verdict_of("c", measured, 0.025, "m", n, "e").state is state

"""Docking error and its figure; detections of each sensor against the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shapely import Polygon

from configs.site import Bay, Site
from configs.strict import find, load
from configs.vehicle import ImplementFile, Vehicle
from geometry.transforms import planar
from messages.message import Envelope, Message
from messages.perception import ObstacleClass, Obstacles
from messages.plan import MissionState, MissionStatus, Path, PathSection, PathSectionType
from messages.truth import TrueMachine, TrueObject, TrueObjects
from validation.drive.detections import Detections, DetectionSample, range_rows, sensor_views, share_rows
from validation.drive.docking import bodies_of, docking_drive, measure_docking
from validation.drive.record import DriveRecord, collect
from validation.drive.sensing_figures import detections_figure, docking_figure, nearest_approach, shares_figure
from validation.drive.summary import Planned, summarize

SITE = load(Site, find("sites", "demo"))
VEHICLE = load(Vehicle, find("machines", "tractor_e"))
HARROW = load(ImplementFile, find("implements", "harrow_6m")).implement
BAY = SITE.bay("narrow")


def machine(t_ns: int, x_m: float, y_m: float, yaw_rad: float, speed_mps: float = 0.0) -> TrueMachine:
    return TrueMachine(
        t_ns, planar(x_m, y_m, yaw_rad), speed_mps, 0.0, 0.0, 0.0, np.zeros(3), yaw_rad, 1.0, False, 0, 0
    )


def path(t_ns: int, number: int, section_type: PathSectionType) -> Path:
    s = np.arange(3.0)
    return Path(
        t_ns, number, 1, np.outer(s, [1.0, 0.0]), np.zeros(3), np.zeros(3), s, np.ones(3), np.zeros(3, np.uint8),
        (PathSection(section_type, -1, 0, 2),), np.zeros(3, np.int32), False,
    )  # fmt: skip


def docking_record(bay: Bay, along_m: float, left_m: float, turned_deg: float, state: MissionState) -> DriveRecord:
    """Undocking, a lane, and docking that ends with the given errors from the dock pose."""
    heading = math.radians(bay.dock.heading_deg)
    c, s = math.cos(heading), math.sin(heading)
    x, y = bay.dock.x_m + c * along_m - s * left_m, bay.dock.y_m + s * along_m + c * left_m
    rows: list[tuple[str, Message]] = [
        ("path", path(0, 0, PathSectionType.DOCK)), ("truth_machine", machine(1, x, y, heading, 0.5)),
        ("path", path(2, 1, PathSectionType.LANE)), ("truth_machine", machine(3, x + 20.0 * c, y + 20.0 * s, heading,
        2.0)),
        ("path", path(4, 2, PathSectionType.DOCK)), ("path", path(5, 3, PathSectionType.DOCK)),
    ]  # fmt: skip
    for k in range(10):
        away = 0.5 * (9 - k)
        yaw = heading + math.radians(turned_deg)
        rows.append(("truth_machine", machine(6 + k, x + away * c, y + away * s, yaw, -0.5 if k < 9 else 0.0)))
    rows.append(("mission", MissionStatus(20, state, PathSectionType.DOCK, -1, 3, 0.0, 0.0, 0.0, "", ())))
    return collect(Envelope(topic, i, m.stamp_ns + 1, m) for i, (topic, m) in enumerate(rows))


@pytest.mark.parametrize("bay", SITE.shed.bays if SITE.shed else (), ids=lambda b: b.name)
@pytest.mark.parametrize(("along_m", "left_m", "turned_deg"), [(0.0, 0.0, 0.0), (0.03, -0.04, 1.5), (-0.1, 0.0, -0.5)])
def test_dock_error_of_true_pose(bay: Bay, along_m: float, left_m: float, turned_deg: float) -> None:
    for turn in (0.0, 120.0):
        dock = bay.dock.model_copy(update={"heading_deg": turn})
        found = measure_docking(
            docking_record(bay.model_copy(update={"dock": dock}), along_m, left_m, turned_deg, MissionState.FINISHED),
            bay.model_copy(update={"dock": dock}),
        )
        assert found is not None
        assert found.error_m == pytest.approx(math.hypot(along_m, left_m), abs=1e-9)
        assert (found.along_m, found.across_m) == pytest.approx((along_m, left_m), abs=1e-9)
        assert math.degrees(found.error_rad) == pytest.approx(turned_deg, abs=1e-9)


def test_outcome_docked_only_for_mission_finished_in_bay() -> None:
    planned = Planned(Polygon(), 0.0, 6.0, {}, BAY)
    done = summarize(docking_record(BAY, 0.03, 0.04, -1.0, MissionState.FINISHED), planned)
    assert (done.outcome, done.as_dict["dock_error_m"], done.as_dict["dock_error_deg"]) == ("docked", 0.05, 1.0)
    aborted = summarize(docking_record(BAY, 0.03, 0.04, -1.0, MissionState.ABORTED), planned)
    assert (aborted.outcome, aborted.as_dict["dock_error_m"]) == ("aborted", None)
    in_yard = summarize(docking_record(BAY, 0.0, 0.0, 0.0, MissionState.FINISHED), replace(planned, bay=None))
    assert (in_yard.outcome, in_yard.as_dict["dock_error_deg"]) == ("finished", None)
    states = {v.clause: v.state.value for v in done.verdicts}
    assert (states["dock-error"], states["dock-heading"], states["demo-coverage"]) == ("passed", "passed", "not_shown")


def test_figure_of_last_docking() -> None:
    record = docking_record(BAY, 0.0, 0.0, 0.0, MissionState.FINISHED)
    poses, speed_mps = docking_drive(record)
    assert len(poses) == 10
    assert SITE.shed is not None
    png = docking_figure(SITE.shed, BAY, poses, speed_mps, bodies_of(VEHICLE, HARROW))
    assert png.startswith(b"\x89PNG")


def obstacles_of(stamp_ns: int, sensor: str, at_m: list[tuple[float, float]]) -> Obstacles:
    n = len(at_m)
    center = np.array([(x, y, 0.9) for x, y in at_m]).reshape(-1, 3)
    return Obstacles(
        stamp_ns, sensor, stamp_ns, center, np.full((n, 3), 0.5), np.zeros(n), center - [0.25, 0.0, 0.0],
        np.full((n, 2), np.nan), np.full((n, 7), 1 / 7), np.zeros(n + 1, np.int32), np.empty(0, np.int32),
        np.empty((0, 3), np.float32),
    )  # fmt: skip


def test_needed_topics_by_sensor_range() -> None:
    detections = Detections(VEHICLE)
    person = TrueObject(
        1, ObstacleClass.PERSON, "person", np.array([112.0, 0.0, 0.9]), np.ones(3), 0.0, np.zeros(2), clearance_m=8.0
    )
    near, other, short = "obstacles/lidar_front", "truth_machine", "obstacles/ultrasonic_front_middle"
    assert not detections.needs(near)
    detections(Envelope("truth_objects", 0, 0, TrueObjects(0, (replace(person, role=""),))))
    assert not detections.needs(near)
    detections(Envelope("truth_objects", 1, 1, TrueObjects(1, (person,))))
    assert (detections.needs(near), detections.needs(other), detections.needs(short)) == (True, True, False)
    detections(Envelope("truth_objects", 2, 2, TrueObjects(2, (replace(person, clearance_m=4.0),))))
    assert detections.needs(short)


def test_samples_in_field_of_view_and_detections_at_objects() -> None:
    detections = Detections(VEHICLE)
    assert "lidar_front" in sensor_views(VEHICLE)
    assert "obstacles/lidar_rear" in detections.topics
    for k, away in enumerate((12.0, 8.0, 4.0)):
        t = k * 100_000_000
        size = np.array([0.5, 0.5, 1.8])
        person = TrueObject(
            1, ObstacleClass.PERSON, "person", np.array([100.0, 3.3 + away + 0.25, 0.9]), size, 0.0, np.zeros(2), 0.0
        )
        post = replace(person, id=2, role="")
        rows = [
            ("truth_machine", machine(t, 100.0, 0.0, math.pi / 2.0)),
            ("truth_objects", TrueObjects(t, (person, post))),
            ("obstacles/lidar_front", obstacles_of(t, "lidar_front", [(3.3 + away + 0.25, 0.4 if k else 3.0)])),
            ("obstacles/lidar_rear", obstacles_of(t, "lidar_rear", [(3.3 + away, 0.0)])),
        ]
        for topic, message in rows:
            detections(Envelope(topic, k, t, message))
    assert [(sample.sensor, round(sample.range_m, 2), sample.is_detected) for sample in detections.samples] == [
        ("lidar_front", 12.0, False), ("lidar_front", 8.0, True), ("lidar_front", 4.0, True),
    ]  # fmt: skip
    (row,) = range_rows(detections.samples)
    assert (row["class"], row["samples"], row["detected"]) == ("person", 3, 2)
    assert (row["farthest_m"], row["always_detected_m"]) == pytest.approx((8.0, 8.0))
    assert [(r["from_m"], r["share"]) for r in share_rows(detections.samples)] == [(2.0, 1.0), (5.0, 1.0), (10.0, 0.0)]
    for png in (detections_figure(detections.samples, 0), shares_figure(detections.samples)):
        assert png is not None
        assert png.startswith(b"\x89PNG")
    assert detections_figure([], 0) is None


def test_nearest_approach_between_pauses() -> None:
    ranges = ((0, 20.0), (1, 19.0), (50, 9.0), (51, 8.0), (52, 9.0), (99, 9.5))
    samples = [DetectionSample("lidar_front", t * 10**9, "person", "person", r, math.nan) for t, r in ranges]
    assert [sample.stamp_ns * 1e-9 for sample in nearest_approach(samples)] == [50.0, 51.0, 52.0]

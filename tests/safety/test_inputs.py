"""Inputs of the supervisor (topics, ages, sensor failures) and its state message."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from messages.command import ControlCommand, Mode
from messages.message import Message
from messages.motion import MapPose, Odometry, PositionSource
from messages.node import Latest
from messages.perception import HealthState, ObstacleClass, Track, Tracks
from messages.plan import MissionState, MissionStatus, PathSectionType
from messages.sensors import RadarScan, UltrasonicRange
from messages.topics import spec_of
from safety.collision_monitor import MonitorInputs
from safety.inputs import SupervisorInputs
from safety.obstacle_sources import SourceData
from safety.output.supervisor_state import build_state
from safety.stopping_distance import required_range, stopping_distance
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import footprint_of
from safety.zones.protective_field import Clearance, SweptField
from safety.zones.swept_area import arc_poses, outline_of, spaced, sweep_along
from safety.zones.tracked_obstacles import CriticalObject
from tests.safety.safety_world import (
    START_NS,
    SyntheticInbox,
    healthy,
    machine_state,
    nothing_seen,
    situation_of,
    straight_path,
)

NOW_NS = START_NS + 10_000_000_000
ULTRASONIC = ("left", "right", "rear")
OWN = ("machine", "imu", "wheel", "lidar/front", "health/lidar_front", "lidar/rear", "health/lidar_rear", "odom",
       "map_pose", "tracks", "control_command", "mission", "order_status")  # fmt: skip


@pytest.fixture
def inputs(full: Vehicle, config: SupervisorConfig) -> SupervisorInputs:
    return SupervisorInputs(full.sensors, frozenset(), config)


def stamped(stamp_ns: int = NOW_NS) -> Any:
    return SimpleNamespace(stamp_ns=stamp_ns)


def collision_monitor(*away: str, frozen: tuple[str, ...] = ()) -> Any:
    """Two lidars, some of which do not cover the direction of travel, and a radar."""
    lidars = [
        SimpleNamespace(name=name, covers=lambda direction, name=name: name not in away or direction != 1)
        for name in ("front", "rear")
    ]
    radars = [SimpleNamespace(name="front", is_frozen="front" in frozen)]
    return SimpleNamespace(sources=SimpleNamespace(lidars=lidars, radars=radars))


def test_topics_of_all_sensors(inputs: SupervisorInputs) -> None:
    others = ("radar_front", "camera_front", *(f"ultrasonic_{name}" for name in ULTRASONIC))
    raw = ("radar/front", *(f"ultrasonic/{name}" for name in ULTRASONIC))
    derived = [f"{kind}/{label}" for kind in ("obstacles", "health") for label in others]
    assert inputs.reads == dict.fromkeys((*OWN, "path", *raw, *derived), Latest())


def test_no_topics_of_missing_sensors(full: Vehicle, config: SupervisorConfig) -> None:
    bare = full.sensors.model_copy(update={"imu": None, "wheels": None, "radar": {}, "ultrasonic": {}})
    reads = SupervisorInputs(bare, frozenset({"camera_front"}), config).reads
    assert set(reads) == {*OWN, "path"} - {"imu", "wheel"}


def odometry(**changes: Any) -> Odometry:
    return replace(Odometry(NOW_NS, np.eye(4), 2.0, 0.0, 0.0, 0.0, 0.0, np.eye(6)), **changes)


def test_read(inputs: SupervisorInputs) -> None:
    inbox, machine = SyntheticInbox(), machine_state(NOW_NS, fold_position=0.7)
    inbox.now_ns = NOW_NS
    pose = MapPose(NOW_NS, np.eye(4), np.eye(4), np.eye(6), PositionSource.RTK_FIXED, 0.1, 0.1, True)
    control_command = ControlCommand(NOW_NS, 2.0, 0.0, 0.0, True, True, 1, 0.0, 0.0, 0.0, False)
    path = replace(straight_path(), stamp_ns=NOW_NS)
    came: dict[str, Any] = {
        "odom": odometry(), "map_pose": pose, "control_command": control_command, "path": path,
        "tracks": Tracks(NOW_NS, ()),
        "lidar/front": stamped(), "radar/front": stamped(), "ultrasonic/rear": stamped(),
        "health/lidar_rear": healthy(NOW_NS, "lidar_rear"), "health/camera_front": healthy(NOW_NS, "camera_front"),
    }  # fmt: skip
    inbox.messages.update(came)
    seen = inputs.read(inbox, machine)
    assert seen == MonitorInputs(
        came["odom"], pose, control_command, path, came["tracks"], 0.7, 0.0,
        SourceData({"front": came["lidar/front"], "rear": None}, {"front": came["radar/front"]},
                     {"left": None, "right": None, "rear": came["ultrasonic/rear"]}),
        {"lidar_front": None, "lidar_rear": came["health/lidar_rear"], "radar_front": None,
         "camera_front": came["health/camera_front"], "ultrasonic_left": None, "ultrasonic_right": None,
         "ultrasonic_rear": None},
    )  # fmt: skip
    inbox.messages["mission"] = MissionStatus(
        NOW_NS, MissionState.DRIVING, PathSectionType.SWATH, 0, 1, 0.0, 0.0, 1.0, "", (), 0.03, -0.04, 0.05
    )
    assert inputs.read(inbox, machine) == replace(seen, line_shift_m=(0.03, -0.04))
    inbox.messages["odom"] = odometry(speed_mps=math.nan)
    inbox.messages["map_pose"] = replace(pose, T_map_odom=np.full((4, 4), math.nan))
    broken = inputs.read(inbox, replace(machine, implement_stamp_ns=0))
    assert (broken.odom, broken.map_pose, broken.fold, broken.hitch) == (None, None, None, 1.0)


def test_ages_by_direction(inputs: SupervisorInputs) -> None:
    inbox = SyntheticInbox()
    inbox.messages.update({"lidar/front": stamped(NOW_NS - 300_000_000), "odom": stamped(NOW_NS)})
    ages = {age.topic: age for age in inputs.ages(NOW_NS, inbox, collision_monitor(), 1)}
    assert tuple(ages) == OWN
    assert ages["lidar/front"].age_s == pytest.approx(0.3)
    assert ages["odom"].age_s == 0.0
    assert not ages["odom"].is_late
    assert ages["imu"].is_late
    few = [age.topic for age in inputs.ages(NOW_NS, inbox, collision_monitor("rear"), 1)]
    assert few == [topic for topic in OWN if topic not in ("lidar/rear", "health/lidar_rear")]


def all_well(inputs: SupervisorInputs) -> tuple[SyntheticInbox, MonitorInputs]:
    inbox = SyntheticInbox()
    inbox.now_ns = NOW_NS
    for topic in inputs.reads:
        if topic.startswith("health/"):
            inbox.messages[topic] = healthy(NOW_NS, topic.partition("/")[2])
        if topic.startswith("obstacles/"):
            inbox.messages[topic] = nothing_seen(NOW_NS, topic.partition("/")[2])
    some = np.ones(1)
    inbox.messages["radar/front"] = RadarScan(NOW_NS, some, some, some, some, some)
    inbox.messages |= {f"ultrasonic/{name}": UltrasonicRange(NOW_NS, 1.0) for name in ULTRASONIC}
    return inbox, inputs.read(inbox, None)


def sensor_failures(
    inputs: SupervisorInputs, inbox: SyntheticInbox, direction: int = 1, frozen: tuple[str, ...] = ()
) -> list[str]:
    seen = inputs.read(inbox, None)
    return [
        one.code for one in inputs.sensor_failures(NOW_NS, inbox, seen, collision_monitor(frozen=frozen), direction)
    ]


def test_no_sensor_failure(inputs: SupervisorInputs) -> None:
    inbox, _ = all_well(inputs)
    assert sensor_failures(inputs, inbox) == sensor_failures(inputs, inbox, -1) == []


@pytest.mark.parametrize(("topic", "direction", "code"), [
    ("radar/front", 1, "radar/front.silent"), ("ultrasonic/left", 1, "ultrasonic/left.silent"),
    ("ultrasonic/rear", -1, "ultrasonic/rear.silent"), ("health/camera_front", 1, "health/camera_front.silent"),
    ("obstacles/camera_front", 1, "obstacles/camera_front.silent"),
])  # fmt: skip
def test_sensor_timeout_in_its_direction(inputs: SupervisorInputs, topic: str, direction: int, code: str) -> None:
    inbox, _ = all_well(inputs)
    del inbox.messages[topic]
    assert sensor_failures(inputs, inbox, direction) == [code]
    assert sensor_failures(inputs, inbox, -direction) == []


def test_frozen_radar_and_blind_sector(inputs: SupervisorInputs, config: SupervisorConfig) -> None:
    inbox, _ = all_well(inputs)
    assert sensor_failures(inputs, inbox, frozen=("front",)) == ["radar/front.frozen"]
    half_rad = math.radians(config.detection_range.half_cone_deg)
    for edges_rad, is_coasting in ((half_rad - 0.01, True), (half_rad + 0.01, False)):
        edges, ranges = np.array([-math.pi, edges_rad, 3.0]), np.array([30.0, 0.0])
        inbox.messages["health/radar_front"] = replace(
            healthy(NOW_NS, ""), sector_edges_rad=edges, detection_range_m=ranges
        )
        assert (sensor_failures(inputs, inbox) == ["radar/front.blind"]) == is_coasting, edges_rad
    inbox.messages["health/radar_front"] = healthy(NOW_NS, "", HealthState.BLIND)
    assert sensor_failures(inputs, inbox) == ["radar/front.blind"]


@pytest.mark.parametrize(("label", "max_output_age_s"), [("radar_front", 0.35), ("camera_front", 1.5)])
def test_max_output_age(inputs: SupervisorInputs, label: str, max_output_age_s: float) -> None:
    inbox, _ = all_well(inputs)
    for age_s, is_told in (
        (max_output_age_s, True),
        (-max_output_age_s, True),
        (max_output_age_s + 1e-9, False),
        (-max_output_age_s - 1e-9, False),
    ):
        inbox.messages[f"obstacles/{label}"] = nothing_seen(NOW_NS - round(age_s * 1e9), label)
        assert (sensor_failures(inputs, inbox) == []) == is_told, age_s


def test_range_without_each_kind(config: SupervisorConfig) -> None:
    left = [config.rules.sensor_loss.without_m[kind] for kind in ("radar", "camera", "ultrasonic")]
    assert left == [5.0, 4.3, 3.0]


def track(id: int, x: float = 9.0) -> Track:
    return Track(id, ObstacleClass.PERSON, 0.9, np.array([x, 1.0, 0.8]), np.zeros(3), np.eye(4),
                 np.array([2.0, 1.0, 1.7]), math.pi / 2, 0, NOW_NS, True, ("lidar_front",))  # fmt: skip


def way_of(vehicle: Vehicle, config: SupervisorConfig) -> SweptField:
    s = spaced(6.0, 0.4)
    return SweptField(
        sweep_along(footprint_of(vehicle, None), 1, s, arc_poses(0.1, 1, s), 0.1, config.field, True), None, True
    )


def test_supervisor_state(vehicle: Vehicle, config: SupervisorConfig) -> None:
    hits = np.arange(9.0).reshape(3, 3)
    tracks = Tracks(NOW_NS, (track(4),))
    situation = situation_of(
        config, clearance=Clearance(5.0, 6.0, hits), critical_object=CriticalObject(4.0, ObstacleClass.PERSON, 4),
        detection_range_m=33.0, odom=odometry(),
        tracks=tracks,
    )  # fmt: skip
    swept_field = way_of(vehicle, config)
    asked = []

    def obstacle_class(*args: Any) -> ObstacleClass:
        asked.append(args)
        return ObstacleClass.ANIMAL

    decision: Any = SimpleNamespace(results=("some", "rules"), clearance_m=4.5)
    monitor: Any = SimpleNamespace(swept_field=swept_field, obstacle_class=obstacle_class)

    def built(clearance: Clearance | None = situation.clearance, monitor: Any = monitor) -> Any:
        return build_state(replace(situation, clearance=clearance), monitor, decision, Mode.OBSTACLE_STOP, "why", 1.5)

    state = built()
    assert (state.stamp_ns, state.mode, state.reason, state.rules) == (
        START_NS,
        Mode.OBSTACLE_STOP,
        "why",
        ("some", "rules"),
    )
    assert (state.obstacle_class, asked) == (ObstacleClass.ANIMAL, [(situation.inputs.odom, tracks)])
    assert (state.clearance_m, state.resume_in_s, state.detection_range_m) == (4.5, 1.5, 33.0)
    assert state.stopping_distance_m == pytest.approx(stopping_distance(2.0, situation.braking))
    assert state.required_range_m == pytest.approx(required_range(2.0, situation.braking, 2.1))
    assert state.triggering_points_base_m.dtype == np.float32
    assert state.triggering_points_base_m.tolist() == hits.tolist()
    assert state.protective_field_base_m == pytest.approx(outline_of(swept_field.main))
    assert built(None).triggering_points_base_m.shape == (0, 3)
    assert built(
        monitor=SimpleNamespace(swept_field=None, obstacle_class=obstacle_class)
    ).protective_field_base_m.shape == (0, 2)


@pytest.mark.parametrize(("count", "every"), [(1, 1), (300, 1), (301, 2), (600, 2), (601, 3)])
def test_at_most_300_triggering_points(config: SupervisorConfig, count: int, every: int) -> None:
    hits = np.column_stack([np.arange(float(count)), np.zeros(count), np.zeros(count)])
    monitor: Any = SimpleNamespace(swept_field=None, obstacle_class=lambda odom, tracks: ObstacleClass.UNKNOWN)
    decision: Any = SimpleNamespace(results=(), clearance_m=4.5)
    situation = situation_of(config, clearance=Clearance(1.0, 1.0, hits))
    state = build_state(situation, monitor, decision, Mode.AUTOMATIC, "", 0.0)
    assert state.triggering_points_base_m[:, 0].tolist() == list(range(0, count, every))


def test_message_types(inputs: SupervisorInputs) -> None:
    asked: set[tuple[str, type[Message]]] = set()

    class Asked(SyntheticInbox):
        def last(self, topic: str, kind: type) -> Any:
            asked.add((topic, kind))

        latest = last

    inbox = Asked()
    seen = inputs.read(inbox, None)
    inputs.ages(NOW_NS, inbox, collision_monitor(), 1)
    inputs.sensor_failures(NOW_NS, inbox, seen, collision_monitor(), 1)
    assert asked == {(topic, spec_of(topic).type) for topic in inputs.reads}


def test_a_lidar_that_looks_down_only_has_no_health(vehicle: Vehicle, config: SupervisorConfig) -> None:
    low = vehicle.sensors.lidar["front"].model_copy(update={"elevation_deg": [-40.0, -10.0]})
    sensors = vehicle.sensors.model_copy(update={"lidar": {**vehicle.sensors.lidar, "low": low}})
    reads = SupervisorInputs(sensors, frozenset(), config).reads
    assert "lidar/low" in reads
    assert "health/lidar_low" not in reads
    only_low = vehicle.sensors.model_copy(update={"lidar": {"low": low}})
    assert "health/lidar_low" in SupervisorInputs(only_low, frozenset(), config).reads

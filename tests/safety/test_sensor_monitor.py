"""Radar, ultrasonic sensors and camera in closed loop: each alone stops the machine; failures limit the speed."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest

from configs.strict import parse
from configs.vehicle import Mount, Vehicle
from messages.command import Mode, OperatorCommandKind
from messages.errors import ConfigError
from messages.motion import Odometry
from messages.perception import HealthState, ObstacleClass, Track, Tracks
from messages.sensors import RadarScan, UltrasonicRange
from safety.config import RadarConfig, SafetyConfig
from safety.monitors.sensors import MonitoredSensor, failure_of, monitored_sensors
from safety.sources.radar import RadarSource
from safety.sources.ultrasonic import NARROW_M, UltrasonicSource, ground_range_m, is_confirmed_by_track
from safety.supervisor import Supervisor
from safety.zones.footprint import footprint_of
from tests.safety.safety_world import START_NS, Target, World, around, healthy, straight_path

FRONT_M = 3.5
LOST = {
    "radar/front": "radar/front.silent", "ultrasonic/left": "ultrasonic/left.silent",
    "health/radar_front": "health/radar_front.silent", "health/camera_front": "health/camera_front.silent",
    "health/ultrasonic_right": "health/ultrasonic_right.silent",
    "obstacles/radar_front": "obstacles/radar_front.silent", "obstacles/camera_front": "obstacles/camera_front.silent",
    "obstacles/ultrasonic_left": "obstacles/ultrasonic_left.silent",
}  # fmt: skip


STARTED: dict[str, World] = {}


def driving(world: World, speed_mps: float) -> World:
    """In automatic mode and at speed; the start of the usual world is run once and copied."""
    is_usual = world.steps == 0 and not world.clutter and "health/camera_front" in world.supervisor.reads
    if is_usual and "usual" in STARTED:
        world.__dict__.update(copy.deepcopy(STARTED["usual"]).__dict__)
    else:
        world.start()
        STARTED.update({"usual": copy.deepcopy(world)} if is_usual else {})
    world.commanded_mps = speed_mps
    assert world.mode == Mode.AUTOMATIC
    world.speed_mps = speed_mps
    world.command = replace(world.command, speed_mps=speed_mps)
    world.supervisor._command_builder.last = world.command
    return world.run(0.3)


def limit_of(world: World, code: str) -> float:
    return next((rule.speed_limit_mps for rule in world.state.rules if rule.code == code), math.inf)


def test_no_limit_with_healthy_sensors(seeing: World) -> None:
    driving(seeing, 2.78).run(1.0)
    assert seeing.command.reason == ""
    assert seeing.speed_mps == pytest.approx(2.78, abs=0.02)
    assert seeing.faults == []


def test_radar_stops_for_static_person(seeing: World) -> None:
    driving(seeing, 2.78)
    seeing.targets = (Target(seeing.x_m + 20.0, 0.5, rcs_dbsm=-5.0),)
    seeing.run(12.0)
    assert seeing.mode == Mode.OBSTACLE_STOP
    assert seeing.command.reason == "protective_field"
    assert 1.0 < seeing.targets[0].x_m - seeing.x_m - FRONT_M < 3.5
    hardest = max(c.deceleration_mps2 for _, c in seeing.history)
    assert hardest < 2.5  # in time
    seeing.targets = ()
    seeing.run(5.0)
    assert seeing.mode == Mode.AUTOMATIC


def test_radar_detects_moving_child(seeing: World) -> None:
    driving(seeing, 2.0)
    seeing.targets = (Target(seeing.x_m + 12.0, 0.0, vx_mps=-1.0, rcs_dbsm=-15.0),)
    for _ in range(50):
        seeing.step(2)
        target = seeing.targets[0]
        seeing.targets = (replace(target, x_m=target.x_m - 0.04),)
    assert seeing.mode == Mode.OBSTACLE_STOP or seeing.command.reason == "protective_field"
    weak = seeing.state.triggering_points_base_m
    assert len(weak) > 0


def test_radar_clutter(seeing: World) -> None:
    seeing.clutter = 15
    driving(seeing, 2.78)
    seeing.targets = tuple(Target(seeing.x_m + x, 0.0, rcs_dbsm=-12.0) for x in (8.0, 15.0, 22.0))
    seeing.run(6.0)
    assert all(c.reason == "" for mode, c in seeing.history if mode == Mode.AUTOMATIC)
    assert seeing.mode == Mode.AUTOMATIC


@pytest.mark.parametrize("side", [1, -1])
def test_radar_posts_beside_path(seeing: World, side: int) -> None:
    driving(seeing, 2.78)
    seeing.targets = tuple(Target(seeing.x_m + x, side * 3.9, rcs_dbsm=5.0) for x in np.arange(5.0, 30.0, 2.5))
    seeing.run(6.0)
    assert seeing.mode == Mode.AUTOMATIC
    assert all(c.reason == "" for mode, c in seeing.history if mode == Mode.AUTOMATIC)


@pytest.mark.parametrize("y", [0.0, 0.6, -1.0])
def test_ultrasonic_stops_slow_machine(seeing: World, y: float) -> None:
    driving(seeing, 0.8)
    seeing.targets = (Target(seeing.x_m + 9.0, y, rcs_dbsm=-60.0, has_echo=True),)
    seeing.run(12.0)
    assert seeing.mode == Mode.OBSTACLE_STOP
    assert seeing.command.reason == "protective_field"
    assert 0.5 < seeing.targets[0].x_m - seeing.x_m - FRONT_M < 4.0


def test_rear_ultrasonic_stops_reversing(seeing: World) -> None:
    seeing.path = straight_path(5, 40.0, direction=-1)
    seeing.commanded_mps = 0.8
    seeing.start()
    seeing.targets = (Target(seeing.x_m - 9.0, 0.0, rcs_dbsm=-60.0, has_echo=True),)
    seeing.run(15.0)
    assert seeing.mode == Mode.OBSTACLE_STOP
    assert 0.5 < seeing.x_m - 2.4 - seeing.targets[0].x_m < 4.0


def test_single_echo_and_speed_limit_of_echoes(seeing: World) -> None:
    driving(seeing, 0.8)
    for k in range(20):
        seeing.targets = (Target(seeing.x_m + 6.0, 0.0, rcs_dbsm=-60.0, has_echo=True),) if k % 4 == 0 else ()
        seeing.step(5)
    assert seeing.command.reason == ""
    driving(seeing, 2.78)
    seeing.targets = (Target(seeing.x_m + 9.0, 2.0, rcs_dbsm=-60.0, has_echo=True),)
    seeing.run(1.2)
    assert seeing.command.reason == ""


def test_camera_track_stops_for_static_person(seeing: World) -> None:
    driving(seeing, 2.78)
    x = seeing.x_m + 15.0
    seeing.tracks = (Track(3, ObstacleClass.PERSON, 0.9, np.array([x, 0.3, 0.8]), np.zeros(3), np.eye(4) * 0.2,
                           np.array([0.5, 0.5, 1.7]), 0.0, START_NS, START_NS + 10**9, True,
                           ("camera_front",)),)  # fmt: skip
    seeing.run(10.0)
    assert seeing.mode == Mode.OBSTACLE_STOP
    assert seeing.command.reason == "tracked_obstacle"
    assert seeing.state.obstacle_class is ObstacleClass.PERSON
    assert 1.0 < x - seeing.x_m - FRONT_M < 3.5


@pytest.mark.parametrize("topic", LOST)
def test_sensor_loss_speed_and_code(seeing: World, config: SafetyConfig, topic: str) -> None:
    driving(seeing, 2.78)
    seeing.mute.add(topic)
    seeing.run(4.0)
    assert seeing.mode == Mode.AUTOMATIC
    assert seeing.command.reason == LOST[topic]
    assert 0.5 < seeing.speed_mps < 0.8 * 2.78
    reported = [fault for fault in seeing.faults if fault.is_active]
    assert [fault.code for fault in reported] == [LOST[topic]]
    seeing.mute.clear()
    seeing.run(4.0)
    assert seeing.command.reason == ""
    assert seeing.speed_mps == pytest.approx(2.78, abs=0.05)


@pytest.mark.parametrize(
    ("label", "max_output_age_s"), [("radar_front", 0.35), ("ultrasonic_left", 0.35), ("camera_front", 1.5)]
)
def test_obstacle_output_age_limit(seeing: World, label: str, max_output_age_s: float) -> None:
    driving(seeing, 2.78)
    topic = f"obstacles/{label}"
    seeing.mute.add(topic)
    while seeing.command.reason == "":
        seeing.step(1)
    last_ns = seeing.inbox.messages[topic].stamp_ns
    assert max_output_age_s < (seeing.command.stamp_ns - last_ns) * 1e-9 < max_output_age_s + 0.021


@pytest.mark.parametrize(("kind", "kmh"), [("radar", 7.5), ("camera", 6.7), ("ultrasonic", 3.6)])
def test_blind_sensor_speed(seeing: World, kind: str, kmh: float) -> None:
    name = {"radar": "front", "camera": "front", "ultrasonic": "left"}[kind]
    driving(seeing, 2.78)
    seeing.mute.add(f"health/{kind}_{name}")
    for _ in range(20):
        blind = healthy(seeing.inbox.now_ns, f"{kind}_{name}", HealthState.BLIND, "covered")
        seeing.inbox.put(f"health/{kind}_{name}", blind)
        seeing.step(5)
    assert seeing.command.reason == f"{kind}/{name}.blind"
    assert 0.7 * kmh < seeing.speed_mps * 3.6 <= kmh


def test_frozen_radar(seeing: World) -> None:
    driving(seeing, 2.0)
    seeing.targets = (Target(seeing.x_m + 50.0, 8.0),)
    seeing.run(0.2)
    frozen = seeing.inbox.messages["radar/front"]
    seeing.mute.add("radar/front")
    for _ in range(20):
        seeing.inbox.put("radar/front", replace(frozen, stamp_ns=seeing.inbox.now_ns))
        seeing.step(2)
    assert limit_of(seeing, "radar/front.frozen") < 2.1
    assert [fault.code for fault in seeing.faults] == ["radar/front.frozen"]


def test_sensor_outside_direction(seeing: World) -> None:
    driving(seeing, 2.78)
    seeing.mute |= {"ultrasonic/rear", "health/ultrasonic_rear"}
    seeing.run(2.0)
    assert seeing.command.reason == ""
    assert seeing.faults == []


def test_reversing_without_rear_sensors(seeing: World) -> None:
    seeing.path = straight_path(5, 40.0, direction=-1)
    seeing.commanded_mps = 2.0
    seeing.mute.add("ultrasonic/rear")
    seeing.start().run(4.0)
    assert seeing.command.reason == "ultrasonic/rear.silent"
    assert 0.5 < -seeing.speed_mps < 1.1
    seeing.mute.add("lidar/rear")
    seeing.run(3.0)
    assert seeing.mode == Mode.FAULT_STOP
    assert seeing.command.reason == "lidar/rear.silent"
    assert seeing.speed_mps == 0.0


def test_common_cause_reported_alone(seeing: World) -> None:
    driving(seeing, 2.0)
    seeing.mute |= {"odom", "imu", "health/radar_front", "tracks"}
    seeing.run(3.0)
    assert seeing.mode == Mode.FAULT_STOP
    assert [fault.code for fault in seeing.faults if fault.is_active] == ["imu.silent"]


def test_idle_camera(config, full: Vehicle, implement, geofence) -> None:
    supervisor = Supervisor(full, implement, config, geofence, (), idle=frozenset({"camera_front"}))
    assert "health/camera_front" not in supervisor.reads
    world = driving(World(supervisor, full, straight_path()), 2.78)
    assert world.command.reason == ""


def test_reads_by_sensors(config, sparse, full: Vehicle, implement, geofence) -> None:
    few = set(Supervisor(sparse, implement, config, geofence, ()).reads)
    many = set(Supervisor(full, implement, config, geofence, ()).reads)
    assert many - few == {
        "radar/front", "ultrasonic/left", "ultrasonic/right", "ultrasonic/rear", "health/radar_front",
        "health/ultrasonic_left", "health/ultrasonic_right", "health/ultrasonic_rear", "health/camera_front",
        "obstacles/radar_front", "obstacles/ultrasonic_left", "obstacles/ultrasonic_right",
        "obstacles/ultrasonic_rear", "obstacles/camera_front",
    }  # fmt: skip


def test_failure_by_sector(full: Vehicle) -> None:
    camera = next(one for one in monitored_sensors(full.sensors, frozenset()) if one.kind == "camera")
    half = math.radians(30.0)
    fine = healthy(START_NS, "camera_front")
    assert failure_of(camera, True, False, True, fine, 1, half) is None
    edges = np.radians([-40.0, -10.0, 10.0, 40.0])
    partly = replace(fine, sector_edges_rad=edges, detection_range_m=np.array([15.0, 0.0, 15.0]))
    sensor_failures = failure_of(camera, True, False, True, partly, 1, half)
    assert sensor_failures is not None
    assert sensor_failures.code == "camera/front.blind"
    assert failure_of(camera, True, False, True, partly, -1, half) is None
    near = replace(fine, detection_range_m=np.array([0.5]))
    assert failure_of(camera, True, False, True, near, 1, half) is None


def test_failure_codes(full: Vehicle) -> None:
    rear = next(one for one in monitored_sensors(full.sensors, frozenset()) if one.name == "rear")
    fine = healthy(START_NS, "ultrasonic_rear")
    blind = replace(fine, state=HealthState.BLIND, reason="dust")
    for is_received, is_frozen, has_output, health, code in (
        (False, True, False, None, "ultrasonic/rear.silent"),
        (True, True, False, None, "ultrasonic/rear.frozen"),
        (True, False, False, None, "obstacles/ultrasonic_rear.silent"),
        (True, False, True, None, "health/ultrasonic_rear.silent"),
        (True, False, True, blind, "ultrasonic/rear.blind"),
    ):
        sensor_failures = failure_of(rear, is_received, is_frozen, has_output, health, -1, 0.5)
        assert sensor_failures is not None
        assert (sensor_failures.kind, sensor_failures.code) == ("ultrasonic", code)
        assert "ultrasonic/rear" in sensor_failures.text
        assert failure_of(rear, is_received, is_frozen, has_output, health, 1, 0.5) is None


def test_coverage_by_mount_yaw() -> None:
    for direction, ahead_deg in ((1, 0.0), (-1, 180.0), (-1, -180.0)):
        for away_deg in (-120.0, *around(-60.0, 0.1), 0.0, *around(60.0, 0.1), 120.0):
            mount = Mount(xyz_m=(0.0, 0.0, 1.0), rpy_deg=(0.0, 0.0, ahead_deg + away_deg))
            expected = abs(away_deg) <= 60.0 + 1e-9
            if abs(abs(away_deg) - 60.0) > 1e-6 or ahead_deg == 0.0:  # a half turn is not exact in radians
                assert MonitoredSensor("radar", "front", mount).covers(direction) == expected, (direction, away_deg)


def test_monitored_sensors(full: Vehicle) -> None:
    known = {(one.kind, one.name): one.mount for one in monitored_sensors(full.sensors, frozenset({"camera_front"}))}
    assert known == {
        ("radar", "front"): full.sensors.radar["front"].mount,
        **{("ultrasonic", name): one.mount for name, one in full.sensors.ultrasonic.items()},
    }


STILL = Odometry(START_NS, np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))
Detection = tuple[float, float, float, float]


def radar_hits(full: Vehicle, implement, config: SafetyConfig, cycles: list[list[Detection]]) -> RadarSource:
    source = RadarSource("front", full.sensors.radar["front"], (0.25, 3.2), 0.15, config.radar)
    footprint = footprint_of(full, implement)
    for k, rows in enumerate(cycles):
        range_m, azimuth, doppler, rcs = np.array(rows).reshape(-1, 4).T
        scan = RadarScan(START_NS + k * 50_000_000, range_m, azimuth, np.full(len(range_m), np.nan), doppler, rcs)
        source.update(scan, np.zeros(3), STILL, footprint)
    return source


def test_radar_hit_limits(full: Vehicle, implement, config: SafetyConfig) -> None:
    radar = config.radar
    standing, weak = (8.0, 0.0, 0.0, radar.static_rcs_dbsm), (8.0, 0.0, 0.0, radar.static_rcs_dbsm - 0.1)
    moving = (8.0, 0.0, radar.moving_mps, radar.moving_rcs_dbsm)
    for count in range(8):
        assert (len(radar_hits(full, implement, config, [[standing]] * count).hits) > 0) == (
            count >= radar.static_cycles
        )
        assert (len(radar_hits(full, implement, config, [[moving]] * count).hits) > 0) == (count >= radar.moving_cycles)
    assert len(radar_hits(full, implement, config, [[weak]] * 8).hits) == 0
    assert len(radar_hits(full, implement, config, [[(8.0, 0.0, 0.4, radar.moving_rcs_dbsm)]] * 8).hits) == 0
    assert len(radar_hits(full, implement, config, [[(radar.static_cap_m + 0.1, 0.0, 0.0, 5.0)]] * 8).hits) == 0
    assert len(radar_hits(full, implement, config, [[(8.0, 1.2, 0.0, 5.0)]] * 8).hits) == 0  # beside the view
    assert len(radar_hits(full, implement, config, [[standing]] * 8 + [[]] * 9).hits) == 0  # forgotten
    assert len(radar_hits(full, implement, config, [[(np.nan, 0.0, 0.0, 5.0)]] * 8).hits) == 0


def test_malformed_radar_scan(full: Vehicle, implement, config: SafetyConfig) -> None:
    source = radar_hits(full, implement, config, [])
    scan = RadarScan(START_NS, np.ones(3), np.zeros(2), np.zeros(3), np.zeros(3), np.zeros(3))
    source.update(scan, np.zeros(3), STILL, footprint_of(full, implement))
    assert len(source.hits) == 0


def measure_all(
    full: Vehicle, config: SafetyConfig, ranges: list[float], speed_mps: float = 0.0, name: str = "left"
) -> UltrasonicSource:
    source = UltrasonicSource(name, full.sensors.ultrasonic[name], config.ultrasonic)
    for k, range_m in enumerate(ranges):
        pose = np.array([speed_mps * 0.1 * k, 0.0, 0.0])
        source.update(UltrasonicRange(START_NS + k * 100_000_000, range_m), pose, replace(STILL, speed_mps=speed_mps))
    return source


@pytest.mark.parametrize(
    ("y", "width", "sensor", "is_confirmed", "is_known"),
    [
        (1.2, 0.2, "lidar_front", True, True),
        (1.2, 0.2, "ultrasonic_left", True, False),  # the echo does not answer for itself
        (1.2, 0.2, "lidar_front", False, False),
        (2.6, 0.2, "lidar_front", True, False),
        (1.2, NARROW_M, "lidar_front", True, True),
        (1.2, NARROW_M + 0.01, "lidar_front", True, False),
    ],
)
def test_echo_confirmed_by_lidar_track(y: float, width: float, sensor: str, is_confirmed: bool, is_known: bool) -> None:
    geofence = Track(1, ObstacleClass.UNKNOWN, 0.9, np.array([3.0, y, 0.6]), np.zeros(3), np.eye(4) * 0.01,
                  np.array([8.0, width, 1.2]), 0.0, 0, START_NS, is_confirmed, (sensor,))  # fmt: skip
    arc = np.array([[3.0, 0.0], [2.9, 0.5], [2.6, 1.0]])
    assert is_confirmed_by_track(arc, Tracks(START_NS, (geofence,)), 0.3) == is_known
    assert not is_confirmed_by_track(arc, None, 0.3)


def test_echo_repeats(full: Vehicle, config: SafetyConfig) -> None:
    for count in range(6):
        source = measure_all(full, config, [2.0] * count)
        assert (len(source.echo_arc_odom_m) > 0) == (count >= 3)
    assert len(measure_all(full, config, [2.0, 3.5, 1.0, 4.0, 2.6]).echo_arc_odom_m) == 0
    assert len(measure_all(full, config, [4.6] * 5).echo_arc_odom_m) == 0  # beyond its reach
    assert len(measure_all(full, config, [math.nan] * 5).echo_arc_odom_m) == 0


def test_dead_zone_hold(full: Vehicle, config: SafetyConfig) -> None:
    near = [1.0 - 0.05 * k for k in range(13)]  # down to 0.4 m
    gone = [math.nan] * 20
    source = measure_all(full, config, near + gone, speed_mps=0.5)
    assert len(source.echo_arc_odom_m) == 7
    assert len(measure_all(full, config, [1.0] * 5 + gone).echo_arc_odom_m) == 0
    lasting = [math.nan] * round(config.ultrasonic.dead_zone_hold_s * 10 + 20)
    assert len(measure_all(full, config, near + lasting, speed_mps=0.5).echo_arc_odom_m) == 0


def test_ground_echo_range() -> None:
    T = np.eye(4)
    T[2, 3] = 0.7
    assert math.isinf(ground_range_m(T))
    T[2, 0] = -0.35
    assert ground_range_m(T) == pytest.approx(2.0)


def test_invalid_values(config: SafetyConfig) -> None:
    with pytest.raises(ConfigError, match="cycles"):
        parse(RadarConfig, config.radar.model_dump() | {"cycles": 4}, "test")


def test_start_with_failed_sensor(seeing: World) -> None:
    seeing.mute.add("ultrasonic/left")
    seeing.run(0.2)
    seeing.order(OperatorCommandKind.START)
    seeing.run(6.0)
    assert seeing.command.reason == "ultrasonic/left.silent"
    assert 0.5 < seeing.speed_mps < 1.1


def test_echo_of_known_wall(seeing: World) -> None:
    driving(seeing, 0.8)
    seeing.targets = (Target(seeing.x_m + 9.0, 0.0, rcs_dbsm=-60.0, has_echo=True),)
    seeing.run(12.0)
    collision_monitor = seeing.supervisor.collision_monitor
    assert collision_monitor.swept_field is not None
    arcs = [source.echo_arc_odom_m for source in collision_monitor.sources.ultrasonics if len(source.echo_arc_odom_m)]

    def clearance_m(is_wall: np.ndarray, turned_rad: float = 0.0) -> float:
        pose = np.array([seeing.x_m, seeing.y_m, seeing.yaw_rad + turned_rad])
        found = collision_monitor.sources.clearance(
            collision_monitor.swept_field, pose, 0.5, lambda points: is_wall[: len(points)], None
        )
        return math.inf if found is None else found.main_m

    longest = max(len(arc) for arc in arcs)
    one = np.arange(longest) == 0  # the wall need but touch the arc
    assert clearance_m(np.zeros(longest, bool)) < 4.0
    assert clearance_m(one) == math.inf
    assert clearance_m(np.zeros(longest, bool), math.pi) == math.inf  # it lies behind

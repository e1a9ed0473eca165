"""The supervisor in a closed loop: a machine that obeys its commands, over ground scanned by its lidars."""

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from messages.command import Mode, OperatorCommandKind, SafeCommand, SupervisorState
from messages.faults import Fault, Response, Severity
from messages.motion import PositionSource
from messages.perception import ObstacleClass, Track
from messages.plan import MissionState
from messages.topics import TOPICS
from safety.config import SafetyConfig
from safety.rules import RULES
from safety.rules.rule import Effect
from safety.stopping_distance import stopping_distance
from safety.supervisor import Supervisor
from safety.zones.geofence import Geofence
from tests.clause import clause
from tests.safety.safety_world import START_NS, STEP_NS, Box, SyntheticInbox, World, straight_path

FRONT_M, HALF_IMPLEMENT_M = 3.5, 3.05
STARTED: list[World] = []


def driving(world: World, speed_mps: float = 2.0) -> World:
    """A world in automatic mode at speed; the start of an unchanged world is simulated once and copied."""
    is_untouched = world.is_plain and world.steps == 0 and (world.boxes, world.mute, world.slope) == ((), set(), 0.0)
    if is_untouched and STARTED:
        world.__dict__.update(copy.deepcopy(STARTED[0]).__dict__)
    else:
        world.start()
        STARTED.extend([copy.deepcopy(world)] if is_untouched else [])
    world.commanded_mps = speed_mps
    assert world.mode == Mode.AUTOMATIC
    world.speed_mps = speed_mps
    world.command = replace(world.command, speed_mps=speed_mps)
    world.supervisor._command_builder.last = world.command
    return world.run(0.2)


def test_standby_without_inputs(world: World) -> None:
    inbox = SyntheticInbox()
    outputs = dict(world.supervisor.step(START_NS, inbox))
    command, state = outputs["safe_command"], outputs["supervisor"]
    assert isinstance(command, SafeCommand)
    assert isinstance(state, SupervisorState)
    assert (command.mode, command.is_drive_enabled, command.speed_mps) == (Mode.STANDBY, False, 0.0)
    assert command.deceleration_mps2 > 0.0
    assert command.reason == "machine.silent"
    assert math.isinf(state.clearance_m)
    assert state.detection_range_m == 0.0
    assert len(state.protective_field_base_m) == 0


def test_start_waits_for_inputs(world: World) -> None:
    world.mute |= {"odom", "machine"}
    world.order(OperatorCommandKind.START)
    world.run(5.0)
    assert world.mode == Mode.STANDBY
    world.mute.clear()
    world.run(3.4)  # the operator command still waits
    assert world.mode == Mode.AUTOMATIC


def test_start_warning_before_the_first_motion(world: World, config: SafetyConfig) -> None:
    world.run(0.2)
    world.order(OperatorCommandKind.START)
    world.run(config.modes.start_warning_s + 1.0)
    warned = [c for mode, c in world.history if mode == Mode.START_WARNING]
    assert len(warned) == pytest.approx(config.modes.start_warning_s * 50, abs=2)
    assert all(c.is_horn_on and c.is_beacon_on and c.speed_mps == 0.0 and c.deceleration_mps2 > 0.0 for c in warned)
    assert all(c.is_drive_enabled for c in warned)
    driven = [c for mode, c in world.history if mode == Mode.AUTOMATIC]
    assert driven[-1].speed_mps > 0.2
    assert not driven[-1].is_horn_on
    assert driven[-1].is_beacon_on
    assert driven[-1].reason == ""
    rises = np.diff([c.speed_mps for c in driven])
    assert rises.max() <= 0.6 * 0.02 + 1e-9


def test_command_every_step_and_state_at_10_hz(world: World) -> None:
    states = commands = 0
    for _ in range(50):
        world.inbox.now_ns += STEP_NS
        world.put_all()
        topics = [topic for topic, _ in world.supervisor.step(world.inbox.now_ns, world.inbox)]
        commands += topics.count("safe_command")
        states += topics.count("supervisor")
        world.steps += 1
    assert commands == 50
    assert 10 <= states <= 12


@clause("BD-5.2.4", "BD-5.2.5b", rule="protective_field")
def test_stop_before_an_obstacle_and_resume(world: World, config: SafetyConfig) -> None:
    world.start()
    world.boxes = (Box(20.0, 0.0),)
    world.run(13.0)
    assert world.mode == Mode.OBSTACLE_STOP
    left = 19.75 - world.x_m - FRONT_M
    assert config.field.margin_m <= left <= config.field.margin_m + 0.4
    assert world.command.reason == world.state.reason == "protective_field"
    assert world.state.clearance_m == pytest.approx(left, abs=0.1)
    assert len(world.state.triggering_points_base_m) > 10
    assert world.command.is_park_brake_set
    assert world.faults == []
    hardest = max(c.deceleration_mps2 for _, c in world.history)
    assert hardest < 2.5  # detected in time: gentle braking
    world.boxes = ()
    world.step(5)
    world.order(OperatorCommandKind.CONFIRM_CLEAR)  # it was not seen leaving
    world.run(config.modes.resume_clear_s - 0.4)
    assert world.mode == Mode.OBSTACLE_STOP
    assert 0.0 < world.state.resume_in_s < 0.6
    world.run(0.6)
    assert world.mode == Mode.START_WARNING
    world.run(config.modes.resume_warning_s)
    assert world.mode == Mode.AUTOMATIC
    world.run(4.0)
    assert world.speed_mps > 1.0
    assert not world.command.is_park_brake_set


def test_no_resume_with_an_intermittent_obstacle(world: World) -> None:
    driving(world)
    world.boxes = (Box(world.x_m + 8.0, 0.0),)
    world.run(5.0)
    assert world.mode == Mode.OBSTACLE_STOP
    there = world.boxes
    for k in range(6):
        world.boxes = () if k % 2 else there
        world.run(1.5)
        assert world.mode == Mode.OBSTACLE_STOP


@clause("BD-5.2.5b", rule="protective_field")
def test_obstacle_inside_the_stopping_distance(world: World) -> None:
    driving(world, 2.78)
    world.boxes = (Box(world.x_m + FRONT_M + 3.6, 0.0),)
    world.run(0.3)
    assert world.mode == Mode.OBSTACLE_STOP
    assert world.command.deceleration_mps2 > 2.0
    world.run(3.0)
    assert world.speed_mps == 0.0
    assert world.boxes[0].x_m - 0.25 > world.x_m + FRONT_M


def test_obstacle_during_the_start_warning(world: World) -> None:
    world.run(0.2)
    world.boxes = (Box(5.0, 0.0),)
    world.order(OperatorCommandKind.START)
    world.run(2.9)
    assert world.mode == Mode.START_WARNING
    world.run(0.3)
    assert world.mode == Mode.OBSTACLE_STOP
    assert all(c.speed_mps == 0.0 for _, c in world.history)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("beside_m", "stops"), [(0.15, True), (0.4, False), (0.55, False)])
def test_posts_beside_the_implement(world: World, side: int, beside_m: float, stops: bool) -> None:
    driving(world)
    post = Box(world.x_m + 11.0, side * (HALF_IMPLEMENT_M + beside_m + 0.1), (0.2, 0.2, 1.5))
    world.boxes = (post,)
    world.run(8.0)
    assert (world.mode == Mode.OBSTACLE_STOP) == stops
    if not stops:
        assert all(c.reason == "" for mode, c in world.history if mode == Mode.AUTOMATIC)


def test_no_slowing_by_crops_slopes_and_own_implement(world: World) -> None:
    world.slope = 0.08
    crops = tuple(Box(6.0 + 2.0 * k, y, (1.2, 0.3, 0.2)) for k in range(3) for y in (-1.0, 1.0))
    world.shape_boxes = (Box(-1.75, 0.0, (1.3, 6.1, 1.2)), *crops)
    driving(world).run(4.0)
    assert all(c.reason == "" for mode, c in world.history if mode == Mode.AUTOMATIC)
    assert len(world.state.triggering_points_base_m) == 0


def test_obstacle_beside_the_planned_path_on_the_arc(config, sparse, implement, geofence) -> None:
    """Straight path after a bend: a fence on the extended arc neither stops nor slows."""
    world = World(Supervisor(sparse, implement, config, geofence, ()), sparse, straight_path())
    driving(world, 1.4)
    world.curvature = 0.15
    world.odom_changes = {"curvature_radpm": 0.15}
    world.machine_changes = {"curvature_radpm": 0.0}
    world.boxes = (Box(world.x_m + 9.0, 5.5, (6.0, 0.3, 1.5)),)
    world.step(5)
    assert world.command.reason == ""
    world.boxes = (Box(world.x_m + 4.9, 1.5, (0.4, 0.4, 1.5)),)
    world.path = straight_path(2, start=(world.x_m, -30.0))  # far from this path: the arc alone
    world.run(0.3)
    assert world.mode == Mode.OBSTACLE_STOP


def backing(world: World) -> World:
    world.path = straight_path(5, 40.0, direction=-1)
    return world


def test_reverse_with_the_rear_lidar(world: World, config: SafetyConfig) -> None:
    backing(world).commanded_mps = 1.2
    world.boxes = (Box(-12.0, 0.0), Box(8.0, 0.0))
    world.start()
    world.run(10.0)
    assert world.mode == Mode.OBSTACLE_STOP
    left = world.x_m - 2.4 + 11.75
    assert config.field.margin_m <= left <= config.field.margin_m + 0.4


def test_no_driving_without_a_sensor_in_the_direction(config, sparse: Vehicle, implement, geofence) -> None:
    only_front = sparse.sensors.model_copy(update={"lidar": {"front": sparse.sensors.lidar["front"]}})
    blind = sparse.model_copy(update={"sensors": only_front})
    world = backing(World(Supervisor(blind, implement, config, geofence, ()), blind, straight_path()))
    world.start().run(2.0)
    assert world.x_m == 0.0
    assert world.mode == Mode.OBSTACLE_STOP
    assert world.state.reason == "detection_range.limit"


def test_rear_lidar_timeout_only_in_reverse(world: World) -> None:
    world.mute.add("lidar/rear")
    driving(world).run(1.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.speed_mps > 1.9
    world.order(OperatorCommandKind.PAUSE)
    world.run(3.0)
    backing(world)
    world.path_s_m = 0.0
    world.path = straight_path(9, 30.0, (world.x_m, 0.0), -1)
    world.order(OperatorCommandKind.START, expires_s=1.0)
    world.run(3.0)
    assert world.mode == Mode.STANDBY
    assert world.command.reason == "lidar/rear.silent"


SILENT = {"imu": "imu.silent", "wheel": "wheel.silent", "lidar/front": "lidar/front.silent", "odom": "odom.silent",
          "map_pose": "map_pose.silent", "machine": "machine.silent", "control_command": "control_command.silent",
          "tracks": "tracks.silent",
          "health/lidar_front": "health/lidar_front.silent", "mission": "mission.silent",
          "order_status": "order_status.silent",
          }  # fmt: skip


@pytest.mark.parametrize("topic", SILENT)
@clause("BD-5.5.1a", "BD-5.5.2d", rule="message_timeout")
def test_topic_timeout(world: World, config, topic: str) -> None:
    driving(world, 2.78)
    world.mute.add(topic)
    before = world.x_m
    world.run(5.0)
    assert world.mode == Mode.FAULT_STOP
    assert world.command.reason == SILENT[topic]
    assert world.speed_mps == 0.0
    bound = 2.78 * TOPICS[topic.partition("/")[0]].max_age_s + stopping_distance(2.78, config.braking.flat)
    assert world.x_m - before <= bound
    assert [f.code for f in world.faults if f.is_active] == [SILENT[topic]]
    world.mute.clear()
    world.run(5.0)
    assert world.mode == Mode.FAULT_STOP
    assert world.speed_mps == 0.0
    assert not world.command.is_drive_enabled
    assert world.command.is_park_brake_set
    assert not world.command.is_pto_on


def test_frozen_lidar(world: World) -> None:
    driving(world)
    frozen = world.inbox.messages["lidar/front"]
    for _ in range(50):
        world.mute.add("lidar/front")
        if world.steps % 5 == 0:
            world.inbox.put("lidar/front", replace(frozen, stamp_ns=world.inbox.now_ns + STEP_NS))
        world.step()
    assert world.mode == Mode.FAULT_STOP
    assert world.command.reason == "lidar/front.frozen"


def test_lidar_with_few_returns(world: World) -> None:
    driving(world)
    scan = world.inbox.messages["lidar/front"]
    world.mute.add("lidar/front")
    for _ in range(150):
        if world.steps % 5 == 0:
            ranges_mm = np.zeros_like(scan.ranges_mm)
            ranges_mm[-1, world.steps % ranges_mm.shape[1]] = 30_000
            dirty = replace(scan, stamp_ns=world.inbox.now_ns + STEP_NS, ranges_mm=ranges_mm)
            world.inbox.put("lidar/front", dirty)
        world.step()
    assert world.speed_mps == 0.0
    assert (world.mode, world.state.reason) == (Mode.OBSTACLE_STOP, "lidar/front.blind")


@pytest.mark.parametrize(("changes", "mode", "reason"), [
    ({"supply_v": 8.9}, Mode.FAULT_STOP, "supply_voltage"),
    ({"heartbeat_stamp_ns": 0}, Mode.FAULT_STOP, "machine.heartbeat.silent"),
    ({"is_steering_ready": False}, Mode.FAULT_STOP, "steering.not_ready"),
    ({"curvature_radpm": 0.1}, Mode.FAULT_STOP, "steering.not_following"),
    ({"brake_pedal": 0.5}, Mode.EMERGENCY_STOP, "emergency_stop.pedal"),
    ({"is_emergency_button_pressed": True}, Mode.EMERGENCY_STOP, "emergency_stop.button"),
    ({"driver_rate_radps": math.radians(50.0)}, Mode.MANUAL, "driver_override"),
    ({"driver_angle_rad": math.radians(31.0)}, Mode.MANUAL, "driver_override"),
    ({"driver_torque_nm": 3.0}, Mode.MANUAL, "driver_override"),
])  # fmt: skip
def test_machine_fault(world: World, changes: dict[str, Any], mode: Mode, reason: str) -> None:
    driving(world)
    world.machine_changes = changes
    world.run(1.4)
    assert world.mode == mode
    assert world.command.reason == reason
    assert world.command.speed_mps == 0.0
    world.machine_changes = {}
    world.run(4.0)
    assert world.mode == mode


@pytest.mark.parametrize("changes", [{"driver_rate_radps": 1.0}, {"driver_angle_rad": 1.0}])
@clause("BD-5.5.2e", rule="driver_override")
def test_driver_override_within_one_step(world: World, changes: dict[str, float]) -> None:
    driving(world)
    world.machine_changes = {"is_seat_occupied": True, **changes}
    world.step(1)
    assert world.mode == Mode.MANUAL
    assert not world.command.is_drive_enabled
    assert world.command.deceleration_mps2 > 0.0
    world.follows_commands, world.speed_mps = False, 0.0
    world.step(5)
    assert world.command.deceleration_mps2 == 0.0
    assert not world.command.is_park_brake_set
    world.speed_mps = 1.0  # with a driver nothing is commanded
    world.run(1.0)
    assert world.command.deceleration_mps2 == 0.0


@clause("BD-5.8.1b")
def test_emergency_stop_latch(world: World) -> None:
    driving(world)
    world.order(OperatorCommandKind.EMERGENCY_STOP, "anyone", sequence=-1)
    world.step(1)
    assert world.mode == Mode.EMERGENCY_STOP
    assert world.command.deceleration_mps2 == 6.0
    assert not world.command.is_drive_enabled
    assert world.command.reason == "operator_command.emergency_stop"
    world.speed_mps = 1.0
    world.follows_commands = False
    world.order(OperatorCommandKind.RESET)
    world.run(0.3)
    assert world.mode == Mode.EMERGENCY_STOP  # not while it moves
    world.speed_mps = 0.0
    world.order(OperatorCommandKind.START)
    world.run(2.0)
    assert world.mode == Mode.EMERGENCY_STOP
    assert world.command.deceleration_mps2 == 1.0
    world.follows_commands = True
    world.order(OperatorCommandKind.RESET)
    world.run(0.2)
    assert world.mode == Mode.STANDBY
    world.run(5.0)
    assert world.mode == Mode.STANDBY
    assert [(f.code, f.is_active) for f in world.faults] == [
        ("operator_command.emergency_stop", True), ("operator_command.emergency_stop", False),
    ]  # fmt: skip
    world.order(OperatorCommandKind.RESUME)
    world.run(3.3)
    assert world.mode == Mode.AUTOMATIC


@clause("BD-5.8.1b")
def test_no_reset_with_pressed_button(world: World) -> None:
    driving(world)
    world.machine_changes = {"is_emergency_button_pressed": True}
    world.run(3.0)
    world.order(OperatorCommandKind.RESET)
    world.run(0.2)
    assert world.mode == Mode.EMERGENCY_STOP


def test_ineffective_brake(world: World) -> None:
    driving(world, 2.78)
    world.follows_commands = False
    world.mute.add("control_command")
    world.run(2.0)
    assert world.mode == Mode.EMERGENCY_STOP
    assert world.command.reason == "brake.weak"


@pytest.mark.parametrize(("changes", "reason"), [
    ({"protection_level_m": 0.6}, "localization.protection"),
    ({"gnss_age_s": 121.0}, "localization.gnss_age"),
    ({"is_initialized": False}, "localization.none"),
    ({"source": PositionSource.NONE}, "localization.none"),
])  # fmt: skip
def test_insufficient_position(world: World, changes: dict[str, Any], reason: str) -> None:
    driving(world)
    world.pose_changes = changes
    world.run(3.0)
    assert world.mode == Mode.FAULT_STOP
    assert world.command.reason == reason
    assert world.speed_mps == 0.0


@pytest.mark.parametrize(("seconds", "mode"), [(0.44, Mode.AUTOMATIC), (0.6, Mode.FAULT_STOP)])
def test_a_brief_protection_level_slows_at_once_and_is_no_fault(world: World, seconds: float, mode: Mode) -> None:
    driving(world)
    before_mps = world.speed_mps
    world.pose_changes = {"protection_level_m": 0.6}
    world.run(0.1)
    assert world.command.speed_mps == 0.0
    assert world.command.reason.startswith("localization")
    world.run(seconds - 0.1)
    assert world.speed_mps < before_mps - 0.1
    world.pose_changes = {"protection_level_m": 0.1}
    world.run(2.0)
    assert world.mode == mode
    assert (world.speed_mps > 0.0) == (mode is Mode.AUTOMATIC)


def test_alarm_without_stop_on_lost_fixes(world: World) -> None:
    driving(world)
    world.pose_changes = {"gnss_age_s": 1.5}
    world.run(1.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.command.reason == ""
    assert [(f.code, f.severity) for f in world.faults] == [("localization.gnss_lost", Severity.WARNING)]
    world.pose_changes = {"protection_level_m": 0.4}
    world.run(4.0)
    assert world.command.reason == "localization"
    assert world.speed_mps == pytest.approx(5.0 / 3.6, abs=0.1)


def test_stop_before_the_geofence(world: World) -> None:
    world.start()
    world.supervisor.collision_monitor._geofence = Geofence(
        (np.array([(-50.0, -50.0), (20.0, -50.0), (20.0, 50.0), (-50.0, 50.0)]),)
    )
    world.run(14.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.command.reason == "geofence"
    assert 19.0 < world.x_m + FRONT_M < 20.0
    assert world.speed_mps == 0.0
    assert world.command.is_park_brake_set


def test_fault_outside_the_geofence(world: World) -> None:
    driving(world)
    world.y_m = 48.0
    world.run(2.0)
    assert world.mode == Mode.FAULT_STOP
    assert world.command.reason == "geofence.outside"


def person(x: float, y: float, vy: float) -> Track:
    return Track(7, ObstacleClass.PERSON, 0.9, np.array([x, y, 0.8]), np.array([0.0, vy, 0.0]), np.eye(4) * 0.01,
                 np.array([0.5, 0.5, 1.7]), 0.0, START_NS, START_NS + 10**9, True, ("lidar/front",))  # fmt: skip


def test_person_crossing(world: World) -> None:
    driving(world, 2.78)
    world.tracks = (person(world.x_m + 11.0, 5.0, -1.4),)
    world.run(0.5)
    assert world.command.reason == "tracked_obstacle"
    assert world.speed_mps < 2.7
    assert world.state.obstacle_class is ObstacleClass.PERSON
    world.tracks = (person(world.x_m + 6.0, 5.0, -1.4),)
    world.run(0.3)
    assert world.mode == Mode.OBSTACLE_STOP
    assert world.state.obstacle_class is ObstacleClass.PERSON


def test_obstacle_class_in_the_state(world: World) -> None:
    driving(world)
    x = world.x_m + 9.0
    world.boxes = (Box(x, 0.0),)
    world.tracks = (replace(person(x, 0.0, 0.0), label=ObstacleClass.ANIMAL),)
    world.run(6.0)
    assert world.mode == Mode.OBSTACLE_STOP
    assert world.state.obstacle_class is ObstacleClass.ANIMAL
    world.tracks = ()
    world.run(1.0)
    assert world.state.obstacle_class is ObstacleClass.UNKNOWN


def test_automatic_start_of_a_reverse_detour(world: World) -> None:
    """Detour around a static obstacle: the field on the new path is free."""
    driving(world)
    world.boxes = (Box(world.x_m + 9.0, 0.0, (2.0, 2.0, 1.6)),)
    world.run(8.0)
    assert world.mode == Mode.OBSTACLE_STOP
    stood = world.x_m
    world.path, world.path_s_m, world.commanded_mps = straight_path(2, 8.0, (world.x_m, 0.0), -1), 0.0, 1.0
    world.run(2.5 + 1.5 + 3.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.x_m < stood - 0.5


def test_no_resume_on_a_path_into_the_obstacle(world: World) -> None:
    driving(world)
    world.boxes = (Box(world.x_m + 9.0, 0.0, (2.0, 2.0, 1.6)),)
    world.run(8.0)
    world.path, world.path_s_m = straight_path(2, 50.0, (world.x_m, 0.0), 1), 0.0
    world.run(6.0)
    assert world.mode == Mode.OBSTACLE_STOP


def test_rules_passed_in(config, sparse, implement, geofence) -> None:
    rules = {name: rule for name, rule in RULES.items() if Effect.OBSTACLE not in rule.effect}
    supervisor = Supervisor(sparse, implement, config, geofence, (), rules=rules)
    world = driving(World(supervisor, sparse, straight_path()))
    world.boxes = (Box(world.x_m + 8.0, 0.0),)
    world.run(5.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.x_m + FRONT_M > world.boxes[0].x_m
    assert world.faults == []


def test_pause_manual_and_back(world: World) -> None:
    driving(world)
    world.order(OperatorCommandKind.PAUSE)
    world.step(2)
    assert world.mode == Mode.STANDBY
    assert world.command.is_drive_enabled  # enabled until the end of the stop
    world.run(3.0)
    assert world.speed_mps == 0.0
    assert not world.command.is_drive_enabled
    world.order(OperatorCommandKind.MANUAL)
    world.step(2)
    assert (world.mode, world.command.reason) == (Mode.MANUAL, "manual")
    world.order(OperatorCommandKind.START)
    world.run(1.0)
    assert world.mode == Mode.MANUAL
    world.order(OperatorCommandKind.AUTOMATIC)
    world.step(2)
    assert world.mode == Mode.STANDBY
    world.run(2.0)
    assert world.mode == Mode.STANDBY


@pytest.mark.parametrize("state", [MissionState.FINISHED, MissionState.ABORTED])
def test_end_of_mission(world: World, state: MissionState) -> None:
    driving(world)
    world.mission = state
    world.run(0.5)
    assert world.mode == Mode.AUTOMATIC  # not while it moves
    world.commanded_mps = 0.0
    world.run(6.0)
    assert world.mode == Mode.FINISHED
    assert not world.command.is_drive_enabled
    assert not world.command.is_beacon_on
    assert world.command.is_park_brake_set


def test_implement_and_pto_only_in_automatic_mode(world: World) -> None:
    world.machine_changes = {"is_hitch_in_work": False}
    world.run(0.5)
    assert (world.command.is_implement_lowered, world.command.is_pto_on) == (False, False)
    world.start()
    assert (world.command.is_implement_lowered, world.command.is_pto_on) == (True, True)
    world.boxes = (Box(world.x_m + 7.0, 0.0),)
    world.run(6.0)
    assert world.mode == Mode.OBSTACLE_STOP
    assert (world.command.is_implement_lowered, world.command.is_pto_on) == (True, False)
    world.command_changes = {"is_implement_lowered": False, "is_pto_on": False}
    world.step(2)
    assert (world.command.is_implement_lowered, world.command.is_pto_on) == (False, False)
    world.command_changes = {}
    world.step(2)
    assert (world.command.is_implement_lowered, world.command.is_pto_on) == (False, False)


def test_reported_faults(world: World) -> None:
    driving(world)
    stop = Response.CONTROLLED_STOP
    fault = Fault(0, "node.raised", "control", Severity.ALARM, True, stop, True, "raised", "gestürzt")
    world.inbox.put("fault/executor", fault)
    world.run(3.0)
    assert (world.mode, world.command.reason) == (Mode.FAULT_STOP, "node.raised")
    world.inbox.put("fault/executor", replace(fault, is_active=False))
    world.order(OperatorCommandKind.RESET)
    world.run(0.2)
    assert world.mode == Mode.STANDBY
    world.order(OperatorCommandKind.START)
    world.run(3.3)
    assert world.mode == Mode.AUTOMATIC


def test_lower_speed_downhill(world: World) -> None:
    driving(world)
    world.boxes = (Box(world.x_m + 10.5, 0.0),)
    world.step(5)
    flat = next(r for r in world.state.rules if r.code == "protective_field").speed_limit_mps
    world.pitch_rad = math.atan(0.08)
    world.follows_commands = False
    world.step(5)
    steep = next(r for r in world.state.rules if r.code == "protective_field").speed_limit_mps
    assert steep < flat


def test_no_geofence_in_a_log(config, sparse, implement) -> None:
    world = World(Supervisor(sparse, None, config, None, ()), sparse, straight_path())
    driving(world).run(1.0)
    assert world.command.reason == ""


def test_curvature_limit_and_rate(world: World, config: SafetyConfig) -> None:
    driving(world)
    world.command_changes = {"curvature_radpm": 1.0}
    world.run(1.0)
    curvatures = [c.curvature_radpm for _, c in world.history]
    assert max(np.abs(np.diff(curvatures))) <= config.curvature_rate_radpms * 0.02 + 1e-9
    assert max(curvatures) <= 1.02 / 4.6 + 1e-9


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_control_command_not_finite(world: World, bad: float) -> None:
    driving(world)
    world.command_changes = {"speed_mps": bad, "acceleration_mps2": bad, "curvature_radpm": bad, "path_s_m": bad}
    world.run(0.5)
    command = world.command
    values = (command.speed_mps, command.deceleration_mps2, command.curvature_radpm)
    assert all(math.isfinite(v) for v in values)
    assert command.speed_mps == 0.0


@pytest.mark.parametrize(("where", "changes", "reason"), [
    ("odom", {"speed_mps": math.nan}, "odom.invalid"),
    ("odom", {"T_odom_base": np.full((4, 4), math.nan)}, "odom.invalid"),
    ("odom", {"curvature_radpm": math.inf}, "odom.invalid"),
    ("pose", {"T_map_odom": np.full((4, 4), math.nan)}, "map_pose.invalid"),
    ("pose", {"protection_level_m": math.nan}, "localization.protection"),
    ("machine", {"curvature_radpm": math.nan, "speed_mps": math.nan}, "steering.not_following"),
])  # fmt: skip
def test_measured_values_not_finite(world: World, where: str, changes: dict[str, Any], reason: str) -> None:
    driving(world)
    setattr(world, f"{where}_changes", changes)
    world.run(2.5)
    assert all(math.isfinite(c.curvature_radpm) and math.isfinite(c.speed_mps) for _, c in world.history)
    assert world.mode == Mode.FAULT_STOP
    assert world.command.reason == reason
    assert world.speed_mps == 0.0

"""Brake proof test, empty seat, clock steps, alarms; monotonicity: worse inputs never allow a higher speed."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.strict import parse, read_yaml
from messages.command import Mode, OperatorCommandKind
from messages.errors import ConfigError
from messages.faults import Response
from messages.perception import ObstacleClass
from safety.config import BrakeTestConfig, DetectionRangeConfig
from safety.monitors.brake_test import BrakeTest, Phase
from safety.monitors.sensors import SensorFailure
from safety.monitors.watchdog import age_of, timed_out_topics
from safety.rules import RULES
from safety.stopping_distance import on_grade, stopping_distance
from safety.supervisor_config import SupervisorConfig
from safety.zones.protective_field import Clearance
from safety.zones.tracked_obstacles import CriticalObject
from tests.safety.safety_world import ROOT, START_NS, World, around, situation_of

CONFIG = parse(SupervisorConfig, read_yaml(ROOT / "configs/stack/safety.yaml"), "stack/safety.yaml")
HOUR_NS = 3_600_000_000_000
QUICK = settings(max_examples=60, deadline=None, derandomize=True, database=None)
metres = st.floats(0.0, 60.0)
speeds = st.floats(0.0, 9.0)


def trying(world: World) -> World:
    world.has_brake_test = True
    world.supervisor._brake_test.phase = Phase.CREEP
    return world


def test_brake_test_within_the_first_metre(world: World, config: SupervisorConfig) -> None:
    trying(world).start()
    world.run(5.0)
    driven = [c for mode, c in world.history if mode == Mode.AUTOMATIC]
    assert "brake.test" in {c.reason for c in driven}
    assert world.supervisor._brake_test.phase is Phase.PASSED
    braked = next(k for k, c in enumerate(driven) if c.deceleration_mps2 > 0.3 and c.speed_mps == 0.0 and k > 20)
    before = sum(c.speed_mps for c in driven[:braked]) * 0.02
    assert before < 1.0
    assert max(c.speed_mps for c in driven[:braked]) <= config.brake_test.speed_kmh / 3.6 + 1e-9
    assert world.speed_mps > 1.0
    assert world.faults == []


def test_failed_brake_test_and_retry(world: World) -> None:
    trying(world).start()
    world.run(0.7)
    world.follows_commands, world.speed_mps = False, 0.45  # it keeps rolling
    world.run(2.0)
    assert world.mode == Mode.EMERGENCY_STOP
    assert world.command.reason == "brake.test_failed"
    world.follows_commands, world.speed_mps = True, 0.0
    world.order(OperatorCommandKind.RESET)
    world.run(0.2)
    assert world.mode == Mode.STANDBY
    assert world.supervisor._brake_test.phase is Phase.CREEP


def test_brake_test_of_a_machine_that_gains_speed_until_the_brake_acts(config: SupervisorConfig) -> None:
    """The limit is that of the highest speed after the order, and at most that of the test speed."""
    order_mps, test_mps = config.brake_test.brake_kmh / 3.6, config.brake_test.speed_kmh / 3.6
    flat = config.braking.flat
    for highest in (order_mps, 0.5 * (order_mps + test_mps), test_mps, 2.0 * test_mps):
        limit_m = stopping_distance(min(highest, test_mps), flat)
        for at_m in around(limit_m, 1e-3, 2):
            test = BrakeTest(config)
            test.update(Mode.AUTOMATIC, order_mps, 0.0, flat)
            test.update(Mode.AUTOMATIC, highest, 0.0, flat)
            found = test.update(Mode.AUTOMATIC, 0.0, at_m, flat)
            assert found is (Phase.PASSED if at_m <= limit_m + 1e-12 else Phase.FAILED), (highest, at_m)


def test_brake_test_limit(config: SupervisorConfig) -> None:
    flat = config.braking.flat
    way_m = stopping_distance(0.45, flat)
    for left in around(way_m, 1e-3):
        test = BrakeTest(config)
        assert test.update(Mode.STANDBY, 0.45, 0.0, flat) is Phase.CREEP
        assert test.update(Mode.AUTOMATIC, None, 0.0, flat) is Phase.CREEP
        assert test.update(Mode.AUTOMATIC, 0.45, 0.0, flat) is Phase.BRAKE
        assert test.update(Mode.AUTOMATIC, 0.2, 0.1, flat) is Phase.BRAKE
        assert test.update(Mode.AUTOMATIC, 0.0, left, flat) is (Phase.PASSED if left <= way_m + 1e-9 else Phase.FAILED)
    late = BrakeTest(config)
    late.update(Mode.AUTOMATIC, 0.45, 7.0, flat)  # not in the first metres of a day
    assert late.update(Mode.AUTOMATIC, 0.0, 7.0 + way_m - 1e-6, flat) is Phase.PASSED
    for speed in around(config.brake_test.brake_kmh / 3.6, 1e-3):
        is_fast = speed >= config.brake_test.brake_kmh / 3.6 - 1e-12
        assert (BrakeTest(config).update(Mode.AUTOMATIC, -speed, 0.0, flat) is Phase.BRAKE) == is_fast
    for speed in around(config.modes.standstill_mps, 0.01):
        test = BrakeTest(config)
        test.update(Mode.AUTOMATIC, 0.45, 0.0, flat)
        is_still = speed <= config.modes.standstill_mps
        assert test.update(Mode.AUTOMATIC, speed, 0.1, flat) is (Phase.PASSED if is_still else Phase.BRAKE), speed
    broken = BrakeTest(config)
    broken.update(Mode.AUTOMATIC, 0.45, 0.0, flat)
    assert broken.update(Mode.OBSTACLE_STOP, 0.3, 0.1, flat) is Phase.CREEP


def test_results_of_the_brake_test() -> None:
    asked = {phase: RULES["brake"](situation_of(CONFIG, brake_test=phase)) for phase in Phase}
    assert asked[Phase.CREEP].speed_limit_mps == pytest.approx(0.5)
    assert asked[Phase.BRAKE].speed_limit_mps == 0.0
    assert math.isinf(asked[Phase.PASSED].speed_limit_mps)
    assert asked[Phase.FAILED].response is Response.EMERGENCY_STOP
    assert [asked[phase].code for phase in Phase] == ["brake.test", "brake.test", "brake.weak", "brake.test_failed"]


def test_driver_override_with_an_empty_seat(world: World) -> None:
    world.start().run(3.0)
    assert world.speed_mps > 1.0
    world.machine_changes = {"driver_rate_radps": 2.0}
    world.step(1)
    assert (world.mode, world.command.is_drive_enabled) == (Mode.MANUAL, False)
    assert world.command.deceleration_mps2 == 2.5
    world.run(4.0)
    assert world.speed_mps == 0.0
    assert world.command.deceleration_mps2 == 1.0
    assert world.command.is_park_brake_set
    world.machine_changes = {"is_seat_occupied": True}  # a driver sits down
    world.step(1)
    assert (world.command.deceleration_mps2, world.command.is_park_brake_set) == (0.0, False)


def test_seat_off_delay(world: World, config: SupervisorConfig) -> None:
    world.machine_changes = {"is_seat_occupied": True}
    world.run(0.2)
    world.order(OperatorCommandKind.MANUAL)
    world.run(0.2)
    world.follows_commands, world.speed_mps = False, 1.5
    world.machine_changes = {"is_seat_occupied": False}
    world.run(config.modes.seat_empty_s - 0.4)
    assert world.command.deceleration_mps2 == 0.0
    world.mute.add("machine")  # without a machine state the seat counts as before
    world.run(2.0)
    assert world.command.deceleration_mps2 == 0.0
    world.mute.clear()
    world.run(0.1)
    assert world.command.deceleration_mps2 > 0.0


@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS])
@pytest.mark.parametrize("is_driving", [True, False])
def test_clock_step_of_an_hour(world: World, step_ns: int, is_driving: bool) -> None:
    """The clock of all sources; later a restart."""
    if is_driving:
        world.start().run(2.0)
    else:
        world.mute.add("map_pose")  # the start command waits
        world.run(0.2)
        world.order(OperatorCommandKind.START, expires_s=2.0)
        world.run(0.2)
        world.mute.clear()
    world.inbox.now_ns += step_ns
    world.run(3.0)
    assert world.speed_mps == 0.0
    assert world.mode == (Mode.FAULT_STOP if is_driving else Mode.STANDBY)
    if is_driving:
        assert world.command.reason == "clock_step"
        assert [fault.code for fault in world.faults if fault.is_active] == ["clock_step"]
        world.order(OperatorCommandKind.RESET)
        world.run(0.2)
    world.order(OperatorCommandKind.START)
    world.run(6.0)
    assert world.mode == Mode.AUTOMATIC
    assert world.speed_mps > 0.5


@pytest.mark.parametrize("topic", ["odom", "lidar/front", "machine"])
@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS])
def test_source_with_another_clock(world: World, topic: str, step_ns: int) -> None:
    world.start().run(1.0)
    world.mute.add(topic)
    for _ in range(100):
        message = world.inbox.messages[topic]
        changed = replace(message, stamp_ns=world.inbox.now_ns + step_ns)
        world.inbox.put(topic, changed)
        world.step()
    assert world.mode == Mode.FAULT_STOP
    assert world.command.reason == f"{topic}.silent"
    assert world.speed_mps == 0.0


def test_small_delay(world: World, config: SupervisorConfig) -> None:
    world.start()
    world.inbox.now_ns += round(0.4 * config.limits.clock_step_s * 1e9)
    world.step(1)
    assert world.command.reason != "clock_step"


def test_alarm_spacing_of_simultaneous_faults(world: World) -> None:
    world.start().run(1.0)
    world.mute |= {"imu", "wheel", "odom", "map_pose", "tracks", "lidar/front", "control_command"}
    world.machine_changes = {"supply_v": 5.0, "is_steering_ready": False}
    begun: list[tuple[int, str]] = []
    for _ in range(300):
        seen = len(world.faults)
        world.step()
        begun += [(world.inbox.now_ns, fault.code) for fault in world.faults[seen:] if fault.is_active]
    assert all(b - a >= 10**9 for (a, _), (b, _) in pairwise(begun))
    assert world.faults[0].is_latched
    assert world.faults[0].text_en
    assert world.faults[0].text_zh
    assert begun[0][1] == world.command.reason


def allowed(**changes: float) -> float:
    """The highest speed that all rules allow."""
    clearance = Clearance(changes.pop("main_m", math.inf), changes.pop("arc_m", math.inf), np.empty((0, 3)))
    critical_object = CriticalObject(changes.pop("critical_m", math.inf), ObstacleClass.UNKNOWN, 1)
    pitch = changes.pop("pitch_rad", 0.0)
    braking = on_grade(CONFIG.braking.flat, pitch, CONFIG.braking.min_deceleration_mps2)
    sensor_failures = tuple(
        SensorFailure(kind, kind, "") for kind in ("radar", "camera", "ultrasonic")[: int(changes.pop("lost", 0))]
    )
    situation = situation_of(
        CONFIG,
        clearance=clearance,
        critical_object=critical_object,
        braking=braking,
        sensor_failures=sensor_failures,
        **changes,
    )
    return min(rule(situation).speed_limit_mps for rule in RULES.values())


@QUICK
@given(metres, metres, speeds)
def test_monotonic_obstacle_distance(a: float, b: float, speed: float) -> None:
    near, far = sorted((a, b))
    for key in ("main_m", "arc_m", "critical_m", "wall_distance_m", "geofence_distance_m", "detection_range_m"):
        assert allowed(**{key: near, "speed_mps": speed}) <= allowed(**{key: far, "speed_mps": speed}), key


@QUICK
@given(st.floats(0.0, 0.25), st.floats(0.0, 0.25), metres)
def test_monotonic_slope(a: float, b: float, clearance: float) -> None:
    flat, steep = sorted((a, b))
    assert allowed(pitch_rad=steep, main_m=clearance) <= allowed(pitch_rad=flat, main_m=clearance)


@QUICK
@given(metres, metres, metres)
def test_monotonic_obstacle_count(a: float, b: float, c: float) -> None:
    assert allowed(main_m=a, arc_m=b, critical_m=c) <= min(allowed(main_m=a), allowed(arc_m=b), allowed(critical_m=c))


@QUICK
@given(st.integers(0, 3), st.integers(0, 3), metres)
def test_monotonic_sensor_loss(a: int, b: int, clearance: float) -> None:
    few, many = sorted((a, b))
    assert allowed(lost=many, main_m=clearance) <= allowed(lost=few, main_m=clearance)
    assert allowed(lost=3) > 0.5


@QUICK
@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_monotonic_age(a: float, b: float) -> None:
    young, old = sorted((a, b))
    ages = [age_of("odom", START_NS - round(age * 1e9), START_NS) for age in (young, old)]
    assert len(timed_out_topics(ages[:1])) <= len(timed_out_topics(ages[1:]))


@QUICK
@given(st.floats(0.0, 200.0), st.floats(0.0, 200.0), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_monotonic_position_accuracy(age_a: float, age_b: float, level_a: float, level_b: float) -> None:
    (good_age, bad_age), (good, bad) = sorted((age_a, age_b)), sorted((level_a, level_b))

    def speed(age_s: float, level_m: float, is_under_roof: bool) -> float:
        pose = {"gnss_age_s": age_s, "protection_level_m": level_m, "uwb_age_s": 0.1}
        return RULES["localization"](situation_of(CONFIG, pose=pose, is_under_roof=is_under_roof)).speed_limit_mps

    assert speed(bad_age, bad, False) <= speed(good_age, good, False)
    assert speed(good_age, good, True) <= speed(good_age, good, False)


def test_uwb_age_limit() -> None:
    for age in around(CONFIG.docking.max_uwb_age_s, 0.01):
        pose = {"uwb_age_s": age, "gnss_age_s": 5.0}
        result = RULES["localization"](situation_of(CONFIG, pose=pose, is_under_roof=True))
        assert (result.code == "localization.uwb_lost") == (age > CONFIG.docking.max_uwb_age_s + 1e-9), age
    for level in around(CONFIG.docking.protection_stop_m, 0.01):
        pose = {"uwb_age_s": 0.1, "protection_level_m": level}
        result = RULES["localization"](situation_of(CONFIG, pose=pose, is_under_roof=True))
        assert (result.response is Response.CONTROLLED_STOP) == (level > CONFIG.docking.protection_stop_m + 1e-9), level


@pytest.mark.parametrize(("kind", "section", "changes"), [
    (BrakeTestConfig, "brake_test", {"brake_kmh": 1.8}), (DetectionRangeConfig, "detection_range", {"good_ratio": 0.1}),
])  # fmt: skip
def test_contradictory_values(kind, section: str, changes: dict[str, float]) -> None:
    values = getattr(CONFIG, section).model_dump() | changes
    with pytest.raises(ConfigError, match=r"never reached|good_ratio"):
        parse(kind, values, "test")


def test_no_clearance_before_the_first_scan(world: World) -> None:
    world.mute |= {"lidar/front", "lidar/rear"}
    world.run(0.4)
    assert world.supervisor.collision_monitor.clearance() is None
    assert "protective_field.no_scan" in {rule.code for rule in world.state.rules}

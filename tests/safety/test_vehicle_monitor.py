"""The vehicle monitor with constructed messages: measured values and debounce times."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from geometry.transforms import transform
from messages.command import ControlCommand, Mode, SafeCommand
from messages.motion import MapPose, Odometry, PositionSource
from safety.config import SafetyConfig
from safety.monitors.vehicle import VehicleMonitor, VehicleState, direction_of, is_forced, position_sigma_m
from safety.stopping_distance import on_grade
from tests.safety.safety_world import START_NS, around, machine_state, straight_path

COMMAND = SafeCommand(START_NS, Mode.AUTOMATIC, True, 2.0, 0.0, 0.0, False, False, False, False, True, "")

AHEAD = ControlCommand(START_NS, 0.5, 0.0, 0.0, True, True, 1, 0.0, 0.0, 0.0, False)

BACK = replace(AHEAD, speed_mps=-0.5)


def odometry(speed_mps: float = 2.0, acceleration_mps2: float = 0.0, pitch_rad: float = 0.0) -> Odometry:
    T = transform((0.0, 0.0, 0.0), (0.0, pitch_rad, 0.0))
    return Odometry(START_NS, T, speed_mps, 0.0, acceleration_mps2, 0.0, 0.0, np.eye(6))


class Bench:
    """A vehicle monitor and its last messages."""

    def __init__(self, config: SafetyConfig) -> None:
        self.vehicle_monitor, self.now_ns = VehicleMonitor(config), START_NS
        self.shown: dict[str, Any] = {
            "mode": Mode.AUTOMATIC, "odom": odometry(), "machine": machine_state(START_NS, speed_mps=2.0),
            "map_pose": None, "path": None, "control_command": None, "command": COMMAND,
        }  # fmt: skip

    def show(self, after_s: float = 0.02, **changes: Any) -> VehicleState:
        """State after one step; changes persist, `machine` holds those of the machine state."""
        self.now_ns += round(after_s * 1e9)
        if isinstance(changes.get("machine"), dict):
            changes["machine"] = machine_state(START_NS, **{"speed_mps": 2.0, **changes["machine"]})
        self.shown |= changes
        return self.vehicle_monitor.update(self.now_ns, **self.shown)


@pytest.fixture
def bench(config: SafetyConfig) -> Bench:
    return Bench(config)


def test_initial_state(bench: Bench) -> None:
    measured = bench.show(odom=None, machine=None, command=None)
    assert (measured.speed_mps, measured.fastest_mps, measured.direction) == (None, 0.0, 1)
    assert measured.braking == bench.vehicle_monitor._config.braking.flat
    assert not measured.has_driver


def test_faster_speed_source(bench: Bench) -> None:
    for odom, machine, speed in ((1.0, -3.0, -3.0), (-3.0, 1.0, -3.0), (math.nan, 1.0, 1.0), (1.0, math.inf, 1.0)):
        measured = bench.show(odom=odometry(odom), machine={"speed_mps": machine})
        assert (measured.speed_mps, measured.fastest_mps) == (speed, abs(speed)), (odom, machine)
    assert bench.show(odom=None).speed_mps is None
    sensor_failures = bench.show(odom=None, machine=None)
    assert (sensor_failures.speed_mps, sensor_failures.fastest_mps) == (None, 1.0)  # as it was


def test_lowest_protection_level_of_the_last_half_second(bench: Bench, config: SafetyConfig) -> None:
    def shown(level_m: float, after_s: float) -> float:
        pose = MapPose(START_NS, np.eye(4), np.eye(4), np.eye(6), PositionSource.RTK_FIXED, level_m, 0.1, True)
        return bench.show(after_s, map_pose=pose).lasting_level_m

    assert bench.show().lasting_level_m == math.inf
    assert shown(0.2, 0.0) == shown(0.7, config.limits.protection_alert_s) == 0.2
    assert shown(math.nan, 0.02) == 0.7
    assert shown(math.nan, config.limits.protection_alert_s + 0.02) == math.inf
    assert bench.show(map_pose=None).lasting_level_m == math.inf
    assert shown(0.3, 0.02) == 0.3


def test_direction_kept_without_data(bench: Bench) -> None:
    back = bench.show(odom=odometry(-1.0), machine={"speed_mps": -1.0})
    assert back.direction == -1
    assert bench.show(odom=odometry(0.0), machine={"speed_mps": 0.0}).direction == -1
    assert bench.show(path=straight_path()).direction == 1
    assert bench.show(path=None, control_command=BACK).direction == -1


def test_direction_speed_threshold() -> None:
    back = straight_path(direction=-1)
    for speed in around(0.1, 0.01):
        assert direction_of(speed, back, AHEAD, -1) == (1 if speed > 0.1 else -1), speed
    assert direction_of(-0.2, straight_path(), AHEAD, 1) == -1
    assert direction_of(0.0, None, AHEAD, -1) == 1
    assert direction_of(0.0, None, BACK, 1) == -1
    assert direction_of(0.0, None, replace(AHEAD, speed_mps=0.0), 1) == 1


def test_braking_on_grade(bench: Bench, config: SafetyConfig) -> None:
    flat, least = config.braking.flat, config.braking.min_deceleration_mps2
    down = on_grade(flat, 0.1, least)
    assert bench.show(odom=odometry(pitch_rad=0.1)).braking.deceleration_mps2 == pytest.approx(down.deceleration_mps2)
    assert bench.show(odom=None).braking.deceleration_mps2 == pytest.approx(down.deceleration_mps2)  # the last known
    assert bench.show(odom=odometry(-2.0, pitch_rad=0.1), machine={"speed_mps": -2.0}).braking == flat
    assert bench.show(odom=odometry(-2.0, pitch_rad=-0.1)).braking.deceleration_mps2 < 2.0


def test_position_sigma(bench: Bench) -> None:
    pose = MapPose(START_NS, np.eye(4), np.eye(4), np.diag([9.0, 9.0, 9.0, 0.04, 0.01, 9.0]),
                   PositionSource.RTK_FIXED, 0.1, 0.1, True)  # fmt: skip
    assert position_sigma_m(pose) == pytest.approx(0.2)
    assert bench.show(map_pose=pose).position_sigma_m == pytest.approx(0.2)
    assert position_sigma_m(replace(pose, covariance=np.diag([9, 9, 9, 0.01, 0.04, 9.0]))) == pytest.approx(0.2)
    assert position_sigma_m(replace(pose, covariance=np.zeros((6, 6)))) == 0.0
    assert position_sigma_m(replace(pose, covariance=-np.eye(6))) == 0.0


def test_driver_override_duration(bench: Bench) -> None:
    assert bench.show(machine={"driver_torque_nm": -2.0}).driver_override_s == 0.0
    assert bench.show(1.0).driver_override_s == 1.0
    assert bench.show(machine={"driver_torque_nm": 1.9}).driver_override_s == 0.0


def test_steering_deviation(bench: Bench) -> None:
    for error in around(0.04, 0.001):
        bench.show(mode=Mode.STANDBY)
        bench.show(mode=Mode.AUTOMATIC, machine={"curvature_radpm": 0.0})
        bench.show(machine={"curvature_radpm": error})
        assert (bench.show(0.5).steering_deviation_s > 0.0) == (error > 0.04), error
    assert bench.show(machine={"curvature_radpm": -0.1}).steering_deviation_s > 0.5
    assert bench.show(1.0).steering_deviation_s > 1.5
    assert bench.show(mode=Mode.STANDBY).steering_deviation_s == 0.0
    bench.show(mode=Mode.AUTOMATIC, machine={"curvature_radpm": math.nan})
    assert bench.show(1.0).steering_deviation_s == 1.0
    assert bench.show(machine=None).steering_deviation_s > 0.0
    assert bench.show(2.1).steering_deviation_s == 0.0


def test_interrupted_steering_deviation(bench: Bench) -> None:
    """Noise on the angle deviates from time to time; a single wrong value is forgotten."""
    for _ in range(5):
        bench.show(0.2, machine={"curvature_radpm": 0.0})
        bench.show(0.2, machine={"curvature_radpm": 0.1})
    assert bench.show(0.1, machine={"curvature_radpm": 0.0}).steering_deviation_s == pytest.approx(0.9)
    assert bench.show(2.1).steering_deviation_s == 0.0
    bench.show(-0.5, machine={"curvature_radpm": 0.1})
    assert bench.show(0.1).steering_deviation_s == pytest.approx(0.1)


def test_steering_delay(bench: Bench) -> None:
    bench.show(command=replace(COMMAND, curvature_radpm=0.1), machine={"curvature_radpm": 0.1})
    bench.show(command=COMMAND)
    assert bench.show(0.78).steering_deviation_s == 0.0
    bench.show(0.001)
    assert bench.show(0.2).steering_deviation_s == 0.2


def test_steering_speed_threshold(bench: Bench) -> None:
    for speed in around(0.3, 0.01):
        slow = {"speed_mps": speed, "curvature_radpm": 0.1, "is_steering_ready": False}
        bench.show(odom=odometry(speed), machine={"speed_mps": speed})
        bench.show(machine=slow)
        measured = bench.show(0.5)
        assert (measured.steering_deviation_s > 0.0) == (speed >= 0.3), speed
        assert (measured.steering_unavailable_s > 0.0) == (speed >= 0.3), speed


def test_steering_unavailable(bench: Bench) -> None:
    assert bench.show(machine={"is_steering_ready": False}).steering_unavailable_s == 0.0
    assert bench.show(0.5).steering_unavailable_s == 0.5
    assert bench.show(mode=Mode.MANUAL).steering_unavailable_s == 0.0
    bench.show(mode=Mode.AUTOMATIC)
    assert bench.show(0.5).steering_unavailable_s == 0.5
    assert bench.show(machine={}).steering_unavailable_s == 0.0
    assert bench.show(machine=None).steering_unavailable_s == 0.0


@pytest.mark.parametrize("sign", [1, -1])
def test_drive_ineffective(bench: Bench, sign: int) -> None:
    driving = replace(COMMAND, speed_mps=sign * 2.0, is_drive_enabled=True, deceleration_mps2=0.0)

    def stands(speed: float, command: SafeCommand | None = driving, mode: Mode = Mode.AUTOMATIC) -> bool:
        bench.show(odom=None, mode=Mode.AUTOMATIC)
        bench.show(odom=odometry(sign * speed), machine={"speed_mps": sign * speed}, command=command, mode=mode)
        return bench.show(0.5).drive_ineffective_s > 0.0

    for speed in around(0.4, 0.01):
        assert stands(speed) == (speed < 0.4), speed
    assert stands(0.0)
    assert stands(-1.0)  # it rolls back
    for asked in around(0.2, 0.01):
        assert stands(0.0, replace(driving, speed_mps=sign * asked)) == (asked >= 0.2), asked
    for command in (None, replace(driving, is_drive_enabled=False), replace(driving, deceleration_mps2=0.1)):
        assert not stands(0.0, command)
    assert not stands(0.0, mode=Mode.STANDBY)


def test_drive_that_stands_and_reports_motion(bench: Bench) -> None:
    braking = replace(COMMAND, speed_mps=0.0, is_drive_enabled=True, deceleration_mps2=1.0)

    def stands(speed: float, sent: float, command: SafeCommand = braking) -> bool:
        bench.show(odom=None, machine=None, mode=Mode.AUTOMATIC)
        bench.show(odom=odometry(speed), machine={"speed_mps": sent}, command=command)
        return bench.show(0.5).drive_ineffective_s > 0.0

    for sign in (1, -1):
        for sent in around(0.35, 0.01):
            assert stands(0.0, sign * sent) == (sent > 0.35), sent
    for speed in around(0.1, 0.01):
        assert stands(speed, 0.5) == (speed < 0.1), speed
    assert not stands(0.0, 0.5, replace(braking, is_drive_enabled=False))


@pytest.mark.parametrize("sign", [1, -1])
def test_brake_ineffective(bench: Bench, sign: int) -> None:
    braking = replace(COMMAND, deceleration_mps2=2.0)

    def weak(speed: float, felt: float, command: SafeCommand | None = braking) -> bool:
        bench.show(odom=None)
        bench.show(odom=odometry(sign * speed, -sign * felt), command=command)
        return bench.show(0.5).brake_ineffective_s > 0.0

    for felt in around(0.6, 0.01):
        assert weak(2.0, felt) == (felt < 0.6), felt
    assert weak(2.0, -1.0)  # it gains speed
    grade = odometry(sign * 2.0, sign * 0.0, sign * 0.2)  # downhill, of which the brake holds 1.95 m/s²
    for odom, is_weak in ((grade, False), (odometry(sign * 2.0, 0.0, -sign * 0.2), True)):
        bench.show(odom=None)
        bench.show(odom=odom, command=braking)
        assert (bench.show(0.5).brake_ineffective_s > 0.0) == is_weak
    for asked in around(1.0, 0.01):
        assert weak(2.0, 0.0, replace(braking, deceleration_mps2=asked)) == (asked >= 1.0), asked
    for speed in around(0.5, 0.01):
        assert weak(speed, 0.0) == (speed >= 0.5), speed
    assert not weak(2.0, 0.0, None)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("source", ["odom", "machine"])
def test_overspeed(bench: Bench, sign: int, source: str) -> None:
    command = replace(COMMAND, speed_mps=sign * 2.0)
    for speed in around(2.5, 0.01):
        bench.show(command=command, odom=odometry(2.0), machine={"speed_mps": 2.0})
        fast = odometry(sign * speed) if source == "odom" else {"speed_mps": sign * speed}
        bench.show(**{source: fast})
        assert (bench.show(0.1).overspeed_s > 0.0) == (speed > 2.5), speed


def test_overspeed_after_a_lowered_command(bench: Bench) -> None:
    bench.show()
    bench.show(command=replace(COMMAND, speed_mps=0.0))
    held = [bench.show(0.1).overspeed_s > 0.0 for _ in range(40)]  # 2 m/s, while 0.3 m/s² of slowing are expected
    assert 15 <= held.index(True) <= 17
    slowing = [bench.show(0.1, odom=odometry(v), machine={"speed_mps": v}) for v in np.arange(2.0, 0.0, -0.04)]
    assert slowing[-1].overspeed_s == 0.0


@pytest.mark.parametrize("idle", [{"mode": Mode.STANDBY}, {"command": None}])
def test_overspeed_only_while_engaged(bench: Bench, idle: dict[str, Any]) -> None:
    fast = {"odom": odometry(6.0), "machine": {"speed_mps": 6.0}}
    assert bench.show(**idle, **fast).overspeed_s == 0.0
    assert bench.show(1.0).overspeed_s == 0.0
    assert bench.show(0.1, mode=Mode.AUTOMATIC, command=COMMAND).overspeed_s == 0.0  # as fast as it was
    assert bench.show(1.0).overspeed_s == 0.0  # 0.33 m/s less are expected
    bench.show(1.0)
    assert bench.show(0.1).overspeed_s > 0.0
    assert bench.show(-0.2).overspeed_s == 0.0  # the clock was set back


def test_seat_off_delay(bench: Bench) -> None:
    assert not bench.show().has_driver
    assert bench.show(machine={"is_seat_occupied": True}).has_driver
    assert bench.show(machine={}).has_driver
    assert bench.show(1.0).has_driver
    assert bench.show(machine=None).has_driver
    assert not bench.show(machine={}).has_driver
    assert not bench.show(machine=None).has_driver
    assert bench.show(machine={"is_seat_occupied": True}).has_driver
    assert bench.show(5.0).has_driver


def control_command(speed: float = 2.0, acceleration: float = 0.0, curvature: float = 0.0) -> ControlCommand:
    return ControlCommand(START_NS, speed, acceleration, curvature, True, True, 1, 0.0, 0.0, 0.0, False)


def test_direction_sources() -> None:
    back = straight_path(direction=-1)
    assert direction_of(0.5, back, None, -1) == 1
    assert direction_of(-0.5, None, None, 1) == -1
    assert direction_of(0.05, back, control_command(2.0), 1) == -1
    assert direction_of(None, straight_path(), None, -1) == 1
    assert direction_of(0.0, None, control_command(-1.0), 1) == -1
    assert direction_of(0.0, None, control_command(1.0), -1) == 1
    assert direction_of(0.0, None, control_command(0.0), -1) == -1
    assert direction_of(0.0, None, None, -1) == -1


def test_driver_torque_and_position_sigma() -> None:
    for torque in around(2.0, 0.1):
        assert is_forced(machine_state(0, driver_torque_nm=-torque), 2.0) == (torque >= 2.0 - 1e-12), torque
    assert is_forced(machine_state(0, driver_torque_nm=math.nan), 2.0)
    assert not is_forced(None, 2.0)
    assert position_sigma_m(None) == 0.0

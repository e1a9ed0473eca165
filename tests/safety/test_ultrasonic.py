"""Ultrasonic source: confirmation, hold times, echo arc, tracks that explain an echo."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.strict import parse, read_yaml
from configs.vehicle import Mount, Ultrasonic
from geometry.pose2 import to_frame
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import UltrasonicRange
from safety.config import SafetyConfig
from safety.sources.ultrasonic import UltrasonicSource, cone_arc, ground_range_m, is_beyond, is_confirmed_by_track
from safety.supervisor_config import SupervisorConfig
from tests.safety.safety_world import ROOT, START_NS

STILL = Odometry(START_NS, np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))

SENSOR = Ultrasonic(mount=Mount(xyz_m=(3.5, 0.6, 0.7)), cone_deg=60.0, rate_hz=10.0, range_m=(0.25, 4.5),
                    range_sigma_m=0.01)  # fmt: skip

NONE = math.nan
CONFIG = parse(SupervisorConfig, read_yaml(ROOT / "configs/stack/safety.yaml"), "stack/safety.yaml")


def turned(roll_deg: float = 0.0, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> Ultrasonic:
    return SENSOR.model_copy(update={"mount": Mount(xyz_m=(3.5, 0.6, 0.7), rpy_deg=(roll_deg, pitch_deg, yaw_deg))})


def measure_all(
    config: SafetyConfig, ranges: list[float], speeds: Any = 0.0, every_ns: int = 100_000_000, **how: Any
) -> UltrasonicSource:
    source = UltrasonicSource("left", how.get("sensor", SENSOR), config.ultrasonic)
    for k, (range_m, speed) in enumerate(zip(ranges, np.broadcast_to(speeds, len(ranges)), strict=True)):
        source.update(
            UltrasonicRange(START_NS + k * every_ns, range_m), np.zeros(3), replace(STILL, speed_mps=float(speed))
        )
    return source


def is_confirmed(config: SafetyConfig, ranges: list[float], *args: Any, **how: Any) -> bool:
    return len(measure_all(config, ranges, *args, **how).echo_arc_odom_m) > 0


def test_initial_state(config: SafetyConfig) -> None:
    source = measure_all(config, [])
    assert (source.name, source.stamp_ns, source.echo_arc_odom_m.shape) == ("left", None, (0, 2))
    assert measure_all(config, [1.0, 1.0]).stamp_ns == START_NS + 100_000_000


def test_echo_range_limits(config: SafetyConfig) -> None:
    for range_m, counts in ((0.249, False), (0.25, True), (4.5, True), (4.501, False)):
        assert is_confirmed(config, [range_m] * 3) == counts, range_m
    ground = 0.9 * 0.7 / math.sin(math.radians(20.0))
    for further, counts in ((-0.001, True), (0.001, False)):
        assert is_confirmed(config, [ground + further] * 3, sensor=turned(pitch_deg=20.0)) == counts, further


def test_gate_with_object_speed(config: SafetyConfig) -> None:
    most = config.ultrasonic.gate_m + 0.1 * config.ultrasonic.max_object_speed_mps
    for side in (1, -1):
        for further, fits in ((-1e-6, True), (1e-6, False)):
            assert is_confirmed(config, [2.0, 2.0, 2.0 + side * (most + further)]) == fits, (side, further)


def test_motion_compensation(config: SafetyConfig) -> None:
    assert is_confirmed(config, [4.0, 3.5, 3.0], 5.0)
    assert not is_confirmed(config, [4.0, 4.0, 4.0], 5.0)
    assert is_confirmed(config, [4.0, 3.0, 2.6], [0.0, 10.0, 4.0])  # each way by the speed at its end


def test_window_length(config: SafetyConfig) -> None:
    assert is_confirmed(config, [2.0, 2.0, NONE, NONE, 2.0])
    assert not is_confirmed(config, [2.0, 2.0, NONE, NONE, NONE, 2.0])


def test_three_successive_echoes(config: SafetyConfig) -> None:
    for ranges, confirmed in (
        ([2.0], False), ([2.0, 2.0], False), ([2.0, 2.0, 2.0], True), ([2.0, NONE, 2.0, NONE, 2.0], True),
        ([2.0, 2.0, 3.0, 2.0], False), ([3.0, 2.0, 2.0, 2.0], True), ([2.0, 2.0, 2.0, 3.0], True),
        ([2.0, 4.6, 2.0, 2.0], True),  # beyond the reach: not an echo
    ):  # fmt: skip
        assert is_confirmed(config, ranges) == confirmed, ranges


def is_confirmed_by_vote(config: SafetyConfig, ranges: list[float]) -> bool:
    """Whether the newest echo agrees with two of the four measurements before: perception's way of confirmation."""
    *before, newest = ranges[-5:]
    gate_m, speed_mps = config.ultrasonic.gate_m, config.ultrasonic.max_object_speed_mps
    gates = [gate_m + 0.1 * k * speed_mps for k in range(len(before), 0, -1)]
    return sum(abs(old - newest) <= gate for old, gate in zip(before, gates, strict=True)) >= 2


@given(
    start_m=st.floats(1.0, 3.5),
    speed_mps=st.floats(-1.4, 1.4),
    noise_m=st.lists(st.floats(-0.03, 0.03), min_size=8, max_size=8),
    is_missed=st.lists(st.booleans(), min_size=8, max_size=8),
)
@settings(derandomize=True, deadline=None, max_examples=200)
def test_never_later_than_a_vote(start_m: float, speed_mps: float, noise_m: list[float], is_missed: list[bool]) -> None:
    ranges = [
        NONE if missed else start_m + 0.1 * k * speed_mps + noise
        for k, (noise, missed) in enumerate(zip(noise_m, is_missed, strict=True))
    ]
    for count in range(1, 9):
        if is_confirmed_by_vote(CONFIG, ranges[:count]):
            assert is_confirmed(CONFIG, ranges[:count]), ranges[:count]


def test_hold_times(config: SafetyConfig) -> None:
    for range_m, hold_ns in ((1.0, 500_000_000), (0.4, 10_000_000_000), (0.401, 500_000_000)):
        for later_ns, is_kept in ((0, True), (1000, False)):
            source = measure_all(config, [range_m] * 3)
            heard_ns = START_NS + 200_000_000
            source.update(UltrasonicRange(heard_ns + hold_ns + later_ns, NONE), np.zeros(3), STILL)
            assert (len(source.echo_arc_odom_m) > 0) == is_kept, (range_m, later_ns)
            assert source.echo_arc_odom_m.shape[1] == 2
    source.update(UltrasonicRange(heard_ns + hold_ns + 1_000_000_000, NONE), np.zeros(3), STILL)
    assert source.echo_arc_odom_m.shape == (0, 2)


def test_hold_by_present_distance(config: SafetyConfig) -> None:
    near = [1.0, 1.0, 1.0]
    assert is_confirmed(config, [*near, *[NONE] * 6], [0.0] * 3 + [2.0] * 6)
    assert not is_confirmed(config, [*near, *[NONE] * 6], [0.0] * 3 + [0.9] * 6)
    assert not is_confirmed(config, [4.0, 3.5, 3.0, *[NONE] * 6], [5.0] * 3 + [4.0] * 6)
    assert not is_confirmed(config, [0.3] * 3 + [NONE] * 6, [0.0] * 3 + [-1.0] * 6)


def test_axis_speed(config: SafetyConfig) -> None:
    source = UltrasonicSource("left", turned(yaw_deg=30.0), config.ultrasonic)
    odom = replace(STILL, speed_mps=2.0, lateral_mps=0.1, yaw_rate_radps=0.3)
    expected = math.cos(math.pi / 6) * (2.0 - 0.3 * 0.6) + math.sin(math.pi / 6) * (0.1 + 0.3 * 3.5)
    assert source._axis_mps(odom) == pytest.approx(expected)


def test_cone_arc() -> None:
    sensor = turned(yaw_deg=90.0)
    angle = np.radians([-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0])
    expected = np.column_stack([3.5 - 2.0 * np.sin(angle), 0.6 + 2.0 * np.cos(angle)])
    assert cone_arc(2.0, sensor, sensor.mount.T_base_sensor) == pytest.approx(expected)
    leaning = turned(pitch_deg=60.0)
    assert cone_arc(2.0, leaning, leaning.mount.T_base_sensor)[3] == pytest.approx([3.5 + 1.0, 0.6])


def test_arc_at_pose_of_stamp(config: SafetyConfig) -> None:
    source = measure_all(config, [2.0, 2.0])
    pose = np.array([5.0, -2.0, 0.7])
    source.update(UltrasonicRange(START_NS + 200_000_000, 2.1), pose, STILL)
    assert source.echo_arc_odom_m == pytest.approx(to_frame(pose, cone_arc(2.1, SENSOR, SENSOR.mount.T_base_sensor)))


def test_ground_range_of_level_axis() -> None:
    for slope, expected in ((-1e-6, math.inf), (-2e-6, 3.5e5), (0.5, math.inf), (0.0, math.inf)):
        T = np.eye(4)
        T[2, 0], T[2, 3] = slope, 0.7
        assert ground_range_m(T) == pytest.approx(expected), slope


def track(x: float, y: float, size: tuple[float, float], yaw: float = 0.0, **changes: Any) -> Track:
    one = Track(1, ObstacleClass.UNKNOWN, 0.9, np.array([x, y, 0.6]), np.zeros(3), np.eye(4),
                np.array([*size, 1.2]), yaw, 0, START_NS, True, ("radar_front", "lidar_front"))  # fmt: skip
    return replace(one, **changes)


ARC = np.array([[3.0, -1.0], [3.2, 0.0], [3.0, 1.0]])


@pytest.mark.parametrize("size", [(3.0, 0.5), (0.5, 3.0), (0.1, 0.1)])
@pytest.mark.parametrize("yaw", [0.0, 0.6, -2.0, math.pi / 2])
def test_track_match(size: tuple[float, float], yaw: float) -> None:
    c, s = math.cos(yaw), math.sin(yaw)
    for a, b, margin, answers in (
        (1, 0, 0.299, True), (1, 0, 0.301, False), (-1, 0, 0.299, True), (-1, 0, 0.301, False), (0, 1, 0.299, True),
        (0, 1, 0.301, False), (0, -1, 0.299, True), (0, -1, 0.301, False), (1, 1, 0.299, True), (1, 1, 0.301, False),
    ):  # fmt: skip
        along, across = a * (0.5 * size[0] + margin), b * (0.5 * size[1] + margin)
        x, y = 3.0 - (c * along - s * across), 1.0 - (s * along + c * across)
        assert is_confirmed_by_track(ARC[2:], Tracks(START_NS, (track(x, y, size, yaw),)), 0.3) == answers, (
            a,
            b,
            margin,
        )
    beside = track(3.0 + s * (0.5 * size[1] + 0.299), 1.0 - c * (0.5 * size[1] + 0.299), size, yaw)
    assert is_confirmed_by_track(ARC, Tracks(START_NS, (beside,)), 0.3)


def test_track_match_among_several() -> None:
    answers, away = track(3.0, 1.0, (0.2, 0.2)), track(30.0, 1.0, (0.2, 0.2))
    wide = replace(answers, size_m=np.array([1.1, 1.1, 0.5]))
    others = (away, replace(answers, is_confirmed=False), wide, track(3.0, 2.0, (0.2, 0.2)),
              replace(answers, sensors=("ultrasonic_left", "camera_front")))  # fmt: skip
    assert not is_confirmed_by_track(ARC, Tracks(START_NS, others), 0.3)
    assert is_confirmed_by_track(ARC, Tracks(START_NS, (*others, answers)), 0.3)
    assert not is_confirmed_by_track(ARC, None, 0.3)


def test_is_beyond() -> None:
    one = track(4.0, 6.0, (3.0, 4.0))
    for reach, is_far in ((0.0, False), (-0.001, True), (1.0, False)):
        assert is_beyond(one, 1.0, 2.0, reach) == is_far, reach

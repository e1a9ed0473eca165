"""Ultrasonic: stray echoes are rejected, near obstacles confirmed and held in the dead zone; no data is BLIND."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.strict import load, parse, read_yaml
from configs.vehicle import Implement, ImplementFile, Mount, Ultrasonic, Vehicle
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.perception import HealthState, ObstacleClass, Obstacles, SensorHealth
from messages.sensors import UltrasonicRange
from perception.ultrasonic.echoes import Echo, LastObject, axis_speed, held_range, is_valid_range, repeated_range
from perception.ultrasonic.health import UltrasonicHealth
from perception.ultrasonic.obstacles import UltrasonicConfig, UltrasonicObstacles, ground_range
from runtime.bus import NodeInbox

ROOT = Path(__file__).parents[3]
CONFIG = parse(
    UltrasonicConfig, read_yaml(ROOT / "configs/stack/perception.yaml")["ultrasonic"], "stack/perception.yaml"
)
VEHICLE = load(Vehicle, ROOT / "configs" / "machines" / "tractor_e.yaml")
HARROW: Implement = load(ImplementFile, ROOT / "configs" / "implements" / "harrow_6m.yaml").implement
REAR = Ultrasonic(
    mount=Mount(xyz_m=(-1.1, 0.5, 0.6), rpy_deg=(0.0, 0.0, 180.0)), cone_deg=30.0, rate_hz=10.0, range_m=(0.25, 4.0),
    range_sigma_m=0.02,
)  # fmt: skip
S, STEP = 1_000_000_000, 100_000_000
NAN = math.nan


def echoes(*ranges: float, closing_mps: float = 0.0) -> list[Echo]:
    return [Echo(S + k * STEP, r, closing_mps * k * 0.1) for k, r in enumerate(ranges)]


@pytest.mark.parametrize(
    ("ranges", "confirmed"),
    [
        ((), None),
        ((2.0,), None),
        ((2.0, 2.0), None),
        ((2.0, 2.0, 2.0), 2.0),
        ((NAN, NAN, NAN, NAN), None),
        ((2.0, NAN, 2.0, NAN, 2.0), 2.0),
        ((2.0, 2.0, 2.0, NAN, NAN), 2.0),  # two of five may be missed
        ((2.0, 2.0, NAN, NAN, NAN), None),
        ((1.0, 3.0, 2.0, 0.5, 3.9), None),  # cross-talk
        ((2.0, 2.0, 2.0, 0.7, 3.5), 2.0),  # strays do not hide an object
        ((2.0, 1.88, 1.76, 1.64, 1.52), 1.52),  # a walker comes
        ((3.0, 3.0, 1.0, 1.0, 1.0), 1.0),
    ],
)
def test_repeated_range(ranges: tuple[float, ...], confirmed: float | None) -> None:
    result = repeated_range(echoes(*ranges), CONFIG.echoes)
    assert result is None if confirmed is None else result == pytest.approx(confirmed)


def test_ego_motion_compensation() -> None:
    # 2 m/s towards a wall: 0.2 m a step, more than the gate; expected is the present range
    ranges = (3.0, 2.8, 2.6, 2.4, 2.2)
    assert repeated_range(echoes(*ranges, closing_mps=2.0), CONFIG.echoes) == pytest.approx(2.2)
    assert repeated_range(echoes(*ranges[:4], NAN, closing_mps=2.0), CONFIG.echoes) == pytest.approx(2.2)
    assert repeated_range(echoes(0.3, 0.1, 0.0, NAN, NAN, closing_mps=2.0), CONFIG.echoes) == 0.0


def test_old_echoes_are_ignored() -> None:
    old = [Echo(S, 2.0, 0.0), Echo(S + STEP, 2.0, 0.0)]
    window = round(CONFIG.echoes.window_s * S)
    assert repeated_range([*old, Echo(S + window, 2.0, 0.0)], CONFIG.echoes) == 2.0
    assert repeated_range([*old, Echo(S + window + 1, 2.0, 0.0)], CONFIG.echoes) is None


@given(st.lists(st.one_of(st.just(NAN), st.floats(0.0, 4.0)), max_size=8), st.floats(-1.0, 1.0))
@settings(derandomize=True, max_examples=200)
def test_confirmed_range_has_enough_echoes(ranges: list[float], closing: float) -> None:
    confirmed = repeated_range(echoes(*ranges, closing_mps=closing), CONFIG.echoes)
    recent = ranges[-CONFIG.echoes.window :]
    if confirmed is not None:
        assert sum(not math.isnan(r) for r in recent) >= CONFIG.echoes.min_agreeing
        assert 0.0 <= confirmed <= 4.0 + 0.1 * len(ranges)
    same = [r for r in recent if r == (recent[-1] if recent else 0)]
    if closing == 0.0 and len(same) >= CONFIG.echoes.min_agreeing:
        assert confirmed is not None


def test_object_entering_dead_zone_is_held() -> None:
    edge = REAR.range_m[0] + CONFIG.echoes.dead_zone_margin_m
    hold = round(CONFIG.echoes.hold_s * S)

    def held(last_m: float, after_ns: int, advance_m: float) -> float | None:
        return held_range(LastObject(S, last_m, 0.0), Echo(S + after_ns, NAN, advance_m), REAR, CONFIG.echoes)

    assert held(edge, STEP, 0.0) == REAR.range_m[0]
    assert held(edge + 0.001, STEP, 0.0) is None
    assert held(0.3, hold, 0.2) == pytest.approx(0.1)
    assert held(0.3, hold, 0.9) == 0.0
    assert held(0.3, hold + 1, 0.0) is None
    assert held(0.3, STEP, -CONFIG.echoes.release_m + 0.01) == REAR.range_m[0]
    assert held(0.3, STEP, -CONFIG.echoes.release_m) is None
    assert held_range(None, Echo(S, NAN, 0.0), REAR, CONFIG.echoes) is None


def test_axis_speed_with_lever_arm() -> None:
    odom = Odometry(S, np.eye(4), -0.5, 0.0, 0.0, 0.2, 0.0, np.zeros((6, 6)))
    assert axis_speed(odom, REAR.mount.T_base_sensor) == pytest.approx(0.5 + 0.2 * 0.5)


@pytest.mark.parametrize(
    ("value", "good"), [(NAN, True), (0.0, True), (4.4, True), (4.41, False), (-0.01, False), (math.inf, False)]
)
def test_valid_ranges(value: float, good: bool) -> None:
    assert is_valid_range(value, REAR) == good


class Bench:
    """Node with an inbox of given measurements, one per 0.1 s."""

    def __init__(self, node: UltrasonicObstacles | UltrasonicHealth) -> None:
        self.node, self.inbox, self.now_ns = node, NodeInbox(node), S

    def measure(self, range_m: float | None, speed_mps: float = 0.0) -> list[Message]:
        self.now_ns += STEP
        self.put("odom", Odometry(self.now_ns, np.eye(4), speed_mps, 0.0, 0.0, 0.0, 0.0, np.zeros((6, 6))))
        if range_m is not None:
            self.put("ultrasonic/rear", UltrasonicRange(self.now_ns, range_m))
        return self.step()

    def put(self, topic: str, message: Message) -> None:
        self.inbox.put(Envelope(topic, 0, message.stamp_ns, message))

    def step(self) -> list[Message]:
        self.inbox.now_ns = self.now_ns
        out = [message for _, message in self.node.step(self.now_ns, self.inbox)]
        self.inbox.clear()
        return out

    def obstacles(self, range_m: float, speed_mps: float = 0.0) -> Obstacles:
        (message,) = self.measure(range_m, speed_mps)
        assert isinstance(message, Obstacles)
        return message

    def health(self, range_m: float | None, speed_mps: float = 0.0) -> SensorHealth:
        (message,) = self.measure(range_m, speed_mps)
        assert isinstance(message, SensorHealth)
        return message


def test_position_of_obstacle_behind() -> None:
    bench = Bench(UltrasonicObstacles("rear", REAR, VEHICLE, None, CONFIG))
    counts = [len(bench.obstacles(2.0).yaw_rad) for _ in range(4)]
    assert counts == [0, 0, 1, 1]
    found = bench.obstacles(2.0)
    np.testing.assert_allclose(found.nearest_base_m[0, :2], [-3.1, 0.5], atol=1e-9)
    assert abs(found.yaw_rad[0]) == pytest.approx(math.pi)
    assert found.size_m[0, 1] == pytest.approx(2 * 2.0 * math.sin(math.radians(15)))
    assert found.sigma_m[0, 1] > found.sigma_m[0, 0]
    assert np.isnan(found.velocity_mps).all()
    np.testing.assert_allclose(found.class_scores, 1 / len(ObstacleClass))


def test_person_in_dead_zone_while_reversing() -> None:
    bench = Bench(UltrasonicObstacles("rear", REAR, VEHICLE, None, CONFIG))
    r = 1.0
    while r > REAR.range_m[0]:
        bench.obstacles(r, speed_mps=-0.5)
        r -= 0.05
    for _ in range(20):  # at rest, no echo
        assert len(bench.obstacles(NAN).yaw_rad) == 1
    for _ in range(11):  # half a metre forwards
        gone = bench.obstacles(NAN, speed_mps=0.5)
    assert len(gone.yaw_rad) == 0


def test_implement_ground_and_range_limit() -> None:
    for sensor, implement, range_m in (
        (REAR, HARROW, 0.5),
        (REAR.model_copy(update={"mount": Mount(xyz_m=(-1.1, 0.0, 0.6), rpy_deg=(0.0, 20.0, 180.0))}), None, 1.7),
        (REAR, None, 4.2),
    ):
        bench = Bench(UltrasonicObstacles("rear", sensor, VEHICLE, implement, CONFIG))
        assert all(len(bench.obstacles(range_m).yaw_rad) == 0 for _ in range(6))
        clear = Bench(UltrasonicObstacles("rear", sensor, VEHICLE, None, CONFIG))
        assert [len(clear.obstacles(min(range_m, 1.0)).yaw_rad) for _ in range(3)][-1] == 1
    assert ground_range(REAR) == math.inf


def test_reset_on_time_reversal() -> None:
    bench = Bench(UltrasonicObstacles("rear", REAR, VEHICLE, None, CONFIG))
    for _ in range(4):
        bench.obstacles(2.0)
    bench.now_ns = 0
    assert len(bench.obstacles(2.0).yaw_rad) == 0
    assert bench.measure(math.inf) == []
    assert bench.measure(None) == []


def test_no_echo_is_good_and_timeout_is_blind() -> None:
    bench = Bench(UltrasonicHealth("rear", REAR, CONFIG))
    first = bench.health(None)
    assert (first.state, first.reason) == (HealthState.BLIND, "no measurement yet")
    for _ in range(40):
        clear = bench.health(NAN, speed_mps=-0.5)
    assert (clear.state, clear.detection_range_m.tolist()) == (HealthState.GOOD, [REAR.range_m[1]])
    states = [bench.health(None).state for _ in range(5)]
    assert states == [HealthState.GOOD] * 3 + [HealthState.BLIND] * 2
    assert not bench.health(None).detection_range_m.any()
    assert math.degrees(clear.sector_edges_rad[1] - clear.sector_edges_rad[0]) == pytest.approx(REAR.cone_deg)


def test_constant_value_while_moving() -> None:
    bench = Bench(UltrasonicHealth("rear", REAR, CONFIG))
    assert all(bench.health(2.0).state is HealthState.GOOD for _ in range(40))
    states = [bench.health(2.0, speed_mps=-0.5) for _ in range(25)]
    assert states[19].state is HealthState.GOOD
    assert (states[-1].state, states[-1].reason) == (HealthState.BLIND, "sends the same value again")


def test_cross_talk_and_invalid_ranges() -> None:
    rng = np.random.default_rng(3)
    bench = Bench(UltrasonicHealth("rear", REAR, CONFIG))
    for _ in range(CONFIG.health.window):
        health = bench.health(float(rng.uniform(0.3, 4.0)))
    assert (health.state, health.reason) == (HealthState.DEGRADED, "echoes do not repeat: cross-talk")
    for k in range(3):
        assert bench.health(math.inf).rejected_count == k + 1
    steady = Bench(UltrasonicHealth("rear", REAR, CONFIG))
    assert all(steady.health(2.0 + float(rng.normal(0, 0.02))).state is HealthState.GOOD for _ in range(40))

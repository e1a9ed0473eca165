"""The executor: order, latency, busy nodes, staleness, faults and wiring."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from messages.errors import LogError, WiringError
from messages.faults import Fault, Response
from messages.message import Envelope
from messages.motion import Odometry
from messages.node import All, At, Every, Inbox, Latest, Node, On, Output, Read, Trigger, World
from messages.sensors import ImuSample, WheelSample
from runtime.executor import FAULT_TOPIC, Executor, check_wiring

MS = 1_000_000


class Wheels(World):
    """World with a wheel sample at each of the given times (ms)."""

    writes = ("wheel",)

    def __init__(self, times_ms: Sequence[int]) -> None:
        self.times = list(times_ms)

    def next_ns(self) -> int | None:
        return self.times[0] * MS if self.times else None

    def step(self, now_ns: int) -> Iterable[Output]:
        self.times.pop(0)
        return [("wheel", WheelSample(now_ns, now_ns / MS, 0.0))]


@dataclass
class Recorder(Node):
    """Stores the time (ms) and the speeds of each step; publishes an IMU sample."""

    name: str
    reads: dict[str, Read]
    writes: tuple[str, ...]
    runs: Trigger
    fails_at_ns: int = -1

    def __post_init__(self) -> None:
        self.seen: list[tuple[int, tuple[float, ...]]] = []

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        if now_ns == self.fails_at_ns:
            raise RuntimeError("injected")
        if isinstance(self.reads["wheel"], All):
            speeds = tuple(m.speed_mps for m in inbox.all("wheel", WheelSample))
        else:
            message = inbox.latest("wheel", WheelSample)
            speeds = () if message is None else (message.speed_mps,)
        self.seen.append((now_ns // MS, speeds))
        return [(topic, ImuSample(now_ns, np.zeros(3), np.zeros(3))) for topic in self.writes]


def drive(times_ms: Sequence[int], nodes: list[tuple[Node, int]]) -> list[Envelope]:
    log: list[Envelope] = []
    Executor(Wheels(times_ms), nodes, [log.append]).run(lambda: False)
    return log


def test_output_latency() -> None:
    node = Recorder("a", {"wheel": Latest()}, ("imu",), On(("wheel",)))
    log = drive([0, 10, 20], [(node, 3 * MS)])
    assert [(e.topic, e.receive_ns // MS) for e in log] == [
        ("wheel", 0), ("imu", 3), ("wheel", 10), ("imu", 13), ("wheel", 20), ("imu", 23),
    ][: len(log)]  # fmt: skip
    assert len(log) >= 5


def test_busy_node_reads_newest_message() -> None:
    node = Recorder("a", {"wheel": Latest()}, (), On(("wheel",)))
    drive([0, 10, 20, 30, 60], [(node, 25 * MS)])
    assert node.seen == [(0, (0.0,)), (25, (20.0,)), (50, (30.0,)), (75, (60.0,))][:3]


def test_all_returns_each_message_once_up_to_its_maximum() -> None:
    node = Recorder("a", {"wheel": All(2)}, (), Every(30 * MS))
    drive(range(0, 70, 10), [(node, MS)])
    assert node.seen == [(0, (0.0,)), (30, (20.0, 30.0)), (60, (50.0, 60.0))]


def test_delivery_before_steps_at_equal_time() -> None:
    first = Recorder("first", {"wheel": Latest()}, (), Every(10 * MS))
    drive([0, 10], [(first, MS)])
    assert first.seen == [(0, (0.0,)), (10, (10.0,))]


@pytest.mark.parametrize(("age_ms", "is_seen"), [(99, True), (100, True), (101, False), (200, False)])
def test_staleness_limit(age_ms: int, is_seen: bool) -> None:
    node = Recorder("a", {"wheel": Latest()}, (), Every(age_ms * MS))
    drive([0, age_ms + 1], [(node, MS)])
    assert bool(node.seen[1][1]) is is_seen


def test_node_exception_fault() -> None:
    bad = Recorder("bad", {"wheel": Latest()}, (), On(("wheel",)), fails_at_ns=10 * MS)
    good = Recorder("good", {"wheel": Latest()}, (), On(("wheel",)))
    log = drive([0, 10, 20, 30], [(bad, MS), (good, MS)])
    faults = [e for e in log if e.topic == FAULT_TOPIC]
    assert len(faults) == 1
    assert isinstance(faults[0].message, Fault)
    assert "injected" in faults[0].message.text_en
    assert (len(bad.seen), len(good.seen)) == (1, 4)


def test_sequence_numbers_count_from_zero_on_each_topic() -> None:
    node = Recorder("a", {"wheel": Latest()}, ("imu",), On(("wheel",)))
    log = drive([0, 10, 20], [(node, MS)])
    assert [e.sequence for e in log if e.topic == "wheel"] == [0, 1, 2]


def test_at_interpolation_limits() -> None:
    def odometry(ms: int) -> Odometry:
        T = np.eye(4)
        T[0, 3] = ms
        return Odometry(ms * MS, T, 1.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))

    class Drive(Wheels):
        writes = ("wheel", "odom")

        def step(self, now_ns: int) -> Iterable[Output]:
            return [*super().step(now_ns), ("odom", odometry(now_ns // MS))]

    places: list[tuple[float | None, ...]] = []

    class Reader(Node):
        name, reads, writes, runs = "r", {"odom": At(0.05)}, (), On(("wheel",))

        def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
            found = [inbox.at("odom", Odometry, now_ns + d * MS) for d in (-5, 0, 1, -60)]
            places.append(tuple(None if m is None else round(float(m.T_odom_base[0, 3]), 6) for m in found))
            return []

    Executor(Drive([0, 10, 20, 80, 90]), [(Reader(), MS)], []).run(lambda: False)
    assert places[2] == (15.0, 20.0, None, None)
    assert places[4] == (85.0, 90.0, None, None)


def test_wiring_errors() -> None:
    world = Wheels([0])
    reader = Recorder("r", {"wheel": Latest()}, ("imu",), Every(10 * MS))
    check_wiring(world, [(reader, 9 * MS)], cores=1)
    duplicate = Recorder("w", {"wheel": Latest()}, ("wheel",), Every(10 * MS))
    with pytest.raises(WiringError, match=r"'wheel' has two writers: world and w"):
        check_wiring(world, [(duplicate, MS)], cores=1)
    unwritten = Recorder("r", {"gnss/main": Latest()}, (), Every(10 * MS))
    with pytest.raises(WiringError, match="gnss/main"):
        check_wiring(world, [(unwritten, MS)], cores=1)
    with pytest.raises(WiringError, match="latency 0 ns"):
        check_wiring(world, [(reader, 0)], cores=1)
    with pytest.raises(WiringError, match=r"1\.10 cores"):
        check_wiring(world, [(reader, 11 * MS)], cores=1)
    with pytest.raises(WiringError, match="its kind is not"):
        check_wiring(world, [(Recorder("r", {"wheel": Latest()}, ("nonsense",), Every(MS)), 1)], cores=1)


class DelayingTap:
    """Tap that delays every second message by 15 ms."""

    def __init__(self) -> None:
        self.held: list[tuple[int, Output]] = []
        self.count = 0

    def next_ns(self) -> int | None:
        return min((due for due, _ in self.held), default=None)

    def due(self, now_ns: int) -> list[Output]:
        come = [output for due, output in self.held if due <= now_ns]
        self.held = [(due, output) for due, output in self.held if due > now_ns]
        return come

    def apply(self, now_ns: int, outputs: list[Output]) -> list[Output]:
        self.count += 1
        if self.count % 2:
            return outputs
        self.held += [(now_ns + 15 * MS, output) for output in outputs]
        return []


def test_tap_delay() -> None:
    seen: list[Envelope] = []
    Executor(Wheels([10, 20, 30, 50]), [], (seen.append,), DelayingTap()).run(lambda: False)
    assert [(e.receive_ns // MS, e.message.stamp_ns // MS) for e in seen] == [(10, 10), (30, 30), (35, 20)]


def test_log_failure_fault_and_error() -> None:
    seen: list[Envelope] = []

    def full(envelope: Envelope) -> None:
        if envelope.receive_ns >= 20 * MS:
            raise LogError("full")

    with pytest.raises(LogError, match="full"):
        Executor(Wheels([10, 20, 30, 40]), [], (full, seen.append)).run(lambda: False)
    faults = [e.message for e in seen if isinstance(e.message, Fault)]
    assert [(f.code, f.source, f.response) for f in faults] == [("log.failed", "log", Response.CONTROLLED_STOP)]
    assert seen[-1].receive_ns == 40 * MS


def test_backward_clock_step() -> None:
    node = Recorder("node", {"wheel": Latest()}, ("imu",), Every(10 * MS))
    hour = 3_600_000
    executor = Executor(Wheels([hour, hour + 10, hour + 20, 10, 20, 30, 40]), [(node, 5 * MS)], ())
    executor.run(lambda: False)
    assert [t for t, _ in node.seen] == [hour, hour + 10, hour + 20, 10, 20, 30, 40]


def test_forward_clock_step() -> None:
    node = Recorder("node", {"wheel": Latest()}, ("imu",), Every(10 * MS))
    hour = 3_600_000
    Executor(Wheels([10, 20, hour, hour + 10]), [(node, 5 * MS)], ()).run(lambda: False)
    assert [t for t, _ in node.seen] == [10, 20, hour, hour + 10]

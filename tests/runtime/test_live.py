"""Links between the processes of the live stack: rings, records, CAN bus on this computer alone; passive logging."""

import json
import multiprocessing
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import can
import numpy as np
import pytest

from messages.errors import HeadlandError
from messages.faults import Fault
from messages.message import Envelope
from messages.node import Every, Latest, Node
from messages.sensors import LidarScan, WheelSample
from messages.timing import NodeTiming
from runtime.live.can_bus import LOOPBACK, PunctualBus, named_bus, open_bus
from runtime.live.clock import Clock
from runtime.live.live_executor import LiveExecutor, NoWorld, ProcessLinks
from runtime.live.process import wait_for_start
from runtime.live.ring import LAP_BYTES, RingReader, RingWriter, make_ring
from runtime.live.serialization import pack, unpack
from runtime.live.shadow import Listener

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def ring(tmp_path: Path) -> Path:
    path = tmp_path / "ring"
    make_ring(path, 4096)
    return path


def test_ring_order_over_many_wraps(ring: Path) -> None:
    writer, reader = RingWriter(ring), RingReader(ring)
    random = np.random.default_rng(1)
    for _ in range(2000):
        sent = [random.bytes(int(random.integers(0, 700))) or b"x" for _ in range(int(random.integers(0, 5)))]
        for record in sent:
            writer.write(record)
        assert list(reader.records()) == sent
    assert reader.lost == 0


def test_a_large_ring_with_few_messages_takes_no_more_memory(tmp_path: Path) -> None:
    path = tmp_path / "large"
    make_ring(path, 64 << 20)
    writer, reader = RingWriter(path), RingReader(path)
    random = np.random.default_rng(2)
    taken = []
    for k in range(400):
        writer.beat(k * 10_000_000_000)
        sent = [random.bytes(3_000_000 if k in (50, 51) else 20_000) for _ in range(5)]
        for record in sent:
            writer.write(record)
        assert list(reader.records()) == sent
        taken.append(path.stat().st_blocks * 512)
    assert reader.lost == 0
    assert LAP_BYTES <= taken[49] < 2 * LAP_BYTES
    assert taken[-1] == taken[60] < 40e6


def test_slow_reader_counts_loss_and_continues(ring: Path) -> None:
    writer, reader = RingWriter(ring), RingReader(ring)
    for k in range(100):
        writer.write(bytes([k]) * 300)
    assert all(len(set(record)) == 1 for record in reader.records())
    assert reader.lost == 1
    writer.write(b"new")
    assert list(reader.records()) == [b"new"]


def test_corrupt_record_is_skipped(ring: Path) -> None:
    writer, reader = RingWriter(ring), RingReader(ring)
    writer.write(b"hello world")
    raw = bytearray(ring.read_bytes())
    raw[64 + 8 + 3] ^= 1
    ring.write_bytes(raw)
    assert list(RingReader(ring).records()) == []
    assert list(reader.records()) == []


def test_oversized_record_is_refused(ring: Path) -> None:
    with pytest.raises(ValueError, match="1025"):
        RingWriter(ring).write(bytes(1025))


def test_serialization_round_trip_and_topic_filter() -> None:
    scan = LidarScan(7, np.arange(600, dtype=np.uint16).reshape(2, 300), np.zeros(2), np.zeros(300),
                     np.zeros((0, 3), np.float32), np.zeros(0, np.uint8), np.zeros(300, np.float32))  # fmt: skip
    record = pack(("lidar/front", scan))
    assert unpack(record, {"lidar/rear"}) is None
    found = unpack(record, {"lidar/front"})
    assert found is not None
    assert found[0] == "lidar/front"
    assert np.array_equal(found[1].ranges_mm, scan.ranges_mm)
    assert unpack(b"\x03xyz123", None) is None


class WheelReader(Node):
    """Stores the speeds received on the wheel topic."""

    name, reads, writes, runs = "echo", {"wheel": Latest()}, ("imu",), Every(5_000_000)

    def __init__(self) -> None:
        self.speeds: list[float] = []

    def step(self, now_ns, inbox):  # type: ignore[no-untyped-def]
        message = inbox.latest("wheel", WheelSample)
        self.speeds += [] if message is None else [message.speed_mps]
        return []


def test_message_exchange_and_heartbeat_timeout(tmp_path: Path) -> None:
    for name in ("own", "other"):
        make_ring(tmp_path / name, 65536)
    clock = Clock(1_000_000_000_000, time.monotonic_ns())
    other = RingWriter(tmp_path / "other")
    links = ProcessLinks(RingWriter(tmp_path / "own"), {"other": RingReader(tmp_path / "other")}, {"other": 0.1}, 0.1)
    node, received = WheelReader(), list[Envelope]()
    executor = LiveExecutor(NoWorld(), [node], [received.append], clock, links)
    outside = RingReader(tmp_path / "own")
    other.write(pack(("wheel", WheelSample(clock(), 2.5, 0.0))))
    other.beat(clock())
    until_ns = clock() + 1_200_000_000
    executor.run(lambda: clock() > until_ns)
    assert 2.5 in node.speeds
    faults = [e.message for e in received if isinstance(e.message, Fault)]
    assert [(f.code, f.source) for f in faults] == [("process.silent", "other")]
    sent = [unpack(record, None) for record in outside.records()]
    assert [message.code for _, message in sent if isinstance(message, Fault)] == ["process.silent"]  # type: ignore[misc]
    ((topic, timing),) = [output for output in sent if output is not None and isinstance(output[1], NodeTiming)]
    assert topic == "node_timing/echo"
    assert isinstance(timing, NodeTiming)
    assert 2 <= timing.steps <= 240  # it is due every 5 ms, and skips what it was late for
    assert 0.0 < timing.mean_s <= timing.longest_s < 1.3


def test_process_has_longer_at_the_start(tmp_path: Path) -> None:
    for name in ("own", "late", "never"):
        make_ring(tmp_path / name, 65536)
    clock = Clock(1_000_000_000_000, time.monotonic_ns())
    others = {name: RingReader(tmp_path / name) for name in ("late", "never")}
    links = ProcessLinks(RingWriter(tmp_path / "own"), others, {"late": 0.1, "never": 0.1}, 0.5)
    received, late = list[Envelope](), RingWriter(tmp_path / "late")
    executor = LiveExecutor(NoWorld(), [], [received.append], clock, links)
    began_ns = clock()

    def beats() -> bool:
        since_ns = clock() - began_ns
        if since_ns > 300_000_000 and not 320_000_000 < since_ns < 470_000_000:
            late.beat(clock())
        return since_ns > 800_000_000

    def faults() -> list[Fault]:
        return [e.message for e in received if isinstance(e.message, Fault)]

    executor.run(beats)
    assert [(fault.source, fault.is_active, fault.is_latched) for fault in faults()] == [("never", True, True)]
    late.beat(clock() - 200_000_000)
    executor.run(lambda: len(faults()) == 2)
    late.beat(clock())
    executor.run(lambda: len(faults()) == 3)
    assert [(fault.source, fault.is_active) for fault in faults()[1:]] == [("late", True), ("late", False)]


def test_process_that_waits_for_the_start_ends_when_it_is_asked() -> None:
    """An orphan waited for `startup_s`, 5 min, and its folder was locked."""
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(2)
    process = context.Process(target=wait_for_start, args=(barrier, os.getpid(), 120.0))
    process.start()
    while barrier.n_waiting == 0:
        time.sleep(0.01)
    process.terminate()
    process.join(30.0)
    assert process.exitcode == 0


def frame(k: int) -> can.Message:
    return can.Message(arbitration_id=0x0CFE48F0, data=bytes([k] * 8), is_extended_id=True)


@pytest.fixture
def pair() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    name = named_bus(LOOPBACK)
    with open_bus(name) as own, open_bus(name) as other:
        yield own, other


def test_loopback_bus_receives_frames_of_others_only(pair: tuple[can.BusABC, can.BusABC]) -> None:
    own, other = pair
    own.send(frame(1))
    other.send(frame(1))  # equal to an own frame
    other.send(frame(2))
    received = [own.recv(0.2) for _ in range(2)]
    assert [f.data[0] for f in received if f] == [1, 2]
    assert all(f and abs(f.timestamp - time.time()) < 1.0 for f in received)
    assert own.recv(0.01) is None
    assert [(f.arbitration_id, bytes(f.data)) for f in [other.recv(0.2)] if f] == [(0x0CFE48F0, bytes([1] * 8))]


def test_late_machine_receives_a_frame_at_its_arrival(pair: tuple[can.BusABC, can.BusABC]) -> None:
    bus = PunctualBus(pair[0])
    bus.until_s = time.time()
    pair[1].send(frame(1))
    time.sleep(0.02)
    between_s = time.time()
    pair[1].send(frame(2))
    time.sleep(0.02)
    assert bus.recv(0) is None
    bus.until_s = between_s
    assert [bus.recv(0) is None for _ in range(2)] == [False, True]
    bus.until_s = time.time()
    received = bus.recv(0)
    assert received is not None
    assert received.data[0] == 2
    with patch("runtime.live.can_bus.time.time", return_value=between_s - 100.0):  # the wall clock has been set back
        pair[1].send(frame(3))
        time.sleep(0.02)
        assert bus.recv(0) is not None


@pytest.mark.parametrize("data", [b"", b"junk", bytes(15), b"\xff" * 16, bytes(17), bytes(5000)])
def test_datagram_that_is_no_frame_is_an_error_frame(pair: tuple[can.BusABC, can.BusABC], data: bytes) -> None:
    group, port = pair[0].channel_info.split(":")[1:]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        sender.sendto(data, (group, int(port)))
    received = pair[0].recv(0.2)
    assert received is not None
    assert received.is_error_frame


def test_two_runs_do_not_hear_each_other(pair: tuple[can.BusABC, can.BusABC]) -> None:
    port = pair[0].channel_info.split(":")[2]
    others = [named_bus(LOOPBACK), f"{LOOPBACK}:239.74.0.1:{port}"]  # even at the same port
    for name in others:
        with open_bus(name) as stranger:
            stranger.send(frame(1))
            pair[0].send(frame(2))
            assert stranger.recv(0.05) is None
    assert pair[0].recv(0.05) is None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unicast:
        unicast.sendto(bytes(16), ("127.0.0.1", int(port)))
    assert pair[0].recv(0.05) is None


@pytest.mark.parametrize(
    "name", ["can0", "socketcan", "udp_multicast:239.74.163.2", "virtual:x", "none:x", "", "loopback:", ":x"]
)
def test_bus_names_that_are_refused(name: str) -> None:
    with pytest.raises(HeadlandError, match=f"--bus {name}: loopback"):
        named_bus(name)


@pytest.mark.parametrize(
    "name", ["socketcan:absent0", "loopback:x", "loopback:127.0.0.1:9:9", "loopback:239.1.1.1:99999", "pcan:absent"]
)
def test_bus_that_cannot_be_opened_is_named(name: str) -> None:
    with pytest.raises(HeadlandError, match=f"^CAN bus {name} cannot be opened \\(.+\\)$"):
        open_bus(named_bus(name))


def test_listener_never_answers(tmp_path: Path) -> None:
    listener = Listener(240, 28)
    listener.receive(1, can.Message(arbitration_id=0x18EAFFF0, data=bytes.fromhex("00ee00"), is_extended_id=True))
    listener.receive(1, frame(1))
    assert not hasattr(listener, "send")
    topics = [topic for topic, _ in listener.due(200_000_000)]
    assert topics == ["machine", "can/rx"]
    assert listener.receiver.claims == []


def test_shadow_receives_and_sends_nothing(tmp_path: Path) -> None:
    bus = open_bus(named_bus(LOOPBACK))
    words = [sys.executable, "-m", "runtime", "shadow", "--bus", bus.channel_info,
             "--duration", "2", "--json", "--out", str(tmp_path / "run")]  # fmt: skip
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    sent = received = 0
    while process.poll() is None:
        bus.send(frame(3))
        sent += 1
        received += bus.recv(0.02) is not None
    result = json.loads(process.communicate()[0])
    bus.shutdown()
    assert 0 < result["frames"] <= sent
    assert received == 0


PRIORITY = """
import os, threading
from runtime.live.config import LiveConfig
from runtime.live.process import take_priority
from configs.strict import CONFIGS, load
take_priority("ROLE", load(LiveConfig, CONFIGS / "live.yaml"))
policies = [os.sched_getscheduler(0)]
thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
thread.start()
thread.join()
print(*(policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO for policy in policies))
"""


@pytest.mark.parametrize("role", ["safety", "machine", "log"])
def test_real_time_priority_of_a_process_but_not_of_its_threads(role: str) -> None:
    command = [sys.executable, "-c", PRIORITY.replace("ROLE", role)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    is_realtime, is_thread_realtime = (word == "True" for word in done.stdout.split())
    is_refused = "no permission for real-time priority" in done.stderr
    assert not is_thread_realtime
    if role == "log":
        assert not is_realtime
    elif role == "safety":
        assert is_realtime != is_refused

"""Links between the processes of the live stack: rings, records, CAN bus without echo; and passive logging."""

import itertools
import json
import subprocess
import sys
import time
from pathlib import Path

import can
import numpy as np
import pytest

from configs.strict import CONFIGS, load
from messages.faults import Fault
from messages.message import Envelope
from messages.node import Every, Latest, Node
from messages.sensors import LidarScan, WheelSample
from runtime.live.can_bus import SharedBus
from runtime.live.clock import Clock
from runtime.live.config import LiveConfig
from runtime.live.live_executor import LiveExecutor, NoWorld, ProcessLinks
from runtime.live.ring import RingReader, RingWriter, make_ring
from runtime.live.serialization import pack, unpack
from runtime.live.shadow import Listener

ROOT = Path(__file__).resolve().parents[2]
NUMBERS = itertools.count()


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
    links = ProcessLinks(RingWriter(tmp_path / "own"), {"other": RingReader(tmp_path / "other")}, {"other": 0.1})
    node, received = WheelReader(), list[Envelope]()
    executor = LiveExecutor(NoWorld(), [node], [received.append], clock, links)
    outside = RingReader(tmp_path / "own")
    other.write(pack(("wheel", WheelSample(clock(), 2.5, 0.0))))
    other.beat(clock())
    until_ns = clock() + 200_000_000
    executor.run(lambda: clock() > until_ns)
    assert 2.5 in node.speeds
    faults = [e.message for e in received if isinstance(e.message, Fault)]
    assert [(f.code, f.source) for f in faults] == [("process.silent", "other")]
    sent = [unpack(record, None) for record in outside.records()]
    assert [message.code for _, message in sent if isinstance(message, Fault)] == ["process.silent"]  # type: ignore[misc]


def frame(k: int) -> can.Message:
    return can.Message(arbitration_id=0x0CFE48F0, data=bytes([k] * 8), is_extended_id=True)


def test_echo_of_own_frames_is_dropped() -> None:
    channel = f"echo{next(NUMBERS)}"
    own = SharedBus(can.Bus(channel, interface="virtual", receive_own_messages=True))
    other = can.Bus(channel, interface="virtual")
    own.send(frame(1))
    other.send(frame(1))
    other.send(frame(2))
    received = []
    while (found := own.recv(0)) is not None:
        received.append(found.data[0])
    assert received == [1, 2]
    own.shutdown()
    other.shutdown()


def test_listener_never_answers(tmp_path: Path) -> None:
    listener = Listener(240, 28)
    listener.receive(1, can.Message(arbitration_id=0x18EAFFF0, data=bytes.fromhex("00ee00"), is_extended_id=True))
    listener.receive(1, frame(1))
    assert not hasattr(listener, "send")
    topics = [topic for topic, _ in listener.due(200_000_000)]
    assert topics == ["machine", "can/rx"]
    assert listener.receiver.claims == []


def test_shadow_receives_and_sends_nothing(tmp_path: Path) -> None:
    group, port = "239.74.163.2", load(LiveConfig, CONFIGS / "live.yaml").can.port
    try:
        bus = can.Bus(interface="udp_multicast", channel=group, port=port)
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast here: {error}")
    words = [sys.executable, "-m", "runtime", "shadow", "--bus", group, "--interface", "udp_multicast",
             "--duration", "2", "--json", "--out", str(tmp_path / "run")]  # fmt: skip
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    sent = looped = 0
    while process.poll() is None:
        bus.send(frame(3))
        sent += 1
        while bus.recv(0.02) is not None:
            looped += 1
    result = json.loads(process.communicate()[0])
    bus.shutdown()
    assert 0 < result["frames"] <= sent
    assert looped == sent  # loop-back of the own frames only

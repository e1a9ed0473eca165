"""Feeds of the page: rings of a running drive, its run folder, and the position in a log."""

import json
from pathlib import Path

import numpy as np
import pytest

from datasets.log import LogWriter
from hmi.feed import Playback, is_event, is_shown
from messages.command import Mode
from messages.errors import HeadlandError, LogError
from messages.message import Envelope, Message
from messages.sensors import ImuSample, LidarScan
from runtime.live.ring import RingWriter, make_ring
from runtime.live.serialization import header, pack
from runtime.page.live_feed import LiveFeed
from runtime.page.log_feed import LogFeed
from runtime.page.running import running_drive
from runtime.stack import load_stack
from tests.hmi.drive_messages import NOW_NS, SECOND_NS, fault, map_pose, odometry, supervisor


class Ring:
    """A ring and the feed that reads it."""

    def __init__(self, folder: Path) -> None:
        make_ring(folder / "safety", 1 << 20)
        self._writer = RingWriter(folder / "safety")
        self.feed = LiveFeed({"safety": folder / "safety"})

    def write(self, topic: str, message: Message) -> None:
        self._writer.write(pack((topic, message)))

    def write_bytes(self, record: bytes) -> None:
        self._writer.write(record)


@pytest.fixture
def ring(tmp_path: Path) -> Ring:
    return Ring(tmp_path)


def test_newest_message_of_a_topic_and_every_event(ring: Ring) -> None:
    for k in range(50):
        ring.write("odom", odometry(float(k), 0.0, stamp_ns=NOW_NS + k))
    ring.write("fault/supervisor", fault(True))
    ring.write("fault/supervisor", fault(False))
    found = [(envelope.topic, envelope.message) for envelope in ring.feed.poll()]
    assert [topic for topic, _ in found] == ["odom", "fault/supervisor", "fault/supervisor"]
    assert found[0][1].stamp_ns == NOW_NS + 49
    assert list(ring.feed.poll()) == []


def test_topics_that_are_not_shown_are_not_decoded(ring: Ring) -> None:
    ring.write_bytes(bytes([11]) + b"lidar/front" + b"no scan at all")
    ring.write_bytes(bytes([4]) + b"odom" + b"\xff\xff\xff")
    ring.write_bytes(bytes([250]) + b"\xff")
    assert list(ring.feed.poll()) == []


def test_a_recording_gets_every_message_and_the_newest_whole_scan(ring: Ring) -> None:
    """Of a scan that was thinned out the topic alone is in the ring."""
    scan = LidarScan(
        NOW_NS, np.zeros((1, 2), np.uint16), np.zeros(1), np.zeros(2), np.zeros((0, 3), np.float32),
        np.zeros(0, np.uint8), np.zeros(2, np.float32),
    )  # fmt: skip
    topics = ["imu"] * 20 + ["lidar/front"]
    for is_recording in (False, True):
        ring.feed.is_recording = is_recording
        for k in range(20):
            ring.write("imu", ImuSample(NOW_NS + k, np.zeros(3), np.zeros(3)))
        ring.write("lidar/front", scan)
        ring.write_bytes(header("lidar/front"))
        assert [envelope.topic for envelope in ring.feed.poll()] == (topics if is_recording else [])


def test_time_passes_while_nothing_arrives(ring: Ring) -> None:
    ring.write("supervisor", supervisor(Mode.STANDBY))
    list(ring.feed.poll())
    first_ns = ring.feed.now_ns
    assert first_ns == NOW_NS
    list(ring.feed.poll())
    assert 0 < ring.feed.now_ns - first_ns < SECOND_NS


def test_a_slow_simulation_is_not_silent(ring: Ring) -> None:
    """Stamps that advance slower than the clock: the newest one is the present."""
    for k in range(5):
        ring.write("map_pose", map_pose(stamp_ns=NOW_NS + k))
        list(ring.feed.poll())
        assert ring.feed.now_ns == NOW_NS + k


def test_what_the_page_reads() -> None:
    assert all(is_shown(topic) for topic in ("supervisor", "health/lidar_front", "gnss/main", "fault/orders"))
    assert not any(is_shown(topic) for topic in ("lidar/front", "camera/front", "truth_objects", "obstacles/x", ""))
    assert is_event("fault/gateway")
    assert not is_event("odom")


@pytest.mark.parametrize(
    ("first_line", "message"),
    [
        (None, "not the run folder"),
        ("no json", "not the run folder"),
        ("[1]", "no drive of `headland live` is running"),
        (json.dumps({"record": "conditions"}), "no drive of `headland live` is running"),
        (json.dumps({"record": "conditions", "rings": "/dev/shm/none", "order_port": "1"}), "no drive"),
    ],
)
def test_folder_without_a_running_drive_is_refused(tmp_path: Path, first_line: str | None, message: str) -> None:
    if first_line is not None:
        (tmp_path / "result.jsonl").write_text(first_line + "\n")
    with pytest.raises(HeadlandError, match=message):
        running_drive(tmp_path)


def test_log_without_a_supervisor_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path, {}, load_stack().datasets.log) as log:
        log.write(Envelope("odom", 0, NOW_NS, odometry(0.0, 0.0)))
    with pytest.raises(LogError, match="no messages of the supervisor"):
        LogFeed(path)


def test_playback_stays_within_the_log() -> None:
    playback = Playback(60.0, (10.0, 30.0))
    playback.advance(5.0)
    playback.set_rate(20.0)
    playback.advance(1.0)
    assert playback.position_s == 25.0
    playback.advance(1000.0)
    assert playback.position_s == 60.0
    playback.seek(-3.0)
    assert playback.position_s == 0.0
    playback.is_paused = True
    playback.advance(5.0)
    assert playback.position_s == 0.0
    for rate, expected in ((0.1, 1.0), (50.0, 20.0), (5.0, 5.0)):
        playback.set_rate(rate)
        assert playback.rate == expected


def test_next_stop_is_after_the_position() -> None:
    playback = Playback(60.0, (10.0, 30.0))
    assert playback.seek_next_stop()
    assert playback.position_s == 8.0
    assert playback.seek_next_stop()
    assert playback.position_s == 28.0
    assert not playback.seek_next_stop()
    assert playback.position_s == 28.0

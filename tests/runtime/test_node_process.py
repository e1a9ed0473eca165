"""Nodes in a process of their own: the same messages, faults for exceptions, and no process left behind."""

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from messages.errors import HeadlandError
from messages.faults import Fault
from messages.message import Envelope
from messages.node import All, Every, Inbox, Latest, Node, On, Output, Read, Trigger, World
from messages.sensors import CameraImage, ImuSample, LidarScan, WheelSample
from runtime.executor import FAULT_TOPIC, Executor
from runtime.live.serialization import pack, unpack
from runtime.node_process import PIPE_BYTES, NodeProcess, node_process
from tests.recordings import ROOT

MS = 1_000_000


def scan(stamp_ns: int) -> LidarScan:
    """Range image with a value that depends on the stamp."""
    ranges = np.full((2, 3), 1000 + stamp_ns // MS, np.uint16)
    empty = np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)
    return LidarScan(stamp_ns, ranges, np.zeros(2), np.linspace(-1.0, 1.0, 3), *empty, np.zeros(3, np.float32))


class Sensors(World):
    """Wheel and scan every 10 ms; a scan carries points that are computed already."""

    writes = ("wheel", "lidar/front")

    def __init__(self, count: int) -> None:
        self.times = [10 * k for k in range(count)]

    def next_ns(self) -> int | None:
        return self.times[0] * MS if self.times else None

    def step(self, now_ns: int) -> Iterable[Output]:
        self.times.pop(0)
        found = scan(now_ns)
        assert len(found.points_m) == 6
        return [("wheel", WheelSample(now_ns, now_ns / MS, 0.0)), ("lidar/front", found)]


@dataclass
class Summing(Node):
    """Publishes what it has read, and how often it was stepped; `acts` may spoil a step."""

    name: str
    reads: dict[str, Read]
    writes: tuple[str, ...]
    runs: Trigger
    acts: Callable[[int, Inbox], Iterable[Output]] | None = None
    count: int = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.count += 1
        if self.acts is not None:
            yield from self.acts(now_ns, inbox)
        own = inbox.latest("imu", ImuSample) if "imu" in self.reads else None
        wheels = [m.speed_mps for m in inbox.all("wheel", WheelSample)] if "wheel" in self.reads else []
        points = inbox.latest("lidar/front", LidarScan)
        total = sum(wheels) + (0.0 if points is None else float(points.points_m.sum()))
        before = np.zeros(3) if own is None else own.acceleration_mps2
        for topic in self.writes:
            yield topic, ImuSample(now_ns, np.array([self.count, total, before.sum()]), before)


def nodes_of(acts: Callable[[int, Inbox], Iterable[Output]] | None = None) -> list[tuple[Node, int]]:
    """Two nodes of the other process with one of this process between them."""
    return [
        (Summing("lidar_a", {"lidar/front": Latest(), "wheel": All(3)}, ("imu",), On(("lidar/front",)), acts), 15 * MS),
        (Summing("other", {"imu": Latest(), "lidar/front": Latest()}, ("odom",), Every(20 * MS)), 2 * MS),
        (Summing("tracker", {"imu": Latest(), "lidar/front": Latest()}, ("tracks",), On(("imu",))), 6 * MS),
    ]


def drive(nodes: Sequence[tuple[Node, int]], cores: int, count: int = 40) -> list[tuple[str, int, int, bytes]]:
    """Everything that was delivered: topic, number, time, and the message as bytes."""
    log = list[Envelope]()
    with node_process(nodes, cores) as process:
        assert (process is None) == (cores == 1)
        Executor(Sensors(count), nodes, [log.append], process=process).run(lambda: False)
    return [(e.topic, e.sequence, e.receive_ns, pack((e.topic, e.message))) for e in log]


def test_same_messages_in_the_same_order() -> None:
    alone, both = drive(nodes_of(), 1), drive(nodes_of(), 2)
    assert both == alone
    assert {"imu", "odom", "tracks"} < {topic for topic, *_ in both}


def test_steps_are_made_in_the_other_process() -> None:
    nodes = nodes_of()
    drive(nodes, 2)
    assert [node.count > 0 for node, _ in nodes if isinstance(node, Summing)] == [False, True, False]


def fails(now_ns: int, inbox: Inbox) -> Iterable[Output]:
    if now_ns == 60 * MS:
        raise RuntimeError("injected")
    return []


def writes_undeclared(now_ns: int, inbox: Inbox) -> Iterable[Output]:
    return [("gnss/main", WheelSample(now_ns, 0.0, 0.0))] if now_ns == 60 * MS else []


def changes_its_input(now_ns: int, inbox: Inbox) -> Iterable[Output]:
    found = inbox.latest("lidar/front", LidarScan)
    assert found is not None
    found.ranges_mm[0, 0] = 1
    return []


@pytest.mark.parametrize(
    ("acts", "words"),
    [(fails, "injected"), (writes_undeclared, "does not declare"), (changes_its_input, "read-only")],
)
def test_failed_step_is_the_same_fault(acts: Callable[[int, Inbox], Iterable[Output]], words: str) -> None:
    alone, both = drive(nodes_of(acts), 1), drive(nodes_of(acts), 2)
    assert both == alone
    faults = [unpack(record, None) for topic, _, _, record in both if topic == FAULT_TOPIC]
    assert len(faults) == 1
    assert faults[0] is not None
    fault = faults[0][1]
    assert isinstance(fault, Fault)
    assert words in fault.text_en
    assert (fault.code, fault.source) == ("node.exception", "lidar_a")


def test_message_is_sent_without_what_is_computed_from_it() -> None:
    found = scan(MS)
    size = len(pickle.dumps(found, 5))
    assert found.points_m.shape == (6, 3)
    assert len(pickle.dumps(found, 5)) == size
    again = pickle.loads(pickle.dumps(found, 5))
    np.testing.assert_array_equal(again.points_m, found.points_m)


def image(stamp_ns: int) -> CameraImage:
    """An image that is larger than a pipe."""
    size = 1200, 1000, 3
    assert np.prod(size) > PIPE_BYTES
    return CameraImage(stamp_ns, np.full(size, stamp_ns % 251, np.uint8))


class Images(Sensors):
    """An image every 10 ms."""

    writes = ("camera/front",)

    def step(self, now_ns: int) -> Iterable[Output]:
        self.times.pop(0)
        return [("camera/front", image(now_ns))]


@dataclass
class Copying(Node):
    """Publishes the newest image as its own."""

    name: str = "lidar_copy"
    writes: tuple[str, ...] = ("camera/rear",)

    def __post_init__(self) -> None:
        self.reads: dict[str, Read] = {"camera/front": Latest()}
        self.runs = On(("camera/front",))

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        found = inbox.latest("camera/front", CameraImage)
        assert found is not None
        return [(self.writes[0], found)]


def test_messages_larger_than_the_pipes_in_both_directions() -> None:
    """The executor sends an image while the other process sends one."""
    nodes: list[tuple[Node, int]] = [(Copying(), 9 * MS), (Copying("tracker", ("camera/left",)), 25 * MS)]
    log = list[Envelope]()
    with node_process(nodes, 2) as process:
        Executor(Images(12), nodes, [log.append], process=process).run(lambda: False)
    copies = [e.message for e in log if e.topic in ("camera/rear", "camera/left")]
    assert len(copies) == 11 + 4
    assert {m.bgr[0, 0, 0] == m.stamp_ns % 251 for m in copies if isinstance(m, CameraImage)} == {True}


def test_killed_process_ends_the_drive_with_one_line() -> None:
    nodes = nodes_of()
    with node_process(nodes, 2) as process:
        assert isinstance(process, NodeProcess)
        (child,) = children_of(os.getpid())

        def kill(envelope: Envelope) -> None:
            if envelope.sequence == 10 and envelope.topic == "imu":
                os.kill(child, signal.SIGKILL)

        with pytest.raises(HeadlandError, match=r"the process of the nodes lidar_a, tracker has ended \(signal 9\)"):
            Executor(Sensors(40), nodes, [kill], process=process).run(lambda: False)
    assert children_of(os.getpid()) == []


def sends_what_cannot_be_sent(now_ns: int, inbox: Inbox) -> Iterable[Output]:
    return [("imu", lambda: now_ns)]  # type: ignore[list-item]


def test_error_of_the_process_ends_the_drive_with_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(HeadlandError, match=r"lidar_a, tracker has ended \(exit code 1\)"):
        drive(nodes_of(sends_what_cannot_be_sent), 2)
    assert "pickle" in capfd.readouterr().err
    assert children_of(os.getpid()) == []


def children_of(pid: int) -> list[int]:
    """Processes forked by this one that do what it does."""
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    own = Path(f"/proc/{pid}/cmdline").read_bytes()
    return [int(child) for child in found if Path(f"/proc/{child}/cmdline").read_bytes() == own]


T = TypeVar("T")
RUN = ["run", "--mission", "yard", "--cores", "2", "--duration", "300"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "to_child", "code", "words"),
    [
        (signal.SIGINT, False, 130, "interrupted"),
        (signal.SIGTERM, False, 143, "interrupted"),
        (signal.SIGKILL, False, -9, ""),
        (
            signal.SIGKILL,
            True,
            2,
            "tracker, lidar_odometry_front, lidar_map, localizer has ended (signal 9); the drive until then is kept in",
        ),
    ],
)
def test_no_process_is_left_behind(tmp_path: Path, number: int, to_child: bool, code: int, words: str) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "runtime", *RUN, "--out", str(tmp_path / "run")]
    with (tmp_path / "text").open("w") as text:
        run = subprocess.Popen(command, env=env, cwd=ROOT, stdout=text, stderr=text, start_new_session=True)
        try:
            # Before the drive, a program about to be started (git) is for an instant a copy of this process too.
            wait_for(lambda: "start warning" in (tmp_path / "text").read_text() or None, run)
            [child] = children_of(run.pid)
            if number == signal.SIGKILL:
                os.kill(child if to_child else run.pid, number)
            else:
                os.killpg(run.pid, number)  # as a terminal does
            assert run.wait(60.0) == code
        finally:
            run.kill()
            run.wait()
    assert words in (tmp_path / "text").read_text()
    wait_for(lambda: None if Path(f"/proc/{child}").exists() else True)


def wait_for(found: Callable[[], T | None], run: subprocess.Popen[bytes] | None = None) -> T:
    """Waits until something is found while `run` goes on."""
    end_s = time.monotonic() + 120.0
    while time.monotonic() < end_s:
        if (value := found()) is not None:
            return value
        assert run is None or run.poll() is None
        time.sleep(0.1)
    raise TimeoutError

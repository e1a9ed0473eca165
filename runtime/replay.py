"""A recorded log through the real nodes: perception, odometry, and the supervisor in shadow mode."""

import heapq
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from pydantic import Field

from configs.strict import CONFIGS, Config, load
from datasets.importers.formats import open_recording
from datasets.importers.recording import Received, Recording
from datasets.reader import read_metadata
from geometry.geodesy import Datum
from localization.lidar_odometry import LidarOdometry
from localization.localizer import Localizer
from localization.scan_odometry import ScanOdometry, ScanOdometryConfig
from messages.command import Wish
from messages.errors import HeadlandError, LogError
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import Odometry
from messages.node import Node, Output, World
from messages.topics import KINDS
from perception.fusion.tracker import Tracker
from perception.lidar.obstacles import LidarObstacles
from runtime.bus import Sink
from runtime.executor import FAULT_TOPIC, Executor
from runtime.preflight import CHILD_FRAMES, Machine, Survey, find_machine, pose_between, rows_of, survey
from runtime.shadow import Shadow
from runtime.stack import StackConfig
from runtime.trajectory import (
    Trajectory,
    is_steady,
    map_pose_of,
    odometry_of,
    stages_of,
    trajectory_of,
)
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.observation import Setting

RECOMPUTED = {
    "odom", "map_pose", "lidar_motion", "ground", "obstacles", "tracks", "health", "supervisor", "safe_command", "fault",
}  # fmt: skip
RECORDED = "/recorded/"
POSES_EVERY = 5  # of the odometry at 50 Hz


class ReplayConfig(Config):
    """`configs/replay.yaml`."""

    scan_odometry: ScanOdometryConfig
    beyond_m: float = Field(ge=0.0, le=500.0)
    jump_m: float = Field(gt=0.0, le=10.0)
    standing_s: float = Field(ge=0.0, le=60.0)
    clock_s: float = Field(gt=0.0, le=100.0)
    vehicles: dict[str, str]


@dataclass(frozen=True)
class Configuration:
    """All configuration of a replay."""

    stack: StackConfig
    replay: ReplayConfig
    conditions: Conditions


def load_configuration(conditions: Conditions) -> Configuration:
    """The stack's own files, nothing of them changed; raises ConfigError."""
    return Configuration(
        load(StackConfig, CONFIGS / "stack.yaml"), load(ReplayConfig, CONFIGS / "replay.yaml"), conditions
    )


class ReplayWorld(World):
    """Delivers a stream of messages by the time at which they were received."""

    def __init__(self, stream: Iterable[Received], writes: Iterable[str]) -> None:
        self.writes = tuple(writes)
        self._stream = iter(stream)
        self._next = next(self._stream, None)

    def next_ns(self) -> int | None:
        """When the next message was received, or None at the end."""
        return None if self._next is None else self._next[0]

    def step(self, now_ns: int) -> list[Output]:
        """All that was received by now."""
        out: list[Output] = []
        while self._next is not None and self._next[0] <= now_ns:
            out.append((self._next[1], self._next[2]))
            self._next = next(self._stream, None)
        return out


@dataclass(frozen=True)
class Source:
    """Where odometry comes from: the `localizer`, the log's `record` (of our own), a `topic` of it, or `scans`."""

    kind: str
    topic: str
    note: str


@dataclass(frozen=True)
class Prepared:
    """A log looked through: what it is, whose, and how it will be replayed."""

    recording: Recording
    found: Survey
    machine: Machine
    source: Source
    is_planned: bool
    truth_topic: str | None
    clock_ns: int
    config: Configuration

    @property
    def half_width_m(self) -> float:
        """Of the tube: the machine with its implement along a planned path, else as the conditions say."""
        body, implement = self.machine.vehicle.body, self.machine.implement
        widest = max(body.width_m, implement.width_m if implement is not None else 0.0)
        if self.is_planned:
            return 0.5 * widest
        tube = self.config.conditions.tube
        return max(tube.half_width_m, 0.5 * widest + tube.side_m)

    def setting(self, name: str) -> Setting:
        """What the judge must know."""
        about, lidars = self.recording.description, self.machine.vehicle.sensors.lidar
        by_frame = {s.frame: n for n, t in self.machine.lidars.items() for s in about.sensors if s.topic == t}
        frame = None if self.truth_topic is None else about.truth_frame
        frame = by_frame.get(frame, frame) if frame is not None else None
        degrees = self.config.conditions.truth.view_deg.get(about.format, 180.0)
        body = self.machine.vehicle.body
        return Setting(
            name, {n: lidar.mount.T_base_sensor for n, lidar in lidars.items()}, body.front_m, body.width_m,
            self.half_width_m, frame, math.radians(degrees),
        )  # fmt: skip

    def preflight(self) -> dict[str, Any]:
        """The table before anything is judged."""
        needed = dict.fromkeys(self.machine.lidars.values(), "obstacles")
        needed |= {self.truth_topic: "truth"} if self.truth_topic else {"truth_objects": "truth"}
        needed |= dict.fromkeys(self.source.topic.split(), "speed and way") if self.source.topic else {}
        needed |= {"path": "planned way", "wish": "place on it"} if self.is_planned else {}
        notes = [*self.recording.description.notes, *self.machine.notes, self.source.note]
        if self.clock_ns:
            notes.append(f"times of reception run {self.clock_ns * 1e-9:+.1f} s against the stamps: shifted by that")
        has_truth = self.truth_topic is not None
        judged = ["stops", "ranges", "margins"] + (["misses", "false stops", "recall"] if has_truth else [])
        about = self.recording.description
        return {
            "log": str(self.recording.path),
            "format": about.format,
            "span_s": round(self.found.span_s, 3),
            "topics": rows_of(self.found, needed),
            "extrinsics": [f"{e.parent} → {e.child}" for e in about.extrinsics],
            "ignored": [f"{i.source} ({i.source_type}): {i.reason}" for i in about.ignored],
            "notes": notes,
            "judged": judged,
            "not_shown": [] if has_truth else ["misses, false stops and recall: no truth"],
        }


def prepare(
    path: FilePath, truth: FilePath | None, vehicle: FilePath | None, config: Configuration
) -> Prepared:
    """Look a log through; raises LogError or ConfigError that says what is missing."""
    from runtime.sidecar import open_with_truth

    recording = open_with_truth(path, truth, config.conditions.truth.source)
    found = survey(recording)
    machine = find_machine(recording, found, vehicle, config.replay.vehicles)
    is_own = recording.description.format == "headland" and {"path", "wish"} <= found.streams.keys()
    truths = [t for t in found.streams if t.partition("/")[0] == "truth_objects"]
    return Prepared(
        recording, found, machine, find_source(recording, found, machine, config.replay), is_own,
        truths[0] if truths else None, found.clock_ns(config.replay.clock_s), config,
    )  # fmt: skip


def find_source(recording: Recording, found: Survey, machine: Machine, config: ReplayConfig) -> Source:
    """The best odometry that the log allows."""
    streams, sensors = found.streams, machine.vehicle.sensors
    own = {"imu", "wheel", "gnss/main"} <= streams.keys()
    if own and sensors.imu is not None and sensors.wheels is not None and "main" in sensors.gnss:
        if found.stood_s >= config.standing_s and _datum_of(recording.path) is not None:
            return Source("localizer", "imu wheel gnss/main", "odometry: recomputed by the localizer")
        if {"odom", "map_pose"} <= streams.keys():
            note = "odometry: the log's own, since the machine does not stand at its start and the localizer needs that"
            return Source("record", "odom map_pose", note)
    for topic in sorted(t for t in streams if t.partition("/")[0] == "odom"):
        if _child_pose(recording, machine, topic) is not None:
            messages = [m for _, t, m in recording.read() if t == topic and isinstance(m, Odometry)]
            if len(messages) > 2 and is_steady(messages, config.jump_m):
                return Source("topic", topic, f"odometry: {topic} of the log")
    lidar = next(iter(machine.lidars.values()))
    return Source("scans", "", f"no speed that can be used: replaced by lidar odometry from {lidar}, taken as level")


def _child_pose(recording: Recording, machine: Machine, topic: str) -> np.ndarray | None:
    """Pose of base in the frame that an odometry follows, or None when it is not known."""
    about = recording.description
    if topic == "odom" and about.format == "headland":
        return np.eye(4)
    frame = next((s.frame for s in about.sensors if s.topic == topic), "")
    frames = {s.topic: s.frame for s in about.sensors}
    for name, lidar_topic in machine.lidars.items():
        T = pose_between(about, frame, frames.get(lidar_topic, "?")) if frame else None
        if T is not None:
            return np.asarray(T @ np.linalg.inv(machine.vehicle.sensors.lidar[name].mount.T_base_sensor))
    return np.eye(4) if frame in CHILD_FRAMES else None


def _datum_of(path: FilePath) -> Datum | None:
    from configs.site import Site
    from configs.strict import parse
    from runtime.preflight import yaml

    text = read_metadata(path).get("config", {}).get("yaml")
    config = yaml.safe_load(text) if text is not None else None
    if not isinstance(config, dict) or "site" not in config:
        return None
    return parse(Site, config["site"], f"{path}: site").datum.datum


def replay(prepared: Prepared, sinks: Iterable[Sink]) -> None:
    """Run the nodes over the log; raises HeadlandError when one of them fails."""
    made: list[Received] = []
    if prepared.source.kind in ("topic", "scans"):
        made = made_stream(trajectory_before(prepared), prepared.config.replay.beyond_m)
    nodes = nodes_for(prepared)
    stream = recorded_stream(prepared)
    world = ReplayWorld(in_order(heapq.merge(made, stream, key=lambda r: r[0])), ())
    Executor(world, nodes, [_refuse_failure, *sinks]).run(lambda: False)


def _refuse_failure(envelope: Envelope) -> None:
    if envelope.topic == FAULT_TOPIC and isinstance(envelope.message, Fault):
        raise HeadlandError(envelope.message.text_en)


def in_order(stream: Iterator[Received]) -> Iterator[Received]:
    """The stream with times that never go back."""
    last_ns: int | None = None
    for receive_ns, topic, message in stream:
        last_ns = receive_ns if last_ns is None else max(last_ns, receive_ns)
        yield last_ns, topic, message


def recorded_stream(prepared: Prepared) -> Iterator[Received]:
    """The log's messages under the names that the nodes read; what is recomputed comes back under `/recorded/`."""
    names = {topic: f"lidar/{name}" for name, topic in prepared.machine.lidars.items()}
    kept = set(prepared.source.topic.split()) if prepared.source.kind == "record" else set()
    for receive_ns, topic, message in prepared.recording.read():
        kind = topic.partition("/")[0]
        is_input = kind in KINDS and (kind not in RECOMPUTED or topic in kept)
        is_input = is_input and (kind != "lidar" or topic in names) and (kind not in ("path", "wish") or prepared.is_planned)
        # what is measured cannot have come before it was measured: clocks of sensors run a little apart
        at_ns = max(receive_ns - prepared.clock_ns, message.stamp_ns if is_input else 0)
        yield at_ns, names.get(topic, topic) if is_input else f"{RECORDED}{topic}", message


def trajectory_before(prepared: Prepared) -> Trajectory:
    """The first pass: where the vehicle went; raises LogError when that cannot be told."""
    kind, topic = prepared.source.kind, prepared.source.topic
    if kind == "topic":
        messages = [m for _, t, m in prepared.recording.read() if t == topic and isinstance(m, Odometry)]
        T = _child_pose(prepared.recording, prepared.machine, topic)
        trajectory = trajectory_of(messages, np.eye(4) if T is None else T, True)
    else:
        trajectory = trajectory_of(_matched(prepared), np.eye(4), False)
    if len(trajectory.stamps_ns) < 2:
        raise LogError(f"{prepared.recording.path}: fewer than two poses, no way can be told")
    return trajectory


def _matched(prepared: Prepared) -> list[Odometry]:
    vehicle = prepared.machine.vehicle
    name, topic = next(iter(prepared.machine.lidars.items()))
    lidar, stack = vehicle.sensors.lidar[name], prepared.config.stack
    ground = LidarObstacles(name, lidar, vehicle, None, stack.perception.lidar)
    node = ScanOdometry(name, lidar, vehicle.body, prepared.config.replay.scan_odometry)
    out: list[Odometry] = []

    def take(envelope: Envelope) -> None:
        _refuse_failure(envelope)
        if isinstance(envelope.message, Odometry):
            out.append(envelope.message)

    scans = ((r, f"lidar/{name}", m) for r, t, m in prepared.recording.read() if t == topic)
    ends = ((r, t, m) for r, t, m in with_end(scans))
    nodes = [(ground, _latency_ns(prepared, ground.name)), (node, _latency_ns(prepared, "lidar_odometry"))]
    Executor(ReplayWorld(in_order(ends), ()), nodes, [take]).run(lambda: False)
    return out


def with_end(stream: Iterator[Received]) -> Iterator[Received]:
    """The stream and its last message once more a second later, so that nodes get to answer the last."""
    last: Received | None = None
    for last in stream:
        yield last
    if last is not None:
        yield last[0] + 1_000_000_000, last[1], last[2]


def made_stream(trajectory: Trajectory, beyond_m: float) -> list[Received]:
    """Odometry, pose, way and place on it, as a driven machine would have them; ends half a second after the log."""
    odometry = odometry_of(trajectory)
    out: list[Received] = []
    for stage in stages_of(trajectory, beyond_m):
        out.append((stage.path.stamp_ns, "path", stage.path))
        for odom in odometry:
            if stage.stamps_ns[0] <= odom.stamp_ns <= stage.stamps_ns[-1]:
                s = float(np.interp(odom.stamp_ns, stage.stamps_ns, stage.s_m))
                out.append((odom.stamp_ns, "wish", _wish(odom, stage.path.path_id, s)))
    for number, odom in enumerate(odometry):
        out.append((odom.stamp_ns, "odom", odom))
        if number % POSES_EVERY == 0:
            out.append((odom.stamp_ns, "map_pose", map_pose_of(odom)))
    last = odometry[-1]
    out += [(last.stamp_ns + k * 20_000_000, "order", _tick(last.stamp_ns)) for k in range(1, 26)]
    return sorted(out, key=lambda r: r[0])


def _tick(stamp_ns: int) -> Any:
    """An order that nobody follows: time goes on after the last message, so that the nodes can answer it."""
    from messages.command import OperatorOrder, Order

    return OperatorOrder(stamp_ns, Order.PAUSE, "replay", -1, 0)


def _wish(odom: Odometry, path_id: int, s_m: float) -> Wish:
    return Wish(
        odom.stamp_ns, odom.speed_mps, odom.acceleration_mps2, odom.curvature_radpm, False, False, path_id, s_m, 0.0, 0.0,
        False,
    )  # fmt: skip


def nodes_for(prepared: Prepared) -> list[tuple[Node, int]]:
    """The nodes that this log can feed, with their latencies."""
    stack, machine = prepared.config.stack, prepared.machine
    vehicle, implement = machine.vehicle, machine.implement
    eyes: list[Node] = [
        LidarObstacles(name, lidar, vehicle, implement, stack.perception.lidar)
        for name, lidar in vehicle.sensors.lidar.items()
    ]
    nodes = [*eyes, Tracker([f"obstacles/{eye.name}" for eye in eyes], stack.perception.tracker)]
    if prepared.source.kind == "localizer":
        datum = _datum_of(prepared.recording.path)
        assert datum is not None, "find_source has looked"
        if "front" in vehicle.sensors.lidar:
            nodes.append(LidarOdometry(vehicle, "front", stack.localization.lidar_odometry))
        nodes.append(Localizer(vehicle, datum, stack.localization))
    nodes.append(shadow_for(prepared))
    return [(node, _latency_ns(prepared, node.name)) for node in nodes]


def shadow_for(prepared: Prepared) -> Shadow:
    """The supervisor with the braking of the conditions."""
    values, safety = prepared.config.conditions.braking, prepared.config.stack.safety
    braking = safety.braking.model_copy(update=values.model_dump())
    half = None if prepared.is_planned else prepared.half_width_m
    return Shadow(prepared.machine.vehicle, prepared.machine.implement, safety.model_copy(update={"braking": braking}), half)


def _latency_ns(prepared: Prepared, name: str) -> int:
    """The latency that the stack gives a node, by the longest key that its name begins with."""
    table = prepared.config.stack.executor.latency_ms
    known = [key for key in table if name.startswith(key)]
    return round(table[max(known, key=len)] * 1e6)


def rates(found: Survey) -> dict[str, list[float]]:
    """Rates by topic second by second, for the report."""
    return {topic: [s.rate_hz or 0.0] for topic, s in found.streams.items()}



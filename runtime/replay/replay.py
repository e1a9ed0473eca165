"""A recorded log through the real nodes: perception, odometry, and the supervisor in shadow mode."""

import heapq
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from datasets.importers.point_clouds import list_scan
from datasets.importers.recording import Received
from localization.lidar.lidar_odometry import LidarOdometryNode
from localization.lidar.map_localization import LidarMap
from localization.lidar.scan_odometry import ScanOdometry
from localization.localizer import Localizer
from messages.command import ControlCommand
from messages.errors import HeadlandError, LogError
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import Odometry
from messages.node import Node, Output, World
from messages.sensors import LidarScan
from messages.topics import TOPICS
from perception.lidar.obstacles import LidarObstacles
from runtime.bus import Sink
from runtime.executor import FAULT_TOPIC, Executor
from runtime.perception_nodes import perceiving
from runtime.replay.prepare import Prepared, child_pose
from runtime.replay.shadow_supervisor import Shadow
from runtime.replay.trajectory import (
    Trajectory,
    map_pose_of,
    odometry_of,
    stages_of,
    trajectory_of,
)
from safety.zones.known_structure import structure_of_shed

RECOMPUTED = {
    "odom", "map_pose", "lidar_odometry", "lidar_localization", "ground", "obstacles", "tracks", "health", "supervisor",
    "safe_command", "fault",
}  # fmt: skip
RECORDED = "/recorded/"
TRUTH = ("truth_machine", "truth_objects")
TRUTH_AHEAD_NS = 250_000_000
REORDER_NS = 300_000_000  # scans that came out of order are matched in order all the same
POSES_EVERY = 5  # of the odometry at 50 Hz


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


def replay(prepared: Prepared, sinks: Iterable[Sink]) -> None:
    """Run the nodes over the log; raises HeadlandError when one of them fails."""
    made: list[Received] = []
    if prepared.source.kind in ("topic", "scans"):
        made = made_stream(trajectory_before(prepared), prepared.config.replay.beyond_m)
    nodes = nodes_for(prepared)
    stream = recorded_stream(prepared)
    streams = (truth_ahead(prepared), made, stream)
    world = ReplayWorld(in_order(heapq.merge(*streams, key=lambda r: r[0])), ())
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


def truth_ahead(prepared: Prepared) -> list[Received]:
    """All truth in order of its stamps, a little early: it may have come late, and a judge must have it in time."""
    found = prepared.found
    first_ns, last_ns = (found.first_ns or 0) - prepared.clock_ns, found.last_ns - prepared.clock_ns
    timed = ((min(max(m.stamp_ns - TRUTH_AHEAD_NS, first_ns), last_ns), topic, m) for topic, m in found.truth)
    return sorted(timed, key=lambda r: (r[0], r[2].stamp_ns))


def recorded_stream(prepared: Prepared) -> Iterator[Received]:
    """The log's messages under the names that the nodes read; what is recomputed comes back under `/recorded/`."""
    names = {topic: f"lidar/{name}" for name, topic in prepared.machine.lidars.items()}
    kept = set(prepared.source.topic.split()) if prepared.source.kind == "record" else set()
    for receive_ns, topic, message in prepared.recording.read():
        kind = topic.partition("/")[0]
        if kind in TRUTH:
            continue
        is_input = kind in TOPICS and (kind not in RECOMPUTED or topic in kept)
        is_input = (
            is_input
            and (kind != "lidar" or topic in names)
            and (kind not in ("path", "control_command") or prepared.is_planned)
        )
        # what is measured cannot have come before it was measured: clocks of sensors run a little apart
        at_ns = max(receive_ns - prepared.clock_ns, message.stamp_ns if is_input else 0)
        message = finite(message) if isinstance(message, LidarScan) else message
        yield at_ns, names.get(topic, topic) if is_input else f"{RECORDED}{topic}", message


def finite(scan: LidarScan) -> LidarScan:
    """The scan without points that are no numbers, as importers give it."""
    is_real = np.isfinite(scan.xyz_m).all(axis=1)
    if is_real.all():
        return scan
    times = scan.offset_s[is_real] if len(scan.offset_s) else None
    return list_scan(scan.stamp_ns, scan.xyz_m[is_real], offset_s=times)


def trajectory_before(prepared: Prepared) -> Trajectory:
    """The first pass: where the vehicle went; raises LogError when that cannot be told."""
    kind, topic = prepared.source.kind, prepared.source.topic
    if kind == "topic":
        messages = [m for _, t, m in prepared.recording.read() if t == topic and isinstance(m, Odometry)]
        T = child_pose(prepared.recording, prepared.machine, topic)
        trajectory = trajectory_of(messages, np.eye(4) if T is None else T, True)
    else:
        trajectory = trajectory_of(_matched(prepared), np.eye(4), False)
    if len(trajectory.stamps_ns) < 2:
        raise LogError(f"{prepared.recording.path}: fewer than two poses with stamps of their own, no way can be told")
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

    scans = ((m.stamp_ns, f"lidar/{name}", m) for _, t, m in prepared.recording.read() if t == topic)
    ends = with_end(sorted_within(scans, REORDER_NS))
    latency_ns = stack.executor.latency_ns
    nodes = [(ground, latency_ns(ground.name)), (node, latency_ns("lidar_odometry"))]
    Executor(ReplayWorld(in_order(ends), ()), nodes, [take]).run(lambda: False)
    return out


def sorted_within(stream: Iterator[Received], most_ns: int) -> Iterator[Received]:
    """The stream in order of time, where nothing comes later than `most_ns` after what it belongs before."""
    waiting: list[tuple[int, int, Received]] = []
    for number, received in enumerate(stream):
        heapq.heappush(waiting, (received[0], number, received))
        while waiting[0][0] < received[0] - most_ns:
            yield heapq.heappop(waiting)[2]
    yield from (heapq.heappop(waiting)[2] for _ in range(len(waiting)))


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
                out.append((odom.stamp_ns, "control_command", _wish(odom, stage.path.path_id, s)))
    for number, odom in enumerate(odometry):
        out.append((odom.stamp_ns, "odom", odom))
        if number % POSES_EVERY == 0:
            out.append((odom.stamp_ns, "map_pose", map_pose_of(odom)))
    last = odometry[-1]
    out += [(last.stamp_ns + k * 20_000_000, "operator_command", _tick(last.stamp_ns)) for k in range(1, 26)]
    return sorted(out, key=lambda r: r[0])


def _tick(stamp_ns: int) -> Any:
    """An order that nobody follows: time goes on after the last message, so that the nodes can answer it."""
    from messages.command import OperatorCommand, OperatorCommandKind

    return OperatorCommand(stamp_ns, OperatorCommandKind.PAUSE, "replay", -1, 0)


def _wish(odom: Odometry, path_id: int, s_m: float) -> ControlCommand:
    return ControlCommand(
        odom.stamp_ns, odom.speed_mps, odom.acceleration_mps2, odom.curvature_radpm, False, False, path_id, s_m,
        0.0, 0.0, False,
    )  # fmt: skip


def nodes_for(prepared: Prepared) -> list[tuple[Node, int]]:
    """The nodes that this log can feed, with their latencies."""
    stack, machine = prepared.config.stack, prepared.machine
    vehicle = machine.vehicle
    nodes = perceiving(vehicle, machine.implement, stack.perception)
    if prepared.source.kind == "localizer":
        nodes += locating(prepared)
    nodes.append(shadow_for(prepared))
    return [(node, stack.executor.latency_ns(node.name)) for node in nodes]


def locating(prepared: Prepared) -> list[Node]:
    """From sensors to the pose, for a machine of ours at its own place."""
    vehicle, implement, place = prepared.machine.vehicle, prepared.machine.implement, prepared.place
    config, nodes = prepared.config.stack.localization, list[Node]()
    assert place is not None, "find_source has looked"
    if "front" in vehicle.sensors.lidar:
        nodes.append(LidarOdometryNode(vehicle, "front", config.lidar_odometry))
    if "front" in vehicle.sensors.lidar and implement is not None:
        nodes.append(LidarMap(vehicle, implement, place.shed, config.lidar_map))
    return [*nodes, Localizer(vehicle, place.datum, config, place.shed, place.dock)]


def shadow_for(prepared: Prepared) -> Shadow:
    """The supervisor with the braking of the conditions."""
    values, safety = prepared.config.conditions.braking, prepared.config.stack.safety
    braking = safety.braking.model_copy(update=values.model_dump())
    vehicle, place = prepared.machine.vehicle, prepared.place
    is_blind = prepared.config.stack.perception.camera.detector.model is None
    return Shadow(
        vehicle,
        prepared.machine.implement,
        safety.model_copy(update={"braking": braking}),
        None if prepared.is_planned else prepared.half_width_m,
        None if place is None or place.shed is None else structure_of_shed(place.shed),
        frozenset(f"camera_{name}" for name in vehicle.sensors.camera if is_blind),
    )

"""Replay of a recorded log through perception, odometry and the supervisor in shadow mode."""

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
from messages.node import Node
from messages.sensors import LidarScan
from messages.topics import TOPICS
from perception.lidar.obstacles import LidarObstacles
from runtime.bus import Sink
from runtime.executor import FAULT_TOPIC, Executor
from runtime.perception_nodes import perception_nodes
from runtime.replay.prepare import ReplayInput, child_pose
from runtime.replay.shadow_supervisor import ShadowSupervisor
from runtime.replay.trajectory import (
    OdometrySamples,
    Trajectory,
    driven_sections,
    map_pose_of,
    odometry_of,
    sample_times,
    trajectory_of,
)
from runtime.replay.world import ReplayWorld, in_order
from safety.zones.known_structure import structure_of_shed

RECOMPUTED = {
    "odom", "map_pose", "lidar_odometry", "lidar_localization", "ground", "obstacles", "tracks", "health", "supervisor",
    "safe_command", "fault",
}  # fmt: skip
RECORDED = "/recorded/"
TRUTH = ("truth_machine", "truth_objects")
TRUTH_LEAD_NS = 250_000_000
REORDER_NS = 300_000_000  # window in which scans received out of order are sorted
POSES_EVERY = 5  # every n-th odometry message at 50 Hz
EARLY, SYNTHETIC, LOGGED = range(3)  # order at equal time


def replay(replay_input: ReplayInput, sinks: Iterable[Sink]) -> None:
    """Runs the nodes over the log; raises HeadlandError if a node fails."""
    world = ReplayWorld(delivered(replay_input), ())
    Executor(world, nodes_for(replay_input), [_raise_fault, *sinks]).run(lambda: False)


def delivered(replay_input: ReplayInput) -> Iterator[Received]:
    """Messages of the log and of its trajectory in order of delivery."""
    synthetic: Iterator[Received] = iter(())
    if replay_input.odometry.kind in ("topic", "scans"):
        synthetic = synthetic_stream(trajectory_before(replay_input), replay_input.config.replay.extension_m)
    log = with_early_truth(replay_input, recorded_stream(replay_input))
    between = ((received[0], SYNTHETIC, received) for received in synthetic)
    merged = heapq.merge(log, between, key=lambda r: r[:2])
    return in_order(received for _, _, received in merged)


def _raise_fault(envelope: Envelope) -> None:
    if envelope.topic == FAULT_TOPIC and isinstance(envelope.message, Fault):
        raise HeadlandError(envelope.message.text_en)


def with_early_truth(replay_input: ReplayInput, stream: Iterator[Received]) -> Iterator[tuple[int, int, Received]]:
    """Stream by (time, rank), with ground truth by stamp and TRUTH_LEAD_NS early: the observer has it before the scan.

    Messages wait for truth that was received later than it is delivered.
    """
    first_ns, last_ns = replay_input.delivery_span_ns
    lead_ns = max(0, replay_input.inspection.truth_age_ns - replay_input.clock_offset_ns + TRUTH_LEAD_NS)
    waiting: list[tuple[int, int, int, int, Received]] = []
    newest_ns = first_ns
    for number, (at_ns, topic, message) in enumerate(stream):
        if topic.partition("/")[0] in TRUTH:
            early_ns = min(max(message.stamp_ns - TRUTH_LEAD_NS, first_ns), last_ns)
            heapq.heappush(waiting, (early_ns, EARLY, message.stamp_ns, number, (early_ns, topic, message)))
        else:
            newest_ns = max(newest_ns, at_ns)
            heapq.heappush(waiting, (newest_ns, LOGGED, 0, number, (newest_ns, topic, message)))
        while waiting and waiting[0][0] < newest_ns - lead_ns:
            at_ns, rank, *_, received = heapq.heappop(waiting)
            yield at_ns, rank, received
    for at_ns, rank, *_, received in sorted(waiting):
        yield at_ns, rank, received


def recorded_stream(replay_input: ReplayInput) -> Iterator[Received]:
    """Messages of the log under the topics of the nodes; recomputed topics are delivered under `/recorded/`."""
    names = {topic: f"lidar/{name}" for name, topic in replay_input.machine.lidars.items()}
    kept = set(replay_input.odometry.topic.split()) if replay_input.odometry.kind == "record" else set()
    for receive_ns, topic, message in replay_input.recording.read():
        kind = topic.partition("/")[0]
        if kind in TRUTH:
            lidar = names.get(f"lidar/{topic.partition('/')[2]}", "")
            yield receive_ns, f"{kind}/{lidar.partition('/')[2]}" if lidar else topic, message
            continue
        is_input = kind in TOPICS and (kind not in RECOMPUTED or topic in kept)
        is_input = (
            is_input
            and (kind != "lidar" or topic in names)
            and (kind not in ("path", "control_command") or replay_input.is_planned)
        )
        # a message is not received before its stamp; clocks of sensors differ slightly
        at_ns = max(receive_ns - replay_input.clock_offset_ns, message.stamp_ns if is_input else 0)
        message = finite(message) if isinstance(message, LidarScan) else message
        yield at_ns, names.get(topic, topic) if is_input else f"{RECORDED}{topic}", message


def finite(scan: LidarScan) -> LidarScan:
    """Scan without NaN or infinite points."""
    if np.isfinite(scan.xyz_m).all():
        return scan
    is_real = np.isfinite(scan.xyz_m).all(axis=1)
    times = scan.offset_s[is_real] if len(scan.offset_s) else None
    return list_scan(scan.stamp_ns, scan.xyz_m[is_real], offset_s=times)


def trajectory_before(replay_input: ReplayInput) -> Trajectory:
    """First pass: trajectory of the vehicle; raises LogError for fewer than two poses."""
    kind, topic = replay_input.odometry.kind, replay_input.odometry.topic
    if kind == "topic":
        T = child_pose(replay_input.recording, replay_input.machine, topic)
        trajectory = trajectory_of(replay_input.inspection.odometry[topic], np.eye(4) if T is None else T, True)
    else:
        trajectory = trajectory_of(_scan_odometry(replay_input), np.eye(4), False)
    if len(trajectory.stamps_ns) < 2:
        raise LogError(f"{replay_input.recording.path}: fewer than two poses with different stamps, no trajectory")
    return trajectory


def _scan_odometry(replay_input: ReplayInput) -> OdometrySamples:
    vehicle = replay_input.machine.vehicle
    name, topic = next(iter(replay_input.machine.lidars.items()))
    lidar, stack = vehicle.sensors.lidar[name], replay_input.config.stack
    ground = LidarObstacles(name, lidar, vehicle, None, stack.perception.lidar)
    node = ScanOdometry(name, lidar, vehicle.body, replay_input.config.replay.scan_odometry)
    out = OdometrySamples()

    def take(envelope: Envelope) -> None:
        _raise_fault(envelope)
        if isinstance(envelope.message, Odometry):
            out.add(envelope.message)

    scans = ((m.stamp_ns, f"lidar/{name}", m) for _, t, m in replay_input.recording.read() if t == topic)
    ends = with_repeated_end(reordered(scans, REORDER_NS))
    latency_ns = stack.executor.latency_ns
    nodes = [(ground, latency_ns(ground.name)), (node, latency_ns("lidar_odometry"))]
    Executor(ReplayWorld(in_order(ends), ()), nodes, [take]).run(lambda: False)
    return out


def reordered(stream: Iterator[Received], max_delay_ns: int) -> Iterator[Received]:
    """Stream sorted by time, for messages at most `max_delay_ns` out of order."""
    waiting: list[tuple[int, int, Received]] = []
    for number, received in enumerate(stream):
        heapq.heappush(waiting, (received[0], number, received))
        while waiting[0][0] < received[0] - max_delay_ns:
            yield heapq.heappop(waiting)[2]
    yield from (heapq.heappop(waiting)[2] for _ in range(len(waiting)))


def with_repeated_end(stream: Iterator[Received]) -> Iterator[Received]:
    """Stream with its last message repeated a second later, so that the nodes process the last one."""
    last: Received | None = None
    for last in stream:
        yield last
    if last is not None:
        yield last[0] + 1_000_000_000, last[1], last[2]


def synthetic_stream(trajectory: Trajectory, extension_m: float) -> Iterator[Received]:
    """Odometry, pose, path and path position of the recorded drive; ends half a second after the log."""
    sections, current = driven_sections(trajectory, extension_m), -1
    sample_ns, s_m = sample_times(trajectory), np.zeros(0)
    for number, odom in enumerate(odometry_of(trajectory)):
        stamp_ns = odom.stamp_ns
        if current + 1 < len(sections) and stamp_ns >= sections[current + 1].stamps_ns[0]:
            current += 1
            section = sections[current]
            s_m = np.interp(sample_ns, section.stamps_ns, section.s_m)
            yield stamp_ns, "path", section.path
        if current >= 0:
            yield (
                stamp_ns,
                "control_command",
                _control_command(odom, sections[current].path.path_id, float(s_m[number])),
            )
        yield stamp_ns, "odom", odom
        if number % POSES_EVERY == 0:
            yield stamp_ns, "map_pose", map_pose_of(odom)
    for k in range(1, 26):
        yield stamp_ns + k * 20_000_000, "operator_command", _time_command(stamp_ns)


def _time_command(stamp_ns: int) -> Any:
    """Operator command that no node executes; advances the time after the last message."""
    from messages.command import OperatorCommand, OperatorCommandKind

    return OperatorCommand(stamp_ns, OperatorCommandKind.PAUSE, "replay", -1, 0)


def _control_command(odom: Odometry, path_id: int, s_m: float) -> ControlCommand:
    return ControlCommand(
        odom.stamp_ns, odom.speed_mps, odom.acceleration_mps2, odom.curvature_radpm, False, False, path_id, s_m,
        0.0, 0.0, False,
    )  # fmt: skip


def nodes_for(replay_input: ReplayInput) -> list[tuple[Node, int]]:
    """Nodes whose inputs are in the log, with their latencies."""
    stack, machine = replay_input.config.stack, replay_input.machine
    vehicle = machine.vehicle
    nodes = perception_nodes(vehicle, machine.implement, stack.perception)
    if replay_input.odometry.kind == "localizer":
        nodes += localization_nodes(replay_input)
    nodes.append(shadow_for(replay_input))
    return [(node, stack.executor.latency_ns(node.name)) for node in nodes]


def localization_nodes(replay_input: ReplayInput) -> list[Node]:
    """Localization nodes, for a Headland log at its own site."""
    vehicle, implement, site = replay_input.machine.vehicle, replay_input.machine.implement, replay_input.site
    config, nodes = replay_input.config.stack.localization, list[Node]()
    assert site is not None, "checked by find_odometry_source"
    if config.lidar_odometry.sensor in vehicle.sensors.lidar:
        nodes.append(LidarOdometryNode(vehicle, implement, config.lidar_odometry))
    if vehicle.sensors.lidar and implement is not None:
        nodes.append(LidarMap(vehicle, implement, site.shed, config.lidar_map))
    return [*nodes, Localizer(vehicle, site.datum, config, site.shed, site.dock)]


def shadow_for(replay_input: ReplayInput) -> ShadowSupervisor:
    """Supervisor in shadow mode with the braking values of the conditions."""
    values, safety = replay_input.config.conditions.braking, replay_input.config.stack.safety
    braking = safety.braking.model_copy(update=values.model_dump())
    vehicle, site = replay_input.machine.vehicle, replay_input.site
    has_no_detector = replay_input.config.stack.perception.camera.detector.model is None
    return ShadowSupervisor(
        vehicle,
        replay_input.machine.implement,
        safety.model_copy(update={"braking": braking}),
        None if replay_input.is_planned else replay_input.half_width_m,
        None if site is None or site.shed is None else structure_of_shed(site.shed),
        frozenset(f"camera_{name}" for name in vehicle.sensors.camera if has_no_detector),
    )

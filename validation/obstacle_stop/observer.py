"""Bus sink that gathers the input of the evaluation from the messages of a replay."""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from configs.vehicle import FOLDED
from geometry.arrays import Float32, Float64
from geometry.pose2 import from_frame
from geometry.transforms import invert
from messages.command import ControlCommand, MachineState, SupervisorState
from messages.message import Envelope
from messages.motion import MapPose, Odometry
from messages.perception import Obstacles, Tracks
from messages.plan import Path
from messages.sensors import LidarScan
from messages.truth import TrueMachine, TrueObjects
from validation.obstacle_stop.boxes import Box, box_fault, box_of
from validation.obstacle_stop.by_stamp import ByStamp
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.driving_corridor import DrivingCorridor, corridor_along
from validation.obstacle_stop.frames import deskew, map_pose_to_odom, odom_pose_to_map
from validation.obstacle_stop.observation import (
    NO_CLEARANCE,
    LogObservation,
    ObjectObservation,
    ObservedObject,
    Scene,
    Setting,
    TrackObservation,
)
from validation.obstacle_stop.recall import Clusters, detection_of, front_distance_m
from validation.obstacle_stop.recorded_motion import OdometryHistory, recorded_motion
from validation.obstacle_stop.requests import Delivered, stop_requests
from validation.obstacle_stop.swept_path import Outline
from validation.obstacle_stop.true_tracks import TrueTrack

MAX_RANGE_M = 90.0
MAX_MACHINE_AGE_NS = 200_000_000
FIGURE_THINNING = 12
STRUCTURE_MARGIN_M = 0.3
MAX_PENDING = 6
KEEP_NS = 15_000_000_000  # of truth, after odometry and scans of its time: scans come late
LATEST_NS = (1 << 63) - 1


@dataclass(frozen=True)
class _PendingScan:
    """A scan without obstacles so far, with path and control command at its arrival."""

    scan: LidarScan
    path: Path | None
    control_command: ControlCommand | None


class Observer:
    """Call with every envelope; `finish` returns the observations. It only gathers: encounters.py judges."""

    def __init__(self, setting: Setting, conditions: Conditions) -> None:
        self._setting, self._conditions = setting, conditions
        self._out = LogObservation(setting)
        self._scans: dict[tuple[str, int], _PendingScan] = {}
        self._truths, self._machines = ByStamp[TrueObjects](), ByStamp[TrueMachine]()  # recent ones
        self._delivered: list[Delivered] = []
        self._path: Path | None = None
        self._control_command: ControlCommand | None = None
        self._T_map_odom = np.eye(4)
        self._is_folded = False
        self._outlines: list[tuple[int, Outline]] = [(0, setting.working)]
        self._boxes: tuple[int, list[Box]] = (0, [])
        self._least: dict[int, float] = {}
        self._last_points: tuple[int, Float32] = (0, np.empty((0, 3), np.float32))

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message, kind = envelope.message, envelope.topic.partition("/")[0]
        if kind == "":
            return  # recorded outputs of nodes that run again in the replay
        if isinstance(message, LidarScan):
            self._queue(envelope.topic.partition("/")[2], message)
        elif isinstance(message, Obstacles):
            name = message.sensor.removeprefix("lidar_")
            waiting = self._scans.pop((name, message.scan_stamp_ns), None)
            if waiting is not None:
                self._evaluate_scan(name, waiting, message)
        elif isinstance(message, SupervisorState):
            self._record_state(envelope, message)
        elif isinstance(message, Tracks) and kind == "tracks":
            self._record_tracks(message)
            self._record_confirmation(message, envelope.receive_ns)
        else:
            self._remember(kind, message)

    def _remember(self, kind: str, message: object) -> None:
        if isinstance(message, Odometry) and kind == "odom":
            self._out.motion.add(message.stamp_ns, message.T_odom_base, message.speed_mps, message.yaw_rate_radps)
            self._track_truth(min([message.stamp_ns, *(stamp_ns for _, stamp_ns in self._scans)]) - KEEP_NS)
        elif isinstance(message, TrueObjects):
            self._truths.add(message)
        elif isinstance(message, TrueMachine):
            self._machines.add(message)
        elif isinstance(message, MapPose) and kind == "map_pose" and message.is_initialized:
            self._T_map_odom = message.T_map_odom
        elif isinstance(message, Path) and kind == "path":
            self._path = message
        elif isinstance(message, ControlCommand) and kind == "control_command":
            self._control_command = message
        elif isinstance(message, MachineState) and message.implement_stamp_ns:
            self._remember_fold(message)

    def _remember_fold(self, machine: MachineState) -> None:
        is_folded = machine.fold_position >= FOLDED
        if is_folded != self._is_folded:
            self._is_folded = is_folded
            setting = self._setting
            self._outlines.append((machine.stamp_ns, setting.transport if is_folded else setting.working))

    @property
    def tracks(self) -> dict[int, list[TrackObservation]]:
        """Tracks that entered the driving corridor so far, by id."""
        return self._out.tracks

    def finish(self) -> LogObservation:
        """Observations; scans without obstacles message count as scans without detection."""
        for (name, _), waiting in sorted(self._scans.items(), key=lambda item: item[0][1]):
            self._evaluate_scan(name, waiting, None)
        self._scans.clear()
        out = self._out
        self._track_truth(None)
        known = out.scans or out.motion.stamps_ns
        out.first_ns, out.last_ns = (min(known), max(known)) if known else (0, 0)
        out.recorded = recorded_motion(
            out.motion,
            self._outlines,
            self._setting.side_margin_m,
            self._conditions.corridor.length_m,
            self._planned_poses(),
        )
        out.requests = stop_requests(self._delivered, out.truth_ns, out, self._conditions)
        return out

    def _planned_poses(self) -> Float64 | None:
        """Poses (K, 3) in odom of the planned path beyond the recording; None for manual driving."""
        path, command = self._path, self._control_command
        if self._setting.is_manual or path is None or command is None or command.path_id != path.path_id:
            return None
        rest = path.s_m > command.path_s_m
        poses = np.column_stack([path.p_map_m, path.heading_rad])[rest]
        return map_pose_to_odom(self._T_map_odom, poses)

    def _record_state(self, envelope: Envelope, state: SupervisorState) -> None:
        """Keeps a state that limits the speed, and the first one after it: a log has many states."""
        command = self._control_command
        one = Delivered.of(envelope, state, 0.0 if command is None else abs(command.speed_mps))
        if one.rules or not self._delivered or self._delivered[-1].rules:
            self._delivered.append(one)

    def _track_truth(self, until_ns: int | None) -> None:
        """True objects in odom before a time (None: all), of the evaluated classes and within range.

        Their messages are not needed any more: objects of a long log are kept as numbers.
        """
        first_ns = self._truths.stamps_ns[0] if self._truths.stamps_ns else None
        if first_ns is None or (until_ns is not None and until_ns - first_ns < KEEP_NS):
            return
        classes, out = {label.value for label in self._conditions.classes}, self._out
        for message in self._truths.take_before(LATEST_NS if until_ns is None else until_ns):
            self._out.truth_ns.append(message.stamp_ns)
            pose, T = out.motion.pose_at(message.stamp_ns), self._T_base_truth(message.stamp_ns)
            if pose is None or T is None:
                continue
            for i, count in Counter(true.id for true in message.objects).items():
                if count > 1:
                    out.box_faults.setdefault(i, f"{count} boxes at one time")
            for true in message.objects:
                box = box_of(true, T)
                if true.label.value in classes and (fault := box_fault(box)) is not None:
                    out.box_faults.setdefault(true.id, fault)
                if true.label.value in classes and float(np.hypot(*box.center_m[:2])) < MAX_RANGE_M:
                    track = out.true_tracks.setdefault(true.id, TrueTrack(true.id, box.label, box.role))
                    track.add(message.stamp_ns, box, true.occlusion, pose)
        self._machines.take_before(0 if until_ns is None else until_ns - MAX_MACHINE_AGE_NS)

    def _queue(self, name: str, scan: LidarScan) -> None:
        self._scans[(name, scan.stamp_ns)] = _PendingScan(scan, self._path, self._control_command)
        mine = sorted(stamp for other, stamp in self._scans if other == name)
        late = [(name, stamp_ns) for stamp_ns in mine[:-MAX_PENDING]]
        late += [key for key in self._scans if scan.stamp_ns - key[1] > KEEP_NS and key not in late]
        for key in late:
            self._evaluate_scan(key[0], self._scans.pop(key), None)

    def _evaluate_scan(self, name: str, waiting: _PendingScan, obstacles: Obstacles | None) -> None:
        """Observes all true objects in one scan."""
        out, setting, scan = self._out, self._setting, waiting.scan
        out.scans.append(scan.stamp_ns)
        k = out.motion.index(scan.stamp_ns)
        if k is None or name not in setting.T_base_lidar or not len(scan.points_m):
            return
        T = setting.T_base_lidar[name]
        points = deskew(scan, T, *out.motion.rates(k))
        corridor = self._corridor(out.motion, k, waiting.path, waiting.control_command)
        self._last_points = (scan.stamp_ns, points[::FIGURE_THINNING])
        boxes = self._boxes_at(scan.stamp_ns)
        self._keep_structure(scan.stamp_ns, self._last_points[1], boxes or [], out.motion.pose(k))
        if boxes is None or not self._is_evaluated(scan.stamp_ns):
            self._boxes = (0, [])
            return
        out.evaluated_scans += 1
        self._boxes = (scan.stamp_ns, boxes)
        clusters = None if obstacles is None else Clusters.of(obstacles, points)
        for box in boxes:
            observation = self._observe(scan.stamp_ns, points, box, clusters)
            mine = out.observations.setdefault(box.id, ObservedObject(box.id, box.label, box.role))
            mine.add(observation)
            if observation.returns >= self._conditions.recall.min_returns:
                out.countable_ns.setdefault(box.id, scan.stamp_ns)
        if corridor is not None:
            self._keep_scenes(boxes, scan.stamp_ns, corridor)

    def _keep_structure(self, stamp_ns: int, points: Float32, boxes: list[Box], pose: Float64) -> None:
        """Adds the returns outside of all true boxes to the static structure."""
        outside = np.ones(len(points), bool)
        for box in boxes:
            outside &= ~box.contains(points, STRUCTURE_MARGIN_M)
        self._out.structure.add(stamp_ns, points[outside].astype(np.float64), pose)

    def _is_evaluated(self, stamp_ns: int) -> bool:
        first_ns = self._out.scans[0]
        return self._conditions.is_evaluated(self._setting.log, (stamp_ns - first_ns) * 1e-9)

    def _corridor(
        self, motion: OdometryHistory, k: int, path: Path | None, control_command: ControlCommand | None
    ) -> DrivingCorridor | None:
        """Corridor at odometry sample `k`; None without a path and in reverse."""
        if path is None or path.direction < 0 or len(path.s_m) < 2:
            return None
        s_m = (
            control_command.path_s_m
            if control_command is not None and control_command.path_id == path.path_id
            else float(path.s_m[0])
        )
        setting = self._setting
        pose = odom_pose_to_map(self._T_map_odom, motion.pose(k))
        return corridor_along(
            path, s_m, pose, setting.front_m, setting.half_width_m, self._conditions.corridor.length_m
        )

    def _boxes_at(self, stamp_ns: int) -> list[Box] | None:
        """True boxes in base at a time; None without recent truth."""
        truth = self._truths.nearest(stamp_ns, round(self._conditions.truth.max_age_s * 1e9))
        T = self._T_base_truth(stamp_ns)
        if truth is None or T is None:
            return None
        classes = {label.value for label in self._conditions.classes}
        boxes = [box_of(one, T) for one in truth.objects if one.label.value in classes]
        return [box for box in boxes if np.hypot(*box.center_m[:2]) < MAX_RANGE_M]

    def _T_base_truth(self, stamp_ns: int) -> Float64 | None:
        frame = self._setting.truth_frame
        if frame is None or frame in self._setting.T_base_lidar:
            return None if frame is None else self._setting.T_base_lidar[frame]
        machine = self._machines.nearest(stamp_ns, MAX_MACHINE_AGE_NS)
        return None if machine is None else invert(machine.T_map_base)

    def _observe(self, stamp_ns: int, points: Float32, box: Box, clusters: Clusters | None) -> ObjectObservation:
        mine = box.returns(points)
        is_detected, is_detected_strictly = detection_of(mine, box, clusters, self._conditions.truth.association_m)
        edge = front_distance_m(points[mine] if len(mine) else box.footprint_m(), self._setting)
        bearing = math.atan2(box.center_m[1], box.center_m[0] - self._setting.front_m)
        return ObjectObservation(
            box.id, box.label, box.role, stamp_ns, len(mine), edge, bearing, is_detected, is_detected_strictly
        )

    def _record_tracks(self, tracks: Tracks) -> None:
        """Records tracks in the corridor, for logs without truth."""
        motion = self._out.motion
        k = motion.index(tracks.stamp_ns)
        corridor = self._corridor(motion, k, self._path, self._control_command) if k is not None else None
        if k is None or corridor is None or not tracks.tracks:
            return
        xy = from_frame(motion.pose(k), np.array([t.p_odom_m[:2] for t in tracks.tracks]))
        for track, clearance_m in zip(tracks.tracks, corridor.clearances(xy).tolist(), strict=True):
            if math.isfinite(clearance_m):
                one = TrackObservation(track.id, track.label.value, tracks.stamp_ns, clearance_m, track.is_confirmed)
                self._out.tracks.setdefault(track.id, []).append(one)

    def _record_confirmation(self, tracks: Tracks, receive_ns: int) -> None:
        """Records the time of the first confirmed track at each true object."""
        stamp_ns, boxes = self._boxes
        k = self._out.motion.index(stamp_ns) if stamp_ns else None
        confirmed = [t.p_odom_m[:2] for t in tracks.tracks if t.is_confirmed]
        if k is None or not confirmed or abs(tracks.stamp_ns - stamp_ns) > 50_000_000:
            return
        xy = from_frame(self._out.motion.pose(k), np.array(confirmed))
        for box in boxes:
            if (
                box.id not in self._out.confirmed_ns
                and box.distance_m(xy).min() <= self._conditions.truth.association_m
            ):
                self._out.confirmed_ns[box.id] = receive_ns

    def _keep_scenes(self, boxes: list[Box], stamp_ns: int, corridor: DrivingCorridor) -> None:
        """Keeps the scenes of the entry of objects into the corridor and of the smallest clearance."""
        if not boxes:
            return
        points = np.concatenate([box.footprint_m() for box in boxes])
        clearances = corridor.clearances(points).reshape(len(boxes), -1).min(axis=1)
        for box, clearance in zip(boxes, clearances.tolist(), strict=True):
            if math.isfinite(clearance):
                self._keep_scene(box, stamp_ns, corridor, clearance)

    def _keep_scene(self, box: Box, stamp_ns: int, corridor: DrivingCorridor, clearance: float) -> None:
        scenes, key = self._out.scenes, (box.id, "least")
        if (box.id, "entry") not in scenes:
            scenes[(box.id, "entry")] = scenes[key] = self._scene(stamp_ns, corridor)
        elif clearance < self._least.get(box.id, NO_CLEARANCE):
            scenes[key] = self._scene(stamp_ns, corridor)
        self._least[box.id] = min(clearance, self._least.get(box.id, NO_CLEARANCE))

    def _scene(self, stamp_ns: int, corridor: DrivingCorridor) -> Scene:
        boxes = tuple((box.role, box.corners_m()) for box in self._boxes[1])
        points = self._last_points[1].astype(np.float64)
        high = points[(points[:, 2] > 0.2) & (np.hypot(points[:, 0], points[:, 1]) < 60.0)]
        t_s = (stamp_ns - self._out.scans[0]) * 1e-9
        return Scene(t_s, high[:, :2], corridor.outline_m(), boxes, np.empty((0, 2)))

"""Bus sink that gathers the input of the evaluation from the messages of a replay."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.pose2 import from_frame, to_frame
from geometry.transforms import invert
from messages.command import ControlCommand, SupervisorState
from messages.faults import Response
from messages.message import Envelope
from messages.motion import MapPose, Odometry
from messages.perception import Obstacles, Tracks
from messages.plan import Path
from messages.sensors import LidarScan
from messages.truth import TrueMachine, TrueObjects
from validation.drive.stops import OBSTACLE_CHANNELS
from validation.obstacle_stop.boxes import Box, box_of, count_beams, points_near, points_towards
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.driving_corridor import DrivingCorridor, corridor_along
from validation.obstacle_stop.frames import deskew, is_in_ring, odom_pose_to_map
from validation.obstacle_stop.observation import (
    NO_CLEARANCE,
    LogObservation,
    ObjectObservation,
    OdometryHistory,
    Scene,
    Setting,
    StopRequest,
    TrackObservation,
)
from validation.obstacle_stop.visibility import (
    clearance_of,
    detection_of,
    front_distance_m,
    is_in_corridor,
    is_under_vehicle,
)

TOLERANCE_MPS = 0.05  # tolerance of the supervisor's speed limits
STOP_MPS = 0.3
MAX_RANGE_M = 90.0
MIN_VISIBLE = 3  # returns or beams from which a box counts as observable
FIGURE_THINNING = 12
MAX_PENDING = 6
MAX_TRUTHS = 100


@dataclass(frozen=True)
class _PendingScan:
    """A scan without obstacles so far, with path and control command at its arrival."""

    scan: LidarScan
    path: Path | None
    control_command: ControlCommand | None


class Observer:
    """Call with every envelope; `finish` returns the observations."""

    def __init__(self, setting: Setting, conditions: Conditions) -> None:
        self._setting, self._conditions = setting, conditions
        self._out = LogObservation()
        self._scans: dict[tuple[str, int], _PendingScan] = {}
        self._truths: deque[TrueObjects] = deque(maxlen=MAX_TRUTHS)
        self._machines: deque[TrueMachine] = deque(maxlen=MAX_TRUTHS)
        self._path: Path | None = None
        self._control_command: ControlCommand | None = None
        self._T_map_odom = np.eye(4)
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
            self._record_request(message)
        elif isinstance(message, Tracks) and kind == "tracks":
            self._record_tracks(message)
            self._record_confirmation(message, envelope.receive_ns)
        else:
            self._remember(kind, message)

    def _remember(self, kind: str, message: object) -> None:
        if isinstance(message, Odometry) and kind == "odom":
            speed, turn, variance = message.speed_mps, message.yaw_rate_radps, float(message.covariance[3, 3])
            self._out.motion.add(message.stamp_ns, message.T_odom_base, speed, turn, variance)
        elif isinstance(message, TrueObjects):
            self._truths.append(message)
        elif isinstance(message, TrueMachine):
            self._machines.append(message)
        elif isinstance(message, MapPose) and kind == "map_pose" and message.is_initialized:
            self._T_map_odom = message.T_map_odom
        elif isinstance(message, Path) and kind == "path":
            self._path = message
        elif isinstance(message, ControlCommand) and kind == "control_command":
            self._control_command = message

    def finish(self) -> LogObservation:
        """Observations; scans without obstacles message count as scans without detection."""
        for (name, _), waiting in sorted(self._scans.items(), key=lambda item: item[0][1]):
            self._evaluate_scan(name, waiting, None)
        self._scans.clear()
        out = self._out
        out.first_ns, out.last_ns = (min(out.scans), max(out.scans)) if out.scans else (0, 0)
        xy = np.array([pose[:2] for pose in out.motion.poses]).reshape(-1, 2)
        out.driven_m = float(np.hypot(*np.diff(xy, axis=0).T).sum()) if len(xy) > 1 else 0.0
        return out

    def _queue(self, name: str, scan: LidarScan) -> None:
        self._scans[(name, scan.stamp_ns)] = _PendingScan(scan, self._path, self._control_command)
        mine = sorted(stamp for other, stamp in self._scans if other == name)
        for stamp_ns in mine[:-MAX_PENDING]:
            self._evaluate_scan(name, self._scans.pop((name, stamp_ns)), None)

    def _evaluate_scan(self, name: str, waiting: _PendingScan, obstacles: Obstacles | None) -> None:
        """Observes all true objects in one scan."""
        out, setting, scan = self._out, self._setting, waiting.scan
        out.scans.append(scan.stamp_ns)
        k = out.motion.index(scan.stamp_ns)
        if k is None or name not in setting.T_base_lidar or not len(scan.points_m):
            return
        T = setting.T_base_lidar[name]
        points = deskew(scan, T, out.motion.speeds_mps[k], out.motion.turns_radps[k])
        corridor = self._corridor(out.motion, k, waiting.path, waiting.control_command)
        self._last_points = (scan.stamp_ns, points[::FIGURE_THINNING])
        boxes = self._boxes_at(scan.stamp_ns)
        if boxes is None or not self._is_evaluated(scan.stamp_ns):
            self._boxes = (0, [])
            return
        out.evaluated_scans += 1
        self._boxes = (scan.stamp_ns, boxes)
        for box in boxes:
            observation = self._observe(scan.stamp_ns, points, T[:3, 3], box, corridor, obstacles, out.motion.poses[k])
            if observation is not None:
                out.observations.setdefault(box.id, []).append(observation)
                if observation.returns >= self._conditions.recall.min_returns:
                    out.countable_ns.setdefault(box.id, scan.stamp_ns)
                self._keep_scene(observation, corridor)

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
        pose = odom_pose_to_map(self._T_map_odom, motion.poses[k])
        return corridor_along(
            path, s_m, pose, setting.front_m, setting.half_width_m, self._conditions.corridor.length_m
        )

    def _boxes_at(self, stamp_ns: int) -> list[Box] | None:
        """True boxes in base at a time; None without recent truth."""
        max_age_ns = round(self._conditions.truth.max_age_s * 1e9)
        truth = min(self._truths, key=lambda m: abs(m.stamp_ns - stamp_ns), default=None)
        if truth is None or self._setting.truth_frame is None or abs(truth.stamp_ns - stamp_ns) > max_age_ns:
            return None
        T = self._T_base_truth(stamp_ns)
        if T is None:
            return None
        classes = {label.value for label in self._conditions.classes}
        boxes = [box_of(one, T) for one in truth.objects if one.label.value in classes]
        return [box for box in boxes if np.hypot(*box.center_m[:2]) < MAX_RANGE_M]

    def _T_base_truth(self, stamp_ns: int) -> Float64 | None:
        frame = self._setting.truth_frame
        if frame in self._setting.T_base_lidar:
            return self._setting.T_base_lidar[frame]
        machine = min(self._machines, key=lambda m: abs(m.stamp_ns - stamp_ns), default=None)
        return None if machine is None else invert(machine.T_map_base)

    def _observe(
        self, stamp_ns: int, points: Float32, origin: Float64, box: Box, corridor: DrivingCorridor | None,
        obstacles: Obstacles | None, pose: Float64,
    ) -> ObjectObservation | None:  # fmt: skip
        if is_under_vehicle(box, self._setting):
            return None
        about = points_near(points, box, 0.1)
        mine = about[box.contains(points[about])]
        foot = min(self._conditions.truth.ground_margin_m, 0.4 * float(box.size_m[2])) - 0.5 * float(box.size_m[2])
        above_ground = points[mine[points[mine, 2] > box.center_m[2] + foot]]
        beams_through, beams_before = 0, 0
        if len(above_ground) < self._conditions.corridor.min_returns:
            beams_through, beams_before = count_beams(points[points_towards(points, origin, box)], origin, box)
            if len(above_ground) + beams_through + beams_before < MIN_VISIBLE:
                return None
        clearances = (
            np.full(len(above_ground), NO_CLEARANCE)
            if corridor is None
            else corridor.clearances(above_ground[:, :2].astype(np.float64))
        )
        box_clearance = NO_CLEARANCE if corridor is None else float(corridor.clearances(box.footprint_m()).min())
        is_detected, is_detected_strictly = detection_of(
            mine, points, box, obstacles, self._conditions.truth.association_m
        )
        edge = front_distance_m(above_ground if len(above_ground) else box.footprint_m(), self._setting)
        return ObjectObservation(
            box.id, box.label, box.role, stamp_ns, len(mine), len(above_ground), int(np.isfinite(clearances).sum()),
            float(clearances.min(initial=NO_CLEARANCE)), box_clearance, beams_through, beams_before, edge,
            math.atan2(box.center_m[1], box.center_m[0] - self._setting.front_m), is_detected, is_detected_strictly,
            to_frame(pose, box.center_m[None, :2])[0],
        )  # fmt: skip

    def _record_request(self, state: SupervisorState) -> None:
        """Records the request of the supervisor and the true objects at its triggering points."""
        out = self._out
        k = out.motion.index(state.stamp_ns)
        speed = 0.0 if k is None else abs(out.motion.speeds_mps[k])
        wanted_mps = speed if self._control_command is None else max(speed, abs(self._control_command.speed_mps))
        binding = [
            r for r in state.rules if r.code in OBSTACLE_CHANNELS and r.speed_limit_mps < wanted_mps - TOLERANCE_MPS
        ]
        stops = [r for r in binding if r.response >= Response.CONTROLLED_STOP or r.speed_limit_mps < STOP_MPS]
        hits = state.triggering_points_base_m.astype(np.float64)
        touched, has_no_true_cause = self._true_causes(k, hits) if binding and k is not None else ((), False)
        odom = to_frame(out.motion.poses[k], hits[:1, :2])[0] if k is not None and len(hits) else None
        out.requests.append(StopRequest(
            state.stamp_ns, (stops or binding)[0].code if binding else "", state.clearance_m,
            state.required_range_m - state.stopping_distance_m, bool(binding), bool(stops), touched, has_no_true_cause,
            odom, state.obstacle_class.value,
        ))  # fmt: skip

    def _true_causes(self, k: int, triggering_points_base_m: Float64) -> tuple[tuple[int, ...], bool]:
        """Ids of the true objects at the triggering points; whether none is there although truth is complete."""
        stamp_ns, boxes = self._boxes
        then = self._out.motion.index(stamp_ns) if stamp_ns else None
        if then is None or not len(triggering_points_base_m):
            return (), False
        poses = self._out.motion.poses
        odom = to_frame(poses[k], triggering_points_base_m[:, :2])
        points = from_frame(poses[then], odom)
        reach = self._conditions.truth.association_m
        away = np.array([box.distance_m(points) for box in boxes]).reshape(len(boxes), len(points))
        touched = tuple(box.id for box, a in zip(boxes, away, strict=True) if a.min() <= reach)
        bearing = np.arctan2(points[:, 1], points[:, 0] - self._view_x())
        is_shown = (np.abs(bearing) <= self._setting.view_rad) & ~self._is_ignored(odom)
        return touched, not touched and bool(is_shown.any())

    def _view_x(self) -> float:
        frame = self._setting.truth_frame
        return float(self._setting.T_base_lidar[frame][0, 3]) if frame in self._setting.T_base_lidar else 0.0

    def _is_ignored(self, odom_m: Float64) -> np.ndarray:
        out = np.zeros(len(odom_m), bool)
        for area in self._conditions.areas(self._setting.log):
            out |= is_in_ring(odom_m, np.array(area.outline_odom_m))
        return out

    def _record_tracks(self, tracks: Tracks) -> None:
        """Records tracks in the corridor, for logs without truth."""
        motion = self._out.motion
        k = motion.index(tracks.stamp_ns)
        corridor = self._corridor(motion, k, self._path, self._control_command) if k is not None else None
        if k is None or corridor is None or not tracks.tracks:
            return
        xy = from_frame(motion.poses[k], np.array([t.p_odom_m[:2] for t in tracks.tracks]))
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
        xy = from_frame(self._out.motion.poses[k], np.array(confirmed))
        for box in boxes:
            if (
                box.id not in self._out.confirmed_ns
                and box.distance_m(xy).min() <= self._conditions.truth.association_m
            ):
                self._out.confirmed_ns[box.id] = receive_ns

    def _keep_scene(self, observation: ObjectObservation, corridor: DrivingCorridor | None) -> None:
        """Keeps the scenes of the entry and of the smallest clearance."""
        if corridor is None or not is_in_corridor(observation, self._conditions.corridor.min_returns):
            return
        scenes, key = self._out.scenes, (observation.id, "least")
        if (observation.id, "entry") not in scenes:
            scenes[(observation.id, "entry")] = scenes[key] = self._scene(observation, corridor)
        elif clearance_of(observation) < self._least.get(observation.id, NO_CLEARANCE):
            scenes[key] = self._scene(observation, corridor)
        self._least[observation.id] = min(clearance_of(observation), self._least.get(observation.id, NO_CLEARANCE))

    def _scene(self, observation: ObjectObservation, corridor: DrivingCorridor) -> Scene:
        boxes = tuple((box.role, box.corners_m()) for box in self._boxes[1])
        points = self._last_points[1].astype(np.float64)
        high = points[(points[:, 2] > 0.2) & (np.hypot(points[:, 0], points[:, 1]) < 60.0)]
        t_s = (observation.stamp_ns - self._out.scans[0]) * 1e-9
        return Scene(t_s, high[:, :2], corridor.outline_m(), boxes, np.empty((0, 2)))

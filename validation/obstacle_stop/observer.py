"""The sink that watches a replay: it sees messages alone, and keeps what the judgement needs of them."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.transforms import invert
from messages.command import ControlCommand, SupervisorState
from messages.faults import Response
from messages.message import Envelope
from messages.motion import MapPose, Odometry
from messages.perception import Obstacles, Tracks
from messages.plan import Path
from messages.sensors import LidarScan
from messages.truth import TrueMachine, TrueObjects
from validation.obstacle_stop.boxes import Box, beams_at, box_of, near, towards
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.driving_corridor import Tube, tube_of
from validation.obstacle_stop.frames import deskewed, from_odom, in_map, inside_ring, to_odom
from validation.obstacle_stop.observation import NO_GAP, Asked, Motion, Observation, Scene, Seen, Setting, Sighting
from validation.obstacle_stop.visibility import edge_m, found, gap_of, is_in_tube, is_under

RULES = ("protective_field", "tracked_obstacle")
TOLERANCE_MPS = 0.05  # the supervisor lets a speed lie this much above what it allows
STOP_MPS = 0.3
FARTHEST_M = 90.0
VISIBLE = 3  # returns or beams that show that a place can be seen
EVERY_POINT = 12
WAITING = 6
KEPT_TRUTHS = 100


@dataclass(frozen=True)
class _Waiting:
    """A scan whose obstacles have not come, and the way that held when it came."""

    scan: LidarScan
    path: Path | None
    control_command: ControlCommand | None


class Observer:
    """Call it with every envelope; then `finish` gives the observation."""

    def __init__(self, setting: Setting, conditions: Conditions) -> None:
        self._setting, self._conditions = setting, conditions
        self._out = Observation()
        self._scans: dict[tuple[str, int], _Waiting] = {}
        self._truths: deque[TrueObjects] = deque(maxlen=KEPT_TRUTHS)
        self._machines: deque[TrueMachine] = deque(maxlen=KEPT_TRUTHS)
        self._path: Path | None = None
        self._wish: ControlCommand | None = None
        self._T_map_odom = np.eye(4)
        self._boxes: tuple[int, list[Box]] = (0, [])
        self._least: dict[int, float] = {}
        self._looked: tuple[int, Float32] = (0, np.empty((0, 3), np.float32))

    def __call__(self, envelope: Envelope) -> None:
        """Take note of a message."""
        message, kind = envelope.message, envelope.topic.partition("/")[0]
        if kind == "":
            return  # what was recorded of nodes that now run again
        if isinstance(message, LidarScan):
            self._wait(envelope.topic.partition("/")[2], message)
        elif isinstance(message, Obstacles):
            name = message.sensor.removeprefix("lidar_")
            waiting = self._scans.pop((name, message.scan_stamp_ns), None)
            if waiting is not None:
                self._look(name, waiting, message)
        elif isinstance(message, SupervisorState):
            self._ask(message)
        elif isinstance(message, Tracks) and kind == "tracks":
            self._track(message)
            self._confirm(message, envelope.receive_ns)
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
            self._wish = message

    def finish(self) -> Observation:
        """What was seen; scans that perception never answered count as looked at and nothing found."""
        for (name, _), waiting in sorted(self._scans.items(), key=lambda item: item[0][1]):
            self._look(name, waiting, None)
        self._scans.clear()
        out = self._out
        out.first_ns, out.last_ns = (min(out.scans), max(out.scans)) if out.scans else (0, 0)
        xy = np.array([pose[:2] for pose in out.motion.poses]).reshape(-1, 2)
        out.driven_m = float(np.hypot(*np.diff(xy, axis=0).T).sum()) if len(xy) > 1 else 0.0
        return out

    def _wait(self, name: str, scan: LidarScan) -> None:
        self._scans[(name, scan.stamp_ns)] = _Waiting(scan, self._path, self._wish)
        mine = sorted(stamp for other, stamp in self._scans if other == name)
        for stamp_ns in mine[:-WAITING]:
            self._look(name, self._scans.pop((name, stamp_ns)), None)

    def _look(self, name: str, waiting: _Waiting, obstacles: Obstacles | None) -> None:
        """All true objects in one scan."""
        out, setting, scan = self._out, self._setting, waiting.scan
        out.scans.append(scan.stamp_ns)
        k = out.motion.index(scan.stamp_ns)
        if k is None or name not in setting.T_base_lidar or not len(scan.points_m):
            return
        T = setting.T_base_lidar[name]
        points = deskewed(scan, T, out.motion.speeds_mps[k], out.motion.turns_radps[k])
        tube = self._tube(out.motion, k, waiting.path, waiting.control_command)
        self._looked = (scan.stamp_ns, points[::EVERY_POINT])
        boxes = self._boxes_at(scan.stamp_ns)
        if boxes is None or not self._is_judged(scan.stamp_ns):
            self._boxes = (0, [])
            return
        out.judged_scans += 1
        self._boxes = (scan.stamp_ns, boxes)
        for box in boxes:
            sighting = self._sight(scan.stamp_ns, points, T[:3, 3], box, tube, obstacles, out.motion.poses[k])
            if sighting is not None:
                out.sightings.setdefault(box.id, []).append(sighting)
                if sighting.returns >= self._conditions.recall.least_returns:
                    out.countable_ns.setdefault(box.id, scan.stamp_ns)
                self._picture(sighting, tube)

    def _is_judged(self, stamp_ns: int) -> bool:
        first_ns = self._out.scans[0]
        return self._conditions.is_judged(self._setting.log, (stamp_ns - first_ns) * 1e-9)

    def _tube(self, motion: Motion, k: int, path: Path | None, control_command: ControlCommand | None) -> Tube | None:
        """The tube at an odometry; None without a path, or when it is driven backwards."""
        if path is None or path.direction < 0 or len(path.s_m) < 2:
            return None
        place = (
            control_command.path_s_m
            if control_command is not None and control_command.path_id == path.path_id
            else float(path.s_m[0])
        )
        setting = self._setting
        pose = in_map(self._T_map_odom, motion.poses[k])
        return tube_of(path, place, pose, setting.front_m, setting.half_width_m, self._conditions.tube.reach_m)

    def _boxes_at(self, stamp_ns: int) -> list[Box] | None:
        """True boxes in base at a time; None when there is no truth young enough."""
        oldest_ns = round(self._conditions.truth.greatest_age_s * 1e9)
        truth = min(self._truths, key=lambda m: abs(m.stamp_ns - stamp_ns), default=None)
        if truth is None or self._setting.truth_frame is None or abs(truth.stamp_ns - stamp_ns) > oldest_ns:
            return None
        T = self._T_base_truth(stamp_ns)
        if T is None:
            return None
        wanted = {label.value for label in self._conditions.classes}
        boxes = [box_of(thing, T) for thing in truth.objects if thing.label.value in wanted]
        return [box for box in boxes if np.hypot(*box.center_m[:2]) < FARTHEST_M]

    def _T_base_truth(self, stamp_ns: int) -> Float64 | None:
        frame = self._setting.truth_frame
        if frame in self._setting.T_base_lidar:
            return self._setting.T_base_lidar[frame]
        machine = min(self._machines, key=lambda m: abs(m.stamp_ns - stamp_ns), default=None)
        return None if machine is None else invert(machine.T_map_base)

    def _sight(
        self, stamp_ns: int, points: Float32, origin: Float64, box: Box, tube: Tube | None, obstacles: Obstacles | None,
        pose: Float64,
    ) -> Sighting | None:  # fmt: skip
        if is_under(box, self._setting):
            return None
        about = near(points, box, 0.1)
        mine = about[box.contains(points[about])]
        foot = min(self._conditions.truth.foot_m, 0.4 * float(box.size_m[2])) - 0.5 * float(box.size_m[2])
        solid = points[mine[points[mine, 2] > box.center_m[2] + foot]]
        through, before = 0, 0
        if len(solid) < self._conditions.tube.least_returns:
            through, before = beams_at(points[towards(points, origin, box)], origin, box)
            if len(solid) + through + before < VISIBLE:
                return None
        gaps = np.full(len(solid), NO_GAP) if tube is None else tube.gaps(solid[:, :2].astype(np.float64))
        box_gap = NO_GAP if tube is None else float(tube.gaps(box.footprint_m()).min())
        is_seen, is_strict = found(mine, points, box, obstacles, self._conditions.truth.near_m)
        edge = edge_m(solid if len(solid) else box.footprint_m(), self._setting)
        return Sighting(
            box.id, box.label, box.role, stamp_ns, len(mine), len(solid), int(np.isfinite(gaps).sum()),
            float(gaps.min(initial=NO_GAP)), box_gap, through, before, edge,
            math.atan2(box.center_m[1], box.center_m[0] - self._setting.front_m), is_seen, is_strict,
            to_odom(pose, box.center_m[None, :2])[0],
        )  # fmt: skip

    def _ask(self, state: SupervisorState) -> None:
        """What the supervisor says now, and which true objects are at its causes."""
        out = self._out
        k = out.motion.index(state.stamp_ns)
        speed = 0.0 if k is None else abs(out.motion.speeds_mps[k])
        wished = speed if self._wish is None else max(speed, abs(self._wish.speed_mps))
        binding = [r for r in state.rules if r.code in RULES and r.speed_limit_mps < wished - TOLERANCE_MPS]
        stops = [r for r in binding if r.response >= Response.CONTROLLED_STOP or r.speed_limit_mps < STOP_MPS]
        hits = state.triggering_points_base_m.astype(np.float64)
        touched, is_lonely = self._causes(k, hits) if binding and k is not None else ((), False)
        odom = to_odom(out.motion.poses[k], hits[:1, :2])[0] if k is not None and len(hits) else None
        out.asked.append(Asked(
            state.stamp_ns, (stops or binding)[0].code if binding else "", state.clearance_m,
            state.required_range_m - state.stopping_distance_m, bool(binding), bool(stops), touched, is_lonely, odom,
            state.obstacle_class.value,
        ))  # fmt: skip

    def _causes(self, k: int, triggering_points_base_m: Float64) -> tuple[tuple[int, ...], bool]:
        """Ids of the true objects at the hits, and whether truth is complete at some hit and nothing stands there."""
        stamp_ns, boxes = self._boxes
        then = self._out.motion.index(stamp_ns) if stamp_ns else None
        if then is None or not len(triggering_points_base_m):
            return (), False
        poses = self._out.motion.poses
        odom = to_odom(poses[k], triggering_points_base_m[:, :2])
        seen = from_odom(poses[then], odom)
        reach = self._conditions.truth.near_m
        away = np.array([box.away_m(seen) for box in boxes]).reshape(len(boxes), len(seen))
        touched = tuple(box.id for box, a in zip(boxes, away, strict=True) if a.min() <= reach)
        bearing = np.arctan2(seen[:, 1], seen[:, 0] - self._view_x())
        is_shown = (np.abs(bearing) <= self._setting.view_rad) & ~self._is_ignored(odom)
        return touched, not touched and bool(is_shown.any())

    def _view_x(self) -> float:
        frame = self._setting.truth_frame
        return float(self._setting.T_base_lidar[frame][0, 3]) if frame in self._setting.T_base_lidar else 0.0

    def _is_ignored(self, odom_m: Float64) -> np.ndarray:
        out = np.zeros(len(odom_m), bool)
        for area in self._conditions.areas(self._setting.log):
            out |= inside_ring(odom_m, np.array(area.outline_odom_m))
        return out

    def _track(self, tracks: Tracks) -> None:
        """What was perceived in the tube, for logs without truth."""
        motion = self._out.motion
        k = motion.index(tracks.stamp_ns)
        tube = self._tube(motion, k, self._path, self._wish) if k is not None else None
        if k is None or tube is None or not tracks.tracks:
            return
        xy = from_odom(motion.poses[k], np.array([t.p_odom_m[:2] for t in tracks.tracks]))
        for track, gap in zip(tracks.tracks, tube.gaps(xy).tolist(), strict=True):
            if math.isfinite(gap):
                one = Seen(track.id, track.label.value, tracks.stamp_ns, gap, track.is_confirmed)
                self._out.seen.setdefault(track.id, []).append(one)

    def _confirm(self, tracks: Tracks, told_ns: int) -> None:
        """Notes when a confirmed track first stood at a true object."""
        stamp_ns, boxes = self._boxes
        k = self._out.motion.index(stamp_ns) if stamp_ns else None
        sure = [t.p_odom_m[:2] for t in tracks.tracks if t.is_confirmed]
        if k is None or not sure or abs(tracks.stamp_ns - stamp_ns) > 50_000_000:
            return
        xy = from_odom(self._out.motion.poses[k], np.array(sure))
        for box in boxes:
            if box.id not in self._out.confirmed_ns and box.away_m(xy).min() <= self._conditions.truth.near_m:
                self._out.confirmed_ns[box.id] = told_ns

    def _picture(self, sighting: Sighting, tube: Tube | None) -> None:
        """Keeps the moments of entering and of the least gap."""
        if tube is None or not is_in_tube(sighting, self._conditions.tube.least_returns):
            return
        scenes, key = self._out.scenes, (sighting.id, "least")
        if (sighting.id, "entry") not in scenes:
            scenes[(sighting.id, "entry")] = scenes[key] = self._scene(sighting, tube)
        elif gap_of(sighting) < self._least.get(sighting.id, NO_GAP):
            scenes[key] = self._scene(sighting, tube)
        self._least[sighting.id] = min(gap_of(sighting), self._least.get(sighting.id, NO_GAP))

    def _scene(self, sighting: Sighting, tube: Tube) -> Scene:
        boxes = tuple((box.role, box.corners_m()) for box in self._boxes[1])
        points = self._looked[1].astype(np.float64)
        high = points[(points[:, 2] > 0.2) & (np.hypot(points[:, 0], points[:, 1]) < 60.0)]
        t_s = (sighting.stamp_ns - self._out.scans[0]) * 1e-9
        return Scene(t_s, high[:, :2], tube.outline_m(), boxes, np.empty((0, 2)))

"""Ideal path follower and simple supervisor: closed loop around the mission node without other nodes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from shapely.geometry import Point, Polygon

from geometry.arrays import Float64
from geometry.footprint import footprints, sweep
from geometry.transforms import planar
from messages.command import ControlCommand, Mode, OperatorCommand, OperatorCommandKind, SupervisorState
from messages.message import Message
from messages.motion import MapPose, Odometry, PositionSource
from messages.perception import ObstacleClass, Track, Tracks
from messages.plan import MissionState, MissionStatus, Path
from planning.mission import MissionNode
from planning.plan import Plan

STEP_NS = 1_000_000_000  # coarser than the node's own period, for speed
STOP_GAP_M = 2.5  # distance kept by the supervisor to an obstacle
SUPERVISOR_GAP_M = 0.3  # beside the sweep ahead
CLEAR_S = 3.0


@dataclass
class Box:
    """Inbox with fixed messages."""

    messages: Mapping[str, Any]
    commands: tuple[Message, ...] = ()

    def latest(self, topic: str, kind: type) -> Any:
        return self.messages.get(topic)

    last = latest

    def all(self, topic: str, kind: type) -> tuple[Any, ...]:
        return self.commands if topic == "operator_command" else ()

    def at(self, topic: str, kind: type, stamp_ns: int) -> Any:
        return self.messages.get(topic)


@dataclass
class Ideal:
    """Follows each path exactly, stops before obstacles in the sweep ahead, and resumes when they are gone."""

    plan: Plan
    node: MissionNode
    obstacles: dict[int, tuple[ObstacleClass, Polygon]] = field(default_factory=dict)
    pose: Float64 = field(default_factory=lambda: np.zeros(3))
    path: Path | None = None
    s_m: float = 0.0
    is_stopped: bool = False
    clear_s: float = 0.0
    paths: list[Path] = field(default_factory=list)
    trail: list[Float64] = field(default_factory=list)
    worked: list[tuple[Path, float, float]] = field(default_factory=list)
    status: MissionStatus | None = None
    least_gap_m: float = np.inf
    stopped_s: float = 0.0
    now_ns: int = 5_000_000_000
    uwb_age_s: float = 0.1
    end_error_m: float = 0.0  # distance before the end of each path at which it stops

    def run(self, seconds: float, until: str = "") -> None:
        start = self.plan.paths[0]
        if not self.pose.any():
            self.pose = np.array([*start.p_map_m[0], start.heading_rad[0]])
        now = self.now_ns
        command = OperatorCommand(now, OperatorCommandKind.START, "test", 1, now + 60 * 10**9)
        for k in range(int(seconds * 1e9) // STEP_NS):
            now = self.now_ns = now + STEP_NS
            for topic, message in self.node.step(now, Box(self._messages(now), (command,) if k == 2 else ())):
                if topic == "path":
                    assert isinstance(message, Path)
                    self._take(message)
                else:
                    assert isinstance(message, MissionStatus)
                    self.status = message
            assert self.status is not None
            if self.status.state in (MissionState.FINISHED, MissionState.ABORTED):
                return
            if until and self.status.text == until:
                return
            self._drive(STEP_NS / 1e9)

    def _take(self, path: Path) -> None:
        gap = float(np.hypot(*(path.p_map_m[0] - self.pose[:2])))
        turn = abs(float(np.angle(np.exp(1j * (path.heading_rad[0] - self.pose[2])))))
        assert gap < 0.06, f"path {path.path_id} starts {gap:.2f} m from the machine"
        assert turn < np.radians(3.0), (
            f"path {path.path_id} starts {np.degrees(turn):.1f} deg from the machine's heading"
        )
        self.path, self.s_m = path, 0.0
        self.paths.append(path)

    def _drive(self, dt: float) -> None:
        if self.path is None:
            return
        is_blocked = self._is_blocked()
        if self.is_stopped:
            self.clear_s = 0.0 if is_blocked else self.clear_s + dt
            self.is_stopped = self.clear_s < CLEAR_S
        elif is_blocked:
            self.is_stopped, self.clear_s = True, 0.0
        if self.is_stopped:
            self.stopped_s += dt
            return
        limit = float(np.interp(self.s_m, self.path.s_m, self.path.speed_mps))
        before, self.s_m = self.s_m, min(self.s_m + max(limit, 0.2) * dt, self._end_m)
        for s in np.arange(before, self.s_m, 0.1):
            self._place(float(s))
        self._place(self.s_m)
        self.worked.append((self.path, before, self.s_m))

    @property
    def _end_m(self) -> float:
        assert self.path is not None
        return float(self.path.s_m[-1]) - self.end_error_m

    def _place(self, s: float) -> None:
        path = self.path
        assert path is not None
        heading = float(np.interp(s, path.s_m, np.unwrap(path.heading_rad)))
        x, y = (float(np.interp(s, path.s_m, path.p_map_m[:, k])) for k in range(2))
        self.pose = np.array([x, y, heading])
        self.trail.append(self.pose)
        if not self._is_near():
            return
        bodies = footprints(self.plan.rig.bodies, self.pose[None, :2], self.pose[2:])[0]
        for _, outline in self.obstacles.values():
            self.least_gap_m = min(self.least_gap_m, *(body.distance(outline) for body in bodies))

    def _is_near(self) -> bool:
        return any(outline.distance(Point(self.pose[:2])) < 15.0 for _, outline in self.obstacles.values())

    def _is_blocked(self) -> bool:
        path = self.path
        assert path is not None
        ahead = (path.s_m >= self.s_m) & (path.s_m <= self.s_m + STOP_GAP_M)
        if np.count_nonzero(ahead) < 2 or not self._is_near():
            return False
        area = sweep(self.plan.rig.bodies, path.p_map_m[ahead], path.heading_rad[ahead]).buffer(SUPERVISOR_GAP_M)
        return any(area.intersects(outline) for _, outline in self.obstacles.values())

    def _messages(self, now: int) -> dict[str, Message]:
        T, zero = planar(*self.pose), np.zeros((6, 6))
        speed = 0.0 if self.is_stopped or self.path is None else 1.0
        found: dict[str, Message] = {
            "map_pose": MapPose(now, np.eye(4), T, zero, PositionSource.RTK_FIXED, 0.03, 0.0, True, self.uwb_age_s),
            "odom": Odometry(now, T, speed, 0.0, 0.0, 0.0, 0.0, zero),
            "tracks": Tracks(now, tuple(self._track(now, k) for k in sorted(self.obstacles))),
            "supervisor": self._supervisor(now),
        }
        if self.path is not None:
            is_finished = self.s_m >= self._end_m - 1e-6
            found["control_command"] = ControlCommand(
                now, 1.0, 0.0, 0.0, False, False, self.path.path_id, self.s_m, 0.0, 0.0, is_finished
            )
        return found

    def _supervisor(self, now: int) -> SupervisorState:
        mode = Mode.OBSTACLE_STOP if self.is_stopped else Mode.AUTOMATIC
        hits, outline = np.empty((0, 3), np.float32), np.empty((0, 2))
        unknown = ObstacleClass.UNKNOWN
        return SupervisorState(now, mode, "", (), unknown, np.inf, 0.0, 0.0, 40.0, 0.0, hits, outline)

    def _track(self, now: int, key: int) -> Track:
        label, outline = self.obstacles[key]
        ring = np.asarray(outline.minimum_rotated_rectangle.exterior.coords)
        sides = np.diff(ring[:3], axis=0)
        centre = np.append(np.mean(ring[:4], axis=0), 0.8)
        size = np.array([*np.hypot(*sides.T), 1.6])
        yaw = float(np.arctan2(sides[0, 1], sides[0, 0]))
        return Track(key, label, 0.9, centre, np.zeros(3), np.eye(4) * 0.01, size, yaw, 0, now, True, ("lidar",))

"""State of the page: the newest message of each topic, and what accumulates; a function of the messages alone."""

import math
from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from configs.vehicle import TrailedImplement
from geometry.drawbar import Follower
from geometry.pose2 import Pose2
from hmi.coverage import Coverage, Trail
from hmi.drive_view.corrections import CorrectionWatch
from hmi.scene import Scene
from messages.command import MachineState, Mode, SupervisorState
from messages.faults import Fault
from messages.message import Envelope, Message
from messages.motion import MapPose, Odometry
from messages.plan import MissionState, MissionStatus, Path
from messages.sensors import GnssFix
from messages.topics import spec_of

M = TypeVar("M", bound=Message)
SLACK_S = 1.0  # messages arrive once per period of the page
DISTANCE_STEP_M = 0.5  # standstill adds no distance
STOPPED = (Mode.OBSTACLE_STOP, Mode.FAULT_STOP, Mode.EMERGENCY_STOP)
ENGAGED = (Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP)


class PageState:
    """Newest messages, active faults, paths, track and worked area of one run."""

    def __init__(self, scene: Scene, cell_m: float) -> None:
        self.scene = scene
        self.now_ns = 0
        self.faults: dict[tuple[str, str], Fault] = {}
        self.paths: dict[int, Path] = {}
        self.paths_taken = 0
        self.trail = Trail()
        self.coverage = Coverage(scene.field, scene.implement.working_width_m, scene.working_point_m, cell_m)
        self.engaged_s = 0.0  # time in modes of automatic operation
        self.distance_m = 0.0
        self.stops = 0  # of automatic operation, by obstacles, faults and emergencies
        self.new_faults: list[Fault] = []  # of the last messages
        self.corrections = CorrectionWatch(scene.max_correction_age_s)
        self._follower: Follower | None = None
        if isinstance(scene.implement, TrailedImplement):
            self._follower = Follower(scene.implement.hitch_m, scene.implement.axle_length_m)
        self._counted_odom_m: tuple[float, float] | None = None
        self._mode: Mode | None = None
        self._newest: dict[str, Message] = {}
        self._engaged_ns: int | None = None

    def take(self, now_ns: int, envelopes: Iterable[Envelope]) -> None:
        """Processes the messages up to `now_ns`."""
        self.new_faults = []
        for envelope in envelopes:
            self._newest[envelope.topic] = envelope.message
            message = envelope.message
            if isinstance(message, Fault):
                self._take_fault(message)
            elif isinstance(message, Path):
                self.paths[message.path_id] = message
                self.paths_taken += 1
            elif isinstance(message, Odometry):
                self._take_motion(message)
            elif isinstance(message, SupervisorState):
                self._count_time(message)
                self.stops += self._mode is Mode.AUTOMATIC and message.mode in STOPPED
                self._mode = message.mode
        self.now_ns = now_ns
        fixes = [fix for topic in self.topics("gnss") if (fix := self.fresh(topic, GnssFix)) is not None]
        for fault in self.corrections.take(now_ns, fixes):
            self._take_fault(fault)

    def newest(self, topic: str, kind: type[M]) -> M | None:
        """Newest message of a topic, of any age."""
        message = self._newest.get(topic)
        return message if isinstance(message, kind) else None

    def fresh(self, topic: str, kind: type[M]) -> M | None:
        """Newest message of a topic, None if it is older than the topic table allows."""
        message = self.newest(topic, kind)
        if message is None or self.age_s(message) > spec_of(topic).max_age_s + SLACK_S:
            return None
        return message

    def age_s(self, message: Message) -> float:
        """Age of a message (s)."""
        return (self.now_ns - message.stamp_ns) * 1e-9

    def topics(self, kind: str) -> list[str]:
        """Received topics of a kind, sorted."""
        return sorted(topic for topic in self._newest if topic.partition("/")[0] == kind)

    @property
    def hitch_rad(self) -> float:
        """Hitch angle of a trailed implement, which is not measured, from the path driven; 0 of a mounted one."""
        return 0.0 if self._follower is None else self._follower.hitch_rad

    @property
    def pose(self) -> Pose2 | None:
        """Pose of `base` in `map`: the newest odometry by the newest alignment; None unless both are known."""
        odometry, map_pose = self.newest("odom", Odometry), self.newest("map_pose", MapPose)
        if map_pose is None or not map_pose.is_initialized or odometry is None:
            return None
        if not (np.isfinite(map_pose.T_map_odom).all() and np.isfinite(odometry.T_odom_base).all()):
            return None
        return Pose2.of(map_pose.T_map_odom) @ Pose2.of(odometry.T_odom_base)

    @property
    def is_begun(self) -> bool:
        """Whether the mission has been started."""
        mission = self.newest("mission", MissionStatus)
        return mission is not None and mission.state is not MissionState.WAITING

    @property
    def is_refilling(self) -> bool:
        """Whether a mission that has been started waits at a refill place."""
        mission = self.fresh("mission", MissionStatus)
        return mission is not None and mission.state is MissionState.WAITING and mission.path_id >= 0

    def _take_fault(self, fault: Fault) -> None:
        key = (fault.source, fault.code)
        if fault.is_active:
            self.faults[key] = fault
        else:
            self.faults.pop(key, None)
        self.new_faults.append(fault)

    def _take_motion(self, odometry: Odometry) -> None:
        self._count_distance(odometry)
        if self._follower is not None:
            self._follower.move(Pose2.of(odometry.T_odom_base))
        pose, machine = self.pose, self.newest("machine", MachineState)
        if pose is not None:
            self.trail.update(pose)
            self.coverage.update(pose, machine is not None and machine.is_hitch_in_work)

    def _count_distance(self, odometry: Odometry) -> None:
        """Adds the chord in `odom`, which does not jump, since the last counted position."""
        x_m, y_m = (float(v) for v in odometry.T_odom_base[:2, 3])
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            return
        moved_m = 0.0 if self._counted_odom_m is None else math.dist(self._counted_odom_m, (x_m, y_m))
        if self._counted_odom_m is None or moved_m >= DISTANCE_STEP_M:
            self._counted_odom_m = x_m, y_m
            self.distance_m += moved_m

    def _count_time(self, state: SupervisorState) -> None:
        if self._engaged_ns is not None:
            self.engaged_s += max(0.0, min(5.0, (state.stamp_ns - self._engaged_ns) * 1e-9))
        self._engaged_ns = state.stamp_ns if state.mode in ENGAGED else None

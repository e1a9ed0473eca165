"""The supervisor in shadow mode: it judges as if engaged, and its commands go nowhere."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from configs.vehicle import Implement, Vehicle
from messages.command import Mode, OperatorOrder, SupervisorState
from messages.motion import Odometry
from messages.node import Inbox, Output
from messages.perception import Tracks
from messages.plan import MissionStatus
from safety.config import SafetyConfig
from safety.field import Way
from safety.judgement import Judgement
from safety.lookout import Lookout, Seen
from safety.motion import from_frame, planar_of
from safety.rules import OBSTACLE_RULES, RULES
from safety.situation import Situation
from safety.stopping import Braking
from safety.supervisor import Supervisor
from safety.tracked import rim

NOT_JUDGED = frozenset(RULES) - OBSTACLE_RULES  # hand, machine, bus, fence: a log driven by hand has none of it


class RecordedWay(Lookout):
    """A lookout along the recorded way alone: the arc of the present steering stands for a steering that fails."""

    def _lay_way(
        self, seen: Seen, odom: Odometry, direction: int, speed_mps: float, braking: Braking, allowance_m: float
    ) -> Way:
        way = super()._lay_way(seen, odom, direction, speed_mps, braking, allowance_m)
        return replace(way, arc=None) if way.is_planned else way


class Shadow(Supervisor):
    """The supervisor with its mode held: nothing that it says reaches a machine, so nothing would change the mode back.

    `half_width_m` is that of the way judged when a person drove: it takes the place of the body's width and of the
    field's margins to the sides. None judges machine and implement as they are, beside their planned path.
    """

    def __init__(
        self, vehicle: Vehicle, implement: Implement | None, config: SafetyConfig, half_width_m: float | None
    ) -> None:
        if half_width_m is not None:
            vehicle = vehicle.model_copy(
                update={"body": vehicle.body.model_copy(update={"width_m": 2.0 * half_width_m})}
            )
            config = config.model_copy(
                update={"field": config.field.model_copy(update={"near_lateral_m": 0.0, "far_lateral_m": 0.0})}
            )
        super().__init__(vehicle, implement, config, None, (), NOT_JUDGED)
        self.writes = ("supervisor",)
        self.mode = Mode.AUTOMATIC
        if half_width_m is not None:
            eyes = self._lookout.eyes
            self._lookout = RecordedWay(self._lookout._shape, vehicle.sensors.lidar, None, config)
            assert len(self._lookout.eyes) == len(eyes), "the same lidars look"

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The supervisor's step; only its state leaves."""
        return [(topic, message) for topic, message in super().step(now_ns, inbox) if topic == "supervisor"]

    def _change_mode(
        self,
        now_ns: int,
        orders: tuple[OperatorOrder, ...],
        situation: Situation,
        judgement: Judgement,
        mission: MissionStatus | None,
    ) -> None:
        self.mode = Mode.AUTOMATIC

    def _state(self, situation: Situation, seen: Seen, judgement: Judgement, reason: str) -> SupervisorState:
        """With the box of a tracked threat among the points that caused it, so that judges can tell which it was."""
        state = super()._state(situation, seen, judgement, reason)
        outline = threat_outline(self._lookout.threat().id, seen.tracks, seen.odom)
        return replace(state, hits_base_m=np.concatenate([state.hits_base_m, outline])) if len(outline) else state


def threat_outline(track_id: int, tracks: Tracks | None, odom: Odometry | None) -> np.ndarray:
    """Points (9, 3) on the box of a track, in base; (0, 3) without it."""
    track = next((t for t in tracks.tracks if t.id == track_id), None) if tracks is not None else None
    if track is None or odom is None:
        return np.empty((0, 3), np.float32)
    xy = from_frame(planar_of(odom.T_odom_base), rim(track))
    return np.column_stack([xy, np.full(len(xy), track.p_odom_m[2])]).astype(np.float32)

"""The supervisor in shadow mode: evaluates a recording as if engaged; its commands go nowhere."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from configs.vehicle import Implement, Vehicle
from geometry.pose2 import from_frame
from messages.command import Mode, SupervisorState
from messages.message import Message
from messages.motion import Odometry
from messages.node import Inbox, Node
from messages.perception import Tracks
from safety.collision_monitor import CollisionMonitor
from safety.config import ModesConfig
from safety.mode_machine import ModeMachine
from safety.pose_history import planar_pose, valid_odometry
from safety.rules import RULES
from safety.rules.rule import Effect
from safety.supervisor import Supervisor
from safety.supervisor_config import SupervisorConfig
from safety.zones.known_structure import KnownStructure
from safety.zones.protective_field import SweptField
from safety.zones.tracked_obstacles import box_points

# The other rules need what a log driven by hand does not have: driver, machine state, bus, geofence.
SHADOW_RULES = {name: rule for name, rule in RULES.items() if Effect.OBSTACLE in rule.effect}


class AutomaticMode(ModeMachine):
    """Stays in automatic mode."""

    def __init__(self, config: ModesConfig) -> None:
        super().__init__(config)
        self.mode = Mode.AUTOMATIC

    def update(self, *args: Any, **kwargs: Any) -> None:
        """Takes no transition."""


class PlannedPathMonitor(CollisionMonitor):
    """Covers the planned path alone where there is one, not the arc of the present steering."""

    def lay_field(self, *args: Any, **kwargs: Any) -> SweptField:
        """The field on the planned path."""
        swept_field = super().lay_field(*args, **kwargs)
        return SweptField(swept_field.main, None, True) if swept_field.is_planned else swept_field


class ShadowSupervisor(Node):
    """Runs a supervisor held in automatic mode and writes only its state, with the box of the critical object added.

    `half_width_m` is that of the path evaluated when a person drove: it replaces the width of the body and the lateral
    margins of the field, and the arc of the present steering (which covers a steering failure) is left out. None
    evaluates machine and implement as they are. `survey` is the shed, `idle` names sensors that detect nothing.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        implement: Implement | None,
        config: SupervisorConfig,
        half_width_m: float | None,
        known_structure: KnownStructure | None = None,
        idle: frozenset[str] = frozenset(),
    ) -> None:
        if half_width_m is not None:
            body = vehicle.body.model_copy(update={"width_m": 2.0 * half_width_m})
            vehicle = vehicle.model_copy(update={"body": body})
            field = config.field.model_copy(update={"lateral_margin_near_m": 0.0, "lateral_margin_far_m": 0.0})
            config = config.model_copy(update={"field": field})
        self.supervisor = Supervisor(
            vehicle, implement, config, None, (), known_structure, idle, None, SHADOW_RULES,
            AutomaticMode(config.modes), CollisionMonitor if half_width_m is None else PlannedPathMonitor,
        )  # fmt: skip
        self.name, self.reads, self.runs = self.supervisor.name, self.supervisor.reads, self.supervisor.runs
        self.writes = ("supervisor",)

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[tuple[str, Message]]:
        """The state of this step."""
        outputs = dict(self.supervisor.step(now_ns, inbox))
        state = outputs.get("supervisor")
        return [("supervisor", self._with_box(state, inbox))] if isinstance(state, SupervisorState) else []

    def _with_box(self, state: SupervisorState, inbox: Inbox) -> SupervisorState:
        """The same with points on the box of the critical object among those that trigger."""
        odom, tracks = valid_odometry(inbox.latest("odom", Odometry)), inbox.latest("tracks", Tracks)
        track_id = self.supervisor.collision_monitor.critical_object().id
        track = next((t for t in tracks.tracks if t.id == track_id), None) if tracks is not None else None
        if track is None or odom is None:
            return state
        xy = from_frame(planar_pose(odom.T_odom_base), box_points(track))
        box = np.column_stack([xy, np.full(len(xy), track.p_odom_m[2])]).astype(np.float32)
        return replace(state, triggering_points_base_m=np.concatenate([state.triggering_points_base_m, box]))

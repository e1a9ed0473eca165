"""Builds the SupervisorState message."""

import math

import numpy as np

from messages.command import Mode, SupervisorState
from safety.collision_monitor import CollisionMonitor
from safety.rules.arbitration import Decision
from safety.rules.situation import Situation
from safety.stopping_distance import required_range, stopping_distance
from safety.zones.swept_area import outline_of

MAX_POINTS = 300


def build_state(
    situation: Situation, monitor: CollisionMonitor, decision: Decision, mode: Mode, reason: str, resume_in_s: float
) -> SupervisorState:
    """The reasons for the safe command of this step."""
    points = np.empty((0, 3)) if situation.clearance is None else situation.clearance.triggering_points_base_m
    points = points[:: max(1, math.ceil(len(points) / MAX_POINTS))]
    return SupervisorState(
        stamp_ns=situation.now_ns,
        mode=mode,
        reason=reason,
        rules=decision.results,
        obstacle_class=monitor.obstacle_class(situation.inputs.odom, situation.inputs.tracks),
        clearance_m=decision.clearance_m,
        stopping_distance_m=stopping_distance(situation.speed_mps, situation.braking),
        required_range_m=required_range(situation.speed_mps, situation.braking, situation.allowance_m),
        detection_range_m=situation.detection_range_m,
        resume_in_s=resume_in_s,
        triggering_points_base_m=points.astype(np.float32),
        protective_field_base_m=np.empty((0, 2))
        if monitor.swept_field is None
        else outline_of(monitor.swept_field.main),
    )

"""What the supervisor tells of itself."""

import math

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import from_frame
from messages.command import SupervisorState
from messages.motion import Odometry
from messages.perception import Tracks
from safety.collision_monitor import CollisionMonitor, MonitorInputs
from safety.pose_history import planar_pose
from safety.rules.arbitration import Decision
from safety.rules.situation import Situation
from safety.stopping_distance import required_range, stopping_distance
from safety.zones.swept_area import outline_of
from safety.zones.tracked_obstacles import box_points

MOST_HITS = 300
NOTHING = np.empty((0, 3))


def build_state(
    situation: Situation, inputs: MonitorInputs, collision_monitor: CollisionMonitor, decision: Decision,
    reason: str, resume_in_s: float,
    has_threat: bool,
) -> SupervisorState:  # fmt: skip
    """Why the safe command is what it is; `has_threat` puts the box of a tracked threat among the hits."""
    hits = NOTHING if situation.clearance is None else situation.clearance.triggering_points_base_m
    hits = hits[:: max(1, math.ceil(len(hits) / MOST_HITS))]
    if has_threat:
        hits = np.concatenate([hits, critical_object_outline(situation.critical_object.id, inputs.tracks, inputs.odom)])
    return SupervisorState(
        stamp_ns=situation.now_ns,
        mode=situation.mode,
        reason=reason,
        rules=decision.results,
        obstacle_class=collision_monitor.obstacle_class(inputs.odom, inputs.tracks),
        clearance_m=decision.clearance_m,
        stopping_distance_m=stopping_distance(situation.speed_mps, situation.braking),
        required_range_m=required_range(situation.speed_mps, situation.braking, situation.allowance_m),
        detection_range_m=situation.detection_range_m,
        resume_in_s=resume_in_s,
        triggering_points_base_m=hits.astype(np.float32),
        protective_field_base_m=np.empty((0, 2))
        if collision_monitor.swept_field is None
        else outline_of(collision_monitor.swept_field.main),
    )


def critical_object_outline(track_id: int, tracks: Tracks | None, odom: Odometry | None) -> Float64:
    """Points (9, 3) on the box of a track, in base; (0, 3) without it."""
    track = next((t for t in tracks.tracks if t.id == track_id), None) if tracks is not None else None
    if track is None or odom is None:
        return NOTHING
    xy = from_frame(planar_pose(odom.T_odom_base), box_points(track))
    return np.column_stack([xy, np.full(len(xy), track.p_odom_m[2])])

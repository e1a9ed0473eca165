"""What the supervisor tells of itself."""

import math

import numpy as np

from messages.command import SupervisorState
from messages.message import Float64
from messages.motion import Odometry
from messages.perception import Tracks
from safety.collision_monitor import Lookout, Seen
from safety.pose_history import from_frame, planar_of
from safety.rules.arbitration import Decision
from safety.rules.situation import Situation
from safety.stopping_distance import required_range, stopping_distance
from safety.zones.swept_area import outline_of
from safety.zones.tracked_obstacles import rim

MOST_HITS = 300
NOTHING = np.empty((0, 3))


def build_state(
    situation: Situation, seen: Seen, lookout: Lookout, decision: Decision, reason: str, resume_in_s: float,
    has_threat: bool,
) -> SupervisorState:  # fmt: skip
    """Why the safe command is what it is; `has_threat` puts the box of a tracked threat among the hits."""
    hits = NOTHING if situation.gap is None else situation.gap.triggering_points_base_m
    hits = hits[:: max(1, math.ceil(len(hits) / MOST_HITS))]
    if has_threat:
        hits = np.concatenate([hits, critical_object_outline(situation.threat.id, seen.tracks, seen.odom)])
    return SupervisorState(
        stamp_ns=situation.now_ns,
        mode=situation.mode,
        reason=reason,
        rules=decision.results,
        obstacle_class=lookout.cause(seen.odom, seen.tracks),
        clearance_m=decision.clearance_m,
        stopping_distance_m=stopping_distance(situation.speed_mps, situation.braking),
        required_range_m=required_range(situation.speed_mps, situation.braking, situation.allowance_m),
        detection_range_m=situation.proven_m,
        resume_in_s=resume_in_s,
        triggering_points_base_m=hits.astype(np.float32),
        protective_field_base_m=np.empty((0, 2)) if lookout.way is None else outline_of(lookout.way.main),
    )


def critical_object_outline(track_id: int, tracks: Tracks | None, odom: Odometry | None) -> Float64:
    """Points (9, 3) on the box of a track, in base; (0, 3) without it."""
    track = next((t for t in tracks.tracks if t.id == track_id), None) if tracks is not None else None
    if track is None or odom is None:
        return NOTHING
    xy = from_frame(planar_of(odom.T_odom_base), rim(track))
    return np.column_stack([xy, np.full(len(xy), track.p_odom_m[2])])

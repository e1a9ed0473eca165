"""What the supervisor tells of itself."""

import math

import numpy as np

from messages.command import SupervisorState
from messages.message import Float64
from messages.motion import Odometry
from messages.perception import Tracks
from safety.judgement import Judgement
from safety.lookout import Lookout, Seen
from safety.motion import from_frame, planar_of
from safety.situation import Situation
from safety.stopping import required_range, stopping_distance
from safety.sweep import outline_of
from safety.tracked import rim

MOST_HITS = 300
NOTHING = np.empty((0, 3))


def state_of(
    situation: Situation, seen: Seen, lookout: Lookout, judgement: Judgement, reason: str, resume_in_s: float,
    has_threat: bool,
) -> SupervisorState:  # fmt: skip
    """Why the safe command is what it is; `has_threat` puts the box of a tracked threat among the hits."""
    hits = NOTHING if situation.gap is None else situation.gap.hits_base_m
    hits = hits[:: max(1, math.ceil(len(hits) / MOST_HITS))]
    if has_threat:
        hits = np.concatenate([hits, threat_outline(situation.threat.id, seen.tracks, seen.odom)])
    return SupervisorState(
        stamp_ns=situation.now_ns,
        mode=situation.mode,
        reason=reason,
        rules=judgement.results,
        cause_class=lookout.cause(seen.odom, seen.tracks),
        gap_m=judgement.gap_m,
        stopping_m=stopping_distance(situation.speed_mps, situation.braking),
        required_m=required_range(situation.speed_mps, situation.braking, situation.allowance_m),
        proven_range_m=situation.proven_m,
        resume_in_s=resume_in_s,
        hits_base_m=hits.astype(np.float32),
        field_base_m=np.empty((0, 2)) if lookout.way is None else outline_of(lookout.way.main),
    )


def threat_outline(track_id: int, tracks: Tracks | None, odom: Odometry | None) -> Float64:
    """Points (9, 3) on the box of a track, in base; (0, 3) without it."""
    track = next((t for t in tracks.tracks if t.id == track_id), None) if tracks is not None else None
    if track is None or odom is None:
        return NOTHING
    xy = from_frame(planar_of(odom.T_odom_base), rim(track))
    return np.column_stack([xy, np.full(len(xy), track.p_odom_m[2])])

"""The second channel: tracks that will enter the swept field while the machine still needs to stop."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import from_frame, point_from_frame
from messages.perception import ObstacleClass, Track, Tracks
from safety.config import TrackedConfig
from safety.zones.footprint import Footprint, is_own
from safety.zones.swept_area import SweptArea, distance_to_contact_m


@dataclass(frozen=True)
class CriticalObject:
    """The nearest tracked obstacle in the way: its gap (infinite: none), class and id (-1: none)."""

    clearance_m: float
    label: ObstacleClass
    id: int


KnownStructureFilter = Callable[[Float64], np.ndarray]
REACH_M = 15.0  # farther than any body, margin and uncertainty reach from base
FIXED = frozenset({ObstacleClass.POLE, ObstacleClass.MOUND, ObstacleClass.DITCH})
NO_CRITICAL_OBJECT = CriticalObject(math.inf, ObstacleClass.UNKNOWN, -1)


def larger(a: float, b: float) -> float:
    """The larger of two numbers, and NaN when either is, unlike `max`."""
    return a if a >= b or a != a else b


def length_m(track: Track) -> float:
    """The longer side of a track's box."""
    return larger(float(track.size_m[0]), float(track.size_m[1]))


def velocity_sigma_mps(track: Track) -> float:
    """Standard deviation of the less certain component of its velocity."""
    return math.sqrt(max(0.0, larger(float(track.covariance[2, 2]), float(track.covariance[3, 3]))))


def is_moving(track: Track, config: TrackedConfig) -> bool:
    """Whether a track surely moves: a speed near 0, or not known well or long enough, does not count.

    The seen part of a fence, hedge or vehicle grows and shrinks as the machine passes, which looks like motion of its
    middle: what has no class must be compact, and what is long or a vehicle must be faster. A pole or mound faster than
    any walker is a wall seen from place to place, with its edge taken for one thing.
    """
    if track.last_seen_ns - track.first_seen_ns < config.min_track_age_s * 1e9:
        return False
    is_long = length_m(track) > config.max_unclassified_length_m
    if track.label is ObstacleClass.UNKNOWN and is_long:
        return False
    speed = math.hypot(float(track.velocity_mps[0]), float(track.velocity_mps[1]))
    if not math.isfinite(speed):
        return False
    if track.label in FIXED and speed > config.max_static_class_speed_mps:
        return False
    sigma = velocity_sigma_mps(track)
    is_machine = is_long or track.label is ObstacleClass.VEHICLE
    least_mps = config.long_moving_mps if is_machine else config.moving_mps
    return speed >= max(least_mps, config.moving_sigmas * sigma)


def is_coasting(track: Track, stamp_ns: int, config: TrackedConfig) -> bool:
    """Whether a track without class is only carried on: pieces of clutter taken for one thing part again at once."""
    return track.label is ObstacleClass.UNKNOWN and stamp_ns - track.last_seen_ns > config.max_coasting_s * 1e9


def predicted(track: Track, times_s: Float64, config: TrackedConfig) -> tuple[Float64, Float64]:
    """Places (T, 2) in odom and how far the object reaches about them (T,), with what its velocity leaves open."""
    places = track.p_odom_m[:2] + times_s[:, None] * track.velocity_mps[:2]
    sigma = velocity_sigma_mps(track)
    half = 0.5 * float(np.min(track.size_m[:2]))
    return places, half + np.minimum(sigma * times_s, config.uncertainty_cap_m)


def box_points(track: Track) -> Float64:
    """Points (9, 2) in odom on the box of a track that stands: corners, middles of the sides and centre."""
    length, width = 0.5 * float(track.size_m[0]), 0.5 * float(track.size_m[1])
    c, s = math.cos(track.yaw_rad), math.sin(track.yaw_rad)
    local = np.array([(a * length, b * width) for a in (-1, 0, 1) for b in (-1, 0, 1)])
    return np.column_stack([local[:, 0] * c - local[:, 1] * s, local[:, 0] * s + local[:, 1] * c]) + track.p_odom_m[:2]


def is_ahead(
    track: Track,
    moves: bool,
    footprint: Footprint,
    pose_odom: Float64,
    curvature: float,
    direction: int,
    self_filter_m: float,
) -> bool:
    """Whether a track lies before some leading edge and is not the machine's own implement, tracked by mistake.

    Whatever comes from behind or lies beside the rear is not met by driving on; standing would not help it. Between
    the foremost and the last leading edge, only what has a class and moves counts: what stands there is in the raw
    field if it is in the way at all.
    """
    x, y = point_from_frame(pose_odom, *track.p_odom_m[:2].tolist())
    ahead_m = direction * x + 0.5 * length_m(track)
    foremost_m = direction * footprint.foremost_m(direction)
    counts_beside = moves and track.label is not ObstacleClass.UNKNOWN
    edge_m = foremost_m - max(footprint.leads_m(direction)) if counts_beside else foremost_m
    return ahead_m >= edge_m and not bool(is_own(np.array([[x], [y], [0.0]]), footprint, curvature, self_filter_m)[0])


def is_within_reach(track: Track, pose_odom: Float64, length_m: float, horizon_s: float) -> bool:
    """Whether a track with a finite place could touch a sweep of this length within the horizon, by distance alone.

    A fenced field has hundreds of tracks, and all but a few are beyond this circle.
    """
    (x, y), (vx, vy) = track.p_odom_m[:2].tolist(), track.velocity_mps[:2].tolist()
    moved_m = math.hypot(vx, vy) * horizon_s
    far_m = math.hypot(x - pose_odom[0], y - pose_odom[1]) - math.hypot(*track.size_m[:2].tolist())
    return math.isfinite(x + y) and not far_m > length_m + REACH_M + moved_m


def is_beside(track: Track, pose_odom: Float64, sweep: SweptArea) -> bool:
    """Whether the circle about a track's box surely lies beside the box about a sweep; its place is finite."""
    x, y = point_from_frame(pose_odom, *track.p_odom_m[:2].tolist())
    reach_m = math.hypot(*track.size_m[:2].tolist()) + sweep.step_m
    (x_low, x_high), (y_low, y_high) = sweep.box.x_m, sweep.box.y_m
    return x < x_low - reach_m or x > x_high + reach_m or y < y_low - reach_m or y > y_high + reach_m


def is_fragment_of(track: Track, standing: Sequence[Track], fragment_margin_m: float) -> bool:
    """Whether the middle of a track lies on, or within `fragment_margin_m` of, the box of a larger one that stands.

    A vehicle passed closely is seen in pieces, whose middles wander. Who steps out from beside it is in the raw field.
    """
    for other in standing:
        if other.id == track.id or length_m(other) <= length_m(track):
            continue
        c, s = math.cos(other.yaw_rad), math.sin(other.yaw_rad)
        dx, dy = (track.p_odom_m[:2] - other.p_odom_m[:2]).tolist()
        along, across = abs(c * dx + s * dy), abs(c * dy - s * dx)
        if along <= 0.5 * other.size_m[0] + fragment_margin_m and across <= 0.5 * other.size_m[1] + fragment_margin_m:
            return True
    return False


def without_walls(tracks: list[Track], is_known: KnownStructureFilter, max_unclassified_length_m: float) -> list[Track]:
    """The tracks that are not what is surveyed: their middle does not lie there, and they are no long boxes of unknown
    or mixed make. Their places are finite."""
    compact = [
        track for track in tracks if not length_m(track) > max_unclassified_length_m
    ]  # a size that is no number is no wall's
    if not compact:
        return compact
    is_wall = is_known(np.array([track.p_odom_m[:2] for track in compact]))
    return [track for track, known in zip(compact, is_wall, strict=True) if not known]


def nearest_critical_object(
    sweep: SweptArea,
    footprint: Footprint,
    tracks: Tracks | None,
    pose_odom: Float64,
    curvature_radpm: float,
    stop_s: float,
    config: TrackedConfig,
    is_known: KnownStructureFilter | None = None,
) -> CriticalObject:
    """The nearest threat of all confirmed tracks, for base at `pose_odom` (3,) in odom.

    What moves counts where it will be until the machine can have stopped; what moves away or past never touches the
    sweep. What stands counts by its box where the evidence gives it a class; the raw field sees the rest.
    `is_known` says of places (N, 2) in odom which are surveyed walls: tracks there, and boxes long enough to be
    made of several walls, are left to the raw field too.
    """
    horizon_s = min(config.max_horizon_s, max(config.min_horizon_s, stop_s))
    times_s = np.linspace(0.0, horizon_s, config.steps)
    best = NO_CRITICAL_OBJECT
    confirmed = [t for t in (() if tracks is None else tracks.tracks) if t.is_confirmed]
    reached = [t for t in confirmed if is_within_reach(t, pose_odom, sweep.length_m, horizon_s)]
    if is_known is not None:
        reached = without_walls(reached, is_known, config.max_unclassified_length_m)
    stamp_ns = 0 if tracks is None else tracks.stamp_ns
    near = [(track, is_moving(track, config) and not is_coasting(track, stamp_ns, config)) for track in reached]
    standing = [track for track, moves in near if length_m(track) >= config.fragment_parent_m and not moves]
    for track, seems_moving in near:
        moves = seems_moving and not is_fragment_of(track, standing, config.fragment_margin_m)
        if not moves and (track.label is ObstacleClass.UNKNOWN or length_m(track) > config.max_static_length_m):
            continue  # left to the raw field: no class, or a fence or hedge, whose box covers free ground
        if not moves and is_beside(track, pose_odom, sweep):
            continue
        if not is_ahead(track, moves, footprint, pose_odom, curvature_radpm, sweep.direction, config.self_filter_m):
            continue
        clearance = _clearance_to_track(sweep, track, moves, pose_odom, times_s, config)
        if clearance < best.clearance_m:
            best = CriticalObject(clearance, track.label, track.id)
    return best


def _clearance_to_track(
    sweep: SweptArea, track: Track, moves: bool, pose_odom: Float64, times_s: Float64, config: TrackedConfig
) -> float:
    if moves:
        places, reach = predicted(track, times_s, config)
        return float(np.min(distance_to_contact_m(from_frame(pose_odom, places), sweep, reach + config.lateral_m)))
    return float(np.min(distance_to_contact_m(from_frame(pose_odom, box_points(track)), sweep)))

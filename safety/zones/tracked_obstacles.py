"""Tracked obstacle channel: the nearest track that is in, or will enter, the swept area within the stopping time."""

import math
from collections.abc import Callable, Iterable, Sequence
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
    """Nearest tracked obstacle in the swept area: clearance (infinite: none), class and track id (-1: none)."""

    clearance_m: float
    label: ObstacleClass
    id: int


KnownStructureFilter = Callable[[Float64], np.ndarray]
REACH_M = 15.0  # above the reach from base of any body, margin and uncertainty
MAY_WALK = frozenset({ObstacleClass.PERSON, ObstacleClass.ANIMAL})
STATIC_CLASSES = frozenset({ObstacleClass.POLE, ObstacleClass.MOUND, ObstacleClass.DITCH})
NO_CRITICAL_OBJECT = CriticalObject(math.inf, ObstacleClass.UNKNOWN, -1)


def larger(a: float, b: float) -> float:
    """Larger of two numbers; NaN when either is NaN, unlike `max`."""
    return a if a >= b or a != a else b


def length_m(track: Track) -> float:
    """Longer side of a track's box."""
    return larger(float(track.size_m[0]), float(track.size_m[1]))


def velocity_sigma_mps(track: Track) -> float:
    """Standard deviation of the less certain velocity component."""
    return math.sqrt(max(0.0, larger(float(track.covariance[2, 2]), float(track.covariance[3, 3]))))


def speed_mps(track: Track) -> float:
    """Speed over ground."""
    return math.hypot(float(track.velocity_mps[0]), float(track.velocity_mps[1]))


def is_moving(track: Track, config: TrackedConfig) -> bool:
    """Whether a track moves significantly: old enough, above the speed threshold and the velocity uncertainty.

    The visible part of a fence, hedge or vehicle changes as the machine passes, and its centre with it: an unclassified
    track must be compact, and a long track or a vehicle needs a higher speed. A static class (pole, mound) above
    `max_static_class_speed_mps` is a visible wall edge that travels along the wall.
    """
    if track.last_seen_ns - track.first_seen_ns < config.min_track_age_s * 1e9:
        return False
    is_long = length_m(track) > config.max_unclassified_length_m
    if track.label is ObstacleClass.UNKNOWN and is_long:
        return False
    speed = speed_mps(track)
    if not math.isfinite(speed):
        return False
    if track.label in STATIC_CLASSES and speed > config.max_static_class_speed_mps:
        return False
    sigma = velocity_sigma_mps(track)
    is_machine = is_long or track.label is ObstacleClass.VEHICLE
    min_mps = config.long_moving_mps if is_machine else config.moving_mps
    return speed >= max(min_mps, config.moving_sigmas * sigma)


def is_broad_mover(track: Track, stamp_ns: int, config: TrackedConfig) -> bool:
    """Whether an unclassified track is broad in all directions and moves fast: a vehicle among plants, no part of a
    fence."""
    is_broad = track.label is ObstacleClass.UNKNOWN and float(np.min(track.size_m)) >= config.broad_m
    if not is_broad or is_coasting(track, stamp_ns, config):
        return False
    return speed_mps(track) >= max(config.long_moving_mps, config.moving_sigmas * velocity_sigma_mps(track))


def is_coasting(track: Track, stamp_ns: int, config: TrackedConfig) -> bool:
    """Whether an unclassified track is only predicted: clutter merged into one track separates again at once."""
    return track.label is ObstacleClass.UNKNOWN and stamp_ns - track.last_seen_ns > config.max_coasting_s * 1e9


def predicted(track: Track, times_s: Float64, config: TrackedConfig) -> tuple[Float64, Float64]:
    """Predicted centres (T, 2) in odom and radii (T,): half the shorter side plus the velocity uncertainty."""
    centers = track.p_odom_m[:2] + times_s[:, None] * track.velocity_mps[:2]
    sigma = velocity_sigma_mps(track)
    half = 0.5 * float(np.min(track.size_m[:2]))
    return centers, half + np.minimum(sigma * times_s, config.uncertainty_cap_m)


def box_points(track: Track) -> Float64:
    """Points (9, 2) in odom of a track's box: corners, side midpoints and centre."""
    length, width = 0.5 * float(track.size_m[0]), 0.5 * float(track.size_m[1])
    c, s = math.cos(track.yaw_rad), math.sin(track.yaw_rad)
    local = np.array([(a * length, b * width) for a in (-1, 0, 1) for b in (-1, 0, 1)])
    return np.column_stack([local[:, 0] * c - local[:, 1] * s, local[:, 0] * s + local[:, 1] * c]) + track.p_odom_m[:2]


def covers(track: Track, place_odom_m: Float64, margin_m: float = 0.0) -> bool:
    """Whether a track's box with a margin covers a place (2,)."""
    pose_odom = np.array([*track.p_odom_m[:2], track.yaw_rad])
    along, across = point_from_frame(pose_odom, *place_odom_m.tolist())
    length, width = track.size_m[:2].tolist()
    return bool(abs(along) <= 0.5 * length + margin_m and abs(across) <= 0.5 * width + margin_m)


def is_ahead(
    track: Track, footprint: Footprint, pose_odom: Float64, curvature: float, direction: int, own_margin_m: float
) -> bool:
    """Whether a track lies ahead of the foremost edge, and is not the machine's own implement, tracked by mistake.

    Static objects behind it are covered by the raw field, moving ones by `bystanders`.
    """
    x, y = point_from_frame(pose_odom, *track.p_odom_m[:2].tolist())
    ahead_m = direction * x + 0.5 * length_m(track)
    foremost_m = direction * footprint.foremost_m(direction)
    return ahead_m >= foremost_m and not bool(
        is_own(np.array([[x], [y], [0.0]]), footprint, curvature, own_margin_m)[0]
    )


def is_within_reach(track: Track, pose_odom: Float64, length_m: float, horizon_s: float) -> bool:
    """Whether a track with a finite position could reach a swept area of this length within the horizon, by distance.

    A fast rejection: a fenced field has hundreds of tracks, most of them outside this circle.
    """
    (x, y), (vx, vy) = track.p_odom_m[:2].tolist(), track.velocity_mps[:2].tolist()
    moved_m = math.hypot(vx, vy) * horizon_s
    far_m = math.hypot(x - pose_odom[0], y - pose_odom[1]) - math.hypot(*track.size_m[:2].tolist())
    return math.isfinite(x + y) and not far_m > length_m + REACH_M + moved_m


def is_beside(track: Track, pose_odom: Float64, area: SweptArea) -> bool:
    """Whether the circle about a track's box lies outside the box about the swept area; its position is finite."""
    x, y = point_from_frame(pose_odom, *track.p_odom_m[:2].tolist())
    reach_m = math.hypot(*track.size_m[:2].tolist()) + area.step_m
    (x_low, x_high), (y_low, y_high) = area.box.x_m, area.box.y_m
    return x < x_low - reach_m or x > x_high + reach_m or y < y_low - reach_m or y > y_high + reach_m


def is_fragment_of(track: Track, static: Sequence[Track], margin_m: float) -> bool:
    """Whether the centre of a track lies within `margin_m` of the box of a larger track that is known not to move so.

    A vehicle passed closely is detected in fragments with moving centres. A person emerging beside it is covered by the
    raw field. A vehicle that comes may be seen in parts too: one without a known velocity is no reason to leave out
    another that moves.
    """
    for other in static:
        if other.id == track.id or length_m(other) <= length_m(track) or velocity_sigma_mps(other) > speed_mps(track):
            continue
        if covers(other, track.p_odom_m[:2], margin_m):
            return True
    return False


def without_known_structure(tracks: list[Track], is_known: KnownStructureFilter, max_length_m: float) -> list[Track]:
    """Tracks (with finite positions) that are not known structure: centre not on it, and not too long, because a long
    box may combine several walls."""
    compact = [track for track in tracks if not length_m(track) > max_length_m]  # NaN is kept
    if not compact:
        return compact
    is_structure = is_known(np.array([track.p_odom_m[:2] for track in compact]))
    return [track for track, known in zip(compact, is_structure, strict=True) if not known]


def without_posts(
    near: list[tuple[Track, bool]], posts_odom_m: Float64, config: TrackedConfig
) -> list[tuple[Track, bool]]:
    """Tracks, each with whether it moves, less the static slim ones at surveyed posts (P, 2) in odom.

    A gate post has the size of a person, and with a piece of the fence beside it for some scans a box that reaches into
    the gate and grows, so that it seems to move. The raw field covers post and person; one who walks away moves.
    """

    def is_post(track: Track) -> bool:
        is_broad = float(np.min(track.size_m[:2])) > config.max_post_width_m
        if is_broad or length_m(track) > config.max_unclassified_length_m:
            return False
        apart_m = np.abs(from_frame(np.append(track.p_odom_m[:2], track.yaw_rad), posts_odom_m))
        reach_m = 0.5 * track.size_m[:2] if length_m(track) > config.max_post_width_m else np.zeros(2)
        gaps_m = np.hypot(*np.maximum(apart_m - reach_m, 0.0).T)
        return bool((gaps_m <= config.post_tolerance_m).any())

    def is_mover(track: Track) -> bool:
        age_s = (track.last_seen_ns - track.first_seen_ns) * 1e-9
        return length_m(track) <= config.max_post_width_m or age_s >= config.joined_post_s

    return [(track, moves) for track, moves in near if (moves and is_mover(track)) or not is_post(track)]


def horizon_s(stop_s: float, config: TrackedConfig) -> float:
    """Time over which moving tracks are predicted, for the time in which the machine can have stopped."""
    return min(config.max_horizon_s, max(config.min_horizon_s, stop_s))


def tracks_near(
    area: SweptArea,
    tracks: Tracks | None,
    pose_odom: Float64,
    predicted_s: float,
    config: TrackedConfig,
    is_known: KnownStructureFilter | None = None,
) -> list[tuple[Track, bool]]:
    """Confirmed tracks that could reach the swept area within the prediction, each with whether it moves.

    `is_known` tests positions (N, 2) in odom for known structure: tracks there, and boxes long enough to combine
    several walls, are left to the raw field. So is what floats: a bird has left before the machine is there, and what
    stays in the path is a hit.
    """
    all_tracks = () if tracks is None else tracks.tracks
    confirmed = [t for t in all_tracks if t.is_confirmed and t.label is not ObstacleClass.AIRBORNE]
    reached = [t for t in confirmed if is_within_reach(t, pose_odom, area.length_m, predicted_s)]
    if is_known is not None:
        reached = without_known_structure(reached, is_known, config.max_unclassified_length_m)
    stamp_ns = 0 if tracks is None else tracks.stamp_ns
    near = [(track, is_moving(track, config) and not is_coasting(track, stamp_ns, config)) for track in reached]
    static = [track for track, moves in near if length_m(track) >= config.fragment_parent_m and not moves]
    return [(track, moves and not is_fragment_of(track, static, config.fragment_margin_m)) for track, moves in near]


def nearest_critical_object(
    area: SweptArea,
    near: Iterable[tuple[Track, bool]],
    pose_odom: Float64,
    predicted_s: float,
    config: TrackedConfig,
) -> CriticalObject:
    """Nearest critical object of tracks ahead, each with whether it moves, for base at `pose_odom` (3,) in odom.

    A moving track counts with its predicted positions until the machine can have stopped. A static track counts with
    its box if it has a class; the raw field covers the rest.
    """
    times_s = np.linspace(0.0, predicted_s, config.steps)
    best = NO_CRITICAL_OBJECT
    for track, moves in near:
        is_large = length_m(track) > config.max_static_length_m or np.min(track.size_m[:2]) > config.max_static_width_m
        if not moves and (track.label is ObstacleClass.UNKNOWN or is_large):
            continue  # left to the raw field: unclassified, or a box that covers free ground: fence, hedge, two cars
        if not moves and is_beside(track, pose_odom, area):
            continue
        clearance = _clearance_to_track(area, track, moves, pose_odom, times_s, config)
        if clearance < best.clearance_m:
            best = CriticalObject(clearance, track.label, track.id)
    return best


def _clearance_to_track(
    area: SweptArea, track: Track, moves: bool, pose_odom: Float64, times_s: Float64, config: TrackedConfig
) -> float:
    if moves:
        centers, reach = predicted(track, times_s, config)
        return float(np.min(distance_to_contact_m(from_frame(pose_odom, centers), area, reach + config.lateral_m)))
    return float(np.min(distance_to_contact_m(from_frame(pose_odom, box_points(track)), area)))

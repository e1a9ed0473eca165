"""What a detection tells of its track: place, speed, box, class, and what it does not tell."""

import numpy as np
import numpy.typing as npt

from messages.message import Float64, Int64
from perception.fusion.detections import Detections
from perception.fusion.fragments import middle_of
from perception.fusion.kalman import correct
from perception.fusion.static_occupancy import Stillness
from perception.fusion.tracks import Table, TrackerConfig, is_moving, is_vehicle, nanoseconds

PART, SLOWLY = 0.6, 0.01  # a vehicle's detection shorter than this share of it is a piece, and shrinks it slowly
ANYWHERE = 0.29  # 1 / √12: the sigma of an even share over a box
ON_ITS_WAY = 0.5  # of the way that its speed should have taken it: what has come less far has only jumped
NEAR_MIDDLE = 0.25  # of the sigma of a piece of scenery: what is not as near belongs to it by its box alone


def update(
    table: Table, tracks: Int64, seen: Detections, rows: Int64, stillness: Stillness, lidars: int, config: TrackerConfig
) -> None:
    """Tracks corrected in place by the detections matched to them; `lidars` are the bits of lidars in `sensors`."""
    x, P, size = table.x[tracks], table.P[tracks], seen.size_m[rows]
    is_part = is_vehicle(table.evidence[tracks]) & (size[:, 0] < PART * table.size_m[tracks, 0])
    fixed = ~is_part & _is_scenery(size, config) if seen.is_lidar else np.zeros(len(rows), np.bool_)
    was_lost = seen.stamp_ns - table.last_ns[tracks] > nanoseconds(config.lost_s)
    if fixed.any() or was_lost.any():
        _forget_way(x, P, seen, rows, fixed, was_lost, config)
    z, R = seen.p_m[rows, :2], seen.R[rows]
    # a piece, or an echo from somewhere on a box, tells of its middle only that the box must reach there
    on = is_part | (~np.bool_(seen.is_lidar) & (table.sensors[tracks] & lidars != 0))
    if on.any():
        own = np.where(is_part[on, None], size[on, :2], 0.0)
        z[on] = middle_of(x[on, :2], z[on], table.size_m[tracks[on], :2] - own, table.yaw_rad[tracks[on]])
        R[on] += np.eye(2) * (ANYWHERE * table.size_m[tracks[on], 0])[:, None, None] ** 2
    correct(x, P, z, R, 0)
    _correct_velocity(x, P, seen, rows, stillness, config)
    table.x[tracks], table.P[tracks] = x, P
    _watch_motion(table, tracks, z, seen.stamp_ns, config)
    # only returns measure a box: radar and cameras guess it
    boxed = (table.sensors[tracks] == 1 << seen.sensor) | seen.is_lidar
    table.boxed_ns[tracks[boxed]] = seen.stamp_ns
    is_first = np.bool_(seen.is_lidar) & (table.sensors[tracks] & lidars == 0)  # till now others guessed
    pace = np.where(is_part, SLOWLY, np.where(is_first | fixed, 1.0, 0.5))[boxed]
    theirs, mine = tracks[boxed], rows[boxed]
    table.height_m[theirs] = seen.p_m[mine, 2]
    table.size_m[theirs] += pace[:, None] * (size[boxed] - table.size_m[theirs])
    table.yaw_rad[theirs] = np.where(is_part[boxed], table.yaw_rad[theirs], seen.yaw_rad[mine])
    worth, scores = np.minimum(seen.returns[rows], seen.kind.worth), seen.log_scores[rows]
    table.returns[tracks] = np.minimum(table.returns[tracks] + worth, 10.0 * config.confirm_returns)
    told = (scores.max(axis=1) > scores.min(axis=1)) & ~is_part  # neither an echo nor a piece tells what its owner is
    table.evidence[tracks[told]] = config.class_memory * table.evidence[tracks[told]] + scores[told]
    table.last_ns[tracks] = seen.stamp_ns
    table.sensors[tracks] |= 1 << seen.sensor


def _watch_motion(table: Table, tracks: Int64, z: Float64, stamp_ns: int, config: TrackerConfig) -> None:
    """Who seems to move must come as far as that speed takes it; who does not is watched anew, in place."""
    x, since, has_moved = table.x[tracks], table.moving_ns[tracks], table.has_moved[tracks] > 0
    moves, dt_ns = is_moving(x, table.P[tracks], config), stamp_ns - since
    way = ((z - table.moved_from_m[tracks]) * x[:, 2:]).sum(axis=1)
    due = (since > 0) & (dt_ns >= nanoseconds(config.confirm_s))
    came = due & (way >= ON_ITS_WAY * dt_ns * 1e-9 * (x[:, 2:] ** 2).sum(axis=1))
    starts = moves & ~has_moved & ((since == 0) | (due & ~came))
    table.has_moved[tracks] = moves & (has_moved | came)
    table.moving_ns[tracks] = np.where(starts, stamp_ns, np.where(moves, since, 0))
    table.moved_from_m[tracks[starts]] = z[starts]


def _is_scenery(size_m: Float64, config: TrackerConfig) -> npt.NDArray[np.bool_]:
    """Whether what a lidar sees is likely a piece of a fence or wall, (K,)."""
    return np.asarray(config.noise.is_strip(size_m) | (size_m[:, 0] > config.stillness.longest_m))


def _forget_way(
    x: Float64,
    P: Float64,
    seen: Detections,
    rows: Int64,
    fixed: npt.NDArray[np.bool_],
    was_lost: npt.NDArray[np.bool_],
    config: TrackerConfig,
) -> None:
    """Scenery is where it is seen, and its middle moves with the view; for what was lost other clutter may stand."""
    x[fixed, :2], P[fixed, :2, :2] = seen.p_m[rows[fixed], :2], NEAR_MIDDLE**2 * seen.R[rows[fixed]]
    P[fixed | was_lost, :2, 2:] = P[fixed | was_lost, 2:, :2] = 0.0
    P[was_lost, 2:, 2:] = np.eye(2) * config.first_speed_mps**2


def _correct_velocity(
    x: Float64, P: Float64, seen: Detections, rows: Int64, stillness: Stillness, config: TrackerConfig
) -> None:
    """By the velocity that the sensor measured, or by what old cells allow."""
    speed = np.hypot(x[:, 2], x[:, 3])
    most = stillness.fastest(seen.still[rows], seen.size_m[rows, 0])
    allowed = x[:, 2:] * np.minimum(1.0, most / np.maximum(speed, 1e-9))[:, None]
    velocity = seen.velocity_mps[rows]
    measured = np.isfinite(velocity).all(axis=1)
    for which, z, sigma in (
        (measured, velocity, config.velocity_sigma_mps),
        (~measured & np.isfinite(most), allowed, config.still_sigma_mps),
    ):
        if which.any():
            xs, Ps = x[which], P[which]
            correct(xs, Ps, z[which], np.eye(2) * sigma**2, 2)
            x[which], P[which] = xs, Ps

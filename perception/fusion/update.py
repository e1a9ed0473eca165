"""Track update by matched detections: position, velocity, box and class.

The centre of a body moves with its outline: where something larger is separated otherwise than in the last scan, or a
track goes over to another part of it, the difference of their centres is no motion. Until its motion is confirmed, a
track whose box changes that much goes on from where it is now seen, at the velocity that it had if it is as short as a
person or an animal. What the same lidar saw as long in its last scan is the same part. At scans further apart, between
which a body may come into view, the evidence of its motion starts again.
"""

import numpy as np

from geometry.arrays import Bool, Float64, Int64
from perception.class_order import AIRBORNE, VEHICLE
from perception.fusion.detections import Detections
from perception.fusion.fitted_motion import has_travelled, length_in_view, remember
from perception.fusion.fragments import shift_center
from perception.fusion.kalman import box_noise, correct
from perception.fusion.tracks import (
    FLIGHT_MPS,
    FRAGMENT_LENGTH_RATIO,
    TrackerConfig,
    TrackTable,
    is_moving,
    is_of,
    nanoseconds,
    start_states,
)

FRAGMENT_GAIN = 0.01  # of a fragment on the size of its vehicle
UNIFORM_SIGMA = 0.29  # 1 / √12: sigma of a uniform distribution over a box
MIN_DISTANCE_SHARE = 0.5  # of the distance at the estimated speed; below it the track has only jumped
OTHER_PART_SHARE = 0.4  # of the longer box: a side that differs by more is that of another part
OTHER_PART_M = 1.1  # least length of the longer box: below it limbs and hidden parts change the outline of one body
STEADY_M, STEADY_TURN_M, STEADY_SHARE = 0.25, 0.8, 0.04  # change of a side, of an end; sigma over side
OTHER_HEIGHT_SHARE = 0.6  # of the higher box: so different ones are other parts at any length, as slab and pile
LONGEST_BODY_M = 2.5  # of a person or an animal; the visible parts of longer ones change all the time
OTHER_PART_NS = 150_000_000  # longest time between such scans, for those at 10 Hz
STRUCTURE_SIGMA_SHARE = 0.25  # of the position sigma of a static structure


def update(
    table: TrackTable,
    tracks: Int64,
    detections: Detections,
    rows: Int64,
    lidars: int,
    config: TrackerConfig,
) -> None:
    """Corrects tracks in place by their matched detections; `lidars` are the bits of lidars in `sensors`."""
    x, P, size = table.x[tracks], table.P[tracks], detections.size_m[rows]
    longer_m = np.maximum(size[:, 0], table.size_m[tracks, 0])
    is_piece = is_of(table.class_evidence[tracks], VEHICLE) & (
        size[:, 0] < FRAGMENT_LENGTH_RATIO * table.size_m[tracks, 0]
    )
    is_body = ~is_piece & np.bool_(detections.is_lidar)
    fixed = is_body & _is_structure(size, config)
    restarts = is_other = is_body & _is_other_part(table, tracks, size, longer_m, lidars)
    was_lost = detections.stamp_ns - table.last_ns[tracks] > nanoseconds(config.lost_s)
    if fixed.any() or was_lost.any():
        _reset_velocity(x, P, detections, rows, fixed, was_lost, config)
    z, R = detections.p_m[rows, :2], detections.R[rows]
    steady = is_body & _is_steady(table, tracks, size, detections.yaw_rad[rows])
    if steady.any():
        noise = config.noise.position_sigma_m, STEADY_SHARE
        R[steady] = box_noise(size[steady], detections.yaw_rad[rows][steady], *noise)
    # a fragment or an echo lies somewhere on the box: it only requires the box to contain it
    on = is_piece | (~np.bool_(detections.is_lidar) & (table.sensors[tracks] & lidars != 0))
    if on.any():
        own = np.where(is_piece[on, None], size[on, :2], 0.0)
        z[on] = shift_center(x[on, :2], z[on], table.size_m[tracks[on], :2] - own, table.yaw_rad[tracks[on]])
        R[on] += np.eye(2) * (UNIFORM_SIGMA * table.size_m[tracks[on], 0])[:, None, None] ** 2
    is_soon = detections.stamp_ns - table.last_ns[tracks] <= OTHER_PART_NS
    if is_other.any():
        R[is_other & is_soon] += np.eye(2) * (UNIFORM_SIGMA * longer_m[is_other & is_soon])[:, None, None] ** 2
        restarts = is_other & ~_is_of_one_body(table, tracks, detections, rows, z, longer_m)
    is_jump = restarts & is_soon
    before, before_P = x[is_jump], P[is_jump]
    correct(x, P, z, R, 0)
    table.restarted_ns[tracks[restarts]] = detections.stamp_ns
    table.moving_since_ns[tracks[restarts & ~is_jump]] = 0
    if is_jump.any():
        jumped = tracks[is_jump]
        is_long = longer_m[is_jump] > LONGEST_BODY_M
        x[is_jump], P[is_jump] = _moved_to(before, before_P, detections, rows[is_jump], is_long, config)
        P[is_jump & fixed, :2, :2] *= STRUCTURE_SIGMA_SHARE**2
        table.motion_origin_m[jumped] += z[is_jump] - before[:, :2]
        table.moving_since_ns[jumped[is_long]] = 0
    _correct_velocity(x, P, detections, rows, config)
    table.x[tracks], table.P[tracks] = x, P
    shows = detections.shows_motion[rows]
    _confirm_motion(table, tracks[shows], z[shows], detections.stamp_ns, config)
    _remember(table, tracks[~is_piece], detections, rows[~is_piece])
    _update_boxes(table, tracks, detections, rows, is_piece, fixed | is_jump, lidars)
    _add_evidence(table, tracks, detections, rows, is_piece, config)
    table.last_ns[tracks] = detections.stamp_ns
    table.sensors[tracks] |= 1 << detections.sensor


def _moved_to(
    x: Float64, P: Float64, detections: Detections, rows: Int64, is_long: Bool, config: TrackerConfig
) -> tuple[Float64, Float64]:
    """States (n, 4) and covariances (n, 4, 4) that start at these detections, with the velocities of shorter bodies."""
    moved, covariance = start_states(detections, rows, config)
    moved[~is_long, 2:], covariance[~is_long, 2:, 2:] = x[~is_long, 2:], P[~is_long, 2:, 2:]
    return moved, covariance


def _update_boxes(
    table: TrackTable, tracks: Int64, detections: Detections, rows: Int64, is_piece: Bool, is_new: Bool, lidars: int
) -> None:
    """Updates height, size and yaw in place; only lidar returns measure a box, other sensors estimate it.

    `is_new`: nothing is kept of the size before.
    """
    size = detections.size_m[rows]
    boxed = (table.sensors[tracks] == 1 << detections.sensor) | detections.is_lidar
    table.box_measured_ns[tracks[boxed]] = detections.stamp_ns
    was_estimated = np.bool_(detections.is_lidar) & (table.sensors[tracks] & lidars == 0)
    gain = np.where(is_piece, FRAGMENT_GAIN, np.where(was_estimated | is_new, 1.0, 0.5))[boxed]
    with_box, boxes = tracks[boxed], rows[boxed]
    table.height_m[with_box] = detections.p_m[boxes, 2]
    table.size_m[with_box] += gain[:, None] * (size[boxed] - table.size_m[with_box])
    table.yaw_rad[with_box] = np.where(is_piece[boxed], table.yaw_rad[with_box], detections.yaw_rad[boxes])


def _add_evidence(
    table: TrackTable, tracks: Int64, detections: Detections, rows: Int64, is_piece: Bool, config: TrackerConfig
) -> None:
    """Adds evidence of existence and of class in place; echoes and fragments carry no class.

    A bird in flight stays one where nothing shows the space beneath it, as before the machine.
    """
    evidence = np.minimum(detections.evidence[rows], detections.kind.evidence)
    table.evidence[tracks] = np.minimum(table.evidence[tracks] + evidence, 10.0 * config.confirm_evidence)
    scores = detections.class_log_scores[rows]
    has_class = (scores.max(axis=1) > scores.min(axis=1)) & ~is_piece
    flies = is_of(table.class_evidence[tracks], AIRBORNE) & (table.has_moved[tracks] > 0)
    flies &= np.hypot(table.x[tracks, 2], table.x[tracks, 3]) >= FLIGHT_MPS
    has_class &= ~flies | is_of(scores, AIRBORNE)
    table.floated_ns[tracks[is_of(scores, AIRBORNE)]] = detections.stamp_ns
    classified = tracks[has_class]
    table.class_evidence[classified] = config.class_memory * table.class_evidence[classified] + scores[has_class]


def _confirm_motion(table: TrackTable, tracks: Int64, z: Float64, stamp_ns: int, config: TrackerConfig) -> None:
    """Confirms motion, in place, of tracks that cover the distance expected at their speed; otherwise restarts."""
    x, since, has_moved = table.x[tracks], table.moving_since_ns[tracks], table.has_moved[tracks] > 0
    moves, dt_ns = is_moving(x, table.P[tracks], config), stamp_ns - since
    distance = ((z - table.motion_origin_m[tracks]) * x[:, 2:]).sum(axis=1)
    due = (since > 0) & (dt_ns >= nanoseconds(config.confirm_s))
    covered = due & (distance >= MIN_DISTANCE_SHARE * dt_ns * 1e-9 * (x[:, 2:] ** 2).sum(axis=1))
    starts = moves & ~has_moved & ((since == 0) | (due & ~covered))
    table.has_moved[tracks] = moves & (has_moved | covered)
    table.moving_since_ns[tracks] = np.where(starts, stamp_ns, np.where(moves, since, 0))
    table.motion_origin_m[tracks[starts]] = z[starts]


def _remember(table: TrackTable, tracks: Int64, detections: Detections, rows: Int64) -> None:
    """Adds whole bodies seen by lidar, in place, to the last detections of their tracks."""
    if detections.is_lidar:
        recent = table.recent_ns[tracks], table.recent_m[tracks], table.recent_view[tracks]
        remember(recent, detections.stamp_ns, detections.p_m[rows, :2], detections.view(rows))
        table.recent_ns[tracks], table.recent_m[tracks], table.recent_view[tracks] = recent


def _is_other_part(table: TrackTable, tracks: Int64, size_m: Float64, longer_m: Float64, lidars: int) -> Bool:
    """Whether lidar boxes (K,), the longer of old and new (K,), are of other parts; not of tracks that moved."""
    before_m = table.size_m[tracks]
    differs = np.abs(size_m[:, :2] - before_m[:, :2]).max(axis=1, initial=0.0) > OTHER_PART_SHARE * longer_m
    is_measured = (table.sensors[tracks] & lidars != 0) & (table.has_moved[tracks] == 0)
    is_large = (longer_m > OTHER_PART_M) | _has_other_height(before_m, size_m)
    return np.asarray(differs & is_large & is_measured)


def _has_other_height(before_m: Float64, size_m: Float64) -> Bool:
    """Whether the heights of boxes (K, 3) differ by more than those of the visible parts of one body."""
    change_m = np.abs(size_m[:, 2] - before_m[:, 2])
    return np.asarray(change_m > OTHER_HEIGHT_SHARE * np.maximum(size_m[:, 2], before_m[:, 2]))


def _is_of_one_body(
    table: TrackTable, tracks: Int64, detections: Detections, rows: Int64, z_m: Float64, longer_m: Float64
) -> Bool:
    """Whether detections (K,), at z (K, 2), the longer of both lengths (K,), are of the body of their track although
    their size is another: the same lidar saw it as long in its last scan, and about as high, or the track has gone on
    by more than parts of a body are apart."""
    length_m, recent_ns = detections.size_m[rows, 0], table.recent_ns[tracks]
    since_ns = detections.stamp_ns - OTHER_PART_NS
    in_view_m = length_in_view(recent_ns, table.recent_view[tracks], detections.sensor, since_ns)
    is_same = np.abs(length_m - in_view_m) <= OTHER_PART_SHARE * np.maximum(length_m, in_view_m)
    is_same &= ~_has_other_height(table.size_m[tracks], detections.size_m[rows])
    has_gone = has_travelled(recent_ns, table.recent_m[tracks], detections.stamp_ns, z_m, longer_m)
    return np.asarray(is_same | has_gone)


def _is_steady(table: TrackTable, tracks: Int64, size_m: Float64, yaw_rad: Float64) -> Bool:
    """Whether lidar boxes (K,) of vehicles are those of the last scans: then the centre is of the whole body."""
    change_m = np.abs(size_m[:, :2] - table.size_m[tracks, :2]).max(axis=1, initial=0.0)
    turn = np.abs(np.sin(yaw_rad - table.yaw_rad[tracks]))
    is_vehicle = is_of(table.class_evidence[tracks], VEHICLE)
    return np.asarray(is_vehicle & (change_m <= STEADY_M) & (turn * size_m[:, 0] <= STEADY_TURN_M))


def _is_structure(size_m: Float64, config: TrackerConfig) -> Bool:
    """Whether lidar boxes (K,) are likely sections of a fence or wall."""
    return np.asarray(config.noise.is_strip(size_m) | (size_m[:, 0] > config.static_occupancy.structure_length_m))


def _reset_velocity(
    x: Float64,
    P: Float64,
    detections: Detections,
    rows: Int64,
    fixed: Bool,
    was_lost: Bool,
    config: TrackerConfig,
) -> None:
    """Resets position of structures (their centre moves with the view) and velocity of lost tracks, in place."""
    x[fixed, :2], P[fixed, :2, :2] = (
        detections.p_m[rows[fixed], :2],
        STRUCTURE_SIGMA_SHARE**2 * detections.R[rows[fixed]],
    )
    P[fixed | was_lost, :2, 2:] = P[fixed | was_lost, 2:, :2] = 0.0
    P[was_lost, 2:, 2:] = np.eye(2) * config.initial_speed_sigma_mps**2


def _correct_velocity(x: Float64, P: Float64, detections: Detections, rows: Int64, config: TrackerConfig) -> None:
    """Corrects velocity, in place, by the measured one or by the bound from long-occupied cells.

    A bound far above 0, as of a body that has just set off, says little about the velocity.
    """
    speed = np.hypot(x[:, 2], x[:, 3])
    bound = detections.max_speed_mps[rows]
    allowed = x[:, 2:] * np.minimum(1.0, bound / np.maximum(speed, 1e-9))[:, None]
    velocity = detections.velocity_mps[rows]
    measured = np.isfinite(velocity).all(axis=1)
    for which, z, sigma in (
        (measured, velocity, np.full(len(x), config.velocity_sigma_mps)),
        (~measured & np.isfinite(bound), allowed, np.maximum(bound, config.static_sigma_mps)),
    ):
        if which.any():
            xs, Ps = x[which], P[which]
            correct(xs, Ps, z[which], np.eye(2) * (sigma[which] ** 2)[:, None, None], 2)
            x[which], P[which] = xs, Ps

"""Track table: association, lifetime and class of tracks; times in seconds, evidence in returns, never in scans."""

from dataclasses import dataclass, fields

import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from configs.strict import Config
from geometry.arrays import Bool, Float64, Int64
from messages.perception import ObstacleClass
from perception.class_order import AIRBORNE, CLASSES, PERSON, POLE, UNKNOWN, VEHICLE
from perception.fusion.detections import Detections, KindConfig, KindConfigs, NoiseConfig
from perception.fusion.fitted_motion import KEPT, FittedMotionConfig, fitted_motion, remember
from perception.fusion.fragments import FragmentsConfig, ParentTracks, is_fragment
from perception.fusion.kalman import distances, predict
from perception.fusion.static_occupancy import StaticOccupancy, StaticOccupancyConfig

MOVING_CLASSES = np.isin(CLASSES, (ObstacleClass.PERSON, ObstacleClass.ANIMAL, ObstacleClass.VEHICLE))
FLIGHT_MPS = 3.0  # a person or an animal that runs so fast was seen on the ground before
SLENDER_M, PERSON_HEIGHT_M = 0.5, 2.0  # what is narrower and higher, of no class, is a post or the edge of a wall
RAIL_M, RAIL_RATIO = 0.6, 0.1  # least length, and greatest width over it, of a piece of fence
LINE_M, LINE_RATIO, LINE_HEIGHT_M = 0.3, 0.2, 0.3  # the same of a line of returns, and its greatest height
LOW_MPS = 8.0  # greatest speed of a body that is seen as a low line, or no wider than a sliver
SLIVER_M = 0.25  # greatest length of what is seen of the next posts of a row, or of a wall, through a moving gap
ALONG = 0.94  # cosine of 20°
GATED_COST = 1e9
FRAGMENT_LENGTH_RATIO = 0.6  # a shorter box of a vehicle is a fragment of it
EQUAL = 0.05  # difference of log scores


class TrackerConfig(Config):
    """Noise, gate, confirmation and deletion of tracks."""

    noise: NoiseConfig
    velocity_sigma_mps: float = Field(gt=0.0, le=5.0, description="of a measured velocity")
    static_sigma_mps: float = Field(gt=0.0, le=5.0, description="of the speed bound from long-occupied cells")
    initial_speed_sigma_mps: float = Field(gt=0.0, le=20.0, description="of a new track")
    acceleration_mps2: float = Field(gt=0.0, le=10.0)
    gate_sigma: float = Field(gt=0.0, le=10.0)
    confirm_s: float = Field(ge=0.0, le=2.0)
    confirm_evidence: float = Field(ge=0.0, le=200.0, description="sum over detections")
    miss_penalty: float = Field(
        ge=0.0, le=1.0, description="share of the evidence of a detection, lost when a sensor misses its track"
    )
    kinds: KindConfigs
    fragments: FragmentsConfig
    lost_s: float = Field(gt=0.0, le=10.0, description="gap after which the velocity of a track is reset")
    moving_sigma: float = Field(gt=0.0, le=10.0, description="a slower speed is published as 0")
    fitted_motion: FittedMotionConfig
    class_memory: float = Field(
        ge=0.0, lt=1.0, description="share of the class evidence kept from one detection to the next"
    )
    static_occupancy: StaticOccupancyConfig


@dataclass
class TrackTable:
    """Tracks as columns of T rows, so that all are predicted and matched at once; state and size in `odom`.

    `moving_since_ns`: start of uninterrupted motion (0: none), `motion_origin_m`: position at that time; `has_moved`:
    whether the distance since agrees with the speed; `box_measured_ns`: stamp of the last measured box;
    `restarted_ns`: when the track started or went over to another part; `floated_ns`: when it was last seen with clear
    space beneath it (0: never); `recent_ns`, `recent_m` and
    `recent_view`, sensor and length: the last detections by lidar.
    """

    id: Int64
    x: Float64
    P: Float64
    height_m: Float64
    size_m: Float64
    yaw_rad: Float64
    evidence: Float64
    class_evidence: Float64
    first_ns: Int64
    last_ns: Int64
    expires_ns: Int64
    moving_since_ns: Int64
    motion_origin_m: Float64
    has_moved: Int64
    box_measured_ns: Int64
    is_confirmed: Int64
    sensors: Int64
    restarted_ns: Int64
    floated_ns: Int64
    recent_ns: Int64
    recent_m: Float64
    recent_view: Float64

    def select(self, wanted: Int64) -> "TrackTable":
        """The given rows, in ascending order; the table itself when these are all rows."""
        if len(wanted) == len(self.id):
            return self
        return TrackTable(*(getattr(self, name)[wanted] for name in COLUMNS))

    def append(self, other: "TrackTable") -> "TrackTable":
        """The rows of this table followed by those of another."""
        if not len(other.id):
            return self
        return TrackTable(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in COLUMNS))


COLUMNS = tuple(f.name for f in fields(TrackTable))


def warm(config: TrackerConfig) -> None:
    """Compiles or loads all kernels at start-up, so that no message waits for it."""
    distances(np.zeros((1, 4)), np.eye(4)[None].copy(), np.zeros((1, 2)), np.eye(2)[None].copy())
    static_occupancy = StaticOccupancy(config.static_occupancy)
    offsets = np.array([0, 1], np.int32)
    offsets.flags.writeable = False  # as in messages: kernels are compiled per array type
    static_occupancy.observe(np.zeros((1, 3), np.float32), offsets, np.ones(1), 0)
    table = empty_table()
    static_occupancy.contradicts_motion(table.x, velocities(table, config)[0], table.size_m, 0)
    static_occupancy.continues_ahead(table.x, velocities(table, config)[0], table.size_m, 0)
    merge_fragments(table, parent_tracks(table, 0, config), 0, 0, config)


def empty_table() -> TrackTable:
    """No tracks."""
    no_int = np.zeros(0, np.int64)
    none = np.zeros(0)
    return TrackTable(
        no_int, np.zeros((0, 4)), np.zeros((0, 4, 4)), none, np.zeros((0, 3)), none, none, np.zeros((0, len(CLASSES))),
        no_int, no_int, no_int, no_int, np.zeros((0, 2)), no_int, no_int, no_int, no_int, no_int, no_int,
        np.zeros((0, KEPT), np.int64), np.zeros((0, KEPT, 2)), np.zeros((0, KEPT, 2)),
    )  # fmt: skip


def start_states(detections: Detections, rows: Int64, config: TrackerConfig) -> tuple[Float64, Float64]:
    """State (n, 4) and covariance (n, 4, 4) of tracks that start with these detections."""
    n = len(rows)
    x, P = np.zeros((n, 4)), np.zeros((n, 4, 4))
    x[:, :2], P[:, :2, :2] = detections.p_m[rows, :2], detections.R[rows]
    measured = np.isfinite(detections.velocity_mps[rows]).all(axis=1)
    x[measured, 2:] = detections.velocity_mps[rows][measured]
    sigma = np.where(measured, config.velocity_sigma_mps, config.initial_speed_sigma_mps)
    P[:, 2, 2] = P[:, 3, 3] = sigma**2
    return x, P


def start_tracks(detections: Detections, rows: Int64, first_id: int, config: TrackerConfig) -> TrackTable:
    """New tracks from unmatched detections."""
    n = len(rows)
    x, P = start_states(detections, rows, config)
    stamp = np.full(n, detections.stamp_ns, np.int64)
    recent = np.zeros((n, KEPT), np.int64), np.zeros((n, KEPT, 2)), np.zeros((n, KEPT, 2))
    if detections.is_lidar:
        remember(recent, detections.stamp_ns, detections.p_m[rows, :2], detections.view(rows))
    return TrackTable(
        np.arange(first_id, first_id + n), x, P, detections.p_m[rows, 2], detections.size_m[rows],
        detections.yaw_rad[rows],
        detections.evidence[rows], detections.class_log_scores[rows], stamp, stamp.copy(),
        stamp + nanoseconds(detections.kind.keep_unconfirmed_s),
        np.zeros(n, np.int64), x[:, :2].copy(), np.zeros(n, np.int64), stamp.copy(), np.zeros(n, np.int64),
        np.full(n, 1 << detections.sensor, np.int64), stamp.copy(),
        np.where(is_of(detections.class_log_scores[rows], AIRBORNE), detections.stamp_ns, 0), *recent,
    )  # fmt: skip


def predict_tracks(table: TrackTable, dt_s: float, config: TrackerConfig) -> None:
    """Predicts all tracks in place."""
    if dt_s > 0.0 and len(table.id):
        predict(table.x, table.P, dt_s, config.acceleration_mps2)


def match(table: TrackTable, detections: Detections, config: TrackerConfig) -> tuple[Int64, Int64]:
    """Matched rows of tracks and of detections: least total cost within the gate."""
    d2, cost = distances(table.x, table.P, np.ascontiguousarray(detections.p_m[:, :2]), detections.R)
    gate = config.gate_sigma if detections.is_lidar else config.fragments.gate_sigma
    cost = np.where((d2 <= gate**2) & _agrees(table, detections, config), cost, GATED_COST)
    tracks, columns = linear_sum_assignment(cost)
    is_valid = cost[tracks, columns] < GATED_COST
    return tracks[is_valid].astype(np.int64), columns[is_valid].astype(np.int64)


def _agrees(table: TrackTable, detections: Detections, config: TrackerConfig) -> Bool:
    """Whether measured velocity and body size agree with the tracks, (T, K); unknown values agree."""
    if detections.is_lidar:
        return np.ones((len(table.id), len(detections.yaw_rad)), np.bool_)
    S = np.maximum(table.P[:, 2, 2], table.P[:, 3, 3]) + config.velocity_sigma_mps**2
    apart = np.linalg.norm(table.x[:, None, 2:] - detections.velocity_mps, axis=2)
    too_large = table.size_m[:, :1] > config.fragments.max_size_ratio * detections.body_length_m
    return np.asarray(~(apart > config.gate_sigma * np.sqrt(S)[:, None]) & ~too_large)


def confirm(table: TrackTable, config: TrackerConfig) -> None:
    """Confirms, in place and permanently, tracks of sufficient duration and evidence."""
    lasted = table.last_ns - table.first_ns >= round(config.confirm_s * 1e9)
    table.is_confirmed |= (lasted & (table.evidence >= config.confirm_evidence)).astype(np.int64)


def penalize_misses(table: TrackTable, missed: Int64, kind: KindConfig, config: TrackerConfig) -> None:
    """Reduces, in place, the evidence of unconfirmed tracks that a sensor missed."""
    table.evidence[missed] -= config.miss_penalty * kind.evidence * (table.is_confirmed[missed] == 0)


def extend_lifetime(table: TrackTable, tracks: Int64, detections: Detections) -> None:
    """Extends, in place, the lifetime of matched tracks by the time that their sensor may miss them."""
    keep = np.where(
        table.is_confirmed[tracks] > 0,
        nanoseconds(detections.kind.keep_s),
        nanoseconds(detections.kind.keep_unconfirmed_s),
    )
    table.expires_ns[tracks] = np.maximum(table.expires_ns[tracks], detections.stamp_ns + keep)


def active_rows(table: TrackTable, stamp_ns: int) -> Int64:
    """Rows of the tracks that are kept."""
    return np.flatnonzero((stamp_ns <= table.expires_ns) & (table.evidence > 0.0)).astype(np.int64)


def nanoseconds(seconds: float) -> int:
    """Seconds as integer nanoseconds."""
    return round(seconds * 1e9)


def is_of(class_evidence: Float64, label: int) -> Bool:
    """Whether the most likely class is the one with index `label`, (T,), from class evidence (T, 8)."""
    return np.asarray(class_evidence.argmax(axis=1) == label) if len(class_evidence) else np.zeros(0, np.bool_)


def is_body(class_evidence: Float64) -> Bool:
    """Which (T,) are bodies separated from something larger, a person or unknown; from class evidence (T, 8)."""
    pair = class_evidence[:, [UNKNOWN, PERSON]]
    return np.asarray(pair.min(axis=1) >= class_evidence.max(axis=1, initial=-np.inf) - EQUAL)


def is_moving_class(class_evidence: Float64) -> Bool:
    """Whether the most likely class moves (person, animal, vehicle), (T,), from class evidence (T, 8)."""
    return np.asarray(MOVING_CLASSES[class_evidence.argmax(axis=1)]) if len(class_evidence) else np.zeros(0, np.bool_)


def unmatched(count: int, matched: Int64) -> Int64:
    """Those of `count` rows that are not matched."""
    is_unmatched = np.ones(count, np.bool_)
    is_unmatched[matched] = False
    return np.flatnonzero(is_unmatched).astype(np.int64)


def parent_tracks(table: TrackTable, lidars: int, config: TrackerConfig) -> ParentTracks:
    """Confirmed tracks of lidars (bits of `sensors`)."""
    row = np.flatnonzero((table.is_confirmed > 0) & measured_by_lidar(table, lidars, config)).astype(np.int64)
    return ParentTracks(
        row, table.x[row], table.size_m[row], table.yaw_rad[row], velocities(table, config)[0][row],
        is_of(table.class_evidence[row], VEHICLE), table.recent_ns[row, -1] == table.last_ns[row],
    )  # fmt: skip


def measured_by_lidar(table: TrackTable, lidars: int, config: TrackerConfig) -> Bool:
    """Whether a lidar measured the boxes (T,) within `lost_s`; otherwise only other sensors kept the track."""
    is_fresh = table.last_ns - table.box_measured_ns <= nanoseconds(config.lost_s)
    return np.asarray((table.sensors & lidars != 0) & is_fresh)


def drop_fragments(detections: Detections, rows: Int64, parents: ParentTracks, config: TrackerConfig) -> Int64:
    """Rows of detections that are no fragment of a track."""
    found = is_fragment(
        detections.p_m[rows], detections.R[rows], detections.velocity_mps[rows], detections.body_length_m[rows],
        detections.size_m[rows],
        np.full(len(rows), detections.is_lidar), is_of(detections.class_log_scores[rows], PERSON),
        is_body(detections.class_log_scores[rows]), parents, config.fragments,
    )  # fmt: skip
    return rows[~found.any(axis=1)]


def merge_fragments(
    table: TrackTable, parents: ParentTracks, lidars: int, cameras: int, config: TrackerConfig
) -> Int64:
    """Rows of tracks that are no fragment; adds, in place, the sensors of fragments to their parents."""
    velocity = np.where((table.P[:, 2, 2] + table.P[:, 3, 3] < 1.0)[:, None], table.x[:, 2:], np.nan)
    body = np.where(table.sensors & cameras != 0, table.size_m[:, 0], np.nan)
    is_lidar = measured_by_lidar(table, lidars, config)
    found = is_fragment(
        table.x, table.P, velocity, body, table.size_m, is_lidar, is_of(table.class_evidence, PERSON),
        is_body(table.class_evidence), parents,
        config.fragments,
    )  # fmt: skip
    found[parents.row, np.arange(len(parents.row))] = False
    _keep_older(found, table, parents)
    fragment, parent = np.nonzero(found)
    np.bitwise_or.at(table.sensors, parents.row[parent], table.sensors[fragment])
    return np.flatnonzero(~found.any(axis=1)).astype(np.int64)


def _keep_older(found: Bool, table: TrackTable, parents: ParentTracks) -> None:
    """Exchanges, in place, fragment and parent where a new track took the detections of an older vehicle."""
    between, first, length = found[parents.row], table.first_ns[parents.row], parents.size_m[:, 0]
    is_alike = parents.is_vehicle[:, None] & (length[:, None] >= FRAGMENT_LENGTH_RATIO * length)
    is_older = between & is_alike & (first[:, None] < first)
    found[parents.row] = between & ~is_older | is_older.T


def velocities(table: TrackTable, config: TrackerConfig) -> tuple[Float64, Float64]:
    """Velocity (T, 2) of tracks with confirmed motion, else 0: one jump is no motion; and its covariance (T, 2, 2)."""
    moves = (table.has_moved > 0) & is_moving(table.x, table.P, config)
    slow, sigma, is_slow = fitted_motion(
        table.recent_ns, table.recent_m, table.restarted_ns, table.size_m, config.fitted_motion
    )
    is_slow &= ~moves
    velocity = np.where(moves[:, None], table.x[:, 2:], np.where(is_slow[:, None], slow, 0.0))
    covariance = np.where(is_slow[:, None, None], (sigma**2)[:, None, None] * np.eye(2), table.P[:, 2:, 2:])
    return velocity, covariance


def is_moving(x: Float64, P: Float64, config: TrackerConfig) -> Bool:
    """Whether velocities (T,) are significant against their uncertainty."""
    v, S = x[:, 2:], P[:, 2:, 2:]
    a, b, c = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    d2 = (c * v[:, 0] ** 2 - 2.0 * b * v[:, 0] * v[:, 1] + a * v[:, 1] ** 2) / (a * c - b * b)
    return np.asarray(d2 >= config.moving_sigma**2)


def is_rail(size_m: Float64, class_evidence: Float64) -> Bool:
    """Which tracks (T,), by class no vehicles, are as thin as a piece of fence: it moves with the rings on it."""
    is_thin = (size_m[:, 0] >= RAIL_M) & (size_m[:, 1] <= RAIL_RATIO * size_m[:, 0])
    return np.asarray(is_thin & ~is_of(class_evidence, VEHICLE))


def is_line(size_m: Float64) -> Bool:
    """Which tracks (T,) are low lines of returns."""
    return np.asarray(
        (size_m[:, 0] >= LINE_M) & (size_m[:, 1] <= LINE_RATIO * size_m[:, 0]) & (size_m[:, 2] <= LINE_HEIGHT_M)
    )


def is_view(size_m: Float64, label: Int64, velocity_mps: Float64) -> Bool:
    """Which tracks (T,) of no class are low lines or slivers faster than such a body: what is seen changes.

    These are rings on a crest as the machine pitches, and posts one behind the other as it passes a gap before them.
    """
    is_small = is_line(size_m) | (size_m[:, 0] <= SLIVER_M)
    return np.asarray(is_small & (label == UNKNOWN) & (np.hypot(*velocity_mps.T) > LOW_MPS))


def is_line_along(size_m: Float64, yaw_rad: Float64, velocity_mps: Float64) -> Bool:
    """Which tracks (T,) are low lines of returns that move along themselves, as where rings meet rails or slopes."""
    along = np.abs(velocity_mps[:, 0] * np.cos(yaw_rad) + velocity_mps[:, 1] * np.sin(yaw_rad))
    return np.asarray(is_line(size_m) & (along >= ALONG * np.hypot(*velocity_mps.T)))


def is_upright(size_m: Float64, label: Int64) -> Bool:
    """Which tracks (T,) are posts or wall edges: the edge of a wall seen end-on moves along the wall with the view."""
    is_slender = (label == POLE) | (label == UNKNOWN) & (size_m[:, 0] <= SLENDER_M)
    return np.asarray(is_slender & (size_m[:, 2] > PERSON_HEIGHT_M))

"""Obstacles followed over time: association, life and class of tracks, in seconds and returns, never in scans."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from configs.strict import Config
from messages.message import Float64, Int64
from messages.perception import ObstacleClass
from perception.fusion.detections import Detections, KindConfig, KindsConfig, NoiseConfig
from perception.fusion.fragments import VEHICLE, Hosts, PartsConfig, explained
from perception.fusion.kalman import distances, predict
from perception.fusion.static_occupancy import Stillness, StillnessConfig

CLASSES = tuple(ObstacleClass)
BODIES = np.isin(CLASSES, (ObstacleClass.PERSON, ObstacleClass.ANIMAL, ObstacleClass.VEHICLE))
UNKNOWN, POLE = CLASSES.index(ObstacleClass.UNKNOWN), CLASSES.index(ObstacleClass.POLE)
SLIM_M, TALLEST_M = 0.3, 2.0  # what is as slim and higher is nobody who walks
REFUSED = 1e9
SPEEDS_MPS = {ObstacleClass.PERSON: 4.0, ObstacleClass.POLE: 0.7, ObstacleClass.MOUND: 0.7, ObstacleClass.DITCH: 0.7}
FASTEST_MPS = np.array([SPEEDS_MPS.get(label, np.inf) for label in CLASSES])


class TrackerConfig(Config):
    """Noise, gate, and what it takes to confirm and to forget."""

    noise: NoiseConfig
    velocity_sigma_mps: float = Field(gt=0.0, le=5.0, description="of a velocity that a sensor measures")
    still_sigma_mps: float = Field(gt=0.0, le=5.0, description="of the bound on speed that old cells give")
    first_speed_mps: float = Field(gt=0.0, le=20.0, description="sigma of the speed of what is seen first")
    acceleration_mps2: float = Field(gt=0.0, le=10.0)
    gate_sigma: float = Field(gt=0.0, le=10.0)
    confirm_s: float = Field(ge=0.0, le=2.0)
    confirm_returns: float = Field(ge=0.0, le=200.0, description="worth of detections, summed")
    doubt_share: float = Field(ge=0.0, le=1.0, description="of its worth, lost when a sensor misses what it saw")
    kinds: KindsConfig
    parts: PartsConfig
    lost_s: float = Field(gt=0.0, le=10.0, description="seen again after longer, its way since tells no speed")
    moving_sigma: float = Field(gt=0.0, le=10.0, description="a slower speed than this is given as none")
    class_memory: float = Field(ge=0.0, lt=1.0, description="of the evidence, kept from one detection to the next")
    stillness: StillnessConfig


@dataclass
class Table:
    """Tracks as columns of T rows, so that all are moved and matched at once; state and size in `odom`.

    `moving_ns` is since when they have moved at every detection (0: they do not), `moved_from_m` where they then were,
    `has_moved` whether they have since come as far as their speed says, `boxed_ns` when a box was measured.
    """

    id: Int64
    x: Float64
    P: Float64
    height_m: Float64
    size_m: Float64
    yaw_rad: Float64
    returns: Float64
    evidence: Float64
    first_ns: Int64
    last_ns: Int64
    until_ns: Int64
    moving_ns: Int64
    moved_from_m: Float64
    has_moved: Int64
    boxed_ns: Int64
    is_confirmed: Int64
    sensors: Int64

    def rows(self, wanted: Int64) -> "Table":
        """Only these rows, in ascending order; the table itself when they are all of it."""
        if len(wanted) == len(self.id):
            return self
        return Table(*(getattr(self, name)[wanted] for name in COLUMNS))

    def below(self, other: "Table") -> "Table":
        """These rows, then those of another table."""
        if not len(other.id):
            return self
        return Table(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in COLUMNS))


COLUMNS = tuple(f.name for f in fields(Table))


def warm(config: TrackerConfig) -> None:
    """Compile or load all kernels at start-up, so that no message waits for it."""
    distances(np.zeros((1, 4)), np.eye(4)[None].copy(), np.zeros((1, 2)), np.eye(2)[None].copy())
    stillness = Stillness(config.stillness)
    offsets = np.array([0, 1], np.int32)
    offsets.flags.writeable = False  # as in messages: kernels are compiled for each kind of array
    stillness.observe(np.zeros((1, 3), np.float32), offsets, 0)
    table = empty_table()
    stillness.is_refuted(table.x, velocities(table, config), table.size_m, 0)
    not_parts(table, hosts_of(table, 0, config), 0, 0, config)


def empty_table() -> Table:
    """No tracks."""
    whole = np.zeros(0, np.int64)
    none = np.zeros(0)
    return Table(
        whole, np.zeros((0, 4)), np.zeros((0, 4, 4)), none, np.zeros((0, 3)), none, none, np.zeros((0, len(CLASSES))),
        whole, whole, whole, whole, np.zeros((0, 2)), whole, whole, whole, whole,
    )  # fmt: skip


def begin(seen: Detections, rows: Int64, first_id: int, config: TrackerConfig) -> Table:
    """New tracks from detections that belong to none."""
    n = len(rows)
    x, P = np.zeros((n, 4)), np.zeros((n, 4, 4))
    x[:, :2], P[:, :2, :2] = seen.p_m[rows, :2], seen.R[rows]
    measured = np.isfinite(seen.velocity_mps[rows]).all(axis=1)
    x[measured, 2:] = seen.velocity_mps[rows][measured]
    sigma = np.where(measured, config.velocity_sigma_mps, config.first_speed_mps)
    P[:, 2, 2] = P[:, 3, 3] = sigma**2
    stamp = np.full(n, seen.stamp_ns, np.int64)
    return Table(
        np.arange(first_id, first_id + n), x, P, seen.p_m[rows, 2], seen.size_m[rows], seen.yaw_rad[rows],
        seen.returns[rows], seen.log_scores[rows], stamp, stamp.copy(), stamp + nanoseconds(seen.kind.forget_new_s),
        np.zeros(n, np.int64), x[:, :2].copy(), np.zeros(n, np.int64), stamp.copy(), np.zeros(n, np.int64),
        np.full(n, 1 << seen.sensor, np.int64),
    )  # fmt: skip


def move(table: Table, dt_s: float, config: TrackerConfig) -> None:
    """All tracks moved on in place."""
    if dt_s > 0.0 and len(table.id):
        predict(table.x, table.P, dt_s, config.acceleration_mps2)


def match(table: Table, seen: Detections, config: TrackerConfig) -> tuple[Int64, Int64]:
    """Rows of tracks and of detections that belong together: least total cost within the gate."""
    d2, cost = distances(table.x, table.P, np.ascontiguousarray(seen.p_m[:, :2]), seen.R)
    gate = config.gate_sigma if seen.is_lidar else config.parts.gate_sigma
    cost = np.where((d2 <= gate**2) & _agrees(table, seen, config), cost, REFUSED)
    tracks, detections = linear_sum_assignment(cost)
    good = cost[tracks, detections] < REFUSED
    return tracks[good].astype(np.int64), detections[good].astype(np.int64)


def _agrees(table: Table, seen: Detections, config: TrackerConfig) -> npt.NDArray[np.bool_]:
    """Whether measured velocity and body fit the tracks, (T, K); what is not known does not disagree."""
    if seen.is_lidar:
        return np.ones((len(table.id), len(seen.yaw_rad)), np.bool_)
    S = np.maximum(table.P[:, 2, 2], table.P[:, 3, 3]) + config.velocity_sigma_mps**2
    apart = np.linalg.norm(table.x[:, None, 2:] - seen.velocity_mps, axis=2)
    too_large = table.size_m[:, :1] > config.parts.largest * seen.body_m
    return np.asarray(~(apart > config.gate_sigma * np.sqrt(S)[:, None]) & ~too_large)


def confirm(table: Table, config: TrackerConfig) -> None:
    """Tracks that lasted long enough and gathered enough returns are confirmed, in place and for good."""
    lasted = table.last_ns - table.first_ns >= round(config.confirm_s * 1e9)
    table.is_confirmed |= (lasted & (table.returns >= config.confirm_returns)).astype(np.int64)


def doubt(table: Table, missed: Int64, kind: KindConfig, config: TrackerConfig) -> None:
    """Unconfirmed tracks that a sensor missed lose evidence, in place."""
    table.returns[missed] -= config.doubt_share * kind.worth * (table.is_confirmed[missed] == 0)


def prolong(table: Table, tracks: Int64, seen: Detections) -> None:
    """Tracks just seen are kept as long as the sensor that saw them may miss them, in place."""
    keep = np.where(
        table.is_confirmed[tracks] > 0, nanoseconds(seen.kind.forget_s), nanoseconds(seen.kind.forget_new_s)
    )
    table.until_ns[tracks] = np.maximum(table.until_ns[tracks], seen.stamp_ns + keep)


def alive(table: Table, stamp_ns: int) -> Int64:
    """Rows of the tracks that are not to be forgotten."""
    return np.flatnonzero((stamp_ns <= table.until_ns) & (table.returns > 0.0)).astype(np.int64)


def nanoseconds(seconds: float) -> int:
    """A time as stamps count it."""
    return round(seconds * 1e9)


def is_vehicle(evidence: Float64) -> npt.NDArray[np.bool_]:
    """Whether a vehicle is what evidence (T, 7) speaks for most, (T,)."""
    return np.asarray(evidence.argmax(axis=1) == VEHICLE) if len(evidence) else np.zeros(0, np.bool_)


def is_body(evidence: Float64) -> npt.NDArray[np.bool_]:
    """Whether evidence (T, 7) speaks most for something that moves by itself, (T,)."""
    return np.asarray(BODIES[evidence.argmax(axis=1)]) if len(evidence) else np.zeros(0, np.bool_)


def left_over(count: int, matched: Int64) -> Int64:
    """Which of `count` rows are not among the matched ones."""
    is_left = np.ones(count, np.bool_)
    is_left[matched] = False
    return np.flatnonzero(is_left).astype(np.int64)


def hosts_of(table: Table, lidars: int, config: TrackerConfig) -> Hosts:
    """Confirmed tracks that lidars (bits of `sensors`) see."""
    row = np.flatnonzero((table.is_confirmed > 0) & by_lidar(table, lidars, config)).astype(np.int64)
    return Hosts(
        row, table.x[row], table.size_m[row], table.yaw_rad[row], velocities(table, config)[row],
        is_vehicle(table.evidence[row]),
    )  # fmt: skip


def by_lidar(table: Table, lidars: int, config: TrackerConfig) -> npt.NDArray[np.bool_]:
    """Whether a lidar has measured the boxes (T,) of late; others alone may have kept a track since."""
    is_fresh = table.last_ns - table.boxed_ns <= nanoseconds(config.lost_s)
    return np.asarray((table.sensors & lidars != 0) & is_fresh)


def not_explained(seen: Detections, rows: Int64, hosts: Hosts, config: TrackerConfig) -> Int64:
    """Of these detections those that are of no thing a track stands for."""
    found = explained(
        seen.p_m[rows], seen.R[rows], seen.velocity_mps[rows], seen.body_m[rows], seen.size_m[rows],
        np.full(len(rows), seen.is_lidar), hosts, config.parts,
    )  # fmt: skip
    return rows[~found.any(axis=1)]


def not_parts(table: Table, hosts: Hosts, lidars: int, cameras: int, config: TrackerConfig) -> Int64:
    """Rows of tracks that are no part of another one; their sensors go to the track that they are of, in place."""
    velocity = np.where((table.P[:, 2, 2] + table.P[:, 3, 3] < 1.0)[:, None], table.x[:, 2:], np.nan)
    body = np.where(table.sensors & cameras != 0, table.size_m[:, 0], np.nan)
    is_lidar = by_lidar(table, lidars, config)
    found = explained(table.x, table.P, velocity, body, table.size_m, is_lidar, hosts, config.parts)
    found[hosts.row, np.arange(len(hosts.row))] = False
    part, host = np.nonzero(found)
    np.bitwise_or.at(table.sensors, hosts.row[host], table.sensors[part])
    return np.flatnonzero(~found.any(axis=1)).astype(np.int64)


def velocities(table: Table, config: TrackerConfig) -> Float64:
    """Velocity (T, 2) of what has moved for as long as confirming takes, else 0: one jump is no motion."""
    moves = (table.has_moved > 0) & is_moving(table.x, table.P, config)
    return np.where(moves[:, None], table.x[:, 2:], 0.0)


def is_moving(x: Float64, P: Float64, config: TrackerConfig) -> npt.NDArray[np.bool_]:
    """Whether velocities (T,) are more than their own uncertainty makes of standing things."""
    v, S = x[:, 2:], P[:, 2:, 2:]
    a, b, c = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    d2 = (c * v[:, 0] ** 2 - 2.0 * b * v[:, 0] * v[:, 1] + a * v[:, 1] ** 2) / (a * c - b * b)
    return np.asarray(d2 >= config.moving_sigma**2)


def is_upright(size_m: Float64, label: Int64) -> npt.NDArray[np.bool_]:
    """Which tracks (T,) are posts, or edges of walls: where a wall's face is seen end on, that edge runs along it."""
    is_slim = (label == POLE) | (label == UNKNOWN) & (size_m[:, 0] <= SLIM_M)
    return np.asarray(is_slim & (size_m[:, 2] > TALLEST_M))


def classify(table: Table, velocity_mps: Float64) -> tuple[Int64, Float64]:
    """Index in `CLASSES` and probability (T,) of the likeliest class, by shape over time and by speed."""
    speed = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    log = table.evidence - table.evidence.max(axis=1, keepdims=True, initial=-np.inf) if len(speed) else table.evidence
    share = np.exp(log)
    share *= np.where(speed[:, None] > FASTEST_MPS, 0.01, 1.0)
    share /= share.sum(axis=1, keepdims=True)
    best = share.argmax(axis=1).astype(np.int64)
    return best, share[np.arange(len(best)), best]

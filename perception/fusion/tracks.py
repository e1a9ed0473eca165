"""Obstacles followed over time: association, life and class of tracks, in seconds and returns, never in scans."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from configs.strict import Config
from geometry.transforms import apply, yaw_of
from messages.message import Float64, Int64
from messages.perception import ObstacleClass, Obstacles
from perception.fusion.kalman import box_noise, correct, distances, predict
from perception.fusion.stillness import Stillness, StillnessConfig

CLASSES = tuple(ObstacleClass)
REFUSED = 1e9
FASTEST_MPS = {ObstacleClass.PERSON: 4.0, ObstacleClass.POLE: 0.7, ObstacleClass.MOUND: 0.7, ObstacleClass.DITCH: 0.7}


class TrackerConfig(Config):
    """Noise, gate, and what it takes to confirm and to forget."""

    position_sigma_m: float = Field(gt=0.0, le=2.0)
    size_share: float = Field(ge=0.0, le=1.0, description="of a box's side, added to the sigma of its centre")
    velocity_sigma_mps: float = Field(gt=0.0, le=5.0, description="of a velocity that a sensor measures")
    still_sigma_mps: float = Field(gt=0.0, le=5.0, description="of the bound on speed that old cells give")
    first_speed_mps: float = Field(gt=0.0, le=20.0, description="sigma of the speed of what is seen first")
    acceleration_mps2: float = Field(gt=0.0, le=10.0)
    gate_sigma: float = Field(gt=0.0, le=10.0)
    confirm_s: float = Field(ge=0.0, le=2.0)
    confirm_returns: float = Field(ge=0.0, le=200.0, description="summed over scans, each up to `most_returns`")
    most_returns: float = Field(gt=0.0, le=200.0)
    other_returns: float = Field(gt=0.0, le=200.0, description="worth of a detection by a sensor without returns")
    doubt_share: float = Field(ge=0.0, le=1.0, description="of `most_returns`, lost with each scan that misses")
    forget_new_s: float = Field(gt=0.0, le=10.0)
    forget_s: float = Field(gt=0.0, le=10.0)
    moving_sigma: float = Field(gt=0.0, le=10.0, description="a slower speed than this is given as none")
    class_memory: float = Field(ge=0.0, lt=1.0, description="of the evidence, kept from one detection to the next")
    stillness: StillnessConfig


@dataclass
class Table:
    """Tracks as columns of T rows, so that all are moved and matched at once; state and size in `odom`."""

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
    is_confirmed: Int64
    sensors: Int64

    def rows(self, wanted: Int64) -> "Table":
        """Only these rows."""
        return Table(*(getattr(self, f.name)[wanted] for f in fields(self)))

    def below(self, other: "Table") -> "Table":
        """These rows, then those of another table."""
        return Table(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


@dataclass(frozen=True)
class Detections:
    """One sensor's obstacles in `odom`, K rows; `R` (K, 2, 2) is the noise of their centres.

    `still` is the share of cells occupied for long, `velocity_mps` may be NaN, `has_returns` holds for lidars.
    """

    stamp_ns: int
    sensor: int
    p_m: Float64
    R: Float64
    has_returns: npt.NDArray[np.bool_]
    size_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    returns: Float64
    log_scores: Float64
    still: Float64


def to_odom(
    obstacles: Obstacles, T_odom_base: Float64, sensor: int, stillness: Stillness, config: TrackerConfig
) -> Detections:
    """Obstacles of one message as detections; the stillness of their cells is looked up and remembered."""
    yaw = yaw_of(T_odom_base)
    c, s = np.cos(yaw), np.sin(yaw)
    counts = np.diff(obstacles.offsets).astype(np.float64)
    # a lidar's returns are evidence by their number; a radar or camera tells one thing by one detection
    is_lidar = np.full(len(counts), obstacles.sensor.startswith("lidar"))
    worth = np.minimum(counts, config.most_returns) ** 1.5 * config.most_returns**-0.5
    points = apply(T_odom_base, obstacles.points_base_m)
    center = np.asarray(apply(T_odom_base, obstacles.center_base_m), np.float64)
    R = box_noise(obstacles.size_m, obstacles.yaw_rad + yaw, config.position_sigma_m, config.size_share)
    if len(obstacles.sigma_m):
        R = box_noise(obstacles.sigma_m, obstacles.yaw_rad + yaw, 0.0, 1.0)
    return Detections(
        obstacles.stamp_ns, sensor, center, R, is_lidar, obstacles.size_m,
        (obstacles.yaw_rad + yaw + np.pi / 2) % np.pi - np.pi / 2,
        obstacles.velocity_mps @ np.array([[c, s], [-s, c]]), np.where(is_lidar, worth, config.other_returns),
        np.log(np.maximum(obstacles.class_scores, 0.01)),
        stillness.observe(points.astype(np.float32), obstacles.offsets, obstacles.stamp_ns),
    )  # fmt: skip


def warm(config: TrackerConfig) -> None:
    """Compile or load all kernels at start-up, so that no message waits for it."""
    distances(np.zeros((1, 4)), np.eye(4)[None].copy(), np.zeros((1, 2)), np.eye(2)[None].copy())
    Stillness(config.stillness).observe(np.zeros((1, 3), np.float32), np.array([0, 1], np.int32), 0)


def empty_table() -> Table:
    """No tracks."""
    whole = np.zeros(0, np.int64)
    none = np.zeros(0)
    return Table(
        whole, np.zeros((0, 4)), np.zeros((0, 4, 4)), none, np.zeros((0, 3)), none, none, np.zeros((0, len(CLASSES))),
        whole, whole, whole, whole,
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
        seen.returns[rows], seen.log_scores[rows], stamp, stamp.copy(), np.zeros(n, np.int64),
        np.full(n, 1 << seen.sensor, np.int64),
    )  # fmt: skip


def move(table: Table, dt_s: float, config: TrackerConfig) -> None:
    """All tracks moved on in place."""
    if dt_s > 0.0 and len(table.id):
        predict(table.x, table.P, dt_s, config.acceleration_mps2)


def match(table: Table, seen: Detections, config: TrackerConfig) -> tuple[Int64, Int64]:
    """Rows of tracks and of detections that belong together: least total cost within the gate."""
    d2, cost = distances(table.x, table.P, np.ascontiguousarray(seen.p_m[:, :2]), seen.R)
    cost = np.where(d2 <= config.gate_sigma**2, cost, REFUSED)
    tracks, detections = linear_sum_assignment(cost)
    good = cost[tracks, detections] < REFUSED
    return tracks[good].astype(np.int64), detections[good].astype(np.int64)


def update(
    table: Table, tracks: Int64, seen: Detections, rows: Int64, stillness: Stillness, config: TrackerConfig
) -> None:
    """Tracks corrected in place by the detections matched to them."""
    x, P = table.x[tracks], table.P[tracks]
    correct(x, P, seen.p_m[rows, :2], seen.R[rows], 0)
    _correct_velocity(x, P, seen, rows, stillness, config)
    table.x[tracks], table.P[tracks] = x, P
    # only returns measure a box: radar and cameras guess it
    boxed = seen.has_returns[rows] | (table.sensors[tracks] == 1 << seen.sensor)
    theirs, mine = tracks[boxed], rows[boxed]
    table.height_m[theirs] = seen.p_m[mine, 2]
    table.size_m[theirs] += 0.5 * (seen.size_m[mine] - table.size_m[theirs])
    table.yaw_rad[theirs] = seen.yaw_rad[mine]
    table.returns[tracks] = np.minimum(table.returns[tracks] + seen.returns[rows], 20.0 * config.most_returns)
    table.evidence[tracks] = config.class_memory * table.evidence[tracks] + seen.log_scores[rows]
    table.last_ns[tracks] = seen.stamp_ns
    table.sensors[tracks] |= 1 << seen.sensor


def _correct_velocity(
    x: Float64, P: Float64, seen: Detections, rows: Int64, stillness: Stillness, config: TrackerConfig
) -> None:
    """By the velocity that the sensor measured, or by what old cells allow."""
    speed = np.hypot(x[:, 2], x[:, 3])
    most = stillness.fastest(seen.still[rows], seen.size_m[rows, 0])
    allowed = x[:, 2:] * np.minimum(1.0, most / np.maximum(speed, 1e-9))[:, None]
    measured = np.isfinite(seen.velocity_mps[rows]).all(axis=1)
    for which, z, sigma in (
        (measured, seen.velocity_mps[rows], config.velocity_sigma_mps),
        (~measured & np.isfinite(most), allowed, config.still_sigma_mps),
    ):
        if which.any():
            xs, Ps = x[which], P[which]
            correct(xs, Ps, z[which], np.broadcast_to(np.eye(2) * sigma**2, (len(xs), 2, 2)), 2)
            x[which], P[which] = xs, Ps


def confirm(table: Table, config: TrackerConfig) -> None:
    """Tracks that lasted long enough and gathered enough returns are confirmed, in place and for good."""
    lasted = table.last_ns - table.first_ns >= round(config.confirm_s * 1e9)
    table.is_confirmed |= (lasted & (table.returns >= config.confirm_returns)).astype(np.int64)


def doubt(table: Table, missed: Int64, config: TrackerConfig) -> None:
    """Unconfirmed tracks that a scan missed lose evidence, in place."""
    lost = config.doubt_share * config.most_returns * (table.is_confirmed[missed] == 0)
    table.returns[missed] -= lost


def alive(table: Table, stamp_ns: int, config: TrackerConfig) -> Int64:
    """Rows of the tracks that are not to be forgotten."""
    age_s = (stamp_ns - table.last_ns) * 1e-9
    limit = np.where(table.is_confirmed > 0, config.forget_s, config.forget_new_s)
    return np.flatnonzero((age_s <= limit) & (table.returns > 0.0)).astype(np.int64)


def velocities(table: Table, config: TrackerConfig) -> Float64:
    """Velocity (T, 2) where it is more than its own uncertainty makes of standing things, else 0."""
    v, S = table.x[:, 2:], table.P[:, 2:, 2:]
    d2 = np.einsum("ti,tij,tj->t", v, np.linalg.inv(S), v) if len(v) else np.zeros(0)
    return np.where((d2 >= config.moving_sigma**2)[:, None], v, 0.0)


def classify(table: Table, velocity_mps: Float64) -> tuple[Int64, Float64]:
    """Index in `CLASSES` and probability (T,) of the likeliest class, by shape over time and by speed."""
    speed = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    log = table.evidence - table.evidence.max(axis=1, keepdims=True, initial=-np.inf) if len(speed) else table.evidence
    share = np.exp(log)
    for label, fastest in FASTEST_MPS.items():
        share[:, CLASSES.index(label)] *= np.where(speed > fastest, 0.01, 1.0)
    share /= share.sum(axis=1, keepdims=True)
    best = share.argmax(axis=1).astype(np.int64)
    return best, share[np.arange(len(best)), best]

"""Tracklets: targets over some cycles, since clutter does not repeat and a cycle measures no speed across.

State (x, y, vx, vy) in `odom`. A cycle measures range, bearing and speed along the line of sight with independent
sigmas, so that three scalar corrections suffice (no matrix is inverted).
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from configs.strict import Config
from configs.vehicle import Radar
from geometry.arrays import Float64, Int64
from geometry.jit import kernel
from perception.radar.clusters import Clusters

GATED_COST = 1e9


class TrackletConfig(Config):
    """Motion of targets, confirmation, and when a velocity counts as measured."""

    target_sigma_m: float = Field(gt=0.0, le=5.0, description="of the reflection point on a target")
    acceleration_mps2: float = Field(gt=0.0, le=20.0)
    initial_speed_sigma_mps: float = Field(gt=0.0, le=30.0, description="across the line of sight, of a new tracklet")
    gate_sigma: float = Field(gt=0.0, le=10.0)
    confirm_hits: int = Field(ge=1, le=50)
    confirm_s: float = Field(ge=0.0, le=5.0)
    confirm_share: float = Field(gt=0.0, le=1.0, description="of the cycles since the first, with a detection")
    keep_s: float = Field(gt=0.0, le=5.0)
    velocity_sigma_mps: float = Field(gt=0.0, le=5.0, description="greatest sigma of a published velocity")
    long_m: float = Field(
        gt=0.0, le=20.0, description="of a target across the line of sight; above it only Doppler shows motion"
    )


@dataclass
class TrackletTable:
    """Tracklets as columns of T rows, in `odom`."""

    x: Float64
    P: Float64
    first_ns: Int64
    last_ns: Int64
    hits: Int64
    cycles: Int64

    def select(self, wanted: Int64) -> "TrackletTable":
        """The given rows."""
        return TrackletTable(*(getattr(self, f.name)[wanted] for f in fields(self)))

    def append(self, other: "TrackletTable") -> "TrackletTable":
        """The rows of this table followed by those of another."""
        return TrackletTable(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


@dataclass(frozen=True)
class TargetDetections:
    """Clusters of one cycle in `odom`: position (K, 2), line of sight (K, 2), speed along it (K,), position sigmas (K,)
    along and across, and speed sigma."""

    p_m: Float64
    line_of_sight: Float64
    radial_mps: Float64
    along_sigma_m: Float64
    across_sigma_m: Float64
    speed_sigma_mps: float


def empty_table() -> TrackletTable:
    """No tracklets."""
    none = np.zeros(0, np.int64)
    return TrackletTable(np.zeros((0, 4)), np.zeros((0, 4, 4)), none, none, none, none)


def sigmas(clusters: Clusters, radar: Radar, config: TrackletConfig) -> Float64:
    """Sigma (K, 2) of the centres, along and across the line of sight.

    The centre of a fence or wall is that of the reflections in view, which change as the machine turns.
    """
    along = np.full(len(clusters), np.hypot(radar.range_sigma_m, config.target_sigma_m))
    across = np.hypot(clusters.range_m * np.radians(radar.azimuth_sigma_deg), config.target_sigma_m)
    return np.asarray(np.hypot(np.stack([along, across], axis=1), clusters.extent_m / math.sqrt(12.0)), np.float64)


def to_odom(clusters: Clusters, sigma_m: Float64, radar: Radar, T_odom_base: Float64) -> TargetDetections:
    """Clusters in `odom`; lines of sight are horizontal."""
    turn = T_odom_base[:2, :2] / np.hypot(T_odom_base[0, 0], T_odom_base[1, 0])
    p = clusters.p_m @ turn.T + T_odom_base[:2, 3]
    along, across = np.ascontiguousarray(
        sigma_m.T
    )  # else a single row has another array type, and kernels compile twice
    return TargetDetections(
        p, clusters.line_of_sight @ turn.T, clusters.radial_mps, along, across, radar.doppler_sigma_mps
    )


def update_tracklets(
    table: TrackletTable, targets: TargetDetections, stamp_ns: int, since_s: float, config: TrackletConfig
) -> tuple[TrackletTable, Int64]:
    """Tracklets after a cycle `since_s` after the previous one, and the row (K,) of the tracklet of each cluster."""
    table = table.select(np.arange(len(table.hits)))
    _predict(table.x, table.P, max(since_s, 0.0), config.acceleration_mps2)
    table.cycles += 1
    own, clusters = match(table, targets, config.gate_sigma)
    _correct(table.x, table.P, own, clusters, targets)
    table.hits[own] += 1
    table.last_ns[own] = stamp_ns
    is_fresh = np.ones(len(targets.radial_mps), np.bool_)
    is_fresh[clusters] = False
    fresh = np.flatnonzero(is_fresh)
    row_of = np.empty(len(targets.radial_mps), np.int64)
    row_of[clusters], row_of[fresh] = own, len(table.hits) + np.arange(len(fresh))
    table = table.append(start_tracklets(targets, fresh, stamp_ns, config)) if len(fresh) else table
    kept = np.flatnonzero(stamp_ns - table.last_ns <= round(config.keep_s * 1e9))
    new_row = np.cumsum(np.bincount(kept, minlength=len(table.hits))) - 1
    return table.select(kept), new_row[row_of].astype(np.int64)


def match(table: TrackletTable, targets: TargetDetections, gate_sigma: float) -> tuple[Int64, Int64]:
    """Matched rows of tracklets and of clusters: least total distance within the gate."""
    cost = np.empty((len(table.hits), len(targets.radial_mps)))
    _distances(
        table.x, table.P, targets.p_m, targets.line_of_sight, targets.radial_mps, targets.along_sigma_m,
        targets.across_sigma_m,
        targets.speed_sigma_mps, cost,
    )  # fmt: skip
    cost[cost > gate_sigma**2] = GATED_COST
    rows, columns = linear_sum_assignment(cost)
    good = cost[rows, columns] < GATED_COST
    return rows[good].astype(np.int64), columns[good].astype(np.int64)


def start_tracklets(targets: TargetDetections, which: Int64, stamp_ns: int, config: TrackletConfig) -> TrackletTable:
    """New tracklets: speed measured along the line of sight, initial sigma across it."""
    n = len(which)
    x, P = np.zeros((n, 4)), np.zeros((n, 4, 4))
    u = targets.line_of_sight[which]
    across = np.stack([-u[:, 1], u[:, 0]], axis=1)
    x[:, :2], x[:, 2:] = targets.p_m[which], targets.radial_mps[which, None] * u
    uu, aa = u[:, :, None] * u[:, None, :], across[:, :, None] * across[:, None, :]
    P[:, :2, :2] = (
        targets.along_sigma_m[which, None, None] ** 2 * uu + targets.across_sigma_m[which, None, None] ** 2 * aa
    )
    P[:, 2:, 2:] = targets.speed_sigma_mps**2 * uu + config.initial_speed_sigma_mps**2 * aa
    stamp = np.full(n, stamp_ns, np.int64)
    return TrackletTable(x, P, stamp, stamp.copy(), np.ones(n, np.int64), np.ones(n, np.int64))


def confirmed(table: TrackletTable, config: TrackletConfig) -> Int64:
    """1 for each tracklet (T,) of sufficient duration and share of detections."""
    lasted = table.last_ns - table.first_ns >= round(config.confirm_s * 1e9)
    repeats = table.hits >= np.maximum(config.confirm_hits, config.confirm_share * table.cycles)
    return np.asarray(lasted & repeats, np.int64)


def velocities(table: TrackletTable, rows: Int64, clusters: Clusters, config: TrackletConfig) -> Float64:
    """Velocity (K, 2) in `odom` of the tracklets in `rows` (K,), those of the clusters; NaN where it is not measured.

    That is while its sigma in any direction exceeds `velocity_sigma_mps`, and where a cluster longer than `long_m`
    across the line of sight has no speed along it: another part of a fence in view is no motion.
    """
    S = table.P[rows, 2:, 2:]
    mean, half = (S[:, 0, 0] + S[:, 1, 1]) / 2, (S[:, 0, 0] - S[:, 1, 1]) / 2
    worst = mean + np.hypot(half, S[:, 0, 1])
    is_view = (clusters.extent_m[:, 1] > config.long_m) & (np.abs(clusters.radial_mps) < config.velocity_sigma_mps)
    return np.where((~is_view & (worst <= config.velocity_sigma_mps**2))[:, None], table.x[rows, 2:], np.nan)


def _predict(x: Float64, P: Float64, dt_s: float, acceleration_mps2: float) -> None:
    F, Q, q = np.eye(4), np.zeros((4, 4)), acceleration_mps2**2
    F[0, 2] = F[1, 3] = dt_s
    for i in (0, 1):
        Q[i, i], Q[i, i + 2], Q[i + 2, i], Q[i + 2, i + 2] = q * dt_s**3 / 3, q * dt_s**2 / 2, q * dt_s**2 / 2, q * dt_s
    x[:] = x @ F.T
    P[:] = F @ P @ F.T + Q


def _correct(x: Float64, P: Float64, rows: Int64, clusters: Int64, targets: TargetDetections) -> None:
    _correct_rows(
        x, P, rows, clusters, targets.p_m, targets.line_of_sight, targets.radial_mps, targets.along_sigma_m,
        targets.across_sigma_m,
        targets.speed_sigma_mps,
    )  # fmt: skip


@kernel
def _distances(
    x: Float64, P: Float64, p: Float64, line_of_sight: Float64, radial: Float64, along_sigma: Float64,
    across_sigma: Float64,
    speed_sigma: float, cost: Float64,
) -> None:  # fmt: skip
    """Squared distance in sigmas of range, bearing and speed along the line of sight, assumed independent."""
    for i in range(x.shape[0]):
        for j in range(p.shape[0]):
            ux, uy = line_of_sight[j, 0], line_of_sight[j, 1]
            dx, dy = p[j, 0] - x[i, 0], p[j, 1] - x[i, 1]
            along, across = dx * ux + dy * uy, dy * ux - dx * uy
            speed = radial[j] - x[i, 2] * ux - x[i, 3] * uy
            a, b, c = P[i, 0, 0], P[i, 0, 1], P[i, 1, 1]
            e, f, g = P[i, 2, 2], P[i, 2, 3], P[i, 3, 3]
            s_along = along_sigma[j] ** 2 + a * ux * ux + 2.0 * b * ux * uy + c * uy * uy
            s_across = across_sigma[j] ** 2 + a * uy * uy - 2.0 * b * ux * uy + c * ux * ux
            s_speed = speed_sigma**2 + e * ux * ux + 2.0 * f * ux * uy + g * uy * uy
            cost[i, j] = along * along / s_along + across * across / s_across + speed * speed / s_speed


@kernel
def _correct_rows(
    x: Float64, P: Float64, rows: Int64, clusters: Int64, p: Float64, line_of_sight: Float64, radial: Float64,
    along_sigma: Float64, across_sigma: Float64, speed_sigma: float,
) -> None:  # fmt: skip
    h, gain, before = np.empty(4), np.empty(4), np.empty(4)
    for n in range(rows.shape[0]):
        i, j = rows[n], clusters[n]
        ux, uy = line_of_sight[j, 0], line_of_sight[j, 1]
        for m in range(3):
            h[:] = 0.0
            if m == 0:
                h[0], h[1], z, r = ux, uy, p[j, 0] * ux + p[j, 1] * uy, along_sigma[j] ** 2
            elif m == 1:
                h[0], h[1], z, r = -uy, ux, p[j, 1] * ux - p[j, 0] * uy, across_sigma[j] ** 2
            else:
                h[2], h[3], z, r = ux, uy, radial[j], speed_sigma**2
            s, guess = r, 0.0
            for a in range(4):
                before[a] = 0.0
                for b in range(4):
                    before[a] += P[i, a, b] * h[b]
                s += h[a] * before[a]
                guess += h[a] * x[i, a]
            for a in range(4):
                gain[a] = before[a] / s
                x[i, a] += gain[a] * (z - guess)
            for a in range(4):
                for b in range(4):
                    P[i, a, b] -= gain[a] * before[b]

"""Detection range of a lidar by sector, from the share of the returns expected from the ground.

A ring that points down must return the ground or an obstacle before it. Per sector, rings are evaluated outwards until
one is silent; the detection range ends at the ground range of that ring. Within it, a person-sized target must get
`target_returns` at the share of beams that do return.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Lidar
from geometry.arrays import Float32, Float64, Int64, UInt8
from geometry.jit import kernel
from messages.perception import HealthState
from perception.lidar.grid import MAX_GRID_POINTS

RANGES_M = np.arange(1.0, 201.0)
STEEPEST, STEPS = 8.0, 2000.0  # greatest tangent of the ring table (83 degrees), and its steps per unit
SELF_SHELL_M = 1.5  # a sensor on the hood lies inside the self filter's box: beams are checked from here


class HealthConfig(Config):
    """Sectors, share below which a ring is silent, and the target that must be detected."""

    sector_deg: float = Field(ge=2.0, le=90.0)
    sector_columns: int = Field(ge=1, le=100, description="fewest in a sector: of fewer beams all may meet fog")
    silent_share: float = Field(gt=0.0, lt=1.0)
    target_width_m: float = Field(gt=0.0, le=3.0)
    target_height_m: float = Field(gt=0.0, le=3.0)
    target_returns: float = Field(ge=1.0, le=100.0)
    degraded_share: float = Field(gt=0.0, lt=1.0, description="of the nominal range, below which health is degraded")


@dataclass(frozen=True)
class NominalCoverage:
    """Returns of a healthy lidar over flat ground, by sector and ring.

    `sector_edges_rad` (S + 1,) about the sensor in `base`; `ring_table` gives the ring by steps of the tangent of
    elevation; `ground_m` (S, R) horizontal range of the ground (infinite: upwards, or too far); `beams` (S, R)
    expected returns; `target_returns` (200,) on the target at RANGES_M; `nominal_m` (S,) nominal detection range.
    """

    sector_edges_rad: Float64
    ring_table: Int64
    ground_m: Float64
    beams: Float64
    target_returns: Float64
    nominal_m: Float64


def nominal_coverage(lidar: Lidar, own: Float64, config: HealthConfig) -> NominalCoverage:
    """Expected returns from the sensor model, its mount and the boxes (K, 2, 3) of the self filter."""
    column_deg = lidar.field_of_view_deg / lidar.columns
    sectors = round(360.0 / max(config.sector_deg, config.sector_columns * column_deg))
    edges = np.linspace(-math.pi, math.pi, sectors + 1)
    order = np.sort(np.radians(np.array(lidar.elevation_deg)))
    T = lidar.mount.T_base_sensor
    middle = (edges[:-1] + edges[1:]) / 2
    ground = _ground_ranges(T, middle, order, own, lidar.range_m[1])
    local = np.abs(_wrap(middle - math.atan2(T[1, 0], T[0, 0])))
    coverage = np.clip((math.radians(lidar.field_of_view_deg) / 2 - local) / (math.pi / sectors) / 2 + 0.5, 0.0, 1.0)
    beams = lidar.columns * (360.0 / lidar.field_of_view_deg) / sectors * coverage[:, None] * np.isfinite(ground)
    returns = _target_returns(lidar, order, T[2, 3], config)
    tangents = np.tan(order)
    steps = np.arange(-STEEPEST, STEEPEST, 1.0 / STEPS) + 0.5 / STEPS
    table = np.searchsorted((tangents[:-1] + tangents[1:]) / 2, steps).astype(np.int64)
    draft = NominalCoverage(edges, table, ground, beams, returns, np.zeros(sectors))
    nominal = detection_range(draft, beams, config, lidar.range_m[1])
    return NominalCoverage(edges, table, ground, beams, returns, nominal)


def _wrap(angle: Float64) -> Float64:
    return np.asarray((angle + math.pi) % (2 * math.pi) - math.pi, np.float64)


def _ground_ranges(T: Float64, azimuth: Float64, elevation: Float64, own: Float64, reach_m: float) -> Float64:
    """Horizontal range (S, R) at which each beam meets z = 0; infinite when it does not, or meets the machine first."""
    R, t = T[:3, :3], T[:3, 3]
    flat, up = azimuth[:, None] - math.atan2(R[1, 0], R[0, 0]), elevation[None]
    in_lidar = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(flat), np.cos(up) * np.sin(flat), np.sin(up)), axis=-1)
    beams = in_lidar @ R.T
    falls = beams[..., 2] < -1e-6
    length = np.divide(-t[2], beams[..., 2], out=np.full(falls.shape, np.inf), where=falls)
    meets = falls & (length <= reach_m)
    meets[meets] = ~_are_hidden(beams[meets], length[meets], t, own)
    return np.where(meets, np.where(meets, length, 0.0) * np.hypot(beams[..., 0], beams[..., 1]), np.inf)


def _are_hidden(beams: Float64, length_m: Float64, t: Float64, own: Float64) -> np.ndarray:
    """Which beams (N, 3) from `t` enter a box of the machine within their length, beyond the sensor shell."""
    hidden = np.zeros(len(beams), bool)
    far = length_m > SELF_SHELL_M
    along = np.linspace(SELF_SHELL_M, length_m[far], 60, axis=1)[..., None] * beams[far, None] + t
    for low, high in own:
        hidden[far] |= ((along > low) & (along < high)).all(axis=2).any(axis=1)
    return hidden


def _target_returns(lidar: Lidar, order: Float64, height_m: float, config: HealthConfig) -> Float64:
    columns = config.target_width_m / RANGES_M / (math.radians(lidar.field_of_view_deg) / lidar.columns)
    low, high = -height_m / RANGES_M, (config.target_height_m - height_m) / RANGES_M
    rings = ((np.tan(order)[None] >= low[:, None]) & (np.tan(order)[None] <= high[:, None])).sum(axis=1)
    # a target may get one ring more or less by its position
    return np.asarray(columns * rings, np.float64)


def count_beams(points_m: Float32, azimuth: Float32, turn: int, usable: UInt8, nominal: NominalCoverage) -> Float64:
    """Usable returns by sector and ring, (S, R); `azimuth` (N,) in parts of which a turn has `turn`."""
    counts = np.zeros(nominal.ground_m.shape, np.int64)
    stride = max(1, len(points_m) // MAX_GRID_POINTS)
    _count(points_m, azimuth, turn, usable, stride, nominal.ring_table, counts)
    return counts.astype(np.float64) * stride


@kernel
def _count(
    points: Float32, azimuth: Float32, turn: int, usable: UInt8, stride: int, table: Int64, counts: Int64
) -> None:
    sectors = counts.shape[0]
    share = np.float32(sectors / turn)
    for i in range(0, points.shape[0], stride):
        if usable[i] == 0:
            continue
        flat = math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1])
        tangent = points[i, 2] / max(flat, np.float32(1e-6))
        steep = min(max(tangent, np.float32(-STEEPEST)), np.float32(STEEPEST))
        k = min(int((steep + np.float32(STEEPEST)) * np.float32(STEPS)), table.shape[0] - 1)
        counts[min(int(azimuth[i] * share), sectors - 1), table[k]] += 1


def detection_range(nominal: NominalCoverage, counts: Float64, config: HealthConfig, reach_m: float) -> Float64:
    """Range (S,) within which the target would have been detected."""
    detected_m = np.zeros(len(counts))
    min_returns = config.target_returns
    _detection_range(
        nominal.ground_m,
        counts,
        nominal.beams,
        nominal.target_returns,
        config.silent_share,
        min_returns,
        reach_m,
        detected_m,
    )
    return detected_m


@kernel
def _detection_range(
    ground: Float64, counts: Float64, beams: Float64, target: Float64, silent: float, min_returns: float,
    reach_m: float,
    detected_m: Float64,
) -> None:  # fmt: skip
    """Rings are ordered by elevation, so that their ground range increases."""
    rings = ground.shape[1]
    for s in range(ground.shape[0]):
        reached, shares, good = reach_m, 0.0, 0
        for r in range(rings):
            if beams[s, r] < 0.5:
                continue
            # elevations of a real lidar differ from their table by part of a ring: neighbours are summed
            first, last = max(0, r - 1), min(rings, r + 2)
            share = counts[s, first:last].sum() / max(beams[s, first:last].sum(), 1e-9)
            if share < silent:
                reached = ground[s, r] if good > 0 else 0.0
                break
            shares += min(share, 1.0)
            good += 1
        if good == 0:
            continue
        for k in range(target.shape[0]):
            if target[k] * shares / good >= min_returns and RANGES_M[k] <= reached:
                detected_m[s] = RANGES_M[k]


def health_state(detected_m: Float64, nominal_m: Float64, config: HealthConfig) -> tuple[HealthState, str]:
    """State and its reason; sectors without nominal range (covered by the machine) do not count."""
    free = nominal_m > 0.0
    if not free.any() or not (detected_m[free] > 0.0).any():
        return HealthState.BLIND, "no sector has the expected returns"
    weak = free & (detected_m < config.degraded_share * nominal_m)
    if weak.any():
        return HealthState.DEGRADED, f"{int(weak.sum())} of {int(free.sum())} sectors have a reduced range"
    return HealthState.GOOD, ""

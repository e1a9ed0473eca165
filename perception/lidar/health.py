"""How far a lidar can be trusted, by sector: from the share of returns that the ground should have sent back.

A ring that looks down must return something: ground where it is flat, or what stands before it. Per sector, rings are
gone through outwards until one stays silent; beyond the next ring's ground nothing is proven. Within that, a person
must get so many returns at the share of beams that do come back.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Lidar
from geometry.jit import kernel
from messages.message import Float32, Float64, Int64, UInt8
from messages.perception import HealthState
from perception.lidar.grid import ENOUGH

RANGES_M = np.arange(1.0, 201.0)
STEEPEST, STEPS = 2.0, 2000.0  # tangent up to which rings are told apart, and steps a unit of it
OWN_SHELL_M = 1.5  # the box round the machine is larger than the machine: a sensor on the hood stands inside it


class HealthConfig(Config):
    """Sectors, the share below which a ring is silent, and the target that must be seen."""

    sector_deg: float = Field(ge=2.0, le=90.0)
    silent_share: float = Field(gt=0.0, lt=1.0)
    target_width_m: float = Field(gt=0.0, le=3.0)
    target_height_m: float = Field(gt=0.0, le=3.0)
    target_returns: float = Field(ge=1.0, le=100.0)
    degraded_share: float = Field(gt=0.0, lt=1.0, description="of the nominal range, below which health is degraded")


@dataclass(frozen=True)
class Expectation:
    """What a healthy lidar returns over flat ground, by sector and ring.

    `sector_edges_rad` (S + 1,) about the sensor in `base`; `ring_table` gives the ring by steps of the tangent of
    elevation; `ground_m` (S, R) level range of the ground (infinite: looks up, or too far); `beams` (S, R) expected
    returns; `target_returns` (200,) on the target at RANGES_M; `nominal_m` (S,) the proven range when all is well.
    """

    sector_edges_rad: Float64
    ring_table: Int64
    ground_m: Float64
    beams: Float64
    target_returns: Float64
    nominal_m: Float64


def expect(lidar: Lidar, own: Float64, config: HealthConfig) -> Expectation:
    """The expectation that follows from the sensor model, its mount and the machine's own boxes (K, 2, 3)."""
    sectors = round(360.0 / config.sector_deg)
    edges = np.linspace(-math.pi, math.pi, sectors + 1)
    order = np.sort(np.radians(np.array(lidar.elevation_deg)))
    T = lidar.mount.T_base_sensor
    middle = (edges[:-1] + edges[1:]) / 2
    ground = np.full((sectors, len(order)), np.inf)
    for s, azimuth in enumerate(middle):
        for r, elevation in enumerate(order):
            ground[s, r] = _ground_range(T, azimuth, elevation, own, lidar.range_m[1])
    local = np.abs(_wrap(middle - math.atan2(T[1, 0], T[0, 0])))
    seen = np.clip((math.radians(lidar.field_of_view_deg) / 2 - local) / (math.pi / sectors) / 2 + 0.5, 0.0, 1.0)
    beams = lidar.columns * (360.0 / lidar.field_of_view_deg) / sectors * seen[:, None] * np.isfinite(ground)
    returns = _target_returns(lidar, order, T[2, 3], config)
    tangents = np.tan(order)
    steps = np.arange(-STEEPEST, STEEPEST, 1.0 / STEPS) + 0.5 / STEPS
    table = np.searchsorted((tangents[:-1] + tangents[1:]) / 2, steps).astype(np.int64)
    fresh = Expectation(edges, table, ground, beams, returns, np.zeros(sectors))
    nominal = proven_range(fresh, beams, config, lidar.range_m[1])
    return Expectation(edges, table, ground, beams, returns, nominal)


def _wrap(angle: Float64) -> Float64:
    return np.asarray((angle + math.pi) % (2 * math.pi) - math.pi, np.float64)


def _ground_range(T: Float64, azimuth: float, elevation: float, own: Float64, reach_m: float) -> float:
    """Level range at which a beam meets z = 0; infinite when it does not, or meets the machine first."""
    R, t = T[:3, :3], T[:3, 3]
    flat = azimuth - math.atan2(R[1, 0], R[0, 0])
    beam = R @ [math.cos(elevation) * math.cos(flat), math.cos(elevation) * math.sin(flat), math.sin(elevation)]
    if beam[2] >= -1e-6 or -t[2] / beam[2] > reach_m:
        return math.inf
    length = -t[2] / beam[2]
    if length <= OWN_SHELL_M:
        return float(length * math.hypot(beam[0], beam[1]))
    along = np.linspace(OWN_SHELL_M, length, 60)[:, None] * beam + t
    inside = ((along[None] > own[:, None, 0]) & (along[None] < own[:, None, 1])).all(axis=2)
    return math.inf if inside.any() else float(length * math.hypot(beam[0], beam[1]))


def _target_returns(lidar: Lidar, order: Float64, height_m: float, config: HealthConfig) -> Float64:
    columns = config.target_width_m / RANGES_M / (math.radians(lidar.field_of_view_deg) / lidar.columns)
    low, high = -height_m / RANGES_M, (config.target_height_m - height_m) / RANGES_M
    rings = ((np.tan(order)[None] >= low[:, None]) & (np.tan(order)[None] <= high[:, None])).sum(axis=1)
    # between two rings a target may get one more or one less: the mean over its place is the height over the spacing
    return np.asarray(columns * rings, np.float64)


def count_beams(points_m: Float32, turn: Float32, turns: int, usable: UInt8, seen: Expectation) -> Float64:
    """Usable returns by sector and ring, (S, R); `turn` (N,) is each one's direction in `turns` parts of the turn."""
    counts = np.zeros(seen.ground_m.shape, np.int64)
    stride = max(1, len(points_m) // ENOUGH)
    _count(points_m, turn, turns, usable, stride, seen.ring_table, counts)
    return counts.astype(np.float64) * stride


@kernel
def _count(points: Float32, turn: Float32, turns: int, usable: UInt8, stride: int, table: Int64, counts: Int64) -> None:
    sectors = counts.shape[0]
    share = np.float32(sectors / turns)
    for i in range(0, points.shape[0], stride):
        if usable[i] == 0:
            continue
        flat = math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1])
        tangent = points[i, 2] / max(flat, np.float32(1e-6))
        steep = min(max(tangent, np.float32(-STEEPEST)), np.float32(STEEPEST))
        k = min(int((steep + np.float32(STEEPEST)) * np.float32(STEPS)), table.shape[0] - 1)
        counts[min(int(turn[i] * share), sectors - 1), table[k]] += 1


def proven_range(seen: Expectation, counts: Float64, config: HealthConfig, reach_m: float) -> Float64:
    """Range (S,) within which the target would have been seen."""
    proven = np.zeros(len(counts))
    least = config.target_returns
    _proven(seen.ground_m, counts, seen.beams, seen.target_returns, config.silent_share, least, reach_m, proven)
    return proven


@kernel
def _proven(
    ground: Float64, counts: Float64, beams: Float64, target: Float64, silent: float, least: float, reach_m: float,
    proven: Float64,
) -> None:  # fmt: skip
    """Rings are ordered by elevation, so that their ground lies ever farther out."""
    rings = ground.shape[1]
    for s in range(ground.shape[0]):
        reached, shares, good = reach_m, 0.0, 0
        for r in range(rings):
            if beams[s, r] < 0.5:
                continue
            # elevations of a real lidar are off their table by part of a ring: neighbours are counted together
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
            if target[k] * shares / good >= least and RANGES_M[k] <= reached:
                proven[s] = RANGES_M[k]


def judge(proven_m: Float64, nominal_m: Float64, config: HealthConfig) -> tuple[HealthState, str]:
    """State and its reason; sectors that the machine itself covers do not count."""
    own = nominal_m > 0.0
    if not own.any() or not (proven_m[own] > 0.0).any():
        return HealthState.BLIND, "no sector returns what it should"
    weak = own & (proven_m < config.degraded_share * nominal_m)
    if weak.any():
        return HealthState.DEGRADED, f"{int(weak.sum())} of {int(own.sum())} sectors see less far"
    return HealthState.GOOD, ""

"""Detection range of a lidar (IEC 61496-3: detection capability): nominal, reduced by measured returns and health.

Over ground nearly every downward beam returns. The ratio of returns by sector shows whether the lidar detects at all: a
covered lens, a dead sector or a silent sensor has none. A health message can only reduce the range.
"""

import math
from itertools import pairwise

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Float32, Float64
from messages.perception import SensorHealth
from safety.config import DetectionRangeConfig, FieldConfig
from safety.zones.footprint import Footprint

TURN_RAD = 2.0 * math.pi
NEAREST_M = 0.5  # nearer returns come from the sensor's own cover
EVERY = 4  # share of the returns used: every fourth gives the same ratio


def nominal_range_m(lidar: Lidar, field: FieldConfig, config: DetectionRangeConfig) -> float:
    """Greatest range at which an object of the specified size gives enough returns above the minimum height."""
    column_rad = math.radians(lidar.field_of_view_deg) / lidar.columns
    height_m = lidar.mount.xyz_m[2]
    elevation_rad = np.radians(np.asarray(lidar.elevation_deg))
    max_m = min(config.cap_m, lidar.range_m[1])
    for range_m in np.arange(max_m, 1.0, -0.5):
        low = math.atan2(field.min_height_m + field.min_height_slope * range_m - height_m, range_m)
        high = math.atan2(config.object_m[1] - height_m, range_m)
        rings = np.count_nonzero((elevation_rad >= low) & (elevation_rad <= high))
        if rings * (config.object_m[0] / (range_m * column_rad)) >= config.min_object_returns:
            return float(range_m)
    return 0.0


def covers(lidar: Lidar, footprint: Footprint, direction: int) -> bool:
    """Whether a lidar covers a direction of travel, unobstructed by the machine's own body."""
    x, y, z = lidar.mount.xyz_m
    away = math.radians(lidar.mount.rpy_deg[2]) - (0.0 if direction > 0 else math.pi)
    is_turned_there = abs(math.remainder(away, TURN_RAD)) <= math.radians(0.5 * lidar.field_of_view_deg) + 1e-9
    machine = footprint.rigid[0]
    is_at_that_end = direction * (x - 0.5 * (machine.front_m + machine.rear_m)) > 0.0
    is_beside = abs(y) > machine.half_width_m
    return is_turned_there and (is_at_that_end or is_beside or z >= footprint.height_m - 0.1)


def expected_density(lidar: Lidar, config: DetectionRangeConfig) -> tuple[Float64, Float64]:
    """Slopes (rise over run) (B + 1,) between which beams must return, by bands of the range of the ground.

    And the number of such beams per radian of azimuth, (B,).
    """
    slopes = -lidar.mount.xyz_m[2] / np.asarray(config.beams_m)
    tangents = np.tan(np.radians(np.asarray(lidar.elevation_deg)))
    rings = np.array([np.count_nonzero((tangents >= low) & (tangents <= high)) for low, high in pairwise(slopes)])
    return slopes, rings * (lidar.columns / math.radians(lidar.field_of_view_deg))


def down_beams(xyz: Float32, origin_m: Float64, slopes: Float64) -> Float32:
    """Every fourth return (3, N) in base whose beam slope lies between the first and the last, (3, K)."""
    some = xyz[:, ::EVERY]
    flat, z = _run_and_rise(some, origin_m)
    is_down = (z >= slopes[0] * flat) & (z <= slopes[-1] * flat) & (flat > NEAREST_M)
    return np.asarray(some.compress(is_down, axis=1))


def return_ratios(xyz: Float32, origin_m: Float64, slopes: Float64, density: Float64, sectors: int) -> Float64:
    """Ratio of received to expected returns by band and by sector of azimuth about the sensor, from −π on, (B, S).

    Infinite in a band without beams.
    """
    azimuth = np.arctan2(xyz[1] - origin_m[1], xyz[0] - origin_m[0])
    sector = np.clip((azimuth + math.pi) * (sectors / TURN_RAD), 0, sectors - 1).astype(np.int64)
    flat, z = _run_and_rise(xyz, origin_m)
    band = np.clip(np.searchsorted(slopes, z / flat) - 1, 0, len(density) - 1)
    counts = np.bincount(band * sectors + sector, minlength=len(density) * sectors).reshape(-1, sectors)
    expected = density[:, None] * (TURN_RAD / sectors / EVERY)
    return np.asarray(np.divide(counts, expected, out=np.full(counts.shape, math.inf), where=expected > 0.0))


def _run_and_rise(xyz: Float32, origin_m: Float64) -> tuple[Float32, Float32]:
    x, y, z = (xyz[row] - np.float32(origin_m[row]) for row in range(3))
    return np.sqrt(x * x + y * y), z


def range_by_ratio(ratio: Float64, max_m: float, config: DetectionRangeConfig) -> Float64:
    """Detection range by sector (S,): the lowest of the bands (B, S).

    In each 0 up to the blind ratio, `max_m` from the good ratio on, linear between; but in fog the near ground shows
    that the range reaches the beginning of the band.
    """
    share = np.clip((ratio - config.blind_ratio) / (config.good_ratio - config.blind_ratio), 0.0, 1.0)
    begins = np.array([0.0, *config.beams_m[1:-1]])
    return np.asarray(np.maximum(max_m * share, np.minimum(begins, max_m)[:, None]).min(axis=0))


def sector_edges(sectors: int) -> Float64:
    """Edges of equal sectors from −π to π, (sectors + 1,)."""
    return np.linspace(-math.pi, math.pi, sectors + 1)


def min_range_towards(sector_edges_rad: Float64, range_m: Float64, direction: int, half_rad: float) -> float:
    """Minimum range of the sectors that intersect the cone about the direction of travel; 0 when none does."""
    center, edges = 0.0 if direction > 0 else math.pi, sector_edges_rad.tolist()  # lists: most sensors have one sector
    min_m: float | None = None
    for low, high, within_m in zip(edges[:-1], edges[1:], range_m.tolist(), strict=True):
        if min_m is not None and within_m >= min_m:
            continue
        away = abs((0.5 * (low + high) - center + math.pi) % TURN_RAD - math.pi)
        if away < 0.5 * (high - low) + half_rad - 1e-9:
            if math.isnan(within_m):
                return math.nan
            min_m = within_m
    return 0.0 if min_m is None else min_m


def limit_by_health(range_m: float, health: SensorHealth | None, direction: int, half_rad: float) -> float:
    """Range limited by a sensor's health message; 0 where that does not cover the direction or is NaN."""
    if health is None or len(health.detection_range_m) == 0:
        return range_m
    reported_m = min_range_towards(health.sector_edges_rad, health.detection_range_m, direction, half_rad)
    return 0.0 if math.isnan(reported_m) else min(range_m, reported_m)

"""Detection range of a lidar (IEC 61496-3: detection capability): nominal, reduced by measured returns and health.

Over ground nearly every downward beam returns. The ratio of returns by sector shows whether the lidar detects at all: a
covered lens, a dead sector or a silent sensor has none. A health message can only reduce the range.
"""

import math

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


def expected_density(lidar: Lidar, config: DetectionRangeConfig) -> tuple[tuple[float, float], float]:
    """Slopes (rise over run) between which beams must return, and the number of such beams per radian of azimuth."""
    height_m = lidar.mount.xyz_m[2]
    slopes = (-height_m / config.beams_m[0], -height_m / config.beams_m[1])
    tangents = np.tan(np.radians(np.asarray(lidar.elevation_deg)))
    rings = np.count_nonzero((tangents >= slopes[0]) & (tangents <= slopes[1]))
    return slopes, rings * lidar.columns / math.radians(lidar.field_of_view_deg)


def down_beams(xyz: Float32, origin_m: Float64, slopes: tuple[float, float]) -> Float32:
    """Every fourth return (3, N) in base whose beam slope lies between the two, (3, K)."""
    some = xyz[:, ::EVERY]
    x, y, z = (some[row] - np.float32(origin_m[row]) for row in range(3))
    flat = np.sqrt(x * x + y * y)
    is_down = (z >= slopes[0] * flat) & (z <= slopes[1] * flat) & (flat > NEAREST_M)
    return np.asarray(some.compress(is_down, axis=1))


def return_ratios(xyz: Float32, origin_m: Float64, density: float, sectors: int) -> Float64:
    """Ratio of received to expected returns by sector of azimuth about the sensor, from −π on, (sectors,)."""
    azimuth = np.arctan2(xyz[1] - origin_m[1], xyz[0] - origin_m[0])
    sector = np.clip((azimuth + math.pi) * (sectors / TURN_RAD), 0, sectors - 1).astype(np.int64)
    expected = max(density * TURN_RAD / sectors / EVERY, 1e-9)
    return np.asarray(np.bincount(sector, minlength=sectors) / expected)


def range_by_ratio(ratio: Float64, max_m: float, config: DetectionRangeConfig) -> Float64:
    """Detection range by sector: 0 up to the blind ratio, `max_m` from the good ratio on, linear between."""
    return max_m * np.clip((ratio - config.blind_ratio) / (config.good_ratio - config.blind_ratio), 0.0, 1.0)


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

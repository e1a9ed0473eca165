"""How far the field is proven free: what a lidar could see, and whether its returns show that it does.

Over ground nearly every beam that points down comes back. The share that does, by sector, says whether the lidar sees:
a covered lens, a dead sector or a mute sensor has none. A message on health may only take away from this.
"""

import math

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Float32, Float64
from messages.perception import SensorHealth
from safety.config import DetectionRangeConfig, FieldConfig
from safety.zones.footprint import Footprint

TURN_RAD = 2.0 * math.pi
NEAREST_M = 0.5  # what returns from nearer is the sensor's own cover
EVERY = 4  # returns looked at: a quarter says the same of a share


def nominal_range_m(lidar: Lidar, field: FieldConfig, config: DetectionRangeConfig) -> float:
    """The range at which an object of the least size still gives enough returns above the lowest height."""
    column_rad = math.radians(lidar.field_of_view_deg) / lidar.columns
    height_m = lidar.mount.xyz_m[2]
    elevation_rad = np.radians(np.asarray(lidar.elevation_deg))
    most_m = min(config.cap_m, lidar.range_m[1])
    for range_m in np.arange(most_m, 1.0, -0.5):
        low = math.atan2(field.min_height_m + field.min_height_slope * range_m - height_m, range_m)
        high = math.atan2(config.object_m[1] - height_m, range_m)
        rings = np.count_nonzero((elevation_rad >= low) & (elevation_rad <= high))
        if rings * (config.object_m[0] / (range_m * column_rad)) >= config.min_object_returns:
            return float(range_m)
    return 0.0


def covers(lidar: Lidar, footprint: Footprint, direction: int) -> bool:
    """Whether a lidar looks in a direction of travel past the machine's own body."""
    x, _, z = lidar.mount.xyz_m
    away = math.radians(lidar.mount.rpy_deg[2]) - (0.0 if direction > 0 else math.pi)
    is_turned_there = abs(math.remainder(away, TURN_RAD)) <= math.radians(0.5 * lidar.field_of_view_deg) + 1e-9
    machine = footprint.rigid[0]
    is_at_that_end = direction * (x - 0.5 * (machine.front_m + machine.rear_m)) > 0.0
    return is_turned_there and (is_at_that_end or z >= footprint.height_m - 0.1)


def expected_density(lidar: Lidar, config: DetectionRangeConfig) -> tuple[tuple[float, float], float]:
    """Slopes (rise over run) between which beams must come back, and how many of them a radian of azimuth has."""
    height_m = lidar.mount.xyz_m[2]
    slopes = (-height_m / config.beams_m[0], -height_m / config.beams_m[1])
    tangents = np.tan(np.radians(np.asarray(lidar.elevation_deg)))
    rings = np.count_nonzero((tangents >= slopes[0]) & (tangents <= slopes[1]))
    return slopes, rings * lidar.columns / math.radians(lidar.field_of_view_deg)


def down_beams(xyz: Float32, origin_m: Float64, slopes: tuple[float, float]) -> Float32:
    """Every fourth return (3, N) in base of the beams whose slope lies between two, (3, K)."""
    some = xyz[:, ::EVERY]
    x, y, z = (some[row] - np.float32(origin_m[row]) for row in range(3))
    flat = np.sqrt(x * x + y * y)
    is_down = (z >= slopes[0] * flat) & (z <= slopes[1] * flat) & (flat > NEAREST_M)
    return np.asarray(some.compress(is_down, axis=1))


def return_ratios(xyz: Float32, origin_m: Float64, density: float, sectors: int) -> Float64:
    """Share of the expected returns that came, by sector of azimuth about the sensor from −π on, (sectors,)."""
    azimuth = np.arctan2(xyz[1] - origin_m[1], xyz[0] - origin_m[0])
    sector = np.clip((azimuth + math.pi) * (sectors / TURN_RAD), 0, sectors - 1).astype(np.int64)
    expected = max(density * TURN_RAD / sectors / EVERY, 1e-9)
    return np.asarray(np.bincount(sector, minlength=sectors) / expected)


def range_by_share(share: Float64, most_m: float, config: DetectionRangeConfig) -> Float64:
    """Proven range by sector: nothing when blind, all when enough returns come, in proportion between."""
    return most_m * np.clip((share - config.blind_ratio) / (config.good_ratio - config.blind_ratio), 0.0, 1.0)


def edges(sectors: int) -> Float64:
    """Edges of equal sectors from −π to π, (sectors + 1,)."""
    return np.linspace(-math.pi, math.pi, sectors + 1)


def min_range_towards(sector_edges_rad: Float64, range_m: Float64, direction: int, half_rad: float) -> float:
    """The least of the ranges whose sector meets the cone about the direction of travel; 0 when none does."""
    center, edges = (
        0.0 if direction > 0 else math.pi,
        sector_edges_rad.tolist(),
    )  # most sensors have one sector: no arrays
    least_m: float | None = None
    for low, high, within_m in zip(edges[:-1], edges[1:], range_m.tolist(), strict=True):
        if least_m is not None and within_m >= least_m:
            continue
        away = abs((0.5 * (low + high) - center + math.pi) % TURN_RAD - math.pi)
        if away < 0.5 * (high - low) + half_rad - 1e-9:
            if math.isnan(within_m):
                return math.nan
            least_m = within_m
    return 0.0 if least_m is None else least_m


def limit_by_health(range_m: float, health: SensorHealth | None, direction: int, half_rad: float) -> float:
    """The range after what a sensor's health says; 0 where that does not cover the direction, or is no number."""
    if health is None or len(health.detection_range_m) == 0:
        return range_m
    said = min_range_towards(health.sector_edges_rad, health.detection_range_m, direction, half_rad)
    return 0.0 if math.isnan(said) else min(range_m, said)

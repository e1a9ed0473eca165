"""Returns of dust and birds, by what the beams next to them and below them met."""

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Bool, Float64, UInt8
from geometry.range_image import BeamGrid, ScatterMemory, dust, floating, range_image, scattered
from messages.sensors import LidarScan

UNUSED, LOW, OBSTACLE, FLOATING = range(4)  # classes of returns


class AirborneConfig(Config):
    """Evidence in a range image that returns are of dust, or of a body with clear space beneath it."""

    dust_range_m: float = Field(ge=0.0, le=50.0, description="within which a person has dozens of returns")
    dust_returns: int = Field(ge=1, le=1000, description="isolated returns in a scan from which on they are dust")
    range_m: float = Field(ge=0.0, le=100.0, description="of returns that are examined for floating")
    clear_m: float = Field(gt=0.0, le=5.0, description="height of the clear space beneath a return that floats")
    ground_m: float = Field(ge=0.0, le=1.0, description="above the plane of the machine; lower returns are its ground")
    ground_growth: float = Field(ge=0.0, le=0.1, description="added per metre of distance, m/m")
    min_share: float = Field(gt=0.0, le=1.0, description="of floating returns in a cluster that floats")


def is_scattered(scan: LidarScan, grid: BeamGrid, memory: ScatterMemory | None) -> Bool:
    """Which returns (N,) are of fog, rain or dense dust; `grid`: beams of the lidar, for a list of points; `memory`: of
    its last scans, for range images: in lists it takes returns from clouds of dust beside the path, which then move."""
    if scan.ranges_mm.size == 0:
        return scattered(*grid.place(scan.points_m))
    return scattered(range_image(scan.ranges_mm, scan.elevation_rad, scan.azimuth_rad), scan.pixels, memory)


def mark_airborne(scan: LidarScan, point_class: UInt8, T_base_sensor: Float64, config: AirborneConfig) -> None:
    """Sets in place the class (N,) of obstacle returns that are dust or float; a list of points proves neither."""
    if scan.ranges_mm.size == 0:
        return
    range_mm = scan.ranges_mm.ravel()[scan.pixels]
    near = np.flatnonzero((point_class == OBSTACLE) & (range_mm <= 1000.0 * config.range_m))
    image, pixels = range_image(scan.ranges_mm, scan.elevation_rad, scan.azimuth_rad), scan.pixels[near]
    is_floating, _ = floating(image, pixels, T_base_sensor, config.ground_m, config.ground_growth, config.clear_m)
    point_class[near[is_floating]] = FLOATING
    point_class[near[dust(image, pixels, config.dust_range_m, config.dust_returns)]] = UNUSED

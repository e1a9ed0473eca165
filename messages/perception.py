"""Obstacles, tracks, ground points and sensor health."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from messages.message import Message, MessagePart


class ObstacleClass(StrEnum):
    """Obstacle classes; `UNKNOWN` is an obstacle as well."""

    UNKNOWN = "unknown"
    PERSON = "person"
    ANIMAL = "animal"
    VEHICLE = "vehicle"
    POLE = "pole"
    MOUND = "mound"
    DITCH = "ditch"
    AIRBORNE = "airborne"


@dataclass(frozen=True)
class LidarGround(Message):
    """Ground segmentation of the scan `scan_stamp_ns`: `is_obstacle_point` (N,) in the order of its `points_m`.

    `plane` (4,) is the ground around the machine in `base`: a x + b y + c z + d = 0 with upward unit normal.
    """

    scan_stamp_ns: int
    is_obstacle_point: UInt8
    plane: Float64


@dataclass(frozen=True)
class Obstacles(Message):
    """Obstacles of one measurement of one sensor, in `base` at `stamp_ns`.

    K obstacles: `center_base_m` (K, 3), `size_m` (K, 3) and `yaw_rad` (K,) of the boxes; `nearest_base_m` (K, 3) the
    return nearest to the front of the machine; `velocity_mps` (K, 2) over ground in base axes, NaN where not measured;
    `class_scores` (K, 8) in the order of `ObstacleClass`, rows sum to 1. The returns of obstacle k are
    `indices[offsets[k]:offsets[k + 1]]` of the `points_m` of the scan `scan_stamp_ns`; `points_base_m` (M, 3) are the
    same returns in `base`, in that order (not logged). `sigma_m` (K, 2) of the centres, along and across the box yaw
    (then the line of sight); empty where the extent of the boxes is used.
    """

    sensor: str
    scan_stamp_ns: int
    center_base_m: Float64
    size_m: Float64
    yaw_rad: Float64
    nearest_base_m: Float64
    velocity_mps: Float64
    class_scores: Float64
    offsets: Int32
    indices: Int32
    points_base_m: Float32
    sigma_m: Float64 = field(default_factory=lambda: np.empty((0, 2)))


@dataclass(frozen=True)
class Track(MessagePart):
    """Tracked obstacle in `odom`; `covariance` (4, 4) of position and velocity."""

    id: int
    label: ObstacleClass
    confidence: float
    p_odom_m: Float64
    velocity_mps: Float64
    covariance: Float64
    size_m: Float64
    yaw_rad: float
    first_seen_ns: int
    last_seen_ns: int
    is_confirmed: bool
    sensors: tuple[str, ...]


@dataclass(frozen=True)
class Tracks(Message):
    """All tracks, confirmed or not."""

    tracks: tuple[Track, ...]


class HealthState(StrEnum):
    """State of a sensor."""

    GOOD = "good"
    DEGRADED = "degraded"
    BLIND = "blind"


@dataclass(frozen=True)
class SensorHealth(Message):
    """Detection range of one sensor by sector in `base`.

    Sector k covers azimuths `sector_edges_rad[k]` to `sector_edges_rad[k + 1]` (left positive); up to
    `detection_range_m[k]` an obstacle would be detected (0 m: blind).
    """

    sensor: str
    state: HealthState
    reason: str
    sector_edges_rad: Float64
    detection_range_m: Float64
    rejected_count: int

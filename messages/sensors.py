"""Sensor measurements, in the frame of the sensor."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from geometry.arrays import Float32, Float64, Int64, UInt8, UInt16
from geometry.range_image import points_of
from messages.message import Message


@dataclass(frozen=True)
class LidarScan(Message):
    """One sweep of a lidar; `stamp_ns` is its end.

    A scan is either a range image (`ranges_mm` (rings, columns), 0 = no return, with `elevation_rad` (rings,) and
    `azimuth_rad` (columns,)) or a list (`xyz_m` (N, 3)); the other arrays are empty. `intensity` is in the order of
    `points_m`, or empty. `offset_s` (columns,) or (N,) is the firing time relative to `stamp_ns` (≤ 0); empty: all
    fired at the stamp.
    """

    ranges_mm: UInt16
    elevation_rad: Float64
    azimuth_rad: Float64
    xyz_m: Float32
    intensity: UInt8
    offset_s: Float32

    @cached_property
    def points_m(self) -> Float32:
        """Returns in the sensor frame, (N, 3), row by row of the range image; indices of clusters refer to them."""
        if self.ranges_mm.size == 0:
            return self.xyz_m
        points = points_of(self.ranges_mm, self.elevation_rad, self.azimuth_rad)
        points.flags.writeable = False
        return points

    @cached_property
    def point_offset_s(self) -> Float32:
        """Time (s) of each of `points_m` relative to the stamp, (N,)."""
        if self.offset_s.size == 0:
            return np.zeros(len(self.points_m), np.float32)
        if self.ranges_mm.size == 0:
            return self.offset_s
        offsets = np.broadcast_to(self.offset_s, self.ranges_mm.shape).ravel()[self.pixels]
        offsets.flags.writeable = False
        return offsets

    @cached_property
    def pixels(self) -> Int64:
        """Places of `points_m` in the flattened range image, (N,)."""
        return np.flatnonzero(self.ranges_mm != 0)  # of bool: a third of the time of np.nonzero of integers


@dataclass(frozen=True)
class CameraImage(Message):
    """One image, (height, width, 3) BGR as in OpenCV.

    `encoded` is the JPEG or PNG of the camera, if any: `bgr` is then its exact decoding, and only `encoded` is logged.
    """

    bgr: UInt8
    encoded: bytes = b""


@dataclass(frozen=True)
class RadarScan(Message):
    """One radar cycle: per detection range, azimuth (left positive), Doppler (receding positive), cross-section."""

    range_m: Float64
    azimuth_rad: Float64
    elevation_rad: Float64
    doppler_mps: Float64
    rcs_dbsm: Float64


@dataclass(frozen=True)
class UltrasonicRange(Message):
    """One measurement; `range_m` is NaN without an echo."""

    range_m: float


@dataclass(frozen=True)
class ImuSample(Message):
    """Specific force and angular rate in the IMU frame, (3,) each; NaN: not measured."""

    acceleration_mps2: Float64
    rate_radps: Float64


class GnssSolution(IntEnum):
    """Type of a GNSS solution, from worst to best."""

    NONE = 0
    SINGLE = 1
    SBAS = 2
    PPP = 3
    RTK_FLOAT = 4
    RTK_FIXED = 5


@dataclass(frozen=True)
class GnssFix(Message):
    """Position of the antenna and, with two antennas, heading of the baseline (else NaN).

    `constellations` in use, such as "BDS" or "BDS+GPS". Unknown: `satellites` None, `height_m`, `correction_age_s`,
    `hdop` and sigmas NaN; a solution without corrections has no age either.
    """

    latitude_rad: float
    longitude_rad: float
    height_m: float
    sigma_enu_m: Float64
    velocity_enu_mps: Float64
    sigma_velocity_mps: float
    heading_rad: float
    sigma_heading_rad: float
    solution: GnssSolution
    satellites: int | None
    hdop: float
    correction_age_s: float
    constellations: str


@dataclass(frozen=True)
class WheelSample(Message):
    """Signed speed of the rear axle from its wheels and the angle of the front wheels (left positive; NaN: unknown)."""

    speed_mps: float
    steering_angle_rad: float


@dataclass(frozen=True)
class UwbRanges(Message):
    """Ranges from one tag to anchors by name; anchors without a range are left out."""

    tag: str
    anchors: tuple[str, ...]
    range_m: Float64
    quality: Float64

"""Odometry, map pose and lidar pose measurements."""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

from geometry.arrays import Float64
from geometry.transforms import interpolate, planar
from messages.message import Message
from messages.node import Inbox

PREDICTED_S = 0.1  # longest time over which the motion of an odometry message counts


@dataclass(frozen=True)
class Odometry(Message):
    """Continuous pose (drifts, no steps) and motion of `base`.

    `T_odom_base` (4, 4); `speed_mps` forward, `lateral_mps` left; `curvature_radpm` measured at the steered wheels;
    `covariance` (6, 6) of the motion over the last second: rotation, then translation, in `base`.
    """

    T_odom_base: Float64
    speed_mps: float
    lateral_mps: float
    acceleration_mps2: float
    yaw_rate_radps: float
    curvature_radpm: float
    covariance: Float64

    def interpolate(self, other: "Odometry", stamp_ns: int) -> "Odometry":
        """Odometry at a time between two messages: pose interpolated, motion of the nearer one."""
        share = (stamp_ns - self.stamp_ns) / max(other.stamp_ns - self.stamp_ns, 1)
        near = self if share < 0.5 else other
        T = interpolate(self.T_odom_base, other.T_odom_base, share)
        return Odometry(
            stamp_ns, T, near.speed_mps, near.lateral_mps, near.acceleration_mps2, near.yaw_rate_radps,
            near.curvature_radpm, near.covariance,
        )  # fmt: skip

    def predicted(self, stamp_ns: int) -> "Odometry":
        """Odometry at a later time by the motion now, at most `PREDICTED_S` on."""
        dt_s = min((stamp_ns - self.stamp_ns) * 1e-9, PREDICTED_S)
        step = planar(self.speed_mps * dt_s, self.lateral_mps * dt_s, self.yaw_rate_radps * dt_s)
        return replace(self, stamp_ns=stamp_ns, T_odom_base=self.T_odom_base @ step)


def odometry_at(inbox: Inbox, stamp_ns: int) -> Odometry | None:
    """Odometry at a time: between two messages, or predicted from the newest; None before the first one kept.

    A scan is often processed before the odometry of its time arrives.
    """
    odom, newest = inbox.at("odom", Odometry, stamp_ns), inbox.latest("odom", Odometry)
    return newest.predicted(stamp_ns) if odom is None and newest is not None and newest.stamp_ns <= stamp_ns else odom


class PositionSource(IntEnum):
    """Source of the position, from worst to best."""

    NONE = 0
    DEAD_RECKONING = 1
    SINGLE = 2
    UWB = 3
    RTK_FLOAT = 4
    RTK_FIXED = 5


@dataclass(frozen=True)
class MapPose(Message):
    """Pose of `odom` in `map`, with accuracy and integrity of the pose of `base`.

    `T_map_odom` and `T_map_base` (4, 4) at `stamp_ns`; `covariance` (6, 6) of `T_map_base`: rotation, then translation,
    in `base` (order of gtsam); `protection_level_m` bounds the horizontal error at 1e-4 per hour, or is infinite;
    `accuracy_95_m` is the horizontal accuracy (95 %) while no sensor is at fault;
    `gnss_age_s` and `uwb_age_s` are the ages of the last accepted fix and UWB range (infinite: none yet).
    """

    T_map_odom: Float64
    T_map_base: Float64
    covariance: Float64
    source: PositionSource
    protection_level_m: float
    gnss_age_s: float
    is_initialized: bool
    uwb_age_s: float = math.inf
    accuracy_95_m: float = math.inf


@dataclass(frozen=True)
class LidarLocalization(Message):
    """Pose of `base` in `map` from scan matching with known structures; if not valid, with the reason.

    `T_map_base` (4, 4); `covariance` (6, 6): rotation, then translation, in `base`; large for roll, pitch and
    (unless the floor is level) height, which are not observable.
    """

    T_map_base: Float64
    covariance: Float64
    is_valid: bool
    reason: str
    matched_points: int


@dataclass(frozen=True)
class LidarOdometry(Message):
    """Motion of `base` between two scans from lidar odometry; if not valid (degenerate), with the reason.

    `T_from_to` (4, 4) maps coordinates in base at `stamp_ns` to base at `from_stamp_ns`.
    """

    from_stamp_ns: int
    T_from_to: Float64
    covariance: Float64
    is_valid: bool
    reason: str
    matched_points: int

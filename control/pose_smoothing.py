"""Smoothed pose for steering: `T_map_odom` follows the localizer without steps while moving."""

import math

from pydantic import Field

from configs.strict import Config
from configs.vehicle import deg
from control.scalars import clamp
from geometry.pose2 import Pose2


class PoseSmoothingConfig(Config):
    """Maximum rates of the correction of the pose in `map`."""

    slew_mps: float = Field(gt=0.0, le=1.0)
    slew_degps: float = Field(gt=0.0, le=20.0)


class PoseSmoothing:
    """Limits the change of `T_map_odom` to the configured rates of position and heading of `base`."""

    def __init__(self, config: PoseSmoothingConfig) -> None:
        self._slew_mps, self._slew_radps = config.slew_mps, deg(config.slew_degps)
        self._T_map_odom: Pose2 | None = None

    def update(self, T_map_odom: Pose2, T_odom_base: Pose2, elapsed_s: float, is_standing: bool) -> Pose2:
        """Smoothed `T_map_base`; the first pose, and any at standstill, is taken over unchanged."""
        target = T_map_odom @ T_odom_base
        if self._T_map_odom is None or is_standing:
            self._T_map_odom = T_map_odom
            return target
        pose = _approach(
            self._T_map_odom @ T_odom_base, target, self._slew_mps * elapsed_s, self._slew_radps * elapsed_s
        )
        self._T_map_odom = pose @ T_odom_base.inverse()
        return pose


def _approach(pose: Pose2, target: Pose2, max_m: float, max_rad: float) -> Pose2:
    dx, dy = target.x_m - pose.x_m, target.y_m - pose.y_m
    distance = math.hypot(dx, dy)
    share = min(1.0, max_m / distance) if distance > 0.0 else 0.0
    turn = math.remainder(target.yaw_rad - pose.yaw_rad, 2.0 * math.pi)
    return Pose2(pose.x_m + share * dx, pose.y_m + share * dy, pose.yaw_rad + clamp(turn, max_rad))

"""The place of `odom` in `map` as steering sees it: it follows the localizer but never steps while moving."""

import math

from pydantic import Field

from configs.strict import Config
from configs.vehicle import deg
from control.scalars import clamp
from geometry.pose2 import Pose2


class AnchorConfig(Config):
    """How fast the machine may be moved on the map under the controller's feet."""

    slew_mps: float = Field(gt=0.0, le=1.0)
    slew_degps: float = Field(gt=0.0, le=20.0)


class MapAnchor:
    """Slews `T_map_odom` so that place and heading of `base` change by no more than the configured rates."""

    def __init__(self, config: AnchorConfig) -> None:
        self._slew_mps, self._slew_radps = config.slew_mps, deg(config.slew_degps)
        self._T_map_odom: Pose2 | None = None

    def update(self, T_map_odom: Pose2, T_odom_base: Pose2, elapsed_s: float, is_standing: bool) -> Pose2:
        """`T_map_base` to steer by; the first target, and any while standing, is taken whole."""
        target = T_map_odom @ T_odom_base
        if self._T_map_odom is None or is_standing:
            self._T_map_odom = T_map_odom
            return target
        pose = _approach(
            self._T_map_odom @ T_odom_base, target, self._slew_mps * elapsed_s, self._slew_radps * elapsed_s
        )
        self._T_map_odom = pose @ T_odom_base.inverse()
        return pose


def _approach(pose: Pose2, target: Pose2, most_m: float, most_rad: float) -> Pose2:
    dx, dy = target.x_m - pose.x_m, target.y_m - pose.y_m
    distance = math.hypot(dx, dy)
    share = min(1.0, most_m / distance) if distance > 0.0 else 0.0
    turn = math.remainder(target.yaw_rad - pose.yaw_rad, 2.0 * math.pi)
    return Pose2(pose.x_m + share * dx, pose.y_m + share * dy, pose.yaw_rad + clamp(turn, most_rad))

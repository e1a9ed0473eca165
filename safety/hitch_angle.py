"""Hitch angle of a trailed implement, which no sensor measures: the angles that can be, from the path driven.

The implement follows its hitch, so two angles approach each other while driving forwards, and one between two stays
between them. Both bounds are moved along the driven path: from those of the drawbar at first they close within a few
of its lengths, and open again in reverse.
"""

import math

import numpy as np

from geometry.arrays import Float64
from geometry.drawbar import Drawbar, follow

MARGIN_RAD = math.radians(3.0)  # wheels that slip sideways, errors of lengths and of odometry
JUMP_M = 0.5  # between two poses: the path between them is unknown
APART_RAD = math.radians(4.0)  # between angles swept: the end of an implement 5 m long is 0.17 m from one of them


class HitchAngle:
    """Bounds of the hitch angle, heading of the implement less that of the machine, within ±`most_rad`."""

    def __init__(self, drawbar: Drawbar, most_rad: float) -> None:
        self._drawbar, self._most_rad = drawbar, most_rad
        self._low_rad, self._high_rad = -most_rad, most_rad
        self._pose: Float64 | None = None

    def add(self, pose: Float64) -> None:
        """Follows the hitch to the newest pose (3,) of base in odom."""
        before, self._pose = self._pose, pose
        if before is None:
            return
        if math.hypot(pose[0] - before[0], pose[1] - before[1]) > JUMP_M:
            self._low_rad, self._high_rad = -self._most_rad, self._most_rad
            return
        (x, y), (to_x, to_y) = self._hitch(before), self._hitch(pose)
        low, high = (
            follow(float(before[2]) + angle, to_x - x, to_y - y, self._drawbar.axle_m) - float(pose[2])
            for angle in (self._low_rad, self._high_rad)
        )
        self._low_rad, self._high_rad = self._possible(low), self._possible(high)

    @property
    def bounds_rad(self) -> tuple[float, float]:
        """Smallest and greatest angle that can be."""
        return max(self._low_rad - MARGIN_RAD, -self._most_rad), min(self._high_rad + MARGIN_RAD, self._most_rad)

    def _hitch(self, pose: Float64) -> tuple[float, float]:
        ahead_m = self._drawbar.hitch_m
        return float(pose[0] + ahead_m * math.cos(pose[2])), float(pose[1] + ahead_m * math.sin(pose[2]))

    def _possible(self, angle_rad: float) -> float:
        turned = math.remainder(angle_rad, 2.0 * math.pi)
        return min(max(turned, -self._most_rad), self._most_rad)


def angles_between(bounds_rad: tuple[float, float]) -> list[float]:
    """Angles from one bound to the other, at most `APART_RAD` apart."""
    low, high = bounds_rad
    return list(map(float, np.linspace(low, high, 1 + math.ceil((high - low) / APART_RAD))))

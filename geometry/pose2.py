"""SE(2) poses: `Pose2`, and points moved between a level frame and its parent frame.

Scalars are plain floats: at 50 Hz on single numbers that is faster than arrays. Functions also take a pose as an
array (x, y, yaw).
"""

import math
from typing import NamedTuple

import numpy as np

from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import yaw_of


class Pose2(NamedTuple):
    """Origin and heading of frame b in frame a: the level `T_a_b`; yaw counter-clockwise from the x axis of a."""

    x_m: float
    y_m: float
    yaw_rad: float

    @classmethod
    def of(cls, T: Float64) -> "Pose2":
        """Level part of a transform (4, 4)."""
        return cls(float(T[0, 3]), float(T[1, 3]), yaw_of(T))

    def __matmul__(self, other: "Pose2") -> "Pose2":
        """`T_a_b @ T_b_c` is `T_a_c`; yaw within (-π, π]."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y = self.x_m + c * other.x_m - s * other.y_m, self.y_m + s * other.x_m + c * other.y_m
        return Pose2(x, y, wrap(self.yaw_rad + other.yaw_rad))

    def inverse(self) -> "Pose2":
        """`T_b_a`."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, -self.yaw_rad)

    def ahead(self, by_m: float) -> "Pose2":
        """The pose shifted forward."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(self.x_m + by_m * c, self.y_m + by_m * s, self.yaw_rad)

    def beside(self, by_m: float) -> "Pose2":
        """The pose shifted to the left."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(self.x_m - by_m * s, self.y_m + by_m * c, self.yaw_rad)


def to_frame(pose: Pose2 | Float64, xy_m: Float64) -> Float64:
    """Points (N, 2) of frame b, whose pose in frame a is given, in frame a."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.column_stack([pose[0] + c * xy_m[:, 0] - s * xy_m[:, 1], pose[1] + s * xy_m[:, 0] + c * xy_m[:, 1]])


def from_frame(pose: Pose2 | Float64, xy_m: Float64) -> Float64:
    """Points (N, 2) of frame a in frame b, whose pose in frame a is given."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = xy_m[:, 0] - pose[0], xy_m[:, 1] - pose[1]
    return np.column_stack([c * dx + s * dy, c * dy - s * dx])


def point_from_frame(pose: Pose2 | Float64, x_m: float, y_m: float) -> tuple[float, float]:
    """`from_frame` of one point."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x_m - float(pose[0]), y_m - float(pose[1])
    return c * dx + s * dy, c * dy - s * dx

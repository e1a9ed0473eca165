"""Level poses in plain floats: what runs fifty times a second on single numbers is faster without arrays."""

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from geometry.angles import wrap
from geometry.transforms import yaw_of
from messages.message import Float64


class Planar(NamedTuple):
    """A pose on the level: `T_a_b` by origin and heading of b in a."""

    x_m: float
    y_m: float
    yaw_rad: float

    def __matmul__(self, other: "Planar") -> "Planar":
        """`T_a_b @ T_b_c` is `T_a_c`."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y = self.x_m + c * other.x_m - s * other.y_m, self.y_m + s * other.x_m + c * other.y_m
        return Planar(x, y, wrap(self.yaw_rad + other.yaw_rad))

    def inverse(self) -> "Planar":
        """`T_b_a`."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Planar(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, -self.yaw_rad)


def planar_of(T: Float64) -> Planar:
    """The level part of a transform (4, 4)."""
    return Planar(float(T[0, 3]), float(T[1, 3]), yaw_of(T))


def singly(values: Float64) -> Sequence[float]:
    """The same numbers, to be asked for one by one as plain floats: no copy, and nearly as fast as a list."""
    return cast(Sequence[float], np.ascontiguousarray(values).data)


def clamp(value: float, limit: float) -> float:
    """The value, or ±`limit` if it is beyond."""
    return max(-limit, min(limit, value))

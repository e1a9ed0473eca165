"""Angles in radians, counter-clockwise from east."""

import math


def wrap(angle_rad: float) -> float:
    """The same angle within (-π, π]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)

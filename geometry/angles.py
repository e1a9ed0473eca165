"""Angles in radians, counter-clockwise from east."""

import math


def wrap(angle_rad: float) -> float:
    """Angle wrapped to (-π, π]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)

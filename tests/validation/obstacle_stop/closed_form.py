"""Braking in closed form, from the values of docs/requirements.md alone."""

import math

TAU, DEAD, BUILD_UP, A = 0.6, 0.3, 0.4, 2.5


def braked_m(v: float) -> float:
    """Distance from the start of the build-up to standstill."""
    if v < 0.5 * A * BUILD_UP:  # v = A t² / (2 BUILD_UP): standstill within the build-up
        t = math.sqrt(2.0 * v * BUILD_UP / A)
        return v * t - A * t**3 / (6.0 * BUILD_UP)
    rest = v - 0.5 * A * BUILD_UP
    return v * BUILD_UP - A * BUILD_UP**2 / 6.0 + rest**2 / (2.0 * A)

"""A roe deer, 0.75 m at the shoulder: body, neck, head with ears, legs with hocks, white rump."""

import math
from functools import cache

import numpy as np

from simulation.environment.lofting import Keys, Part, blob, loft
from simulation.objects.solid import GAIT_STEPS

BODY: Keys = (
    (-0.53, 0.0, 0.72, 0.02, 0.02), (-0.52, 0.0, 0.71, 0.10, 0.08), (-0.44, 0.0, 0.69, 0.155, 0.125),
    (-0.25, 0.0, 0.67, 0.165, 0.145), (0.0, 0.0, 0.66, 0.170, 0.150), (0.22, 0.0, 0.66, 0.180, 0.145),
    (0.38, 0.0, 0.69, 0.165, 0.120), (0.47, 0.0, 0.72, 0.10, 0.08), (0.49, 0.0, 0.73, 0.02, 0.02),
)  # fmt: skip
NECK: Keys = (
    (0.30, 0.0, 0.70, 0.12, 0.09), (0.40, 0.0, 0.80, 0.105, 0.078), (0.50, 0.0, 0.93, 0.075, 0.058),
    (0.57, 0.0, 1.06, 0.060, 0.050), (0.60, 0.0, 1.13, 0.045, 0.045),
)  # fmt: skip
HEAD: Keys = (
    (0.52, 0.0, 1.12, 0.02, 0.02), (0.54, 0.0, 1.12, 0.055, 0.05), (0.60, 0.0, 1.115, 0.072, 0.062),
    (0.68, 0.0, 1.08, 0.058, 0.048), (0.76, 0.0, 1.04, 0.042, 0.034), (0.83, 0.0, 1.01, 0.034, 0.030),
    (0.845, 0.0, 1.005, 0.012, 0.012),
)  # fmt: skip


@cache
def deer(step: int, is_fine: bool) -> tuple[Part, ...]:
    """All parts at a gait step (a trot: diagonal legs together); the lowest hoof is at height 0."""
    sides, more = (20, 3) if is_fine else (10, 1)
    parts = [Part(loft(BODY, sides, 9 * more, axis=(1.0, 0.0, 0.0)), "coat"), Part(loft(NECK, sides, 5 * more), "coat"),
             Part(loft(HEAD, sides, 6 * more), "coat"),
             Part(blob((-0.515, 0.0, 0.73), (0.03, 0.085, 0.10), 10, 6), "white")]  # fmt: skip
    for side in (1.0, -1.0):
        ear = ((0.57, 0.04 * side, 1.14, 0.012, 0.015), (0.55, 0.085 * side, 1.20, 0.016, 0.032),
               (0.535, 0.115 * side, 1.26, 0.010, 0.022), (0.53, 0.125 * side, 1.285, 0.004, 0.006))  # fmt: skip
        parts.append(Part(loft(ear, 8, 4 * more), "coat"))
        for is_front in (True, False):
            phase = side if is_front else -side
            swing = phase * math.sin(2.0 * math.pi * step / GAIT_STEPS) if step >= 0 else 0.06 * phase
            parts += _leg(is_front, side, swing, max(sides // 2, 6), more)
        if is_fine:
            parts.append(Part(blob((0.645, 0.056 * side, 1.115), (0.014, 0.010, 0.013), 8, 5), "dark"))
    if is_fine:
        parts.append(Part(blob((0.842, 0.0, 1.012), (0.014, 0.022, 0.018), 8, 5), "dark"))
    low = min(float(p.mesh.vertices_m[:, 2].min()) for p in parts)
    T = np.eye(4)
    T[2, 3] = -low
    return tuple(Part(p.mesh.transformed(T), p.region) for p in parts)


def _leg(is_front: bool, side: float, swing: float, sides: int, more: int) -> list[Part]:
    """Thigh, joint, lower leg and hoof; `swing` from -1 to 1."""
    x, y = (0.33, 0.085 * side) if is_front else (-0.40, 0.09 * side)
    first, second = (0.35 * swing, 0.35 * swing - 0.3 * max(0.0, -swing)) if is_front else (0.25 + 0.35 * swing,
                                                                                      -0.22 + 0.4 * swing)  # fmt: skip
    upper, lower = (0.30, 0.34) if is_front else (0.32, 0.36)
    sign = 1.0 if is_front else -1.0
    top = 0.64
    joint = (x + sign * upper * math.sin(first), top - upper * math.cos(first))
    foot = (joint[0] + (1.0 if is_front else -1.0) * lower * math.sin(second), joint[1] - lower * math.cos(second))
    thick = 0.10 if is_front else 0.13

    def on(t: float, half_x: float, half_y: float) -> tuple[float, float, float, float, float]:
        a, b = ((x, top), joint) if t < 1.0 else (joint, foot)
        f = t if t < 1.0 else t - 1.0
        return (a[0] + f * (b[0] - a[0]), y, a[1] + f * (b[1] - a[1]), half_x, half_y)

    leg = (on(0.0, thick, 0.05), on(0.35, 0.75 * thick, 0.048), on(0.8, 0.036, 0.030), on(1.05, 0.030, 0.026),
           on(1.3, 0.022, 0.020), on(1.85, 0.020, 0.019), on(2.0, 0.019, 0.018))  # fmt: skip
    hoof = blob((foot[0] + 0.012, y, foot[1] + 0.005), (0.034, 0.024, 0.03), sides, 5)
    return [Part(loft(leg, sides, 6 * more), "coat"), Part(hoof, "dark")]

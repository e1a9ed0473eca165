"""Azimuth without branches and table look-ups, so that a loop over returns is vectorized."""

import numpy as np

from geometry.jit import inline_kernel

ZERO, TINY = np.float32(0.0), np.float32(1e-6)
QUARTER, HALF = np.float32(0.5 * np.pi), np.float32(np.pi)
C3, C5, C7 = np.float32(-0.327622764), np.float32(0.15931422), np.float32(-0.0464964749)


@inline_kernel
def azimuth_of(x: np.float32, y: np.float32) -> np.float32:
    """Angle from the negative x axis, counter-clockwise, from 0 to 2 pi: atan2(y, x) + pi to 2e-4 rad."""
    ax, ay = x if x > ZERO else -x, y if y > ZERO else -y
    big, small = ax if ax > ay else ay, ay if ax > ay else ax
    a = small / (big + TINY)
    s = a * a
    angle = ((C7 * s + C5) * s + C3) * s * a + a
    angle = QUARTER - angle if ay > ax else angle
    angle = HALF - angle if x < ZERO else angle
    angle = -angle if y < ZERO else angle
    return angle + HALF

"""Third-order Butterworth low-pass, forward and backward: bits of `filtfilt(*butter(3, share), x, axis=0)` of SciPy.

`scipy.signal` is not used because importing it takes 1.5 s of processor time at every start.
"""

import numpy as np

from geometry.arrays import Float64
from geometry.jit import kernel

ORDER = 3
EDGE = 3 * (ORDER + 1)  # samples by which both ends are extended, as SciPy does


def low_pass(x: Float64, share: float) -> Float64:
    """Columns of `x` (N, M), N > 12, low-pass filtered at `share` of the Nyquist frequency without phase shift."""
    b, a = butterworth(share)
    ends = 2.0 * x[0] - x[EDGE:0:-1], 2.0 * x[-1] - x[-2 : -(EDGE + 2) : -1]
    extended = np.concatenate([ends[0], x, ends[1]])
    state = steady_state(b, a)[:, None]
    forward = _filter(b, a, extended, state * extended[0])
    backward = _filter(b, a, np.ascontiguousarray(forward[::-1]), state * forward[-1])
    return backward[::-1][EDGE:-EDGE]


def warm() -> None:
    """Compiles the kernel or loads it from the cache, so that the first path does not wait for it."""
    low_pass(np.zeros((2 * EDGE, 2)), 0.5)


def butterworth(share: float) -> tuple[Float64, Float64]:
    """Coefficients (4,) of numerator and denominator at `share` of the Nyquist frequency, 0 to 1."""
    warped = 4.0 * np.tan(np.pi * share / 2.0)
    poles = warped * -np.exp(1j * np.pi * np.arange(-ORDER + 1, ORDER, 2, dtype=np.float64) / (2 * ORDER))
    gain = warped**ORDER * np.real(1.0 / np.prod(4.0 - poles))
    denominator = np.asarray(np.poly((4.0 + poles) / (4.0 - poles)), np.float64)
    return np.asarray(gain * np.poly(-np.ones(ORDER)), np.float64), denominator


def steady_state(b: Float64, a: Float64) -> Float64:
    """State (3,) of the filter after a long constant input of 1."""
    companion = np.vstack([-a[1:] / a[0], np.eye(ORDER - 1, ORDER)])
    return np.linalg.solve(np.eye(ORDER) - companion.T, b[1:] - a[1:] * b[0])


@kernel
def _filter(b: Float64, a: Float64, x: Float64, state: Float64) -> Float64:
    """Transposed direct form II of each column, from `state` (3, M)."""
    y = np.empty_like(x)
    for column in range(x.shape[1]):
        s0, s1, s2 = state[0, column], state[1, column], state[2, column]
        for row in range(x.shape[0]):
            u = x[row, column]
            v = s0 + b[0] * u
            s0 = s1 + u * b[1] - v * a[1]
            s1 = s2 + u * b[2] - v * a[2]
            s2 = u * b[3] - v * a[3]
            y[row, column] = v
    return y

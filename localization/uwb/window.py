"""Window of keyframes solved by Gauss-Newton, with marginalised keyframes as a Gaussian prior.

The unknowns are stacked as (model parameters, anchor scales, anchor biases, keyframe 0, keyframe 1, ...); those before
the keyframes are common to all. Pure functions on arrays; robust weights come from `range_weight`.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from geometry.arrays import Float64, Int64
from localization.uwb.motion_models import MotionModel


@dataclass(frozen=True)
class RobustWeighting:
    """Robust weighting of ranges: sigma, and residuals in sigmas of too long and too short ranges with half weight."""

    sigma_m: float
    long: float
    short: float


@dataclass(frozen=True)
class Ranges:
    """n ranges: keyframe in the window, anchor by row, metres, age before the keyframe."""

    keyframe: Int64
    anchor: Int64
    range_m: Float64
    age_s: Float64


@dataclass(frozen=True)
class Window:
    """`common` (c,), keyframes `x` (n, size), steps between them (n - 1, ...), ranges, and the Gaussian prior.

    `prior` is the information (c + size, c + size) on common and keyframe 0 about `prior_mean`.
    """

    common: Float64
    x: Float64
    steps: Float64
    ranges: Ranges
    prior: Float64
    prior_mean: Float64


@dataclass(frozen=True)
class WindowModel:
    """Constants: motion model, anchors (a, 3), lever arm (2,) and height of the tag, weighting of ranges."""

    motion: MotionModel
    anchors_m: Float64
    arm_m: Float64
    height_m: float
    weighting: RobustWeighting


def range_weight(residual: Float64, weighting: RobustWeighting) -> Float64:
    """Weight 0..1 of measured minus expected (in sigmas), as for Student's t: reflections only lengthen."""
    bound = np.where(residual > 0.0, weighting.long, weighting.short)
    return np.asarray(1.0 / (1.0 + (residual / bound) ** 2))


def range_rows(model: WindowModel, window: Window) -> tuple[Float64, Float64]:
    """Residuals (n,) in sigmas and their derivatives (n, unknowns), not yet weighted."""
    r, motion = window.ranges, model.motion
    c, size, a = len(window.common), motion.size, len(model.anchors_m)
    p, by_x = motion.tag(window.x[r.keyframe], r.age_s, model.arm_m)
    offset = np.column_stack([p - model.anchors_m[r.anchor, :2], model.height_m - model.anchors_m[r.anchor, 2]])
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
    scale = 1.0 + window.common[motion.extra + r.anchor]
    bias = window.common[motion.extra + a + r.anchor]
    J = np.zeros((len(r.range_m), c + window.x.size))
    rows = np.arange(len(J))
    J[rows, motion.extra + r.anchor] = -distance
    J[rows, motion.extra + a + r.anchor] = -1.0
    columns = c + size * r.keyframe[:, None] + np.arange(size)
    J[rows[:, None], columns] = -np.einsum("n,ni,nij->nj", scale / distance, offset[:, :2], by_x)
    return (r.range_m - scale * distance - bias) / model.weighting.sigma_m, J / model.weighting.sigma_m


def motion_rows(model: WindowModel, window: Window) -> tuple[Float64, Float64]:
    """Whitened residuals (n * k,) and derivatives (n * k, unknowns) of the steps."""
    motion, c, size = model.motion, len(window.common), model.motion.size
    lin = motion.linear(window.x[:-1], window.x[1:], window.common[: motion.extra], window.steps)
    n, k = lin.r.shape
    J = np.zeros((n, k, c + window.x.size))
    J[:, :, : motion.extra] = lin.extra
    step, row = np.arange(n)[:, None, None], np.arange(k)[None, :, None]
    columns = c + size * step + np.arange(size)[None, None, :]
    J[step, row, columns] = lin.first
    J[step, row, columns + size] = lin.last
    return lin.r.ravel(), J.reshape(n * k, c + window.x.size)


def normal(model: WindowModel, window: Window) -> tuple[Float64, Float64]:
    """Information (u, u) and gradient (u,) at the window's state, ranges weighted by their residuals there."""
    r, J = range_rows(model, window)
    w = range_weight(r, model.weighting)
    m, K = motion_rows(model, window)
    A, b = (J.T * w) @ J + K.T @ K, J.T @ (w * r) + K.T @ m
    head = len(window.prior)
    A[:head, :head] += window.prior
    b[:head] += window.prior @ (np.concatenate([window.common, window.x[0]]) - window.prior_mean)
    return A, b


def cost(model: WindowModel, window: Window) -> float:
    """Half the robust sum of squares, motion and prior included."""
    r, _ = range_rows(model, window)
    m, _ = motion_rows(model, window)
    bound = np.where(r > 0.0, model.weighting.long, model.weighting.short)
    e = np.concatenate([window.common, window.x[0]]) - window.prior_mean
    return float(0.5 * (np.sum(bound**2 * np.log1p((r / bound) ** 2)) + m @ m + e @ window.prior @ e))


def solve(model: WindowModel, window: Window, iterations: int) -> Window:
    """Gauss-Newton, weights updated in every iteration; raises LinAlgError when an unknown is unobservable."""
    c = len(window.common)
    for _ in range(iterations):
        A, b = normal(model, window)
        step = -cho_solve(cho_factor(A), b)
        x = window.x + step[c:].reshape(window.x.shape)
        window = replace(window, common=window.common + step[:c], x=x)
    return window


def covariance(model: WindowModel, window: Window) -> Float64:
    """Covariance of (common, newest keyframe)."""
    A, _ = normal(model, window)
    c, size = len(window.common), model.motion.size
    keep = np.r_[0:c, len(A) - size : len(A)]
    return np.asarray(cho_solve(cho_factor(A), np.eye(len(A))[:, keep])[keep])


def drop_oldest(model: WindowModel, window: Window, walk: Float64) -> Window:
    """Marginalises keyframe 0; `walk` (c, c) is the process noise of the common unknowns."""
    c, size = len(window.common), model.motion.size
    r = window.ranges
    is_oldest = r.keyframe == 0
    two = replace(window, x=window.x[:2], steps=window.steps[:1], ranges=_select(r, is_oldest, 0))
    A, b = normal(model, two)
    removed, kept = np.arange(c, c + size), np.r_[0:c, c + size : c + 2 * size]
    gain = cho_solve(cho_factor(A[np.ix_(removed, removed)]), np.column_stack([A[np.ix_(removed, kept)], b[removed]]))
    prior = A[np.ix_(kept, kept)] - A[np.ix_(kept, removed)] @ gain[:, :-1]
    gradient = b[kept] - A[np.ix_(kept, removed)] @ gain[:, -1]
    P = cho_solve(cho_factor(prior), np.eye(len(prior)))
    mean = np.concatenate([window.common, window.x[1]]) - P @ gradient
    P[:c, :c] += walk
    prior = cho_solve(cho_factor(P), np.eye(len(P)))
    rest = _select(r, ~is_oldest, 1)
    return Window(window.common, window.x[1:], window.steps[1:], rest, 0.5 * (prior + prior.T), mean)


def append(window: Window, x: Float64, step: Float64, new: Ranges) -> Window:
    """Appends a keyframe at the initial guess `x`, with its ranges (their `keyframe` is overwritten)."""
    n, r = len(window.x), window.ranges
    ranges = Ranges(
        np.concatenate([r.keyframe, np.full(len(new.range_m), n, np.int64)]),
        np.concatenate([r.anchor, new.anchor]),
        np.concatenate([r.range_m, new.range_m]),
        np.concatenate([r.age_s, new.age_s]),
    )
    return replace(window, x=np.vstack([window.x, x]), steps=np.vstack([window.steps, step]), ranges=ranges)


def _select(r: Ranges, chosen: Float64, earlier: int) -> Ranges:
    return Ranges(r.keyframe[chosen] - earlier, r.anchor[chosen], r.range_m[chosen], r.age_s[chosen])

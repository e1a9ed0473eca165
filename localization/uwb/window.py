"""A window of keyframes solved by Gauss-Newton, with what has left it kept as a Gaussian on what remains.

The unknowns are stacked as (model parameters, anchor scales, anchor biases, keyframe 0, keyframe 1, ...); those before
the keyframes are common to all. Pure functions on arrays; robust weights come from `range_weight`.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from geometry.transforms import Float64
from localization.uwb.motion_models import Motion
from messages.message import Int64


@dataclass(frozen=True)
class Gauge:
    """How ranges are weighed: sigma, and the residuals in sigmas at which a range too long or too short counts half."""

    sigma_m: float
    late: float
    early: float


@dataclass(frozen=True)
class Ranges:
    """n ranges: keyframe in the window, anchor by row, metres, age before the keyframe."""

    keyframe: Int64
    anchor: Int64
    range_m: Float64
    age_s: Float64


@dataclass(frozen=True)
class Window:
    """`common` (c,), keyframes `x` (n, size), steps between them (n - 1, ...), ranges, and the Gaussian left behind.

    `prior` is the information (c + size, c + size) on common and keyframe 0 about `prior_mean`.
    """

    common: Float64
    x: Float64
    steps: Float64
    ranges: Ranges
    prior: Float64
    prior_mean: Float64


@dataclass(frozen=True)
class Scene:
    """What does not change: model of motion, anchors (a, 3), arm (2,) and height of the tag, gauge."""

    motion: Motion
    anchors_m: Float64
    arm_m: Float64
    height_m: float
    gauge: Gauge


def range_weight(residual: Float64, gauge: Gauge) -> Float64:
    """Weight 0..1 of measured minus expected (in sigmas), as for Student's t: reflections only make ranges longer."""
    bound = np.where(residual > 0.0, gauge.late, gauge.early)
    return np.asarray(1.0 / (1.0 + (residual / bound) ** 2))


def range_rows(scene: Scene, window: Window) -> tuple[Float64, Float64]:
    """Residuals (n,) in sigmas and their derivatives (n, unknowns), not yet weighted."""
    r, motion = window.ranges, scene.motion
    c, size, a = len(window.common), motion.size, len(scene.anchors_m)
    p, by_x = motion.tag(window.x[r.keyframe], r.age_s, scene.arm_m)
    offset = np.column_stack([p - scene.anchors_m[r.anchor, :2], scene.height_m - scene.anchors_m[r.anchor, 2]])
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
    scale = 1.0 + window.common[motion.extra + r.anchor]
    bias = window.common[motion.extra + a + r.anchor]
    J = np.zeros((len(r.range_m), c + window.x.size))
    rows = np.arange(len(J))
    J[rows, motion.extra + r.anchor] = -distance
    J[rows, motion.extra + a + r.anchor] = -1.0
    columns = c + size * r.keyframe[:, None] + np.arange(size)
    J[rows[:, None], columns] = -np.einsum("n,ni,nij->nj", scale / distance, offset[:, :2], by_x)
    return (r.range_m - scale * distance - bias) / scene.gauge.sigma_m, J / scene.gauge.sigma_m


def motion_rows(scene: Scene, window: Window) -> tuple[Float64, Float64]:
    """Whitened residuals (n * k,) and derivatives (n * k, unknowns) of the steps."""
    motion, c, size = scene.motion, len(window.common), scene.motion.size
    lin = motion.linear(window.x[:-1], window.x[1:], window.common[: motion.extra], window.steps)
    n, k = lin.r.shape
    J = np.zeros((n, k, c + window.x.size))
    J[:, :, : motion.extra] = lin.extra
    step, row = np.arange(n)[:, None, None], np.arange(k)[None, :, None]
    columns = c + size * step + np.arange(size)[None, None, :]
    J[step, row, columns] = lin.first
    J[step, row, columns + size] = lin.last
    return lin.r.ravel(), J.reshape(n * k, c + window.x.size)


def normal(scene: Scene, window: Window) -> tuple[Float64, Float64]:
    """Information (u, u) and gradient (u,) at the window's state, ranges weighted by their residuals there."""
    r, J = range_rows(scene, window)
    w = range_weight(r, scene.gauge)
    m, K = motion_rows(scene, window)
    A, b = (J.T * w) @ J + K.T @ K, J.T @ (w * r) + K.T @ m
    head = len(window.prior)
    A[:head, :head] += window.prior
    b[:head] += window.prior @ (np.concatenate([window.common, window.x[0]]) - window.prior_mean)
    return A, b


def cost(scene: Scene, window: Window) -> float:
    """Half the robust sum of squares, motion and prior included."""
    r, _ = range_rows(scene, window)
    m, _ = motion_rows(scene, window)
    bound = np.where(r > 0.0, scene.gauge.late, scene.gauge.early)
    e = np.concatenate([window.common, window.x[0]]) - window.prior_mean
    return float(0.5 * (np.sum(bound**2 * np.log1p((r / bound) ** 2)) + m @ m + e @ window.prior @ e))


def solve(scene: Scene, window: Window, iterations: int) -> Window:
    """Gauss-Newton with weights renewed in every iteration; raises LinAlgError when nothing holds an unknown."""
    c = len(window.common)
    for _ in range(iterations):
        A, b = normal(scene, window)
        step = -cho_solve(cho_factor(A), b)
        x = window.x + step[c:].reshape(window.x.shape)
        window = replace(window, common=window.common + step[:c], x=x)
    return window


def covariance(scene: Scene, window: Window) -> Float64:
    """Of (common, newest keyframe)."""
    A, _ = normal(scene, window)
    c, size = len(window.common), scene.motion.size
    keep = np.r_[0:c, len(A) - size : len(A)]
    return np.asarray(cho_solve(cho_factor(A), np.eye(len(A))[:, keep])[keep])


def drop_oldest(scene: Scene, window: Window, walk: Float64) -> Window:
    """Marginalises keyframe 0; `walk` (c, c) is how far the common unknowns may have changed meanwhile."""
    c, size = len(window.common), scene.motion.size
    r = window.ranges
    mine = r.keyframe == 0
    two = replace(window, x=window.x[:2], steps=window.steps[:1], ranges=_pick(r, mine, 0))
    A, b = normal(scene, two)
    gone, keep = np.arange(c, c + size), np.r_[0:c, c + size : c + 2 * size]
    gain = cho_solve(cho_factor(A[np.ix_(gone, gone)]), np.column_stack([A[np.ix_(gone, keep)], b[gone]]))
    prior = A[np.ix_(keep, keep)] - A[np.ix_(keep, gone)] @ gain[:, :-1]
    gradient = b[keep] - A[np.ix_(keep, gone)] @ gain[:, -1]
    P = cho_solve(cho_factor(prior), np.eye(len(prior)))
    mean = np.concatenate([window.common, window.x[1]]) - P @ gradient
    P[:c, :c] += walk
    prior = cho_solve(cho_factor(P), np.eye(len(P)))
    rest = _pick(r, ~mine, 1)
    return Window(window.common, window.x[1:], window.steps[1:], rest, 0.5 * (prior + prior.T), mean)


def append(window: Window, x: Float64, step: Float64, new: Ranges) -> Window:
    """One more keyframe at the guess `x`, with its ranges (their `keyframe` is overwritten)."""
    n, r = len(window.x), window.ranges
    ranges = Ranges(
        np.concatenate([r.keyframe, np.full(len(new.range_m), n, np.int64)]),
        np.concatenate([r.anchor, new.anchor]),
        np.concatenate([r.range_m, new.range_m]),
        np.concatenate([r.age_s, new.age_s]),
    )
    return replace(window, x=np.vstack([window.x, x]), steps=np.vstack([window.steps, step]), ranges=ranges)


def _pick(r: Ranges, chosen: Float64, earlier: int) -> Ranges:
    return Ranges(r.keyframe[chosen] - earlier, r.anchor[chosen], r.range_m[chosen], r.age_s[chosen])

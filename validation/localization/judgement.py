"""Judgement of a trajectory: error against truth, NEES, protection level, availability."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.arrays import Float64, Int64
from validation.localization.trajectory import GAP_S, Trajectory
from validation.localization.truth import Truth

MIN_PAIRS = 2


@dataclass(frozen=True, eq=False)
class Errors:
    """Horizontal errors (M, 2) in `map` at stamps of the truth (M,), with covariance and protection level there.

    `is_aligned`: the truth was turned and shifted to the trajectory first.
    """

    stamps_ns: Int64
    error_m: Float64
    covariance_m2: Float64
    level_m: Float64
    is_aligned: bool

    @property
    def distance_m(self) -> Float64:
        """Length of the errors."""
        return np.hypot(self.error_m[:, 0], self.error_m[:, 1])

    @property
    def nees(self) -> float:
        """Mean squared error over its covariance and its two dimensions: 1 where the covariance is right."""
        solved = np.linalg.solve(self.covariance_m2, self.error_m[:, :, None])[:, :, 0]
        return float(np.mean(np.sum(self.error_m * solved, axis=1)) / 2.0)

    @property
    def exceeded_share(self) -> float:
        """Share of the errors above the protection level."""
        return float(np.mean(self.distance_m > self.level_m))


def errors_of(trajectory: Trajectory, truth: Truth, antenna_m: Float64) -> Errors | None:
    """Errors between poses at most `GAP_S` apart; None where truth and trajectory do not overlap."""
    t, at = trajectory.stamps_ns, truth.stamps_ns
    if len(t) < MIN_PAIRS:
        return None
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    is_inside = (at >= t[after - 1]) & (at <= t[after]) & (t[after] - t[after - 1] <= GAP_S * 1e9)
    if int(is_inside.sum()) < MIN_PAIRS:
        return None
    at, after, p_true = at[is_inside], after[is_inside], truth.p_m[is_inside]
    share = ((at - t[after - 1]) / (t[after] - t[after - 1]))[:, None]
    points = trajectory.T_map_base[:, :3, 3]
    points = points + trajectory.T_map_base[:, :3, :3] @ antenna_m if truth.is_antenna else points
    p = ((1.0 - share) * points[after - 1] + share * points[after])[:, :2]
    if not truth.is_placed:
        p_true = aligned(p_true, p)
    nearest = np.where(share[:, 0] > 0.5, after, after - 1)
    return Errors(at, p - p_true, trajectory.covariance_m2[nearest], trajectory.level_m[nearest], not truth.is_placed)


def aligned(p_m: Float64, to_m: Float64) -> Float64:
    """Points (N, 2) turned and shifted to others with the least squared distance, without a scale (Umeyama 1991)."""
    a, b = p_m - p_m.mean(axis=0), to_m - to_m.mean(axis=0)
    angle = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(a @ np.array([[c, s], [-s, c]]) + to_m.mean(axis=0))


def statistics(distance_m: Float64) -> dict[str, float]:
    """Median, mean, RMSE, 95th percentile and largest of errors, m."""
    return {
        "n": len(distance_m),
        "median_m": round(float(np.median(distance_m)), 4),
        "mean_m": round(float(np.mean(distance_m)), 4),
        "rmse_m": round(float(np.sqrt(np.mean(distance_m**2))), 4),
        "p95_m": round(float(np.percentile(distance_m, 95)), 4),
        "max_m": round(float(np.max(distance_m)), 4),
    }


def error_result(errors: Errors | None) -> dict[str, Any] | None:
    """The errors as JSON."""
    if errors is None:
        return None
    return statistics(errors.distance_m) | {
        "is_aligned": errors.is_aligned,
        "nees": round(errors.nees, 3),
        "above_protection_level": round(errors.exceeded_share, 5),
        "largest_excess_m": round(float(np.max(errors.distance_m - errors.level_m)), 3),
    }


def fix_errors(stamps_ns: Int64, p_m: Float64, truth: Truth) -> Float64:
    """Distances (K,) of fixes (N, 2) from the truth, interpolated between positions at most 2 `GAP_S` apart.

    Empty where the truth is that of another point than the antenna or in another frame.
    """
    if not truth.is_antenna or not truth.is_placed or len(truth.stamps_ns) < MIN_PAIRS:
        return np.zeros(0)
    t = truth.stamps_ns
    after = np.clip(np.searchsorted(t, stamps_ns), 1, len(t) - 1)
    gap_ns = t[after] - t[after - 1]
    is_inside = (stamps_ns >= t[after - 1]) & (stamps_ns <= t[after]) & (gap_ns <= 2 * GAP_S * 1e9)
    share = ((stamps_ns - t[after - 1]) / gap_ns)[:, None]
    p_true = (1.0 - share) * truth.p_m[after - 1] + share * truth.p_m[after]
    return np.asarray(np.linalg.norm(p_m - p_true, axis=1)[is_inside])

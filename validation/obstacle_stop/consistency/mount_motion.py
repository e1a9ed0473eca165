"""Yaw and position of a mount by the motion of standing structure.

The rear axle does not slip sideways: the motion of base that the scans give with the configured mount is along x. A yaw
error turns it, tan(error) = left / forward; a lateral error adds error × yaw rate to the speed forward, a longitudinal
one to the speed left, for which a limit is allowed. A finding exceeds its limit by the 95 % quantile of its error,
and a clean log is below the limit by most of it.
"""

import math

import numpy as np

from geometry.arrays import Float64, Int64
from validation.obstacle_stop.consistency.config import MountLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked
from validation.obstacle_stop.consistency.motion_series import MotionSeries
from validation.obstacle_stop.consistency.scan_motion import ScanSteps

BLOCK_NS = 1_500_000_000
MIN_FORWARD_M = 0.15  # per step
MIN_BLOCKS = 3
MIN_STEPS = 6
NOISE_M = 0.03  # least noise of a step
SIGMAS = 1.65  # 95 % of a normal distribution


def check_yaw(name: str, steps: ScanSteps, limits: MountLimits) -> list[Finding]:
    """Yaw of the mount of a lidar."""
    use = steps.is_known & (np.abs(steps.motion[:, 0]) > MIN_FORWARD_M)
    # pairs of successive steps: the error of the scan in between cancels
    pairs = np.flatnonzero(use[1:] & use[:-1] & (steps.from_ns[1:] == steps.to_ns[:-1]))
    if len(pairs) < MIN_STEPS:
        reason = f"{len(pairs)} pairs of steps of the scans determine the direction of travel"
        return [not_checked(f"yaw of the mount of lidar {name}", reason)]
    forward, left, turn = (steps.motion[pairs] + steps.motion[pairs + 1]).T
    slope, error = _slope(forward, left, steps.error_m[pairs])
    curvature = abs(float(np.median(turn / forward)))
    limit = math.radians(limits.yaw_deg) + limits.axle_m * curvature + SIGMAS * error
    numbers = {"yaw_deg": math.degrees(slope), "error_deg": math.degrees(error), "pairs": float(len(pairs))}
    if error > 0.5 * math.radians(limits.yaw_deg):
        return [not_checked(f"yaw of the mount of lidar {name}", "its standard error is too large", numbers)]
    if abs(slope) <= limit:
        return []
    text = (
        f"lidar {name}: standing structure moves {math.degrees(slope):+.1f}° ± {math.degrees(error):.1f}° off the "
        f"direction of travel: the yaw of its mount is wrong by about {math.degrees(-slope):+.1f}°"
    )
    return [Finding("mount_yaw", text, numbers, True)]


def check_lateral(name: str, steps: ScanSteps, used: MotionSeries, limits: MountLimits) -> list[Finding]:
    """Place across of the mount of a lidar, by the speed of an independent odometry in curves."""
    motion, is_covered = used.steps(steps.from_ns, steps.to_ns)
    use = steps.is_known & is_covered & (np.abs(motion[:, 0] - steps.motion[:, 0]) < 0.5)
    what = f"place across of lidar {name}"
    if use.sum() < MIN_STEPS:
        return [not_checked(what, "too few steps determined by the scans")]
    turn, forward = steps.motion[use, 2], motion[use, 0]
    place, error = _lateral(turn, forward, steps.motion[use, 0] - forward, steps.from_ns[use] // BLOCK_NS)
    numbers = {"place_error_m": place, "error_m": error}
    if not math.isfinite(error) or limits.sigmas * error > limits.position_m:
        return [not_checked(what, "too little turning", numbers)]
    if abs(place) <= limits.position_m + SIGMAS * error:
        return []
    text = (
        f"lidar {name}: in curves standing structure moves as if its mount were {place:+.2f} ± {error:.2f} m to the "
        "left of its configured place"
    )
    return [Finding("mount_lateral", text, numbers, True)]


def _slope(forward: Float64, left: Float64, error_m: Float64) -> tuple[float, float]:
    """Mean angle of the usual steps and its standard error (rad): by their scatter, and at least that of one step.

    Few structures shift all registrations alike, so that the error of one step does not fall with their number.
    """
    angles = np.arctan2(left * np.sign(forward), np.abs(forward))
    middle = float(np.median(angles))
    spread = 1.48 * float(np.median(np.abs(angles - middle)))
    mean = float(angles[np.abs(angles - middle) <= 3.0 * spread].mean())
    # overlapping pairs: half as many independent ones
    return mean, math.hypot(spread / math.sqrt(0.5 * len(angles)), float(np.median(error_m / np.abs(forward))))


def _lateral(turn: Float64, forward: Float64, excess: Float64, block: Int64) -> tuple[float, float]:
    """Robust fit of excess = -place × turn + scale × forward; standard error by intervals, infinite if unknown."""
    A, weights = np.stack([turn, forward], axis=1), np.ones(len(turn))
    fit: Float64 = np.zeros(2)
    for _ in range(5):
        H = (A * weights[:, None]).T @ A
        if np.linalg.cond(H + 1e-12 * np.eye(2)) > 1e8:
            return 0.0, math.inf
        fit = np.linalg.solve(H, (A * weights[:, None]).T @ excess).astype(np.float64)
        residual = excess - A @ fit
        scale = max(1.5 * float(np.median(np.abs(residual))), 1e-3)
        weights = 1.0 / (1.0 + (residual / scale) ** 2)
    scores = np.array([((weights * residual)[block == b, None] * A[block == b]).sum(axis=0) for b in np.unique(block)])
    inverse = np.linalg.inv(H)
    covariance = inverse @ (scores.T @ scores) @ inverse
    error2 = max(float(covariance[0, 0]), NOISE_M**2 * float(inverse[0, 0]))
    return float(-fit[0]), math.sqrt(error2) if len(scores) >= MIN_BLOCKS else math.inf

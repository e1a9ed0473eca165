"""Odometry against the motion of the scans, against other sources, and against its own speed.

Distances are compared over intervals of some seconds. One differs when the speeds differ by more than the tolerance and
the scans fit markedly better (share of inliers) at their own motion than at that of the odometry, so that scenes that
look alike at both motions (a hedge, a bare field) contradict nothing. A registration at a wrong place is an error of
single steps; a finding needs several intervals that differ, and a share of all.
"""

import numpy as np

from geometry.arrays import Bool, Float64, Int64
from validation.obstacle_stop.consistency.config import MotionLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked
from validation.obstacle_stop.consistency.motion_series import MotionSeries
from validation.obstacle_stop.consistency.scan_motion import ScanSteps

MIN_KNOWN_S = 0.5  # of an interval in which the scans determine the motion


def driven_m(series: MotionSeries) -> float:
    """Distance over the positions once a second, without steps below 0.1 m (noise at standstill)."""
    stamps, rows = series.columns()
    if len(stamps) < 2:
        return 0.0
    grid = np.append(np.arange(stamps[0], stamps[-1], 1_000_000_000), stamps[-1])
    d = np.hypot(*(np.diff(np.interp(grid, stamps, rows[:, c])) for c in (0, 1)))
    return float(d[d > 0.1].sum())


def check_driven(used: MotionSeries, limits: MotionLimits) -> list[Finding]:
    """Whether the machine moved at all."""
    distance_m = driven_m(used)
    if distance_m >= limits.min_driven_m:
        return []
    text = (
        f"no motion: the machine moved by {distance_m:.1f} m by {used.name}; a verdict needs a drive of at least "
        f"{limits.min_driven_m:g} m"
    )
    return [Finding("no_motion", text, {"driven_m": distance_m}, True)]


def check_against_scans(
    used: MotionSeries, steps: ScanSteps, is_from_scans: bool, limits: MotionLimits
) -> list[Finding]:
    """Speed of the odometry against that of the scans; odometry from scans needs scans that determine the motion."""
    block, known_s = _blocks(steps, limits.block_s)
    usable = known_s >= MIN_KNOWN_S
    numbers = {"intervals": float(len(known_s)), "intervals_with_structure": float(usable.sum())}
    if is_from_scans and usable.sum() < 0.5 * max(len(known_s), 1):
        text = (
            f"the odometry comes from the scans, and in {len(known_s) - usable.sum()} of {len(known_s)} intervals of "
            f"{limits.block_s:g} s these do not determine the motion (too little structure): speed and path are unknown"
        )
        return [Finding("odometry_degenerate", text, numbers, True)]
    if not usable.any():
        return [not_checked("speed of the odometry by the scans", "too little structure in the scans", numbers)]
    motion, is_covered = used.steps(steps.from_ns, steps.to_ns)
    use = steps.is_known & is_covered
    if not use.any():
        return [not_checked("speed of the odometry by the scans", "no common times", numbers)]
    gain = np.where(np.isfinite(steps.odometry_share), steps.share - steps.odometry_share, 0.0)
    mine, theirs, seconds, marked = (
        np.bincount(block[use], weight[use]).astype(np.float64)
        for weight in (motion[:, 0], steps.motion[:, 0], (steps.to_ns - steps.from_ns) * 1e-9, gain >= limits.min_gain)
    )
    usable = seconds >= MIN_KNOWN_S
    differs = usable & _is_different(mine, theirs, seconds, limits) & (marked >= 0.5 * np.bincount(block[use]))
    if differs.sum() < max(limits.min_blocks, limits.min_block_share * usable.sum()):
        return []
    a, b = (float(np.median(v[differs] / seconds[differs])) for v in (mine, theirs))
    first_s = float(np.flatnonzero(differs)[0]) * limits.block_s
    text = (
        f"{used.name} contradicts the scans in {differs.sum()} of {usable.sum()} intervals of {limits.block_s:g} s, "
        f"first after {first_s:.0f} s: {a:.1f} m/s against {b:.1f} m/s of standing structure (medians)"
    )
    numbers |= {"speed_mps": a, "scan_speed_mps": b, "differing_intervals": float(differs.sum()), "first_s": first_s}
    return [Finding("odometry_contradicts_scans", text, numbers, True)]


def check_against(
    used: MotionSeries, other: MotionSeries, steps: list[ScanSteps], is_from_scans: bool, limits: MotionLimits
) -> list[Finding]:
    """Distances of the odometry against those of another source, and which of both the scans support."""
    stamps, _ = used.columns()
    if len(stamps) < 2 or len(other.stamps) < 2:
        return []
    span_s = float(stamps[-1] - stamps[0]) * 1e-9
    # long intervals where the log has them: GNSS positions scatter by metres
    block_s = min(3.0 * limits.block_s, max(limits.block_s, 0.25 * span_s))
    grid = np.arange(stamps[0], stamps[-1], round(block_s * 1e9))
    mine, mine_known = used.steps(grid[:-1], grid[1:])
    theirs, theirs_known = other.steps(grid[:-1], grid[1:])
    use = mine_known & theirs_known
    if use.sum() < limits.min_blocks:
        return [not_checked(f"odometry by {other.name}", "too short together")]
    a, b = np.hypot(*mine[:, :2].T), np.hypot(*theirs[:, :2].T)
    differs = use & _is_different(a, b, np.full(len(a), block_s), limits)
    if differs.sum() < max(limits.min_blocks, limits.min_block_share * use.sum()):
        return []
    numbers = {
        "speed_mps": float(np.median(a[differs])) / block_s,
        "other_speed_mps": float(np.median(b[differs])) / block_s,
        "intervals": float(use.sum()), "differing_intervals": float(differs.sum()),
    }  # fmt: skip
    supported = not is_from_scans and any(_does_support(used, one, limits) for one in steps)
    text = (
        f"{used.name} and {other.name} contradict each other in {differs.sum()} of {use.sum()} intervals of "
        f"{block_s:g} s: {numbers['speed_mps']:.1f} m/s and {numbers['other_speed_mps']:.1f} m/s (medians)"
    )
    text += "; the scans support the first, which is used" if supported else "; which one is right is unknown"
    return [Finding("odometry_contradicted", text, numbers, not supported)]


def check_own_speed(used: MotionSeries, limits: MotionLimits) -> list[Finding]:
    """Speeds of an odometry against its positions."""
    stamps, rows = used.columns()
    if len(stamps) < 2 or not np.isfinite(rows[:, 3]).all():
        return []
    grid = np.arange(stamps[0], stamps[-1], round(limits.block_s * 1e9))
    motion, is_known = used.steps(grid[:-1], grid[1:])
    by_speed = np.diff(np.interp(grid, stamps, rows[:, 3]))
    differs = is_known & _is_different(motion[:, 0], by_speed, np.full(len(by_speed), limits.block_s), limits)
    if differs.sum() < max(limits.min_blocks, limits.min_block_share * is_known.sum()):
        return []
    a, b = (float(np.median(v[differs])) / limits.block_s for v in (motion[:, 0], by_speed))
    text = (
        f"{used.name} contradicts itself in {differs.sum()} of {is_known.sum()} intervals of {limits.block_s:g} s: "
        f"{a:.1f} m/s by its positions, {b:.1f} m/s by its speed"
    )
    return [Finding("odometry_speed", text, {"position_speed_mps": a, "speed_mps": b}, True)]


def _does_support(used: MotionSeries, steps: ScanSteps, limits: MotionLimits) -> bool:
    known_s = _blocks(steps, limits.block_s)[1]
    return bool((known_s >= MIN_KNOWN_S).sum() >= limits.min_blocks) and not check_against_scans(
        used, steps, False, limits
    )


def _blocks(steps: ScanSteps, block_s: float) -> tuple[Int64, Float64]:
    """Interval of each step, and by interval the time in which the scans determine the motion."""
    if not len(steps.from_ns):
        return np.zeros(0, np.int64), np.zeros(0)
    block = (steps.from_ns - steps.from_ns[0]) // round(block_s * 1e9)
    duration_s = (steps.to_ns - steps.from_ns) * 1e-9 * steps.is_known
    known_s = np.bincount(block, duration_s).astype(np.float64)
    return block.astype(np.int64), known_s[np.bincount(block) > 0]


def _is_different(a_m: Float64, b_m: Float64, duration_s: Float64, limits: MotionLimits) -> Bool:
    tolerance = limits.speed_mps * duration_s + limits.speed_share * np.maximum(np.abs(a_m), np.abs(b_m))
    return np.asarray(np.abs(a_m - b_m) > tolerance)

"""Odometry against the motion of the scans, against other sources, and against its own speed.

Distances are compared over intervals of some seconds. One differs when the speeds differ by more than the tolerance and
the scans fit markedly better (share of inliers) at their own motion than at that of the odometry, so that scenes that
look alike at both motions (a hedge, a bare field) contradict nothing. A registration at a wrong place is an error of
single steps; a finding needs several intervals that differ, and a share of all.
"""

import math

import numpy as np

from geometry.arrays import Bool, Float64, Int64
from validation.obstacle_stop.consistency.config import MotionLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked
from validation.obstacle_stop.consistency.motion_series import MotionSeries
from validation.obstacle_stop.consistency.scan_motion import ScanSteps

MIN_KNOWN_S = 0.5  # of an interval in which the scans determine the motion
MIN_BLOCK_S = 0.9  # of an interval in short logs
DEG = math.degrees(1.0)


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
    block_s = _block_s(used, limits)
    block, known_s = _blocks(steps, block_s)
    usable = known_s >= MIN_KNOWN_S
    numbers = {"intervals": float(len(known_s)), "intervals_with_structure": float(usable.sum())}
    if is_from_scans and usable.sum() < 0.5 * max(len(known_s), 1):
        text = (
            f"the odometry comes from the scans, and in {len(known_s) - usable.sum()} of {len(known_s)} intervals of "
            f"{block_s:.3g} s these do not determine the motion (too little structure): speed and path are unknown"
        )
        return [Finding("odometry_degenerate", text, numbers, True)]
    if not usable.any():
        return [not_checked("speed of the odometry by the scans", "too little structure in the scans", numbers)]
    motion, is_covered = used.steps(steps.from_ns, steps.to_ns)
    use = steps.is_known & is_covered
    if not use.any():
        return [not_checked("speed of the odometry by the scans", "no common times", numbers)]
    gain = np.where(np.isfinite(steps.odometry_share), steps.share - steps.odometry_share, 0.0)
    seconds = np.bincount(block[use], ((steps.to_ns - steps.from_ns) * 1e-9)[use]).astype(np.float64)
    is_marked = np.bincount(block[use], (gain >= limits.min_gain)[use]) >= 0.5 * np.bincount(block[use])
    usable, out = seconds >= MIN_KNOWN_S, list[Finding]()
    for code, column, unit, factor in (("odometry_contradicts_scans", 0, "m/s", 1.0), ("odometry_turn", 2, "°/s", DEG)):
        mine, theirs = (np.bincount(block[use], m[use, column]).astype(np.float64) for m in (motion, steps.motion))
        fixed = limits.speed_mps if column == 0 else math.radians(limits.turn_degps)
        differs = usable & is_marked & _is_different(mine, theirs, seconds, fixed, limits.speed_share)
        if differs.sum() < max(limits.min_blocks, limits.min_block_share * usable.sum()):
            continue
        a, b = (factor * float(np.median(v[differs] / seconds[differs])) for v in (mine, theirs))
        first_s = float(np.flatnonzero(differs)[0]) * block_s
        text = (
            f"{used.name} contradicts the scans in {differs.sum()} of {usable.sum()} intervals of {block_s:.3g} s, "
            f"first after {first_s:.0f} s: {a:.1f} {unit} against {b:.1f} {unit} of standing structure (medians)"
        )
        names = ("speed_mps", "scan_speed_mps") if column == 0 else ("turn_degps", "scan_turn_degps")
        values = {names[0]: a, names[1]: b, "differing_intervals": float(differs.sum()), "first_s": first_s}
        out.append(Finding(code, text, numbers | values, True))
    return out


def check_confirmed(
    used: MotionSeries, others: list[MotionSeries], steps: list[ScanSteps], limits: MotionLimits
) -> list[Finding]:
    """Whether anything in the log confirms the speed: scans with structure, or another source."""
    stamps, _ = used.columns()
    if len(stamps) < 2 or any((_blocks(one, _block_s(used, limits))[1] >= MIN_KNOWN_S).any() for one in steps):
        return []
    grid = np.arange(stamps[0], stamps[-1], round(limits.block_s * 1e9))
    if any(other.has_speed and other.steps(grid[:-1], grid[1:])[1].any() for other in others):
        return []
    text = (
        f"nothing in the log confirms the speed of {used.name}: too little structure in the scans, and no other source "
        "(wheel speed, GNSS)"
    )
    return [Finding("speed_unconfirmed", text, {}, True)]


def check_against(
    used: MotionSeries, other: MotionSeries, steps: list[ScanSteps], is_from_scans: bool, limits: MotionLimits
) -> list[Finding]:
    """Distances of the odometry against those of another source, and which of both the scans support."""
    stamps, _ = used.columns()
    if len(stamps) < 2 or len(other.stamps) < 2:
        return []
    span_s = float(stamps[-1] - stamps[0]) * 1e-9
    # long intervals where the log has them: GNSS positions scatter by metres
    block_s = min(3.0 * limits.block_s, max(_block_s(used, limits), 0.25 * span_s))
    grid = np.arange(stamps[0], stamps[-1], round(block_s * 1e9))
    mine, mine_known = used.steps(grid[:-1], grid[1:])
    theirs, theirs_known = other.steps(grid[:-1], grid[1:])
    use = mine_known & theirs_known
    if use.sum() < limits.min_blocks:
        return [not_checked(f"odometry by {other.name}", "too short together")]
    a, b = np.hypot(*mine[:, :2].T), np.hypot(*theirs[:, :2].T)
    differs = use & _is_different(a, b, np.full(len(a), block_s), limits.speed_mps, limits.speed_share)
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
        f"{block_s:.3g} s: {numbers['speed_mps']:.1f} m/s and {numbers['other_speed_mps']:.1f} m/s (medians)"
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
    seconds = np.full(len(by_speed), limits.block_s)
    differs = is_known & _is_different(motion[:, 0], by_speed, seconds, limits.speed_mps, limits.speed_share)
    if differs.sum() < max(limits.min_blocks, limits.min_block_share * is_known.sum()):
        return []
    a, b = (float(np.median(v[differs])) / limits.block_s for v in (motion[:, 0], by_speed))
    text = (
        f"{used.name} contradicts itself in {differs.sum()} of {is_known.sum()} intervals of {limits.block_s:g} s: "
        f"{a:.1f} m/s by its positions, {b:.1f} m/s by its speed"
    )
    return [Finding("odometry_speed", text, {"position_speed_mps": a, "speed_mps": b}, True)]


def _block_s(used: MotionSeries, limits: MotionLimits) -> float:
    """Length of the compared intervals: shorter where the log is too short for `min_blocks`."""
    stamps, _ = used.columns()
    span_s = float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0
    return min(limits.block_s, max(MIN_BLOCK_S, span_s / (limits.min_blocks + 0.2)))


def _does_support(used: MotionSeries, steps: ScanSteps, limits: MotionLimits) -> bool:
    known_s = _blocks(steps, _block_s(used, limits))[1]
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


def _is_different(a: Float64, b: Float64, duration_s: Float64, per_s: float, share: float) -> Bool:
    tolerance = per_s * duration_s + share * np.maximum(np.abs(a), np.abs(b))
    return np.asarray(np.abs(a - b) > tolerance)

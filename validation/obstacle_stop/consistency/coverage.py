"""Parts of a log without scans, odometry or truth."""

from array import array

import numpy as np

from geometry.arrays import Bool, Int64
from validation.obstacle_stop.consistency.config import CoverageLimits
from validation.obstacle_stop.consistency.finding import Finding

MIN_VIEW_DEG = 20.0  # narrower sectors leave out parts of the path a few metres ahead


def check_scans(
    name: str, stamps_ns: "array[int]", moving_ns: tuple[int, int] | None, limits: CoverageLimits
) -> list[Finding]:
    """Number of scans of a lidar and gaps between them, in the time of the motion too."""
    stamps = np.unique(np.array(stamps_ns, np.int64))
    if len(stamps) < limits.min_scans:
        text = f"lidar {name}: {len(stamps)} scans; a verdict needs at least {limits.min_scans}"
        return [Finding("too_few_scans", text, {"scans": float(len(stamps))}, True)]
    return _gaps(
        "scans_missing", f"lidar {name}: no scans", stamps, moving_ns or (int(stamps[0]), int(stamps[-1])), limits
    )


def check_odometry(
    name: str, stamps_ns: "array[int]", span_ns: tuple[int, int], limits: CoverageLimits
) -> list[Finding]:
    """Gaps of the odometry in the span of the scans."""
    stamps = np.array(stamps_ns, np.int64)
    if len(stamps) < 2:
        return [Finding("odometry_missing", f"{name}: no motion known", {"messages": float(len(stamps))}, True)]
    return _gaps("odometry_missing", f"{name}: no odometry", stamps, span_ns, limits)


def check_truth(stamps_ns: "array[int]", has_truth: "array[int]", limits: CoverageLimits) -> list[Finding]:
    """Scans without truth among those that are to be evaluated: nothing is judged there."""
    stamps, known = np.array(stamps_ns, np.int64), np.array(has_truth, bool)
    if not len(stamps) or known.all():
        return []
    intervals = _intervals(stamps, ~known)
    missing = float(1.0 - known.mean())
    longest = max(b - a for a, b in intervals)
    where = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in intervals[:5]) + (" and more" if len(intervals) > 5 else "")
    numbers = {"missing_share": missing, "longest_s": longest, "scans": float(len(stamps))}
    is_blocking = missing > limits.max_missing_share and longest > limits.max_gap_s
    text = f"no truth for {100 * missing:.0f} % of the evaluated scans ({where} after the first scan): not judged there"
    return [Finding("truth_missing", text + ("; name the evaluated times as windows" if is_blocking else ""),
                    numbers, is_blocking)]  # fmt: skip


def check_sector(view_rad: float) -> list[Finding]:
    """Directions without labels."""
    if view_rad > 3.1:
        return []
    view_deg = float(np.degrees(view_rad))
    text = f"truth within ± {view_deg:.0f}° of the lidar's x axis only: nothing is judged outside"
    return [Finding("truth_sector", text, {"view_deg": view_deg}, view_deg < MIN_VIEW_DEG)]


def _gaps(code: str, what: str, stamps: Int64, span_ns: tuple[int, int], limits: CoverageLimits) -> list[Finding]:
    edges = np.concatenate([[min(span_ns[0], stamps[0])], stamps, [max(span_ns[1], stamps[-1])]])
    gaps = np.diff(edges) * 1e-9
    usual = float(np.median(np.diff(stamps))) * 1e-9
    is_gap = gaps > max(limits.max_gap_s, 3.0 * usual)
    if not is_gap.any():
        return []
    missing = float(gaps[is_gap].sum() / max(gaps.sum(), 1e-9))
    starts = (edges[:-1][is_gap] - edges[0]) * 1e-9
    longest = int(np.argmax(gaps[is_gap]))
    text = (
        f"{what} for {100 * missing:.0f} % of the log ({is_gap.sum()} gaps, longest {gaps[is_gap][longest]:.1f} s "
        f"after {starts[longest]:.1f} s): not judged there"
    )
    numbers = {"missing_share": missing, "gaps": float(is_gap.sum()), "longest_s": float(gaps[is_gap].max())}
    return [Finding(code, text, numbers, missing > limits.max_missing_share)]


def _intervals(stamps: Int64, mask: Bool) -> list[tuple[float, float]]:
    """Intervals (s after the first stamp) of consecutive scans of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    seconds = (stamps - stamps[0]) * 1e-9
    return [(float(seconds[a]), float(seconds[b - 1])) for a, b in edges.reshape(-1, 2)]

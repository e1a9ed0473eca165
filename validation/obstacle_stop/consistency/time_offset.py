"""Time of the scans against that of the odometry and of other sources.

The steps of the scans in yaw and forward are compared with those of the other source at times displaced by a lag. A lag
other than zero is a finding when it explains the steps markedly better: the sum of squares falls by a ratio, the
improvement is many times the noise at the best lag, and both halves of the log give the same lag. Steps of a drive at
constant speed and curvature are the same at every lag: then nothing is known.
"""

import numpy as np

from geometry.arrays import Float64
from validation.obstacle_stop.consistency.config import TimeLimits
from validation.obstacle_stop.consistency.finding import Finding, not_checked
from validation.obstacle_stop.consistency.motion_series import MotionSeries
from validation.obstacle_stop.consistency.scan_motion import ScanSteps

LAG_STEP_S = 0.02
MIN_STEPS = 8
SEARCH_SHARE = 0.15  # of the duration of the log at most
NOISE = {"yaw": 0.003, "forward": 0.02}  # rad and m per step: least noise of a registration
MAX_STEP_BACK_S = 1.0  # more than scans out of order
NEAR_S = 0.08  # lags of halves of a log may differ by this much


def check_lags(name: str, steps: ScanSteps, others: list[MotionSeries], limits: TimeLimits) -> list[Finding]:
    """Lags of the scans of a lidar against other sources of motion; positive: the scans are late."""
    what = f"time of the scans of lidar {name}"
    known = steps.select(steps.is_known)
    if not others:
        return [not_checked(what, "no other source of motion")]
    if len(known.from_ns) < MIN_STEPS:
        return [not_checked(what, "too few scans determine the motion")]
    found = [_check_lag(name, known, other, limits) for other in others]
    if all(one is None for one in found):
        return [not_checked(what, "speed and yaw rate hardly change in the log")]
    return [finding for one in found if one is not None for finding in one]


def _check_lag(name: str, known: ScanSteps, other: MotionSeries, limits: TimeLimits) -> list[Finding] | None:
    """None where the motion is the same at every lag."""
    kinds = [k for k, has in (("yaw", other.has_yaw), ("forward", other.has_speed)) if has]
    found = [(kind, *_best_lag(known, other, kind, limits)) for kind in kinds]
    observable = [f for f in found if f[2]]
    if not observable:
        return None
    late = [f for f in observable if abs(f[1]) > limits.max_lag_s and f[3]]
    if not late:
        return []
    kind, lag_s = late[0][:2]
    text = (
        f"the scans of lidar {name} are {abs(lag_s):.2f} s {'late' if lag_s > 0 else 'early'} against {other.name}: "
        f"the {'yaw rate' if kind == 'yaw' else 'speed'} agrees best at this lag"
    )
    return [Finding("time_offset", text, {"lag_s": lag_s}, True)]


def _best_lag(steps: ScanSteps, other: MotionSeries, kind: str, limits: TimeLimits) -> tuple[float, bool, bool]:
    """Best lag, whether other lags fit less, and whether it explains the steps markedly better than none."""
    span_s = float(steps.to_ns[-1] - steps.from_ns[0]) * 1e-9
    count = int(min(limits.search_s, SEARCH_SHARE * span_s) / LAG_STEP_S)
    lags = np.arange(-count, count + 1) * LAG_STEP_S
    column = 2 if kind == "yaw" else 0
    mine = steps.motion[:, column]
    mine = mine if other.is_signed else np.abs(mine)
    errors = np.full((len(lags), len(mine)), np.nan)
    for k, lag_s in enumerate(lags.tolist()):
        shift = round(lag_s * 1e9)
        theirs, is_known = other.steps(steps.from_ns - shift, steps.to_ns - shift)
        errors[k] = np.where(is_known, mine - theirs[:, column], np.nan)
    use = np.isfinite(errors).all(axis=0)
    if use.sum() < MIN_STEPS:
        return 0.0, False, False
    errors = errors[:, use] - np.median(errors[:, use], axis=1)[:, None]
    noise = max(1.5 * float(np.median(np.abs(errors), axis=1).min()), NOISE[kind])
    squares = np.minimum(errors**2, (4.0 * noise) ** 2) / noise**2  # bounded: steps matched at a wrong place
    cost = squares.sum(axis=1)
    best, zero = int(np.argmin(cost)), len(lags) // 2
    near = np.abs(lags - lags[best]) > limits.max_lag_s
    is_observable = bool(cost[near].min() > cost[best] + limits.sigmas**2) and 0 < best < len(lags) - 1
    halves = [lags[int(np.argmin(part.sum(axis=1)))] for part in np.array_split(squares, 2, axis=1)]
    is_marked = (
        cost[zero] > cost[best] + limits.sigmas**2
        and cost[zero] > limits.min_ratio * cost[best]
        and float(np.ptp(halves)) <= NEAR_S
    )
    return float(lags[best]), is_observable, bool(is_marked)


def check_stamps(name: str, stamps_ns: Float64) -> list[Finding]:
    """Stamps of scans in order of delivery."""
    back = np.diff(stamps_ns)
    if len(back) == 0 or (back > 0).all():
        return []
    numbers = {"scans": float(len(stamps_ns)), "backwards": float((back <= 0).sum())}
    text = f"lidar {name}: {numbers['backwards']:.0f} of {len(stamps_ns)} scans have a stamp not after the one before"
    out = [Finding("stamps_backwards", text, numbers, numbers["backwards"] > 0.1 * len(stamps_ns))]
    step_s = -float(back.min()) * 1e-9
    if step_s > MAX_STEP_BACK_S:
        text = f"lidar {name}: the clock was set back by {step_s:.1f} s in the log; cut it there"
        out.append(Finding("clock_set_back", text, {"step_s": step_s}, True))
    return out

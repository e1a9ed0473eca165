"""Stop requests grouped into stops, and their classification as true or false."""

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Any

from validation.obstacle_stop.observation import LogObservation, StopRequest

Cause = tuple[tuple[int, ...], bool | None] | None
MAX_PAUSE_NS = 600_000_000  # requests further apart are separate stops


@dataclass(frozen=True)
class Stop:
    """One interval of requested braking; `is_false` is None when truth does not decide it."""

    log: str
    t_s: float
    until_s: float
    reason: str
    label: str
    clearance_m: float | None
    objects: tuple[int, ...]
    is_stop: bool
    is_false: bool | None
    p_odom_m: tuple[float, float] | None

    @property
    def as_dict(self) -> dict[str, Any]:
        """Object of `--json`."""
        return {
            "log": self.log, "t_s": round(self.t_s, 3), "until_s": round(self.until_s, 3), "reason": self.reason,
            "class": self.label, "clearance_m": self.clearance_m, "objects": list(self.objects),
            "is_stop": self.is_stop,
            "is_false": self.is_false, "p_odom_m": self.p_odom_m,
        }  # fmt: skip


def find_stops(log: str, observed: LogObservation, has_truth: bool) -> list[Stop]:
    """All intervals of requested braking, one for each cause: the objects at the nearest triggering points, or none."""
    groups: list[list[StopRequest]] = []
    latest: dict[Cause, list[StopRequest]] = {}
    last: Cause = None
    for one in observed.requests:
        if not one.is_braking:
            continue
        is_known = has_truth and (one.cause or one.is_false is not None)
        last = (one.cause, one.is_false) if is_known else last  # one of unknown cause continues the last
        group = latest.get(last)
        if group is None or one.receive_ns - group[-1].receive_ns > MAX_PAUSE_NS:
            group = latest[last] = []
            groups.append(group)
        group.append(one)
    return [_stop(log, group, observed, has_truth) for group in groups]


def _stop(log: str, group: list[StopRequest], observed: LogObservation, has_truth: bool) -> Stop:
    """A stop is false when truth is complete at its cause and no true object is there."""
    worst = min(group, key=lambda a: a.clearance_m)
    is_stop = any(a.is_stop for a in group)
    is_false = group[0].is_false if has_truth else None
    at = next((one.hit_odom_m for one in group if one.hit_odom_m is not None), None)
    return Stop(
        log, observed.time_s(group[0].receive_ns), observed.time_s(group[-1].receive_ns), group[0].reason, worst.label,
        round(worst.clearance_m, 3) if math.isfinite(worst.clearance_m) else None, group[0].cause, is_stop,
        None if is_false is None else is_false and is_stop,
        None if at is None else (round(float(at[0]), 3), round(float(at[1]), 3)),
    )  # fmt: skip


def false_stop_scans(observed: LogObservation) -> int:
    """Number of scans during which a stop was requested that no true object explains."""
    scans = sorted(set(observed.scans))
    return len({bisect_right(scans, r.stamp_ns) for r in observed.requests if r.is_false and r.is_stop})

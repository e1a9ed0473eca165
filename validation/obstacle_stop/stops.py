"""Stop requests grouped into stops, and their classification as true or false."""

import math
from dataclasses import dataclass
from typing import Any

from validation.obstacle_stop.observation import LogObservation, StopRequest

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
    """All intervals of requested braking."""
    groups: list[list[StopRequest]] = []
    for one in observed.requests:
        if not one.is_braking:
            continue
        if groups and one.stamp_ns - groups[-1][-1].stamp_ns <= MAX_PAUSE_NS:
            groups[-1].append(one)
        else:
            groups.append([one])
    return [_stop(log, group, observed, has_truth) for group in groups]


def _stop(log: str, group: list[StopRequest], observed: LogObservation, has_truth: bool) -> Stop:
    """A stop is false when no true object was at its triggering points although truth was complete there."""
    objects = tuple(sorted({i for one in group for i in one.touched}))
    worst = min(group, key=lambda a: a.clearance_m)
    has_no_true_cause = any(one.has_no_true_cause and one.is_stop for one in group)
    is_false = (not objects and has_no_true_cause) if has_truth else None
    if has_truth and not objects and not any(one.has_no_true_cause for one in group):
        is_false = None
    at = next((one.hit_odom_m for one in group if one.hit_odom_m is not None), None)
    return Stop(
        log, observed.time_s(group[0].stamp_ns), observed.time_s(group[-1].stamp_ns), group[0].reason, worst.label,
        round(worst.clearance_m, 3) if math.isfinite(worst.clearance_m) else None, objects,
        any(a.is_stop for a in group), is_false,
        None if at is None else (round(float(at[0]), 3), round(float(at[1]), 3)),
    )  # fmt: skip

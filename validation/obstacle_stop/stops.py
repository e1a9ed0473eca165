"""Stops that were asked, grouped, and told true from false."""

import math
from dataclasses import dataclass
from typing import Any

from validation.obstacle_stop.observation import Asked, Observation

APART_NS = 600_000_000  # askings further apart are two


@dataclass(frozen=True)
class Stop:
    """One time of braking asked without a pause; `is_false` None: truth does not tell."""

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
        """Plain values."""
        return {
            "log": self.log, "t_s": round(self.t_s, 3), "until_s": round(self.until_s, 3), "reason": self.reason,
            "class": self.label, "clearance_m": self.clearance_m, "objects": list(self.objects),
            "is_stop": self.is_stop,
            "is_false": self.is_false, "p_odom_m": self.p_odom_m,
        }  # fmt: skip


def find_stops(log: str, seen: Observation, has_truth: bool) -> list[Stop]:
    """All times when braking was asked within the judged scans."""
    groups: list[list[Asked]] = []
    for one in seen.asked:
        if not one.is_braking:
            continue
        if groups and one.stamp_ns - groups[-1][-1].stamp_ns <= APART_NS:
            groups[-1].append(one)
        else:
            groups.append([one])
    return [_stop(log, group, seen, has_truth) for group in groups]


def _stop(log: str, group: list[Asked], seen: Observation, has_truth: bool) -> Stop:
    """False when no true object was ever at its causes, though truth was complete there at some time of the stop."""
    objects = tuple(sorted({i for one in group for i in one.touched}))
    worst = min(group, key=lambda a: a.clearance_m)
    is_lonely = any(one.lonely and one.is_stop for one in group)
    is_false = (not objects and is_lonely) if has_truth else None
    if has_truth and not objects and not any(one.lonely for one in group):
        is_false = None
    at = next((one.hit_odom_m for one in group if one.hit_odom_m is not None), None)
    return Stop(
        log, seen.time_s(group[0].stamp_ns), seen.time_s(group[-1].stamp_ns), group[0].reason, worst.label,
        round(worst.clearance_m, 3) if math.isfinite(worst.clearance_m) else None, objects,
        any(a.is_stop for a in group), is_false,
        None if at is None else (round(float(at[0]), 3), round(float(at[1]), 3)),
    )  # fmt: skip

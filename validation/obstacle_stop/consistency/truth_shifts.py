"""Shifts of the truth in place, yaw and time that are compared, and true boxes at any time."""

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.transforms import interpolate, invert
from messages.truth import TrueMachine, TrueObjects
from validation.obstacle_stop.boxes import Box, box_of
from validation.obstacle_stop.by_stamp import ByStamp, M
from validation.obstacle_stop.consistency.config import TruthLimits

KEEP_NS = 8_000_000_000
MAX_MACHINE_AGE_NS = 200_000_000
YAWS_DEG = (-4.0, -3.0, -2.0, -1.5, 1.5, 2.0, 3.0, 4.0)


@dataclass(frozen=True, eq=False)
class Shifts:
    """Displacements (S, 2) of all boxes in base, turns (Y,) about the sensor, one swap of left and right, and delays
    (D,) of the truth.

    Truth in map is displaced along the axes of map. The places from `first_wide` on are an even grid over the search
    range. A positive delay means that the truth is late: the boxes of a scan have later stamps. With poses of the
    machine in the truth a delay holds for both, and `has_objects_late` adds delays of the objects alone.
    """

    places_m: Float64
    first_wide: int
    yaws_rad: Float64
    delays_s: Float64
    has_objects_late: bool

    @classmethod
    def of(cls, limits: TruthLimits, has_machine: bool) -> "Shifts":
        """Coarse grid over the search range and a fine one near zero."""
        wide = np.arange(-limits.search_m, limits.search_m + 1e-9, limits.step_m)
        fine = np.arange(-1.5, 1.5 + 1e-9, 0.5 * limits.step_m)
        places = np.concatenate([np.stack(np.meshgrid(g, g), axis=-1).reshape(-1, 2) for g in (fine, wide)])
        count = round(limits.search_s / limits.step_s)
        delays = np.arange(-count, count + 1) * np.float64(limits.step_s)
        return cls(places, len(fine) ** 2, np.radians(YAWS_DEG), delays, has_machine)

    @property
    def zero(self) -> int:
        """Index of no displacement."""
        return int(np.argmin(np.abs(self.places_m).sum(axis=1)))

    def __len__(self) -> int:
        return len(self.places_m) + len(self.yaws_rad) + 1 + len(self.delays_s) * (1 + self.has_objects_late)

    def size_of(self, k: int) -> tuple[str, float, float]:
        """Kind of shift `k` (`place`, `yaw`, `mirror`, `time`, `objects_time`) and its values."""
        n, m, d = len(self.places_m), len(self.yaws_rad), len(self.delays_s)
        if k < n:
            return "place", float(self.places_m[k, 0]), float(self.places_m[k, 1])
        if k < n + m:
            return "yaw", math.degrees(self.yaws_rad[k - n]), 0.0
        if k == n + m:
            return "mirror", 1.0, 0.0
        return ("time" if k <= n + m + d else "objects_time"), float(self.delays_s[(k - n - m - 1) % d]), 0.0


class TrueBoxes:
    """Recent truth; `at` gives the boxes in base at a time, `is_complete_until` the time of the newest truth."""

    def __init__(self, truth_frame: str | None, T_base_lidar: dict[str, Float64], classes: set[str]) -> None:
        self._frame, self._mounts, self._classes = truth_frame, T_base_lidar, classes
        self._objects, self._machines = ByStamp[TrueObjects](), ByStamp[TrueMachine]()
        self._boxes: dict[int, dict[int, Box]] = {}  # of messages in the frame of a lidar, by stamp
        self.latest_ns = 0

    @property
    def has_machine(self) -> bool:
        """Whether the truth is in map, by poses of the machine."""
        return self._frame is not None and self._frame not in self._mounts

    def add(self, message: TrueObjects | TrueMachine) -> None:
        """Stores truth of the last 8 s."""
        if isinstance(message, TrueMachine):
            _append(self._machines, message)
        elif _append(self._objects, message):
            self.latest_ns = message.stamp_ns
            for stamp_ns in [ns for ns in self._boxes if ns < message.stamp_ns - KEEP_NS]:
                del self._boxes[stamp_ns]

    def at(self, machine_ns: int, objects_ns: int, max_age_ns: int) -> dict[int, Box]:
        """Boxes by id, of the nearest truth; empty without truth within `max_age_ns`."""
        truth, T = self._objects.nearest(objects_ns, max_age_ns), self._T_base_truth(machine_ns)
        if truth is None or T is None:
            return {}
        known = None if self.has_machine else self._boxes.get(truth.stamp_ns)
        if known is None:
            known = {one.id: box_of(one, T) for one in truth.objects if one.label.value in self._classes}
            if not self.has_machine:
                self._boxes[truth.stamp_ns] = known
        return known

    def is_known(self, stamp_ns: int, max_age_ns: int) -> bool:
        """Whether there is truth at a time; it arrives before the scans."""
        return self._objects.nearest(stamp_ns, max_age_ns) is not None

    def yaw_at(self, stamp_ns: int) -> float:
        """Yaw of map in base; 0 for truth in the frame of a lidar."""
        T = self._T_base_truth(stamp_ns) if self.has_machine else None
        return 0.0 if T is None else math.atan2(T[1, 0], T[0, 0])

    def _T_base_truth(self, stamp_ns: int) -> Float64 | None:
        if self._frame is None or self._frame in self._mounts:
            return None if self._frame is None else self._mounts[self._frame]
        stamps, machines = self._machines.stamps_ns, self._machines.messages
        if len(machines) < 2:
            return None
        k = min(max(bisect_left(stamps, stamp_ns), 1), len(machines) - 1)
        a, b = machines[k - 1], machines[k]
        if not a.stamp_ns - MAX_MACHINE_AGE_NS <= stamp_ns <= b.stamp_ns + MAX_MACHINE_AGE_NS:
            return None
        return invert(interpolate(a.T_map_base, b.T_map_base, (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)))


def _append(queue: ByStamp[M], message: M) -> bool:
    """Adds a message of a later stamp than all others, and drops those older than `KEEP_NS`."""
    if queue.stamps_ns and message.stamp_ns <= queue.stamps_ns[-1]:
        return False
    queue.add(message)
    queue.take_before(message.stamp_ns - KEEP_NS)
    return True

"""Motion window: IMU, wheels and fixes of the last seconds, divided at the fixes, for a start in motion."""

from collections import deque
from dataclasses import dataclass

import gtsam
import numpy as np

from geometry.arrays import Float64
from localization.dead_reckoning.imu_track import ImuTrack
from localization.dead_reckoning.wheel_track import WheelTrack, displacement_columns
from localization.gnss_gate import Position
from localization.graph.imu_preintegration import preintegrate, vibration_density


@dataclass(frozen=True)
class Interval:
    """Interval between two keyframes that ends at `stamp_ns`.

    `turn_rad` is the integral of the yaw rate; `columns` (3, 4) the displacement per slip parameter, None without
    wheels; `rate_radps` (3,) the mean turn rate; `fix` the one at its end.
    """

    stamp_ns: int
    dt_s: float
    preintegrated: gtsam.PreintegratedCombinedMeasurements
    turn_rad: float
    rate_radps: Float64
    columns: Float64 | None
    is_standstill: bool
    fix: Position | None


class MotionWindow:
    """Intervals of at most `longest_s` since a first fix; fixes are at least `spacing_s` apart."""

    def __init__(
        self, parameters: gtsam.PreintegrationCombinedParams, accelerometer_density: float, standstill_mps: float,
        spacing_s: float, longest_s: float, keyframes: int,
    ) -> None:  # fmt: skip
        self._parameters, self._density, self._standstill_mps = parameters, accelerometer_density, standstill_mps
        self._spacing_ns, self._longest_ns = round(spacing_s * 1e9), round(longest_s * 1e9)
        self._queue: deque[Position] = deque()
        self.first: Position | None = None
        self.intervals: deque[Interval] = deque(maxlen=keyframes)

    def clear(self) -> None:
        """Drops everything: after a gap or clock jump, and after a start."""
        self._queue.clear()
        self.first = None
        self.intervals.clear()

    @property
    def fixes(self) -> list[Position]:
        """Fixes in the window, the first one included."""
        return [f for f in (self.first, *(i.fix for i in self.intervals)) if f is not None]

    @property
    def last_ns(self) -> int:
        """End of the newest interval."""
        assert self.first is not None, "a fix comes first"
        return self.intervals[-1].stamp_ns if self.intervals else self.first.stamp_ns

    def add(self, fix: Position) -> None:
        """Queues a fix until IMU samples reach its stamp; one of another type of solution begins a new window."""
        newest = self._queue[-1] if self._queue else next(iter(reversed(self.fixes)), None)
        if newest is not None and fix.solution is not newest.solution:
            self.clear()
        elif newest is not None and fix.stamp_ns - newest.stamp_ns < self._spacing_ns:
            return
        self._queue.append(fix)

    def advance(self, track: ImuTrack, wheels: WheelTrack | None) -> bool:
        """Adds the intervals that the samples received so far allow; whether one with a fix was added."""
        has_new, wait_ns = False, self._longest_ns // 2
        while self._queue and self._queue[0].stamp_ns <= track.last_ns:
            fix = self._queue.popleft()
            if self.first is None or fix.stamp_ns <= self.last_ns:
                is_covered = track.first_ns <= fix.stamp_ns
                self.first = fix if self.first is None and is_covered else self.first
                continue
            self._fill(fix.stamp_ns - wait_ns, track, wheels)
            self._append(fix.stamp_ns, fix, track, wheels)
            has_new = True
        if self.first is not None:
            self._fill(track.last_ns - wait_ns, track, wheels)
        return has_new

    def _fill(self, until_ns: int, track: ImuTrack, wheels: WheelTrack | None) -> None:
        while until_ns - self.last_ns >= self._longest_ns:
            self._append(self.last_ns + self._longest_ns, None, track, wheels)

    def _append(self, stamp_ns: int, fix: Position | None, track: ImuTrack, wheels: WheelTrack | None) -> None:
        begin_ns = self.last_ns
        steps = track.between(begin_ns, stamp_ns)
        columns, is_standstill, dt_s = None, False, (stamp_ns - begin_ns) * 1e-9
        if wheels is not None and len(wheels):
            speed_mps = wheels.speed_at(steps.middle_ns, begin_ns)
            columns = displacement_columns(steps, speed_mps, np.zeros(3))
            is_standstill = float(np.max(np.abs(speed_mps))) < self._standstill_mps
        density = max(self._density, vibration_density(steps))
        preintegrated = preintegrate(self._parameters, np.zeros(6), steps, density)
        turned = (steps.rate_radps * steps.dt_s[:, None]).sum(axis=0)
        interval = Interval(
            stamp_ns, dt_s, preintegrated, float(turned[2]), turned / dt_s, columns, is_standstill, fix
        )  # fmt: skip
        if len(self.intervals) == self.intervals.maxlen:
            self._drop_oldest()
        self.intervals.append(interval)

    def _drop_oldest(self) -> None:
        """Begins the window at its next fix."""
        while self.intervals:
            dropped = self.intervals.popleft()
            if dropped.fix is not None:
                self.first = dropped.fix
                return
        self.first = None

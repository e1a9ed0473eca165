"""Motion by time from one source: odometry, wheel, GNSS speed or IMU."""

import math
from array import array
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Bool, Float64, Int64
from messages.motion import Odometry

MIN_STEP_NS = 15_000_000  # denser samples are skipped
MAX_GAP_NS = 500_000_000  # longer gaps are not interpolated


@dataclass
class MotionSeries:
    """Poses in a frame of the source: x, y, yaw; without positions, x is the distance by the speed.

    `has_yaw` and `is_signed` (False: speed without direction of travel) tell what the source measures; `distance_m` is
    the integral of the speed field, to compare with the positions. Memory: 5 numbers per sample.
    """

    name: str
    has_speed: bool = True
    has_yaw: bool = True
    is_signed: bool = True
    has_positions: bool = True
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    values: "array[float]" = field(default_factory=lambda: array("d"))

    def add_odometry(self, odom: Odometry) -> None:
        """Appends a message of odometry."""
        self.add_pose(odom.stamp_ns, odom.T_odom_base, odom.speed_mps)

    def add_pose(self, stamp_ns: int, T: Float64, speed_mps: float = math.nan) -> None:
        """Appends a pose (4, 4) and a speed."""
        yaw = math.atan2(T[1, 0], T[0, 0])
        if self._is_next(stamp_ns) and np.isfinite(T).all():
            before, distance = self._last()[2:4]
            yaw = before + math.remainder(yaw - before, 2.0 * math.pi)
            self._append(stamp_ns, float(T[0, 3]), float(T[1, 3]), yaw, distance, speed_mps)

    def add_speed(self, stamp_ns: int, speed_mps: float) -> None:
        """Appends a speed."""
        if self._is_next(stamp_ns) and math.isfinite(speed_mps):
            distance = self._last()[0] + self._dt(stamp_ns) * 0.5 * (speed_mps + self._last()[4])
            self._append(stamp_ns, distance, 0.0, 0.0, distance, speed_mps)

    def add_turn(self, stamp_ns: int, turn_radps: float) -> None:
        """Appends a yaw rate."""
        if self._is_next(stamp_ns) and math.isfinite(turn_radps):
            yaw = self._last()[2] + self._dt(stamp_ns) * 0.5 * (turn_radps + self._last()[4])
            self._append(stamp_ns, 0.0, 0.0, yaw, 0.0, turn_radps)

    def _is_next(self, stamp_ns: int) -> bool:
        return not self.stamps or stamp_ns >= self.stamps[-1] + MIN_STEP_NS

    def _dt(self, stamp_ns: int) -> float:
        return (stamp_ns - self.stamps[-1]) * 1e-9 if self.stamps else 0.0

    def _last(self) -> tuple[float, float, float, float, float]:
        last = self.values[-5:]
        return (last[0], last[1], last[2], last[3], last[4]) if last else (0.0, 0.0, 0.0, 0.0, 0.0)

    def _append(self, stamp_ns: int, x: float, y: float, yaw: float, distance: float, rate: float) -> None:
        if self.has_positions:
            before = self._last()[4] if self.stamps else rate
            distance += self._dt(stamp_ns) * 0.5 * (rate + before) if math.isfinite(rate + before) else math.nan
        self.stamps.append(stamp_ns)
        self.values.extend((x, y, yaw, distance, rate))

    def rates_at(self, stamp_ns: int) -> tuple[float, float]:
        """Speed and yaw rate of the newest interval before a time; zero without one."""
        if len(self.stamps) < 2 or not self.has_positions:
            return 0.0, 0.0
        k = max(len(self.stamps) - 8, 0)
        dt = (self.stamps[-1] - self.stamps[k]) * 1e-9
        turn = (self.values[-3] - self.values[5 * k + 2]) / dt
        speed = self.values[-1]
        return (speed if math.isfinite(speed) else 0.0), turn

    def pose_at(self, stamp_ns: int) -> Float64 | None:
        """Pose (3,) at a recent time, up to 0.2 s after the newest sample; None outside."""
        n = len(self.stamps)
        k = n - 1
        while k > 0 and self.stamps[k] > stamp_ns:
            k -= 1
        if n < 2 or self.stamps[k] > stamp_ns or stamp_ns - self.stamps[k] > MAX_GAP_NS:
            return None
        k = min(k, n - 2)
        share = (stamp_ns - self.stamps[k]) / (self.stamps[k + 1] - self.stamps[k])
        a, b = (np.array(self.values[5 * j : 5 * j + 3]) for j in (k, k + 1))
        return np.asarray(a + share * (b - a)) if share < 15.0 else None

    def moving_span(self) -> tuple[int, int] | None:
        """First and last time of motion above 0.3 m/s, by positions once a second; None at standstill."""
        stamps, rows = self.columns()
        if len(stamps) < 2:
            return None
        grid = np.append(np.arange(stamps[0], stamps[-1], 1_000_000_000), stamps[-1])
        d = np.hypot(*(np.diff(np.interp(grid, stamps, rows[:, c])) for c in (0, 1)))
        is_moving = np.flatnonzero(d > 0.3 * np.diff(grid) * 1e-9)
        return (int(grid[is_moving[0]]), int(grid[is_moving[-1] + 1])) if len(is_moving) else None

    def columns(self) -> tuple[Int64, Float64]:
        """Stamps (N,) and rows (N, 5): x, y, yaw, distance by speed, rate; views, so that nothing may be added."""
        if not self.stamps:
            return np.zeros(0, np.int64), np.zeros((0, 5))
        return np.frombuffer(self.stamps, np.int64), np.frombuffer(self.values, np.float64).reshape(-1, 5)

    def steps(self, from_ns: Int64, to_ns: Int64) -> tuple[Float64, Bool]:
        """Forward, left and yaw steps (K, 3), in the mean heading, between times, and where they are known."""
        stamps, rows = self.columns()
        if len(stamps) < 2:
            return np.zeros((len(from_ns), 3)), np.zeros(len(from_ns), bool)
        a, b = (np.stack([np.interp(t, stamps, rows[:, c]) for c in range(3)], axis=1) for t in (from_ns, to_ns))
        middle = 0.5 * (a[:, 2] + b[:, 2])
        d, c, s = b - a, np.cos(middle), np.sin(middle)
        out = np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]], axis=1)
        return out, self._covers(stamps, from_ns) & self._covers(stamps, to_ns)

    @staticmethod
    def _covers(stamps: Int64, at_ns: Int64) -> Bool:
        k = np.clip(np.searchsorted(stamps, at_ns), 1, len(stamps) - 1)
        is_inside = (at_ns >= stamps[0]) & (at_ns <= stamps[-1])
        return np.asarray(is_inside & (stamps[k] - stamps[k - 1] <= MAX_GAP_NS))

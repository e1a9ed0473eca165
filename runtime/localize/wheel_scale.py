"""Speed of the wheels against that of the fixes over a whole drive: wrong units, radius or gear show as a ratio."""

import math
from array import array
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64
from localization.gnss_gate import Position

PART_M, SIGMAS, LONGEST_S = 10.0, 5.0, 60.0  # of a part: displacement, the same in sigmas of a fix, duration
LEAST_PARTS = 5
LOWEST, HIGHEST = 0.8, 1.25  # ratios that slip and a worn tyre explain
MAX_STEP_S = 2.0  # between samples, and between fixes whose velocity is integrated
UNITS = {3.6: "km/h", 2.237: "mph", 1.944: "knots", 3.281: "ft/s"}  # per m/s


@dataclass
class WheelScale:
    """Displacements by wheels and gyro, and by fixes (Doppler velocity where there is one), over parts of the drive.

    `up` (3,) is the vertical of base in axes of the IMU, `arm_m` the horizontal distance of the antenna from base.
    """

    up: Float64
    arm_m: float
    _speed_mps: float = 0.0
    _yaw_rad: float = 0.0
    _by_wheels_m: complex = 0j
    _stamps: "array[int]" = field(default_factory=lambda: array("q"))
    _path_m: "array[float]" = field(default_factory=lambda: array("d"))
    _fixes: "array[float]" = field(default_factory=lambda: array("d"))
    _fix_stamps: "array[int]" = field(default_factory=lambda: array("q"))

    def add_speed(self, speed_mps: float) -> None:
        """Takes a speed of the wheels."""
        self._speed_mps = speed_mps if math.isfinite(speed_mps) else self._speed_mps

    def add_rates(self, stamp_ns: int, rate_radps: Float64) -> None:
        """Takes a sample of the gyro (3,); one that is not newer, or not finite, is left out."""
        dt_s = (stamp_ns - self._stamps[-1]) * 1e-9 if self._stamps else 0.0
        turn = float(self.up @ rate_radps)
        if (self._stamps and dt_s <= 0.0) or not math.isfinite(turn):
            return
        if dt_s <= MAX_STEP_S:
            middle_rad = self._yaw_rad + 0.5 * turn * dt_s
            self._yaw_rad += turn * dt_s
            self._by_wheels_m += self._speed_mps * dt_s * complex(math.cos(middle_rad), math.sin(middle_rad))
        self._stamps.append(stamp_ns)
        self._path_m.extend((self._by_wheels_m.real, self._by_wheels_m.imag))

    def add_fix(self, fix: Position) -> None:
        """Takes a fix; one that is not newer is left out."""
        if self._fix_stamps and fix.stamp_ns <= self._fix_stamps[-1]:
            return
        self._fix_stamps.append(fix.stamp_ns)
        self._fixes.extend((*fix.p_map_m[:2], *fix.velocity_mps[:2], float(np.max(fix.total_m[:2]))))

    @property
    def ratios(self) -> Float64:
        """Displacement by the wheels over that by the fixes, (N,) parts of the drive."""
        if len(self._stamps) < 2 or len(self._fix_stamps) < 2:
            return np.zeros(0)
        stamps_ns, rows = np.array(self._fix_stamps), np.array(self._fixes).reshape(-1, 5)
        origin_ns, path_m = self._stamps[0], np.array(self._path_m).reshape(-1, 2)
        t_s, imu_s = (stamps_ns - origin_ns) * 1e-9, (np.array(self._stamps) - origin_ns) * 1e-9
        wheels_m = np.column_stack([np.interp(t_s, imu_s, path_m[:, k]) for k in (0, 1)])
        fixes_m, sigma_m = _integrated(t_s, rows)
        is_within = (t_s >= imu_s[0]) & (t_s <= imu_s[-1])
        found, first = [], 0
        for k in range(len(t_s)):
            if not (is_within[k] and is_within[first]) or t_s[k] - t_s[first] > LONGEST_S:
                first = k
                continue
            moved_m = float(np.hypot(*(fixes_m[k] - fixes_m[first])))
            if moved_m >= max(PART_M, SIGMAS * self.arm_m, SIGMAS * sigma_m[k]):
                found.append(float(np.hypot(*(wheels_m[k] - wheels_m[first]))) / moved_m)
                first = k
        return np.array(found)

    def finding(self) -> str:
        """What is wrong with the wheels, when most parts of the drive agree on it; else ""."""
        ratios = self.ratios
        if len(ratios) < LEAST_PARTS:
            return ""
        low, median, high = np.percentile(ratios, (25, 50, 75)).tolist()
        if low <= HIGHEST and high >= LOWEST:
            return ""
        near = [unit for factor, unit in UNITS.items() if abs(median / factor - 1.0) < 0.1]
        cause = f"{near[0]}?" if near else "radius, gear or units?"
        return f"the wheels say {median:.2f} times the speed of the fixes: {cause}"


def _integrated(t_s: Float64, rows: Float64) -> tuple[Float64, Float64]:
    """Positions (N, 2) by fixes, or by the integral of their velocity where it is known, and their sigmas (N,)."""
    p_m, v_mps, sigma_m = rows[:, :2], rows[:, 2:4], rows[:, 4].copy()
    dt_s = np.diff(t_s)
    by_velocity_m = 0.5 * (v_mps[1:] + v_mps[:-1]) * dt_s[:, None]
    is_known = np.isfinite(by_velocity_m).all(axis=1) & (dt_s <= MAX_STEP_S)
    steps_m = np.where(is_known[:, None], by_velocity_m, np.diff(p_m, axis=0))
    sigma_m[1:][is_known] = 0.0
    return np.vstack([np.zeros((1, 2)), np.cumsum(steps_m, axis=0)]), sigma_m

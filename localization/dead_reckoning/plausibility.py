"""Plausibility of IMU and wheels: the IMU by itself, and both against each other.

A contradiction between two sensors is resolved by GNSS as reference, where available:

    turn:  gyro           against  speed x curvature of the steered wheels   reference: heading of the two antennas
    speed: accelerometer  against  wheel speed corrected for slip            reference: speed over ground
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from localization.dead_reckoning.imu_track import STANDARD_GRAVITY_MPS2

MEAN_SIGMAS = 4.0  # of the noise of samples in their mean
STRAIGHT = 1e-6  # m/s² and rad/s; largest second difference of values on a straight line, by rounding
CODES = ("imu.frozen", "imu.noisy", "imu.implausible", "wheel.implausible", "imu_or_wheel.implausible")


class CrossCheckConfig(Config):
    """Limit of the difference over the window: floor + per_change x smaller change + per_m x path length + per_noise
    x noise of the IMU, of acceleration (m/s2) or rate (rad/s)."""

    floor: float = Field(gt=0.0, le=10.0)
    per_change: float = Field(ge=0.0, le=1.0)
    per_m: float = Field(ge=0.0, le=1.0)
    per_noise: float = Field(ge=0.0, le=1.0)


class PlausibilityConfig(Config):
    """Limits that working sensors never exceed."""

    frozen_samples: int = Field(ge=2, le=100, description="equal or interpolated samples in a row; noise is neither")
    samples: int = Field(ge=5, le=200, description="for noise")
    gravity_samples: int = Field(ge=5, le=500, description="for gravity; a bump changes its mean by speed over time")
    max_noise_mps2: float = Field(gt=0.0, le=50.0, description="sigma between samples, per axis")
    max_noise_radps: float = Field(gt=0.0, le=10.0)
    max_gravity_error_mps2: float = Field(gt=0.0, le=10.0, description="mean specific force against gravity")
    window_s: float = Field(gt=0.1, le=10.0)
    debounce_s: float = Field(ge=0.0, le=2.0, description="duration of a contradiction; a fix comes in that time")
    recovery_s: float = Field(gt=0.0, le=60.0, description="without suspicion, to end the fault")
    turn: CrossCheckConfig
    speed: CrossCheckConfig


@dataclass(frozen=True)
class Suspicion:
    """Suspected fault: one of `CODES`, and its measured value."""

    code: str
    detail: str


class ImuCheck:
    """Checks the IMU by itself: noise within limits, mean specific force near gravity."""

    def __init__(self, config: PlausibilityConfig) -> None:
        self._config = config
        self._values: deque[Float64] = deque(maxlen=max(config.samples, config.gravity_samples))
        self._straight_count, self._straight_ns = 1, 0  # newest samples on a straight line, and the begin of that
        self._unmeasured_s = 0.0
        self.noise = (0.0, 0.0)

    def clear(self) -> None:
        """Drops all samples."""
        self._values.clear()
        self._straight_count, self._unmeasured_s = 1, 0.0

    def add(self, stamp_ns: int, value: Float64) -> None:
        """Takes specific force, then rate, (6,)."""
        is_straight = len(self._values) > 1 and bool(
            (np.abs(value - 2.0 * self._values[-1] + self._values[-2]) <= STRAIGHT).all()
        )
        self._values.append(value)
        if is_straight:
            self._straight_count = max(2, self._straight_count) + 1
            return
        if self._straight_count >= self._config.frozen_samples:
            self._unmeasured_s += (stamp_ns - self._straight_ns) * 1e-9
        self._straight_count, self._straight_ns = 1, stamp_ns

    def take_unmeasured_s(self) -> float:
        """Duration of equal or interpolated samples that have ended since the last call."""
        duration_s, self._unmeasured_s = self._unmeasured_s, 0.0
        return duration_s

    def suspicion(self) -> Suspicion | None:
        """The present suspicion against the IMU."""
        cfg = self._config
        if self._straight_count >= cfg.frozen_samples:
            return Suspicion("imu.frozen", f"{self._straight_count} equal or interpolated samples")
        if len(self._values) < cfg.samples:
            return None
        values = np.array(self._values)
        steps = np.diff(values[-cfg.samples :], axis=0)
        specific, rate = np.sqrt(0.5 * np.mean(steps.reshape(-1, 2, 3) ** 2, axis=(0, 2))).tolist()
        self.noise = (specific, rate)
        if not (specific <= cfg.max_noise_mps2 and rate <= cfg.max_noise_radps):
            return Suspicion("imu.noisy", f"{specific:.1f} m/s², {rate:.2f} rad/s")
        of_mean_mps2 = MEAN_SIGMAS * specific / math.sqrt(cfg.gravity_samples)
        gravity = math.hypot(*values[-cfg.gravity_samples :, :3].mean(axis=0).tolist())
        is_known = len(values) >= cfg.gravity_samples
        if is_known and not abs(gravity - STANDARD_GRAVITY_MPS2) <= cfg.max_gravity_error_mps2 + of_mean_mps2:
            return Suspicion("imu.implausible", f"gravity of {gravity:.1f} m/s²")
        return None


class Suspect(Enum):
    """Sensor at fault of two that contradict each other."""

    FIRST = "imu.implausible"
    SECOND = "wheel.implausible"
    EITHER = "imu_or_wheel.implausible"


class CrossCheck:
    """Compares the changes of two measurements over a sliding window; a reference identifies the wrong one."""

    def __init__(self, config: CrossCheckConfig, window_s: float, debounce_s: float) -> None:
        self._config, self._debounce_ns, self._window_ns = config, round(debounce_s * 1e9), round(window_s * 1e9)
        self._stamps: deque[int] = deque()
        self._rows: deque[tuple[float, float, float]] = deque()
        self._references: deque[tuple[int, float]] = deque()
        self._since_ns: int | None = None
        self._noise = 0.0

    def clear(self) -> None:
        """Drops all samples."""
        self._stamps.clear()
        self._rows.clear()
        self._references.clear()
        self._since_ns = None

    def add(self, stamp_ns: int, first: float, second: float, path_m: float, noise: float) -> None:
        """Takes both measurements, the path length so far and the noise of the first; stamps increase."""
        self._noise = noise
        self._stamps.append(stamp_ns)
        self._rows.append((first, second, path_m))
        while stamp_ns - self._stamps[0] > self._window_ns:
            self._stamps.popleft()
            self._rows.popleft()
        while self._references and self._references[0][0] < self._stamps[0]:
            self._references.popleft()
        error, limit = self.margin()
        if error <= limit:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = stamp_ns

    def set_reference(self, stamp_ns: int, reference: float) -> None:
        """Takes a reference measurement."""
        self._references.append((stamp_ns, reference))

    def margin(self) -> tuple[float, float]:
        """Difference of the two over the window, and its limit."""
        (a, b, path), (a0, b0, path0) = self._rows[-1], self._rows[0]
        change = min(abs(a - a0), abs(b - b0))
        cfg = self._config
        limit = cfg.floor + cfg.per_change * change + cfg.per_m * (path - path0) + cfg.per_noise * self._noise
        return abs((a - a0) - (b - b0)), limit

    @property
    def contradiction(self) -> float:
        """Difference of the two over the window where it is above its limit, else zero."""
        error, limit = self.margin() if self._rows else (0.0, 0.0)
        return error if error > limit else 0.0

    def suspect(self) -> Suspect | None:
        """Sensor at fault, once the contradiction has lasted for the debounce time."""
        if self._since_ns is None or self._stamps[-1] - self._since_ns < self._debounce_ns:
            return None
        known = [reference for reference in self._references if reference[0] <= self._stamps[-1]]
        if not known or 2 * (known[-1][0] - known[0][0]) < self._window_ns:
            return Suspect.EITHER
        first, second = (abs(self._change(k, known[0][0], known[-1][0]) - known[-1][1] + known[0][1]) for k in (0, 1))
        if max(first, second) < 2.0 * min(first, second):
            return Suspect.EITHER
        return Suspect.FIRST if first > second else Suspect.SECOND

    def _change(self, column: int, start_ns: int, end_ns: int) -> float:
        stamps = np.array(self._stamps, np.int64) - start_ns
        start, end = np.interp([0.0, float(end_ns - start_ns)], stamps, [row[column] for row in self._rows])
        return float(end - start)


class Plausibility:
    """All checks; the first suspicion is held until there has been none for the recovery time."""

    def __init__(self, config: PlausibilityConfig) -> None:
        self._config = config
        self.imu = ImuCheck(config)
        self.turn, self.speed = (CrossCheck(c, config.window_s, config.debounce_s) for c in (config.turn, config.speed))
        self._gyro_rad = self._steering_rad = self._heading_rad = self._accelerated_mps = self._path_m = 0.0
        self._suspicion: Suspicion | None = None
        self._suspected_ns = 0

    def clear(self) -> None:
        """Drops all samples, but holds the suspicion."""
        for part in (self.imu, self.turn, self.speed):
            part.clear()

    def advance(self, stamp_ns: int, dt_s: float, imu: tuple[float, float], wheels: tuple[float, float]) -> None:
        """Adds an interval that ends at a stamp.

        `imu` is turn rate and forward acceleration without gravity, `wheels` speed over ground and curvature.
        """
        (rate_radps, acceleration_mps2), (speed_mps, curvature_radpm) = imu, wheels
        self._gyro_rad += dt_s * rate_radps
        self._steering_rad += dt_s * speed_mps * curvature_radpm
        self._accelerated_mps += dt_s * acceleration_mps2
        self._path_m += dt_s * abs(speed_mps)
        specific, rate = self.imu.noise
        self.turn.add(stamp_ns, self._gyro_rad, self._steering_rad, self._path_m, rate)
        self.speed.add(stamp_ns, self._accelerated_mps, speed_mps, self._path_m, specific)

    def set_reference(self, stamp_ns: int, heading_rad: float, speed_mps: float) -> None:
        """Takes heading and signed speed by GNSS; NaN: not measured."""
        if math.isfinite(heading_rad):
            self._heading_rad += wrap(heading_rad - self._heading_rad)
            self.turn.set_reference(stamp_ns, self._heading_rad)
        if math.isfinite(speed_mps):
            self.speed.set_reference(stamp_ns, speed_mps)

    def evaluate(self, now_ns: int) -> Suspicion | None:
        """The present suspicion."""
        suspicion = self.imu.suspicion() or self._contradiction()
        if suspicion is not None:
            self._suspicion, self._suspected_ns = self._suspicion or suspicion, now_ns
        elif not 0 <= now_ns - self._suspected_ns <= self._config.recovery_s * 1e9:
            self._suspicion = None
        return self._suspicion

    def _contradiction(self) -> Suspicion | None:
        for cross_check, quantity, unit in ((self.turn, "turn", "rad"), (self.speed, "change of speed", "m/s")):
            suspect = cross_check.suspect()
            if suspect is not None:
                return Suspicion(suspect.value, f"{quantity} differs by {cross_check.margin()[0]:.2f} {unit}")
        return None

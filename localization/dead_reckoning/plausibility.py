"""Whether inertial unit and wheels can be believed: the unit by itself, and both against each other.

Two that contradict each other do not say which of them is wrong: GNSS, where it is heard, is the third.

    turn:  gyro           against  speed x curvature of the steered wheels   third: heading of the two antennas
    speed: accelerometer  against  speed of the wheels, rid of their slip    third: speed over ground
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.transforms import Float64
from localization.dead_reckoning.imu_track import STANDARD_GRAVITY_MPS2

CODES = ("imu.frozen", "imu.noisy", "imu.implausible", "wheel.implausible", "imu_or_wheel.implausible")


class AgreementConfig(Config):
    """How far two may differ over the window: a floor, a share of the smaller change, and a part of the way."""

    floor: float = Field(gt=0.0, le=10.0)
    per_change: float = Field(ge=0.0, le=1.0)
    per_m: float = Field(ge=0.0, le=1.0)


class PlausibilityConfig(Config):
    """What sound devices never exceed."""

    frozen_samples: int = Field(ge=2, le=100, description="so many equal samples in a row: noise never repeats itself")
    samples: int = Field(ge=5, le=200, description="that shake and weight are taken from")
    largest_shake_mps2: float = Field(gt=0.0, le=50.0, description="sigma from sample to sample, of an axis")
    largest_shake_radps: float = Field(gt=0.0, le=10.0)
    largest_weight_error_mps2: float = Field(gt=0.0, le=10.0, description="of the mean specific force against gravity")
    window_s: float = Field(gt=0.1, le=10.0)
    held_s: float = Field(ge=0.0, le=2.0, description="a contradiction lasts so long, and a fix comes in that time")
    heal_s: float = Field(gt=0.0, le=60.0, description="without any doubt, for a device to be believed again")
    turn: AgreementConfig
    speed: AgreementConfig


@dataclass(frozen=True)
class Doubt:
    """What is not believed: one of `CODES`, and why."""

    code: str
    detail: str


class InertialCheck:
    """The unit by itself: it must be noisy, but not too much, and feel its weight."""

    def __init__(self, config: PlausibilityConfig) -> None:
        self._config = config
        self._values: deque[Float64] = deque(maxlen=config.samples)
        self._equal = 1

    def clear(self) -> None:
        """Forgets everything."""
        self._values.clear()
        self._equal = 1

    def add(self, value: Float64) -> None:
        """Takes specific force, then rate, (6,)."""
        is_same = bool(self._values) and bool((value == self._values[-1]).all())
        self._equal = self._equal + 1 if is_same else 1
        self._values.append(value)

    def doubt(self) -> Doubt | None:
        """What speaks against the unit now."""
        cfg = self._config
        if self._equal >= cfg.frozen_samples:
            return Doubt("imu.frozen", f"{self._equal} equal samples")
        if len(self._values) < cfg.samples:
            return None
        values = np.array(self._values)
        shake = np.sqrt(0.5 * np.mean(np.diff(values, axis=0).reshape(-1, 2, 3) ** 2, axis=(0, 2)))
        if not (shake[0] <= cfg.largest_shake_mps2 and shake[1] <= cfg.largest_shake_radps):
            return Doubt("imu.noisy", f"{shake[0]:.1f} m/s², {shake[1]:.2f} rad/s")
        weight = math.hypot(*values[:, :3].mean(axis=0).tolist())
        if not abs(weight - STANDARD_GRAVITY_MPS2) <= cfg.largest_weight_error_mps2:
            return Doubt("imu.implausible", f"weight of {weight:.1f} m/s²")
        return None


class Blame(Enum):
    """Which of two that contradict each other is wrong."""

    FIRST = "imu.implausible"
    SECOND = "wheel.implausible"
    EITHER = "imu_or_wheel.implausible"


class Agreement:
    """Two measures of one quantity, whose changes over a sliding window must agree; a third tells which is wrong."""

    def __init__(self, config: AgreementConfig, window_s: float, held_s: float) -> None:
        self._config, self._held_ns, self._window_ns = config, round(held_s * 1e9), round(window_s * 1e9)
        self._stamps: deque[int] = deque()
        self._rows: deque[tuple[float, float, float]] = deque()
        self._thirds: deque[tuple[int, float]] = deque()
        self._since_ns: int | None = None

    def clear(self) -> None:
        """Forgets everything."""
        self._stamps.clear()
        self._rows.clear()
        self._thirds.clear()
        self._since_ns = None

    def add(self, stamp_ns: int, first: float, second: float, way_m: float) -> None:
        """Takes both measures, and the way driven so far, at a time later than all before."""
        self._stamps.append(stamp_ns)
        self._rows.append((first, second, way_m))
        while stamp_ns - self._stamps[0] > self._window_ns:
            self._stamps.popleft()
            self._rows.popleft()
        while self._thirds and self._thirds[0][0] < self._stamps[0]:
            self._thirds.popleft()
        error, limit = self.margin()
        if error <= limit:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = stamp_ns

    def refer(self, stamp_ns: int, third: float) -> None:
        """Takes the third measure at a time."""
        self._thirds.append((stamp_ns, third))

    def margin(self) -> tuple[float, float]:
        """By how much the two differ over the window, and how much they may."""
        (a, b, way), (a0, b0, way0) = self._rows[-1], self._rows[0]
        change = min(abs(a - a0), abs(b - b0))
        cfg = self._config
        return abs((a - a0) - (b - b0)), cfg.floor + cfg.per_change * change + cfg.per_m * (way - way0)

    def blame(self) -> Blame | None:
        """Which is wrong, once they have contradicted each other for long enough."""
        if self._since_ns is None or self._stamps[-1] - self._since_ns < self._held_ns:
            return None
        known = [third for third in self._thirds if third[0] <= self._stamps[-1]]
        if not known or 2 * (known[-1][0] - known[0][0]) < self._window_ns:
            return Blame.EITHER
        first, second = (abs(self._change(k, known[0][0], known[-1][0]) - known[-1][1] + known[0][1]) for k in (0, 1))
        if max(first, second) < 2.0 * min(first, second):
            return Blame.EITHER
        return Blame.FIRST if first > second else Blame.SECOND

    def _change(self, column: int, start_ns: int, end_ns: int) -> float:
        stamps = np.array(self._stamps, np.int64) - start_ns
        start, end = np.interp([0.0, float(end_ns - start_ns)], stamps, [row[column] for row in self._rows])
        return float(end - start)


class Plausibility:
    """All of it; the first doubt stays until there has been none for some time."""

    def __init__(self, config: PlausibilityConfig) -> None:
        self._config = config
        self.inertial = InertialCheck(config)
        self.turn, self.speed = (Agreement(c, config.window_s, config.held_s) for c in (config.turn, config.speed))
        self._turned_rad = self._steered_rad = self._heading_rad = self._gained_mps = self._way_m = 0.0
        self._doubt: Doubt | None = None
        self._doubted_ns = 0

    def clear(self) -> None:
        """Forgets what was measured, but not what is doubted."""
        for part in (self.inertial, self.turn, self.speed):
            part.clear()

    def advance(self, stamp_ns: int, dt_s: float, unit: tuple[float, float], wheels: tuple[float, float]) -> None:
        """Goes on by a stretch of time that ends at a stamp.

        `unit` is turn rate and forward acceleration without gravity, `wheels` speed over ground and curvature.
        """
        (rate_radps, acceleration_mps2), (speed_mps, curvature_radpm) = unit, wheels
        self._turned_rad += dt_s * rate_radps
        self._steered_rad += dt_s * speed_mps * curvature_radpm
        self._gained_mps += dt_s * acceleration_mps2
        self._way_m += dt_s * abs(speed_mps)
        self.turn.add(stamp_ns, self._turned_rad, self._steered_rad, self._way_m)
        self.speed.add(stamp_ns, self._gained_mps, speed_mps, self._way_m)

    def refer(self, stamp_ns: int, heading_rad: float, speed_mps: float) -> None:
        """Takes heading and signed speed by GNSS; what is NaN was not measured."""
        if math.isfinite(heading_rad):
            self._heading_rad += wrap(heading_rad - self._heading_rad)
            self.turn.refer(stamp_ns, self._heading_rad)
        if math.isfinite(speed_mps):
            self.speed.refer(stamp_ns, speed_mps)

    def judge(self, now_ns: int) -> Doubt | None:
        """What is not believed now."""
        doubt = self.inertial.doubt() or self._contradiction()
        if doubt is not None:
            self._doubt, self._doubted_ns = self._doubt or doubt, now_ns
        elif not 0 <= now_ns - self._doubted_ns <= self._config.heal_s * 1e9:
            self._doubt = None
        return self._doubt

    def _contradiction(self) -> Doubt | None:
        for agreement, what, unit in ((self.turn, "turn", "rad"), (self.speed, "change of speed", "m/s")):
            blame = agreement.blame()
            if blame is not None:
                return Doubt(blame.value, f"{what} differs by {agreement.margin()[0]:.2f} {unit}")
        return None

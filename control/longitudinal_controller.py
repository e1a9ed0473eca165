"""Longitudinal controller: speed limits of the path, smooth stop at its end, integral correction of the speed error."""

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Kmh, Vehicle, kmh, steering_rate
from control.reference import Reference
from control.scalars import as_floats, clamp
from geometry.arrays import Float64
from messages.plan import Path

GRAVITY_MPS2 = 9.80665
STANDING_MPS = 0.03
MIN_LEARNING_MPS = 0.2
STUCK_SHARE = 0.8  # of the target in the model while the machine stands
STUCK_MPS2 = 0.1  # ramp of the command while the machine does not start


class SpeedConfig(Config):
    """Speed control and stop at the end of a path."""

    steering_share: float = Field(gt=0.0, le=1.0, description="of the steering rate that limits speed on a path")
    braking_mps2: float = Field(gt=0.0, le=3.0, description="planned deceleration without brakes")
    delay_s: float = Field(ge=0.0, le=2.0, description="from command to speed")
    integral_per_s: float = Field(ge=0.0, le=5.0)
    integral_max_mps: float = Field(ge=0.0, le=1.0)
    model_lag_s: float = Field(gt=0.0, le=5.0, description="time constant of the tractor's speed loop")
    overspeed_mps: float = Field(
        gt=0.0, le=2.0, description="above the target, after `delay_s` at the present acceleration: brakes are applied"
    )
    acceleration_time_s: float = Field(gt=0.0, le=5.0, description="time constant of that acceleration")
    overspeed_per_s: float = Field(gt=0.0, le=10.0, description="deceleration per overspeed, beyond the downhill force")
    max_braking_mps2: float = Field(gt=0.0, le=6.0)
    holding_mps2: float = Field(gt=0.0, le=6.0, description="brake demand at standstill")
    end_decay_s: float = Field(gt=0.05, le=5.0, description="time constant of the final approach")
    creep_mps: float = Field(gt=0.01, le=0.5, description="minimum speed of the final approach")
    stop_s: float = Field(ge=0.0, le=2.0, description="travel after the stop command, as time at the present speed")
    far_offset_m: float = Field(gt=0.02, le=5.0, description="cross-track error above which `far_speed_kmh` applies")
    far_speed_kmh: Kmh

    @property
    def far_mps(self) -> float:
        """`far_speed_kmh` in m/s."""
        return kmh(self.far_speed_kmh)


class SpeedPlan:
    """Speed limits along a path, lowered to what `braking_mps2` can keep."""

    def __init__(self, path: Path, reference: Reference, vehicle: Vehicle, config: SpeedConfig) -> None:
        self.end_m = float(path.s_m[-1])
        self._braking_mps2 = config.braking_mps2
        limits = np.minimum(path.speed_mps, steerable_mps(path, reference, vehicle, config.steering_share))
        limits[-1] = limits[-2] if len(limits) > 1 else 0.0  # the end is limited by ending_mps
        gaps = np.diff(path.s_m)
        lost = 2.0 * config.braking_mps2 * (path.s_m - path.s_m[0])  # decrease of v² by braking from the start
        limits = np.sqrt(np.maximum(np.minimum.accumulate((limits**2 + lost)[::-1])[::-1] - lost, 0.0))
        times = np.concatenate([[0.0], np.cumsum(gaps / np.maximum(0.5 * (limits[1:] + limits[:-1]), 0.05))])
        self._s, self._limits, self._times = as_floats(path.s_m), as_floats(limits), as_floats(times)

    def limit_mps(self, s_m: float) -> float:
        """Limit at an arc length, without the end."""
        return self._at(self._limits, s_m)

    def ending_mps(self, remaining_m: float, config: SpeedConfig) -> float:
        """Speed from which the machine stops at the end: constant braking, then exponential decay.

        v = d / τ near the end and v² = 2 a d − (a τ)² before it, with equal value and slope at v = a τ.
        """
        decay_mps = self._braking_mps2 * config.end_decay_s
        if remaining_m <= decay_mps * config.end_decay_s:
            return max(remaining_m, 0.0) / config.end_decay_s
        return math.sqrt(2.0 * self._braking_mps2 * remaining_m - decay_mps * decay_mps)

    def time_s(self, from_m: float, to_m: float, speed_mps: float) -> float:
        """Time between two arc lengths at the planned speeds scaled to the present one, s."""
        planned_s = self._at(self._times, to_m) - self._at(self._times, from_m)
        if abs(speed_mps) < STANDING_MPS:
            return math.inf
        return planned_s * max(self.limit_mps(from_m), 0.05) / abs(speed_mps)

    def _at(self, values: Sequence[float], s_m: float) -> float:
        k = min(max(bisect_right(self._s, s_m) - 1, 0), len(self._s) - 2) if len(self._s) > 1 else 0
        if len(self._s) < 2:
            return values[0]
        share = (s_m - self._s[k]) / max(self._s[k + 1] - self._s[k], 1e-9)
        return values[k] + min(max(share, 0.0), 1.0) * (values[k + 1] - values[k])


def steerable_mps(path: Path, reference: Reference, vehicle: Vehicle, share: float) -> Float64:
    """Speed at the points (N,) at which following the path needs `share` of the steering rate, m/s."""
    s, rates = reference.steering_rates(vehicle.drivetrain.wheelbase_m)
    steady = np.maximum(np.interp(path.s_m, s, rates), 1e-3)
    return np.asarray(share * steering_rate(vehicle) / steady, np.float64)


class LongitudinalController:
    """Speed and deceleration commands, both in the direction of travel."""

    def __init__(self, config: SpeedConfig) -> None:
        self._config = config
        self._integral_mps = 0.0
        self._model_mps = 0.0
        self._is_slowed = False
        self._speed_mps: float | None = None
        self._acceleration_mps2 = 0.0
        self.is_arrived = False

    def start(self) -> None:
        """Starts a path."""
        self.is_arrived = False

    def target_mps(self, plan: SpeedPlan, s_m: float, speed_mps: float, offset_m: float) -> float:
        """Target speed, m/s; remains 0 once the end is reached."""
        config = self._config
        ahead_m = s_m + max(speed_mps, 0.0) * config.delay_s
        remaining_m = plan.end_m - s_m
        self.is_arrived = self.is_arrived or remaining_m <= max(speed_mps, 0.0) * config.stop_s
        if self.is_arrived:
            return 0.0
        limit = min(plan.limit_mps(s_m), plan.limit_mps(ahead_m))
        ending = max(plan.ending_mps(plan.end_m - ahead_m, config), config.creep_mps)
        far = config.far_mps if abs(offset_m) > config.far_offset_m else math.inf
        return min(limit, ending, far)

    def command(
        self, target_mps: float, speed_mps: float, elapsed_s: float, is_followed: bool, descent: float = 0.0
    ) -> tuple[float, float]:
        """Commanded speed and acceleration (< 0: brakes) for target and measured speed on a slope of sine `descent`."""
        self._learn(target_mps, speed_mps, elapsed_s, is_followed)
        self._follow(speed_mps, elapsed_s)
        min_mps = min(target_mps, self._config.creep_mps)  # a negative integral must not stop the machine
        commanded_mps = max(min_mps, target_mps + self._integral_mps) if target_mps > 0.0 else 0.0
        return commanded_mps, -self._braking_mps2(target_mps, speed_mps, descent)

    def _follow(self, speed_mps: float, elapsed_s: float) -> None:
        """Takes the present speed into the acceleration."""
        if self._speed_mps is not None and elapsed_s > 0.0:
            off_mps2 = (speed_mps - self._speed_mps) / elapsed_s - self._acceleration_mps2
            self._acceleration_mps2 += off_mps2 * min(elapsed_s / self._config.acceleration_time_s, 1.0)
        self._speed_mps = speed_mps

    def _learn(self, target_mps: float, speed_mps: float, elapsed_s: float, is_followed: bool) -> None:
        """Integrates the error once the model has reached the target, so that changes of target have no effect."""
        config = self._config
        self._model_mps += (target_mps - self._model_mps) * min(elapsed_s / config.model_lag_s, 1.0)
        if not is_followed:
            self._model_mps = min(self._model_mps, speed_mps)
            return
        is_stuck = speed_mps < STANDING_MPS and self._model_mps > max(STUCK_SHARE * target_mps, STANDING_MPS)
        is_steady = abs(target_mps - self._model_mps) < 0.05 and target_mps > MIN_LEARNING_MPS
        if is_stuck:
            self._integral_mps = clamp(self._integral_mps + STUCK_MPS2 * elapsed_s, config.integral_max_mps)
        elif is_steady and abs(target_mps - speed_mps) < 0.5:
            change = config.integral_per_s * (target_mps - speed_mps) * elapsed_s
            self._integral_mps = clamp(self._integral_mps + change, config.integral_max_mps)

    def _braking_mps2(self, target_mps: float, speed_mps: float, descent: float) -> float:
        """Brake demand: against overspeed until the target is reached, and holding at standstill.

        While the brakes act the drive does not: they hold the machine on the slope too.
        """
        config = self._config
        if target_mps == 0.0:
            self._is_slowed = False
            return min(max(config.overspeed_per_s * speed_mps, config.holding_mps2), config.max_braking_mps2)
        excess_mps = speed_mps - max(target_mps, self._model_mps)
        coming_mps = excess_mps + max(self._acceleration_mps2, 0.0) * config.delay_s
        self._is_slowed = excess_mps > 0.0 and (self._is_slowed or coming_mps > config.overspeed_mps)
        if not self._is_slowed:
            return 0.0
        return min(config.overspeed_per_s * coming_mps + GRAVITY_MPS2 * max(descent, 0.0), config.max_braking_mps2)

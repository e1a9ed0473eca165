"""Dead reckoning: continuous pose in `odom` from gyro and wheels; drifts but never steps."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import interpolate
from localization.dead_reckoning.imu_track import Steps
from localization.dead_reckoning.kernels import integrate


class DeadReckoningConfig(Config):
    """Time constants with which corrections from the graph take effect."""

    slew_s: float = Field(gt=0.0, le=60.0, description="of gyro bias and slip")
    tilt_s: float = Field(gt=0.0, le=600.0, description="of roll and pitch")
    max_tilt_rate_radps: float = Field(gt=0.0, le=0.1)


@dataclass(frozen=True)
class Calibration:
    """Calibration estimated by the graph: gyro bias (3,) and slip (4,), see wheel_track.py."""

    gyro_bias_radps: Float64
    slip: Float64

    def velocity(self, speed_mps: float, force: Float64) -> tuple[float, float]:
        """Forward and left speed of base at a wheel speed and tyre force (2,) over weight."""
        scale, drift, per_longitudinal, per_lateral = self.slip.tolist()
        forward_mps = (scale - per_longitudinal * float(force[0])) * speed_mps
        return forward_mps, (drift - per_lateral * float(force[1])) * speed_mps


class DeadReckoning:
    """Integrates turn rate and wheel speed step by step; corrections take effect gradually."""

    def __init__(self, config: DeadReckoningConfig, T_odom_base: Float64, calibration: Calibration) -> None:
        self._config = config
        self.T_odom_base = T_odom_base.copy()
        self._now, self._goal = _vector(calibration), _vector(calibration)
        self._tilt_odom = np.zeros(3)

    @property
    def calibration(self) -> Calibration:
        """The calibration applied at present."""
        return Calibration(self._now[:3].copy(), self._now[3:].copy())

    def correct(self, calibration: Calibration, up_base: Float64, T_odom_base: Float64) -> None:
        """Sets the calibration and up direction (3,) in base estimated by the graph at the pose `T_odom_base`."""
        self._goal = _vector(calibration)
        x, y, _ = T_odom_base[:3, :3] @ up_base
        self._tilt_odom = np.array([y, -x, 0.0])  # cross product with up: rotates the one to the other

    def advance(self, steps: Steps, speed_mps: Float64) -> Float64:
        """Integrates n steps with wheel speeds (n,); returns the pose after each, (n, 4, 4)."""
        cfg = self._config
        poses = integrate(
            self.T_odom_base, steps.dt_s, steps.rate_radps, speed_mps, steps.tyre_force, self._now, self._goal,
            self._tilt_odom, cfg.slew_s, cfg.tilt_s, cfg.max_tilt_rate_radps,
        )  # fmt: skip
        self.T_odom_base = poses[-1]
        return poses


def _vector(calibration: Calibration) -> Float64:
    return np.concatenate([calibration.gyro_bias_radps, calibration.slip])


class PoseHistory:
    """Poses of the last `keep_s` seconds by stamp."""

    def __init__(self, keep_s: float) -> None:
        self._keep_ns = int(keep_s * 1e9)
        self._stamps: deque[int] = deque()
        self._poses: deque[Float64] = deque()

    def clear(self) -> None:
        """Drops all poses."""
        self._stamps.clear()
        self._poses.clear()

    def add(self, stamp_ns: int, T: Float64) -> None:
        """Appends a pose newer than all others."""
        self._stamps.append(stamp_ns)
        self._poses.append(T)
        while self._stamps[-1] - self._stamps[0] > self._keep_ns:
            self._stamps.popleft()
            self._poses.popleft()

    def at(self, stamp_ns: int) -> Float64 | None:
        """The interpolated pose at a time, None outside the stored interval."""
        k = len(self._stamps) - 1
        if k < 0 or not self._stamps[0] <= stamp_ns <= self._stamps[k]:
            return None
        while self._stamps[k] > stamp_ns:
            k -= 1
        if self._stamps[k] == stamp_ns:
            return self._poses[k]
        share = (stamp_ns - self._stamps[k]) / (self._stamps[k + 1] - self._stamps[k])
        return interpolate(self._poses[k], self._poses[k + 1], share)

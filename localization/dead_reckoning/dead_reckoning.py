"""The continuous pose in `odom` from gyro and wheels; it drifts but never steps."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.transforms import Float64, interpolate
from localization.dead_reckoning.imu_track import Steps
from localization.dead_reckoning.kernels import reckon


class DeadReckoningConfig(Config):
    """How slowly corrections from the graph enter."""

    slew_s: float = Field(
        gt=0.0, le=60.0, description="time constant with which bias, scale and drift follow the graph"
    )
    tilt_s: float = Field(gt=0.0, le=600.0, description="time constant with which roll and pitch follow the graph")
    largest_tilt_rate_radps: float = Field(gt=0.0, le=0.1)


@dataclass(frozen=True)
class Calibration:
    """What the graph knows about the sensors: gyro bias (3,) and slip (4,), see wheels.py."""

    gyro_bias_radps: Float64
    slip: Float64

    def motion(self, speed_mps: float, pull: Float64) -> tuple[float, float]:
        """Speed of base forwards and to the left at a wheel speed and pull (2,)."""
        scale, drift, per_pull, per_side = self.slip.tolist()
        return (scale - per_pull * float(pull[0])) * speed_mps, (drift - per_side * float(pull[1])) * speed_mps


class DeadReckoning:
    """Integrates turn rate and wheel speed step by step; corrections of its inputs come in gliding."""

    def __init__(self, config: DeadReckoningConfig, T_odom_base: Float64, calibration: Calibration) -> None:
        self._config = config
        self.T_odom_base = T_odom_base.copy()
        self._now, self._goal = _vector(calibration), _vector(calibration)
        self._tilt_odom = np.zeros(3)

    @property
    def calibration(self) -> Calibration:
        """What is applied at this moment."""
        return Calibration(self._now[:3].copy(), self._now[3:].copy())

    def correct(self, calibration: Calibration, up_base: Float64, T_odom_base: Float64) -> None:
        """Takes the graph's calibration and upward direction in base, seen when the pose was `T_odom_base`."""
        self._goal = _vector(calibration)
        x, y, _ = T_odom_base[:3, :3] @ up_base
        self._tilt_odom = np.array([y, -x, 0.0])  # that direction crossed with upwards: turns the one to the other

    def advance(self, steps: Steps, speed_mps: Float64) -> Float64:
        """Goes on by n steps with wheel speeds (n,); gives the pose after each, (n, 4, 4)."""
        cfg = self._config
        poses = reckon(
            self.T_odom_base, steps.dt_s, steps.rate_radps, speed_mps, steps.pull, self._now, self._goal,
            self._tilt_odom, cfg.slew_s, cfg.tilt_s, cfg.largest_tilt_rate_radps,
        )  # fmt: skip
        self.T_odom_base = poses[-1]
        return poses


def _vector(calibration: Calibration) -> Float64:
    return np.concatenate([calibration.gyro_bias_radps, calibration.slip])


class PoseHistory:
    """Poses of the last seconds by time."""

    def __init__(self, keep_s: float) -> None:
        self._keep_ns = int(keep_s * 1e9)
        self._stamps: deque[int] = deque()
        self._poses: deque[Float64] = deque()

    def clear(self) -> None:
        """Forgets everything."""
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
        """The pose at a time, None when it is not covered."""
        k = len(self._stamps) - 1
        if k < 0 or not self._stamps[0] <= stamp_ns <= self._stamps[k]:
            return None
        while self._stamps[k] > stamp_ns:
            k -= 1
        if self._stamps[k] == stamp_ns:
            return self._poses[k]
        share = (stamp_ns - self._stamps[k]) / (self._stamps[k + 1] - self._stamps[k])
        return interpolate(self._poses[k], self._poses[k + 1], share)

"""The continuous pose in `odom` from gyro and wheels; it drifts but never steps."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.transforms import Float64, interpolate
from localization.inertial import Steps


class DeadReckoningConfig(Config):
    """How slowly corrections from the graph enter."""

    slew_s: float = Field(gt=0.0, le=60.0, description="time constant with which bias, scale and drift follow the graph")
    tilt_s: float = Field(gt=0.0, le=600.0, description="time constant with which roll and pitch follow the graph")
    largest_tilt_rate_radps: float = Field(gt=0.0, le=0.1)


@dataclass(frozen=True)
class Calibration:
    """What the graph knows about the sensors: gyro bias (3,), wheel scale and sideways drift."""

    gyro_bias_radps: Float64
    scale: float
    drift: float


def rotation(v_rad: Float64) -> Float64:
    """The rotation by a rotation vector (3,): Rodrigues, with its series near zero."""
    x, y, z = v_rad.tolist()
    a2 = x * x + y * y + z * z
    a = math.sqrt(a2)
    s, c = (math.sin(a) / a, (1.0 - math.cos(a)) / a2) if a > 1e-6 else (1.0 - a2 / 6.0, 0.5 - a2 / 24.0)
    return np.array([
        [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
        [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
        [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
    ])  # fmt: skip


class DeadReckoning:
    """Integrates turn rate and wheel speed step by step; corrections of its inputs come in gliding."""

    def __init__(self, config: DeadReckoningConfig, T_odom_base: Float64, calibration: Calibration) -> None:
        self._config = config
        self.T_odom_base = T_odom_base.copy()
        self._goal = self._now = calibration
        self._tilt_odom = np.zeros(3)

    @property
    def calibration(self) -> Calibration:
        """What is applied at this moment."""
        return self._now

    def correct(self, calibration: Calibration, up_base: Float64, T_odom_base: Float64) -> None:
        """Takes the graph's calibration and upward direction in base, seen when the pose was `T_odom_base`."""
        self._goal = calibration
        up_odom = T_odom_base[:3, :3] @ up_base
        self._tilt_odom = np.cross(up_odom, [0.0, 0.0, 1.0])

    def advance(self, steps: Steps, speed_mps: Float64) -> list[Float64]:
        """Goes on by the steps with wheel speeds (n,); gives the pose after each."""
        return [
            self._step(dt, rate, speed)
            for dt, rate, speed in zip(steps.dt_s.tolist(), steps.rate_radps, speed_mps.tolist(), strict=True)
        ]

    def _step(self, dt_s: float, rate_radps: Float64, speed_mps: float) -> Float64:
        self._glide(dt_s)
        now, T = self._now, self.T_odom_base
        turn = (rate_radps - now.gyro_bias_radps) * dt_s
        R = T[:3, :3]
        way = np.array([now.scale * speed_mps * dt_s, now.drift * speed_mps * dt_s, 0.0])
        out = np.eye(4)
        out[:3, 3] = T[:3, 3] + R @ (way + 0.5 * np.cross(turn, way))
        out[:3, :3] = self._tilt_step(dt_s) @ R @ rotation(turn)
        self.T_odom_base = out
        return out

    def _glide(self, dt_s: float) -> None:
        share = min(1.0, dt_s / self._config.slew_s)
        now, goal = self._now, self._goal
        self._now = Calibration(
            now.gyro_bias_radps + share * (goal.gyro_bias_radps - now.gyro_bias_radps),
            now.scale + share * (goal.scale - now.scale),
            now.drift + share * (goal.drift - now.drift),
        )

    def _tilt_step(self, dt_s: float) -> Float64:
        rate = self._tilt_odom / self._config.tilt_s
        length = math.sqrt(float(rate @ rate))
        if length > self._config.largest_tilt_rate_radps:
            rate = rate * (self._config.largest_tilt_rate_radps / length)
        self._tilt_odom = self._tilt_odom - rate * dt_s
        return rotation(rate * dt_s)


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

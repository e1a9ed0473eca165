"""Side slip (crab angle) and calibration of the measured wheel curvature."""

import math

from pydantic import Field

from configs.strict import Config
from configs.vehicle import deg
from control.scalars import clamp
from geometry.pose2 import Pose2

MIN_LEARNING_MPS = 0.3


class SlipConfig(Config):
    """Learning of slip and calibration, by distance: both depend on ground and machine, not on time."""

    crab_m: float = Field(gt=0.0, le=50.0, description="distance constant of the crab angle")
    crab_max_deg: float = Field(ge=0.0, le=15.0)
    offset_sigma_radpm: float = Field(gt=0.0, le=0.1, description="initial, of the curvature offset")
    gain_sigma: float = Field(gt=0.0, le=0.5, description="initial, of the curvature gain")
    gain_from_radpm: float = Field(gt=0.0, le=1.0, description="the gain is learned above this curvature only")
    noise_radpm: float = Field(gt=0.0, le=0.1, description="of one comparison of yaw rate and wheel angle at 1 m/s")
    forget_m: float = Field(gt=1.0, le=10000.0, description="distance over which the estimate is forgotten")


class CrabEstimate:
    """Crab angle: from heading to course over ground, left positive."""

    def __init__(self, config: SlipConfig) -> None:
        self._length_m, self._max_rad = config.crab_m, deg(config.crab_max_deg)
        self._last: Pose2 | None = None
        self.crab_rad = 0.0

    def update(self, pose: Pose2, is_moving: bool) -> float:
        """Takes the next pose in `map`; returns the angle, rad."""
        if self._last is not None and is_moving:
            along, across = _displacement(self._last, pose)
            change = (across - self.crab_rad * along) * math.copysign(1.0, along) / self._length_m
            self.crab_rad = clamp(self.crab_rad + change, self._max_rad)
        self._last = pose
        return self.crab_rad


def _displacement(before: Pose2, after: Pose2) -> tuple[float, float]:
    """Displacement between two poses, along and across their mean heading."""
    yaw = before.yaw_rad + 0.5 * math.remainder(after.yaw_rad - before.yaw_rad, 2.0 * math.pi)
    c, s = math.cos(yaw), math.sin(yaw)
    dx, dy = after.x_m - before.x_m, after.y_m - before.y_m
    return c * dx + s * dy, c * dy - s * dx


class SteeringCalibration:
    """Gain and offset between measured and driven curvature: Kalman filter on two constants with slow forgetting."""

    def __init__(self, config: SlipConfig) -> None:
        self._config = config
        self.gain, self.offset_radpm = 1.0, 0.0
        self._start = (config.gain_sigma**2, config.offset_sigma_radpm**2)
        self._p00, self._p01, self._p11 = self._start[0], 0.0, self._start[1]

    def update(self, curvature_radpm: float, yaw_rate_radps: float, speed_mps: float, elapsed_s: float) -> None:
        """Compares the curvature of the wheels with the one driven; without effect below `MIN_LEARNING_MPS`."""
        if abs(speed_mps) < MIN_LEARNING_MPS:
            return
        self._forget(abs(speed_mps) * elapsed_s / self._config.forget_m)
        h = curvature_radpm if abs(curvature_radpm) > self._config.gain_from_radpm else 0.0  # no gain from noise
        a, b = self._p00 * h + self._p01, self._p01 * h + self._p11
        variance = h * a + b + (self._config.noise_radpm / min(abs(speed_mps), 1.0)) ** 2
        error = yaw_rate_radps / speed_mps - (self.gain * curvature_radpm + self.offset_radpm)
        error = clamp(error, 3.0 * math.sqrt(variance))
        self.gain = 1.0 + clamp(self.gain + a / variance * error - 1.0, 3.0 * self._config.gain_sigma)
        self.offset_radpm = clamp(self.offset_radpm + b / variance * error, 3.0 * self._config.offset_sigma_radpm)
        self._p00, self._p01, self._p11 = (
            self._p00 - a * a / variance,
            self._p01 - a * b / variance,
            self._p11 - b * b / variance,
        )

    def wheel_curvature_radpm(self, curvature_radpm: float) -> float:
        """Wheel curvature to command for a curvature to be driven."""
        return (curvature_radpm - self.offset_radpm) / self.gain

    def _forget(self, share: float) -> None:
        self._p00 += share * (self._start[0] - self._p00)
        self._p11 += share * (self._start[1] - self._p11)
        self._p01 *= 1.0 - share

"""Zero offset of the steering angle sensor."""

import math

from pydantic import Field

from configs.strict import Config


class SteeringOffsetConfig(Config):
    """Conditions and time constant of the estimate."""

    time_s: float = Field(gt=0.0, le=600.0, description="time constant, while driving")
    min_speed_mps: float = Field(gt=0.0, le=10.0)
    max_rate_radps: float = Field(gt=0.0, le=2.0, description="of the steering angle")
    max_offset_deg: float = Field(gt=0.0, le=10.0)


class SteeringOffset:
    """Estimates the offset between steering angle and gyro while driving."""

    def __init__(self, config: SteeringOffsetConfig, wheelbase_m: float) -> None:
        self._config, self._wheelbase = config, wheelbase_m
        self._previous: float | None = None
        self.offset_rad = 0.0

    def curvature(self, angle_rad: float) -> float:
        """Path curvature of the rear axle at a steering angle, 1/m."""
        return math.tan(angle_rad - self.offset_rad) / self._wheelbase

    def update(self, angle_rad: float, speed_mps: float, yaw_rate_radps: float, dt_s: float) -> None:
        """Takes one sample."""
        previous, self._previous = self._previous, angle_rad
        if previous is None or dt_s <= 0.0 or abs(speed_mps) < self._config.min_speed_mps:
            return
        if abs(angle_rad - previous) > self._config.max_rate_radps * dt_s:
            return
        expected = math.atan(self._wheelbase * yaw_rate_radps / speed_mps)
        limit = math.radians(self._config.max_offset_deg)
        share = dt_s / self._config.time_s
        moved = self.offset_rad + share * (angle_rad - expected - self.offset_rad)
        self.offset_rad = max(-limit, min(limit, moved))

"""The steered wheels' angle, rid of its sensor's zero offset."""

import math

from pydantic import Field

from configs.strict import Config


class SteeringConfig(Config):
    """When and how fast the offset is learnt."""

    time_s: float = Field(gt=0.0, le=600.0, description="of driving, to learn the offset")
    least_speed_mps: float = Field(gt=0.0, le=10.0)
    largest_rate_radps: float = Field(gt=0.0, le=2.0, description="of the steering angle; faster is not learnt from")
    largest_offset_deg: float = Field(gt=0.0, le=10.0)


class Steering:
    """Learns the offset that makes the steering angle agree with the gyro while driving."""

    def __init__(self, config: SteeringConfig, wheelbase_m: float) -> None:
        self._config, self._wheelbase = config, wheelbase_m
        self._previous: float | None = None
        self.offset_rad = 0.0

    def curvature(self, angle_rad: float) -> float:
        """Curvature of the rear axle's path that the wheels are set to."""
        return math.tan(angle_rad - self.offset_rad) / self._wheelbase

    def learn(self, angle_rad: float, speed_mps: float, yaw_rate_radps: float, dt_s: float) -> None:
        """Takes one moment of driving."""
        previous, self._previous = self._previous, angle_rad
        if previous is None or dt_s <= 0.0 or abs(speed_mps) < self._config.least_speed_mps:
            return
        if abs(angle_rad - previous) > self._config.largest_rate_radps * dt_s:
            return
        expected = math.atan(self._wheelbase * yaw_rate_radps / speed_mps)
        limit = math.radians(self._config.largest_offset_deg)
        share = dt_s / self._config.time_s
        moved = self.offset_rad + share * (angle_rad - expected - self.offset_rad)
        self.offset_rad = max(-limit, min(limit, moved))

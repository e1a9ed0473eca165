"""Steering: the tractor's position loop for the wheel angle, over an electric wheel or a hydraulic valve."""

import math
from collections import deque

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Ackermann, ElectricWheel, HydraulicValve


class SteeringConfig(Config):
    """Position loop of the steering ECU."""

    gain_per_s: float = Field(gt=0.0, le=20.0)
    tolerance_deg: float = Field(
        ge=0.0, le=1.0, description="dead band of the loop, against limit cycles from backlash"
    )
    dead_band_compensation: float = Field(
        ge=0.0, le=1.0, description="share of the valve's dead band that is compensated"
    )


class DelayLine:
    """Delay by a fixed number of steps; 0 at first."""

    def __init__(self, delay_s: float, dt_s: float) -> None:
        self._values = deque([0.0] * round(delay_s / dt_s))

    def step(self, value: float) -> float:
        """Takes the newest value, returns the oldest."""
        self._values.append(value)
        return self._values.popleft()


def clamp(value: float, low: float, high: float) -> float:
    """The value limited to [low, high]."""
    return max(low, min(high, value))


def follow_lag(value: float, target: float, lag_s: float, dt_s: float) -> float:
    """One step of a first-order lag, exact for a target held over the step."""
    return target + (value - target) * math.exp(-dt_s / lag_s) if lag_s > 0.0 else target


def follow_play(output: float, drive: float, play: float) -> float:
    """Backlash: the output stays until the drive has taken up `play` (full width)."""
    return clamp(output, drive - 0.5 * play, drive + 0.5 * play)


def open_valve(command: float, dead_band: float) -> float:
    """Share of full flow for a command in [-1, 1]: zero within the dead band, linear outside."""
    beyond = max(abs(command) - dead_band, 0.0) / (1.0 - dead_band)
    return math.copysign(min(beyond, 1.0), command)


class Steering:
    """Front wheels, actuator and position loop; `angle_rad` is the true angle, left positive."""

    def __init__(
        self, actuator: ElectricWheel | HydraulicValve, drivetrain: Ackermann, config: SteeringConfig, dt_s: float
    ) -> None:
        self.angle_rad = 0.0
        self.rate_limit_radps = rate_limit_of(actuator)
        self.max_angle_rad = math.atan(drivetrain.wheelbase_m * drivetrain.max_curvature_radpm) * 1.02
        self._actuator, self._config, self._dt_s = actuator, config, dt_s
        self._delay = DelayLine(actuator.dead_time_s, dt_s)
        self._rate_radps = 0.0
        self._drive_rad = 0.0

    def step(self, requested_rad: float | None, measured_rad: float) -> None:
        """Turns for one time step towards the requested angle as measured; None releases the actuator."""
        requested_rate = 0.0 if requested_rad is None else self._control(requested_rad - measured_rad)
        rate = self._flow_rate(self._delay.step(requested_rate))
        self._rate_radps = follow_lag(self._rate_radps, rate, self._actuator.lag_s, self._dt_s)
        self._drive_rad = clamp(
            self._drive_rad + self._rate_radps * self._dt_s, -self.max_angle_rad, self.max_angle_rad
        )
        play = math.radians(self._actuator.backlash_deg) if isinstance(self._actuator, ElectricWheel) else 0.0
        self.angle_rad = follow_play(self.angle_rad, self._drive_rad, play)

    def _control(self, error_rad: float) -> float:
        """Requested rate, as a share of the limit."""
        if abs(error_rad) <= math.radians(self._config.tolerance_deg):
            return 0.0
        share = self._config.gain_per_s * error_rad / self.rate_limit_radps
        if isinstance(self._actuator, HydraulicValve):
            share += math.copysign(self._actuator.dead_band * self._config.dead_band_compensation, error_rad)
        return clamp(share, -1.0, 1.0)

    def _flow_rate(self, share: float) -> float:
        if isinstance(self._actuator, HydraulicValve):
            share = open_valve(share, self._actuator.dead_band)
        return share * self.rate_limit_radps


def rate_limit_of(actuator: ElectricWheel | HydraulicValve) -> float:
    """Largest turning rate of the front wheels, rad/s."""
    if isinstance(actuator, ElectricWheel):
        return actuator.max_wheel_rpm / 60.0 / actuator.wheel_turns_per_steer_rad
    return actuator.max_flow_lpm / 60.0 / actuator.cylinder_l_per_rad

"""Drivetrain with the tractor's speed loop, and the brakes."""

import math

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Brake
from simulation.machine.steering import DelayLine, clamp, follow_lag

GRAVITY_MPS2 = 9.80665


class DriveConfig(Config):
    """A continuously variable transmission and its speed loop; accelerations are forces over the machine's mass."""

    gain_per_s: float = Field(gt=0.0, le=20.0, description="proportional, per speed error")
    integral_per_s2: float = Field(ge=0.0, le=20.0, description="integral, per speed error")
    lag_s: float = Field(ge=0.0, le=5.0, description="of the traction")
    max_set_point_decrease_mps2: float = Field(
        gt=0.0, le=5.0, description="largest deceleration of the loop's set point"
    )
    max_traction_mps2: float = Field(gt=0.0, le=10.0)
    standstill_hold_mps2: float = Field(ge=0.0, le=10.0, description="holding force at standstill")
    rolling_resistance_mps2: float = Field(ge=0.0, le=2.0)
    slip_per_traction: float = Field(ge=0.0, le=1.0, description="slip over traction in units of weight")
    max_slip: float = Field(ge=0.0, le=0.5)
    park_brake_mps2: float = Field(gt=0.0, le=10.0)
    park_brake_s: float = Field(ge=0.0, le=5.0, description="time to set or release")
    wheel_radius_error: float = Field(ge=-0.2, le=0.2, description="of the true radius, relative to the calibrated one")


class Drive:
    """The tractor's speed loop: follows a set point of wheel speed with limited acceleration."""

    def __init__(self, config: DriveConfig, acceleration_mps2: float, dt_s: float) -> None:
        self.traction_mps2 = 0.0
        self._config, self._acceleration_mps2, self._dt_s = config, acceleration_mps2, dt_s
        self._reference_mps = 0.0
        self._integral_mps2 = 0.0

    def step(self, set_point_mps: float, wheel_speed_mps: float, is_enabled: bool) -> float:
        """Traction for the next time step as an acceleration; 0 when disabled."""
        requested = self._control(set_point_mps, wheel_speed_mps) if is_enabled else self._release(wheel_speed_mps)
        self.traction_mps2 = follow_lag(self.traction_mps2, requested, self._config.lag_s, self._dt_s)
        return self.traction_mps2

    def _release(self, wheel_speed_mps: float) -> float:
        self._reference_mps, self._integral_mps2 = wheel_speed_mps, 0.0
        return 0.0

    def _control(self, set_point_mps: float, wheel_speed_mps: float) -> float:
        change = ramp(
            self._reference_mps,
            set_point_mps,
            self._acceleration_mps2,
            self._config.max_set_point_decrease_mps2,
            self._dt_s,
        )
        self._reference_mps += change
        error = self._reference_mps - wheel_speed_mps
        requested = change / self._dt_s + self._config.gain_per_s * error + self._integral_mps2
        limit = self._config.max_traction_mps2
        if abs(requested) < limit or requested * error < 0.0:  # anti-windup
            self._integral_mps2 += self._config.integral_per_s2 * error * self._dt_s
        return clamp(requested, -limit, limit)


def ramp(value: float, target: float, up_per_s: float, down_per_s: float, dt_s: float) -> float:
    """Change of a value towards its target in one step: `up` away from zero, `down` towards it."""
    is_rising = abs(target) > abs(value) and target * value >= 0.0
    step = (up_per_s if is_rising else down_per_s) * dt_s
    return clamp(target - value, -step, step)


class BrakeSystem:
    """Brakes: dead time, then linear build-up to the request, limited by their capacity."""

    def __init__(self, brake: Brake, dt_s: float) -> None:
        self.deceleration_mps2 = 0.0
        self._brake, self._dt_s = brake, dt_s
        self._delay = DelayLine(brake.dead_time_s, dt_s)

    def step(self, requested_mps2: float) -> float:
        """Deceleration by the brakes for the next time step."""
        target = clamp(self._delay.step(requested_mps2), 0.0, self._brake.deceleration_mps2)
        step = self._brake.deceleration_mps2 * self._dt_s / max(self._brake.build_up_s, self._dt_s)
        self.deceleration_mps2 += clamp(target - self.deceleration_mps2, -step, step)
        return self.deceleration_mps2


def advance_speed(speed_mps: float, drive_mps2: float, friction_mps2: float, dt_s: float) -> float:
    """Speed after a step under a signed drive force and a friction that opposes motion and holds at standstill."""
    if speed_mps == 0.0:
        beyond = max(abs(drive_mps2) - friction_mps2, 0.0)
        return math.copysign(beyond, drive_mps2) * dt_s if beyond > 0.0 else 0.0
    after = speed_mps + (drive_mps2 - math.copysign(friction_mps2, speed_mps)) * dt_s
    return 0.0 if after * speed_mps <= 0.0 and abs(drive_mps2) <= friction_mps2 else after

"""Steering model (dead time, lag, rate limit) and prediction of the pose when a command takes effect."""

import math
from collections import deque
from dataclasses import dataclass

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Vehicle, steering_rate
from geometry.pose2 import Pose2

STEP_S = 0.02


class SteeringConfig(Config):
    """Steering loop, identified from steps of curvature on the machine."""

    pipeline_s: float = Field(ge=0.0, le=0.3, description="delay from odometry to wheels: stack and bus")
    lag_s: float = Field(gt=0.0, le=1.0, description="of the tractor's loop from command to curvature")
    compensated_lag_s: float = Field(gt=0.0, le=1.0, description="with lead compensation")
    correction: float = Field(gt=0.0, le=1.0, description="weight of a measured curvature in the estimate")


@dataclass(frozen=True)
class MotionModel:
    """Motion from measured curvature: `curvature = gain * measured + offset`, with a crab angle."""

    speed_mps: float
    gain: float
    offset_radpm: float
    crab_rad: float


@dataclass(frozen=True)
class Prediction:
    """`pose` when the present command takes effect; `curvature_radpm` of the wheels when it arrives."""

    pose: Pose2
    curvature_radpm: float


class SteeringModel:
    """Curvature of the wheels, estimated from commands and corrected by measurements."""

    def __init__(self, vehicle: Vehicle, config: SteeringConfig) -> None:
        self._dead_ns = round((config.pipeline_s + vehicle.steering.dead_time_s) * 1e9)
        self._lag_s, self._compensated_lag_s, self._correction = (
            config.lag_s,
            config.compensated_lag_s,
            config.correction,
        )
        self._step_share = 1.0 - math.exp(-STEP_S / config.lag_s)
        self._wheelbase_m = vehicle.drivetrain.wheelbase_m
        self._steering_radps = steering_rate(vehicle)
        self._commands: deque[tuple[int, float]] = deque(maxlen=64)
        self._stamp_ns: int | None = None
        self.curvature_radpm = 0.0

    def command(self, now_ns: int, curvature_radpm: float) -> None:
        """Registers a command."""
        self._commands.append((now_ns + self._dead_ns, curvature_radpm))

    def measure(self, stamp_ns: int, curvature_radpm: float, is_followed: bool) -> None:
        """Updates the estimate; without followed commands the measurement is taken over."""
        if self._stamp_ns is None or not is_followed:
            self.curvature_radpm = curvature_radpm
        elif stamp_ns > self._stamp_ns:
            elapsed_s = min((stamp_ns - self._stamp_ns) * 1e-9, 0.2)
            self._advance(stamp_ns, elapsed_s)
            self.curvature_radpm += self._correction * (curvature_radpm - self.curvature_radpm)
        self._stamp_ns = stamp_ns

    def lead(self, curvature_radpm: float, desired_radpm: float) -> float:
        """Command with lead compensation: changes the curvature faster than the lag of the loop."""
        return curvature_radpm + self._lag_s / self._compensated_lag_s * (desired_radpm - curvature_radpm)

    def predict(self, now_ns: int, stamp_ns: int, pose: Pose2, motion: MotionModel) -> Prediction:
        """Prediction from the pose at `stamp_ns` along the pending commands."""
        x, y, yaw = pose
        curvature = arrival = self.curvature_radpm
        arrives_ns = now_ns + self._dead_ns
        steps = max(1, round((arrives_ns - stamp_ns) * 1e-9 / STEP_S))
        for k in range(steps + round(self._compensated_lag_s / STEP_S)):
            if k == steps:
                arrival = curvature
            curvature = self._follow(curvature, self._command_at(stamp_ns + round((k + 0.5) * STEP_S * 1e9)), STEP_S)
            turn = motion.speed_mps * (motion.gain * curvature + motion.offset_radpm) * STEP_S
            course = yaw + 0.5 * turn + motion.crab_rad
            x += motion.speed_mps * STEP_S * math.cos(course)
            y += motion.speed_mps * STEP_S * math.sin(course)
            yaw += turn
        return Prediction(Pose2(x, y, yaw), arrival)

    def _advance(self, stamp_ns: int, elapsed_s: float) -> None:
        target = self._command_at(stamp_ns - round(0.5e9 * elapsed_s))
        self.curvature_radpm = self._follow(self.curvature_radpm, target, elapsed_s)

    def _command_at(self, stamp_ns: int) -> float:
        for arrives_ns, curvature in reversed(self._commands):
            if arrives_ns <= stamp_ns:
                return curvature
        return self._commands[0][1] if self._commands else self.curvature_radpm

    def _follow(self, curvature: float, target: float, step_s: float) -> float:
        """Curvature after a step: κ = tan δ / L, so the rate limit in curvature grows with the wheel angle."""
        share = self._step_share if step_s == STEP_S else 1.0 - math.exp(-step_s / self._lag_s)
        change = (target - curvature) * share
        max_change = (
            self._steering_radps * (1.0 / self._wheelbase_m + self._wheelbase_m * curvature * curvature) * step_s
        )
        if change > max_change:
            return curvature + max_change
        return curvature - max_change if change < -max_change else curvature + change

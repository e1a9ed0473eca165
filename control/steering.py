"""The steering as it answers (dead time, lag, limited rate), and where the machine is when a command takes hold."""

import math
from collections import deque
from dataclasses import dataclass

from pydantic import Field

from configs.strict import Config
from configs.vehicle import Vehicle, steering_rate
from geometry.pose2 import Pose2

STEP_S = 0.02


class SteeringConfig(Config):
    """The steering loop as measured on the machine (a step of curvature commanded and answered)."""

    pipeline_s: float = Field(ge=0.0, le=0.3, description="from odometry to wheels: stack and bus")
    lag_s: float = Field(gt=0.0, le=1.0, description="of the tractor's own loop from command to curvature")
    quickened_lag_s: float = Field(gt=0.0, le=1.0, description="what leading the command makes of it")
    correction: float = Field(gt=0.0, le=1.0, description="share of a measured curvature in the estimate")


@dataclass(frozen=True)
class Motion:
    """How the machine moves by its curvature: `curvature = gain * measured + offset`, and it crabs by an angle."""

    speed_mps: float
    gain: float
    offset_radpm: float
    crab_rad: float


@dataclass(frozen=True)
class Prediction:
    """`pose` when the command given now is being followed; `curvature_radpm` of the wheels when it arrives."""

    pose: Pose2
    curvature_radpm: float


class SteeringModel:
    """Curvature of the wheels, estimated from commands and corrected by what is measured."""

    def __init__(self, vehicle: Vehicle, config: SteeringConfig) -> None:
        self._dead_ns = round((config.pipeline_s + vehicle.steering.dead_time_s) * 1e9)
        self._lag_s, self._quick_s, self._correction = config.lag_s, config.quickened_lag_s, config.correction
        self._step_share = 1.0 - math.exp(-STEP_S / config.lag_s)
        self._wheelbase_m = vehicle.drivetrain.wheelbase_m
        self._steering_radps = steering_rate(vehicle)
        self._commands: deque[tuple[int, float]] = deque(maxlen=64)
        self._stamp_ns: int | None = None
        self.curvature_radpm = 0.0

    def command(self, now_ns: int, curvature_radpm: float) -> None:
        """Note what was commanded."""
        self._commands.append((now_ns + self._dead_ns, curvature_radpm))

    def measure(self, stamp_ns: int, curvature_radpm: float, is_obeyed: bool) -> None:
        """Go on to a measurement; when commands are not obeyed, nothing but the measurement counts."""
        if self._stamp_ns is None or not is_obeyed:
            self.curvature_radpm = curvature_radpm
        elif stamp_ns > self._stamp_ns:
            elapsed_s = min((stamp_ns - self._stamp_ns) * 1e-9, 0.2)
            self._advance(stamp_ns, elapsed_s)
            self.curvature_radpm += self._correction * (curvature_radpm - self.curvature_radpm)
        self._stamp_ns = stamp_ns

    def lead(self, curvature_radpm: float, wanted_radpm: float) -> float:
        """The command that brings the wheels from one curvature to another faster than the loop's own lag."""
        return curvature_radpm + self._lag_s / self._quick_s * (wanted_radpm - curvature_radpm)

    def predict(self, now_ns: int, stamp_ns: int, pose: Pose2, motion: Motion) -> Prediction:
        """From the pose at `stamp_ns` along the commands under way."""
        x, y, yaw = pose
        curvature = arrival = self.curvature_radpm
        arrives_ns = now_ns + self._dead_ns
        steps = max(1, round((arrives_ns - stamp_ns) * 1e-9 / STEP_S))
        for k in range(steps + round(self._quick_s / STEP_S)):
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
        """Curvature after a step: κ = tan δ / L, so the wheels' rate is worth more the further they are turned."""
        share = self._step_share if step_s == STEP_S else 1.0 - math.exp(-step_s / self._lag_s)
        change = (target - curvature) * share
        most = self._steering_radps * (1.0 / self._wheelbase_m + self._wheelbase_m * curvature * curvature) * step_s
        if change > most:
            return curvature + most
        return curvature - most if change < -most else curvature + change

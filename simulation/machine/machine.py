"""The tractor: single-track model with tyre slip on uneven ground, actuators and implement."""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.site import PoseConfig
from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.arrays import Float64
from simulation.environment.terrain import Terrain
from simulation.machine.body_motion import BodyMotionConfig
from simulation.machine.drivetrain import GRAVITY_MPS2, BrakeSystem, Drive, DriveConfig, advance_speed
from simulation.machine.implement import AttachedImplement, ImplementConfig
from simulation.machine.steering import Steering, SteeringConfig, clamp, follow_lag


class TyreConfig(Config):
    """Lateral tyre model: slip angle = lateral force over weight, divided by stiffness."""

    front_stiffness: float = Field(gt=0.5, le=50.0)
    rear_stiffness: float = Field(gt=0.5, le=50.0)
    relaxation_length_m: float = Field(gt=0.0, le=5.0, description="distance over which the slip angle builds up")
    soil_lateral_sigma_mps2: float = Field(ge=0.0, le=2.0, description="sigma of the lateral soil force while working")
    soil_correlation_s: float = Field(gt=0.0, le=60.0, description="correlation time of the soil force")
    max_angle_offset_deg: float = Field(ge=0.0, le=5.0, description="largest zero error of the angle sensor")


class MachineConfig(Config):
    """Parameters of the plant; dimensions and actuators are in the vehicle file."""

    steering: SteeringConfig
    drive: DriveConfig
    tyres: TyreConfig
    implement: ImplementConfig
    body_motion: BodyMotionConfig


@dataclass(frozen=True)
class ActuatorCommand:
    """Requests of the ECUs; None releases the steering or holds hitch or fold; `speed_mps` is signed."""

    steering_angle_rad: float | None = None
    speed_mps: float = 0.0
    is_drive_enabled: bool = False
    brake_mps2: float = 0.0
    is_park_brake_set: bool = True
    hitch: float | None = None
    is_folded: bool | None = None
    is_pto_on: bool = False


class Machine:
    """State of tractor and implement; changed by `step` alone."""

    def __init__(
        self, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, terrain: Terrain, start: PoseConfig,
        is_folded: bool, config: MachineConfig, dt_s: float, random: np.random.Generator,
    ) -> None:  # fmt: skip
        self.x_m, self.y_m, self.yaw_rad = start.x_m, start.y_m, math.radians(start.heading_deg)
        self.speed_mps = self.acceleration_mps2 = self.lateral_mps = self.yaw_rate_radps = 0.0
        self.wheel_speed_mps = self.wheel_distance_m = 0.0
        self.park_brake = 1.0
        offset_deg, wheels = random.uniform(-1.0, 1.0) * config.tyres.max_angle_offset_deg, vehicle.sensors.wheels
        self.angle_offset_rad = math.radians(offset_deg - (0.0 if wheels is None else wheels.angle_zero_deg))
        self.wheelbase_m = vehicle.drivetrain.wheelbase_m
        self.steering = Steering(vehicle.steering, vehicle.drivetrain, config.steering, dt_s)
        self.drive = Drive(config.drive, vehicle.acceleration_mps2, dt_s)
        self.brakes = BrakeSystem(vehicle.brake, dt_s)
        self.attached = AttachedImplement(implement, config.implement, self.yaw_rad, is_folded, dt_s, random)
        self.vehicle, self._terrain, self._config, self._dt_s, self._random = vehicle, terrain, config, dt_s, random
        self._slip_front_rad = self._slip_rear_rad = self._soil_mps2 = 0.0
        self.T_map_base = self._ground_pose()

    @property
    def measured_angle_rad(self) -> float:
        """Front-wheel angle with the sensor's zero error, without noise."""
        return self.steering.angle_rad + self.angle_offset_rad

    def step(self, command: ActuatorCommand) -> None:
        """Advances one time step."""
        self.steering.step(command.steering_angle_rad, self.measured_angle_rad)
        self.attached.step(command.hitch, command.is_pto_on)
        if self.speed_mps == 0.0 and command.is_folded is not None:
            self.attached.step_fold(command.is_folded)
        self._step_speed(command)
        self._step_sideways()
        self._step_pose()

    def _step_speed(self, command: ActuatorCommand) -> None:
        drive, before = self._config.drive, self.speed_mps
        is_driven = command.is_drive_enabled and command.brake_mps2 <= 0.0
        traction = self.drive.step(command.speed_mps, self.wheel_speed_mps, is_driven)
        change = self._dt_s / max(drive.park_brake_s, self._dt_s)
        self.park_brake += clamp(float(command.is_park_brake_set) - self.park_brake, -change, change)
        friction = (
            drive.rolling_resistance_mps2
            + self.brakes.step(command.brake_mps2)
            + self.park_brake * drive.park_brake_mps2
        )
        friction += self.attached.draft_n() / self.vehicle.body.mass_kg
        if is_driven and command.speed_mps == 0.0 and abs(before) < 0.05:
            friction += drive.standstill_hold_mps2
        downhill = -GRAVITY_MPS2 * float(self.T_map_base[2, 0])
        self.speed_mps = advance_speed(before, traction + downhill, friction, self._dt_s)
        self.acceleration_mps2 = (self.speed_mps - before) / self._dt_s
        braking = math.copysign(self.brakes.deceleration_mps2, before)
        slip = clamp(drive.slip_per_traction * (traction - braking) / GRAVITY_MPS2, -drive.max_slip, drive.max_slip)
        circumferential_mps = self.speed_mps * (1.0 + math.copysign(1.0, before) * slip)
        self.wheel_speed_mps = circumferential_mps / (1.0 + drive.wheel_radius_error)
        self.wheel_distance_m += abs(self.wheel_speed_mps) * self._dt_s

    def _step_sideways(self) -> None:
        tyres, dt = self._config.tyres, self._dt_s
        share = math.exp(-dt / tyres.soil_correlation_s)
        white = float(self._random.standard_normal()) * tyres.soil_lateral_sigma_mps2
        self._soil_mps2 = share * self._soil_mps2 + math.sqrt(1.0 - share * share) * white
        soil = self._soil_mps2 if self.attached.is_working else 0.0
        # lateral tyre force balances centripetal force and side slope (left side high: gravity pulls to the right)
        side = self.speed_mps * self.yaw_rate_radps + GRAVITY_MPS2 * float(self.T_map_base[2, 1]) - soil
        lag = tyres.relaxation_length_m / max(abs(self.speed_mps), 1e-3)
        self._slip_front_rad = follow_lag(self._slip_front_rad, side / (GRAVITY_MPS2 * tyres.front_stiffness), lag, dt)
        self._slip_rear_rad = follow_lag(self._slip_rear_rad, side / (GRAVITY_MPS2 * tyres.rear_stiffness), lag, dt)
        travel = 1.0 if self.speed_mps >= 0.0 else -1.0
        front, rear = self.steering.angle_rad - travel * self._slip_front_rad, travel * self._slip_rear_rad
        self.lateral_mps = -self.speed_mps * math.tan(rear)
        self.yaw_rate_radps = self.speed_mps * (math.tan(front) + math.tan(rear)) / self.vehicle.drivetrain.wheelbase_m

    def _step_pose(self) -> None:
        """Midpoint rule in heading; speed is along the ground, so its horizontal part shrinks on a grade."""
        yaw = self.yaw_rad + 0.5 * self.yaw_rate_radps * self._dt_s
        ahead = self.speed_mps * math.hypot(self.T_map_base[0, 0], self.T_map_base[1, 0]) * self._dt_s
        aside = self.lateral_mps * self._dt_s
        self.x_m += ahead * math.cos(yaw) - aside * math.sin(yaw)
        self.y_m += ahead * math.sin(yaw) + aside * math.cos(yaw)
        self.yaw_rad += self.yaw_rate_radps * self._dt_s
        self.attached.follow(self.yaw_rad, self.speed_mps, self.lateral_mps, self.yaw_rate_radps)
        self.T_map_base = self._ground_pose()

    def _ground_pose(self) -> Float64:
        drivetrain = self.vehicle.drivetrain
        return self._terrain.pose_on_ground(
            self.x_m, self.y_m, self.yaw_rad, drivetrain.wheelbase_m, drivetrain.track_m
        )

"""Lateral controller: position on the path, prediction, tracking law and steering calibration."""

import math
from dataclasses import dataclass

from configs.vehicle import Vehicle, steering_rate
from control.reference import FrenetPosition, Reference
from control.scalars import clamp
from control.slip import CrabEstimate, SlipConfig, SteeringCalibration
from control.steering import MotionModel, SteeringConfig, SteeringModel
from control.tracking_law import OffsetIntegral, TrackingConfig, TrackingLaw
from geometry.angles import wrap
from geometry.pose2 import Pose2


@dataclass(frozen=True)
class VehicleSample:
    """Measured motion at `stamp_ns`: pose in map, signed speed, yaw rate, curvature of the wheel angle.

    `rise` is the sine of the angle by which the nose is raised.
    """

    stamp_ns: int
    pose: Pose2
    speed_mps: float
    yaw_rate_radps: float
    curvature_radpm: float
    rise: float = 0.0


@dataclass(frozen=True)
class SteeringOutput:
    """Position on the reference, errors in the direction of travel (left positive), commanded curvature."""

    position: FrenetPosition
    offset_m: float
    heading_error_rad: float
    curvature_radpm: float


class LateralController:
    """Curvature command along one reference."""

    def __init__(self, vehicle: Vehicle, tracking: TrackingConfig, steering: SteeringConfig, slip: SlipConfig) -> None:
        self._config = tracking
        self._min_radius_m = vehicle.drivetrain.min_turning_radius_m
        self._rate_radpmps = steering_rate(vehicle) / vehicle.drivetrain.wheelbase_m
        self._max_radpm = vehicle.drivetrain.max_curvature_radpm
        self._model = SteeringModel(vehicle, steering)
        self._crab, self._calibration = CrabEstimate(slip), SteeringCalibration(slip)
        self._integral = OffsetIntegral(tracking)
        self._reference: Reference | None = None
        self._near = 0
        self._last_ns: int | None = None

    def start(self, reference: Reference, pose: Pose2) -> None:
        """Starts a path; its position is searched near the beginning."""
        self._reference = reference
        travel = _travel_heading(pose.yaw_rad, reference.direction)
        self._near = reference.start_index(pose.x_m, pose.y_m, travel, self._config.start_window_m)

    def update(self, now_ns: int, sample: VehicleSample, is_followed: bool) -> SteeringOutput:
        """Steering command at `now_ns`; raises RuntimeError before `start`."""
        reference = self._reference
        if reference is None:
            raise RuntimeError("steering command without a path")
        elapsed_s = self._learn(sample, is_followed)
        position, self._near = self._position(reference, sample.pose, self._near)
        driven_m = abs(sample.speed_mps) * elapsed_s if is_followed else 0.0
        bias_m = self._integral.update(position.offset_m, position.curvature_radpm, driven_m)
        desired, arrival = self._desired_curvature(now_ns, reference, sample, bias_m)
        command = clamp(self._model.lead(arrival, self._calibration.wheel_curvature_radpm(desired)), self._max_radpm)
        self._model.command(now_ns, command)
        offset_m = position.offset_m + reference.deviation_m(self._near)
        return SteeringOutput(position, offset_m, wrap(position.heading_error_rad - self._crab.crab_rad), command)

    def _desired_curvature(
        self, now_ns: int, reference: Reference, sample: VehicleSample, bias_m: float
    ) -> tuple[float, float]:
        """Curvature to drive when the command takes effect, and the curvature of the wheels when it arrives."""
        sign = reference.direction
        calibration = self._calibration
        motion = MotionModel(sample.speed_mps, calibration.gain, calibration.offset_radpm, self._crab.crab_rad)
        ahead = self._model.predict(now_ns, sample.stamp_ns, sample.pose, motion)
        position, _ = self._position(reference, ahead.pose, self._near)
        law = TrackingLaw.at(self._config, abs(sample.speed_mps), self._min_radius_m, self._rate_radpmps)
        travelled = law.curvature(position.offset_m + bias_m, position.heading_error_rad, position.curvature_radpm)
        return clamp(sign * travelled, self._max_radpm), ahead.curvature_radpm

    def _position(self, reference: Reference, pose: Pose2, near: int) -> tuple[FrenetPosition, int]:
        course = _travel_heading(pose.yaw_rad + self._crab.crab_rad, reference.direction)
        return reference.locate(pose.x_m, pose.y_m, course, near)

    def _learn(self, sample: VehicleSample, is_followed: bool) -> float:
        """Updates the estimates; returns the time since the last sample, s."""
        elapsed_s = 0.0 if self._last_ns is None else max(0.0, min((sample.stamp_ns - self._last_ns) * 1e-9, 0.5))
        self._last_ns = sample.stamp_ns
        self._model.measure(sample.stamp_ns, sample.curvature_radpm, is_followed)
        self._crab.update(sample.pose, abs(sample.speed_mps) > 0.1)
        self._calibration.update(self._model.curvature_radpm, sample.yaw_rate_radps, sample.speed_mps, elapsed_s)
        return elapsed_s


def _travel_heading(heading_rad: float, direction: int) -> float:
    return heading_rad if direction > 0 else wrap(heading_rad + math.pi)

"""Steering along one reference: place on the path, prediction, law and calibration brought together."""

import math
from dataclasses import dataclass

from configs.vehicle import Vehicle, steering_rate
from control.reference import Place, Reference
from control.scalars import clamp
from control.slip import CrabEstimate, SlipConfig, SteeringCalibration
from control.steering import Motion, SteeringConfig, SteeringModel
from control.tracking_law import Law, OffsetIntegral, TrackingConfig
from geometry.angles import wrap
from geometry.pose2 import Pose2


@dataclass(frozen=True)
class Sample:
    """What is known of the machine at `stamp_ns`: pose in map, signed speed, turn rate, curvature by the wheels."""

    stamp_ns: int
    pose: Pose2
    speed_mps: float
    yaw_rate_radps: float
    curvature_radpm: float


@dataclass(frozen=True)
class Steered:
    """The place now, left of the path itself and in the direction of travel, and the wheels' curvature to command."""

    place: Place
    offset_m: float
    heading_error_rad: float
    curvature_radpm: float


class Driver:
    """Holds everything that steering remembers."""

    def __init__(self, vehicle: Vehicle, tracking: TrackingConfig, steering: SteeringConfig, slip: SlipConfig) -> None:
        self._config = tracking
        self._min_radius_m = vehicle.drivetrain.min_turning_radius_m
        self._rate_radpmps = steering_rate(vehicle) / vehicle.drivetrain.wheelbase_m
        self._most_radpm = vehicle.drivetrain.max_curvature_radpm
        self._model = SteeringModel(vehicle, steering)
        self._crab, self._calibration = CrabEstimate(slip), SteeringCalibration(slip)
        self._integral = OffsetIntegral(tracking)
        self._reference: Reference | None = None
        self._near = 0
        self._last_ns: int | None = None

    def start(self, reference: Reference, pose: Pose2) -> None:
        """Take up a new path, from near its beginning."""
        self._reference = reference
        travel = _travel_heading(pose.yaw_rad, reference.direction)
        self._near = reference.find(pose.x_m, pose.y_m, travel, self._config.start_window_m)

    def steer(self, now_ns: int, sample: Sample, is_obeyed: bool) -> Steered:
        """The command for this moment; `start` comes first."""
        reference = self._reference
        if reference is None:
            raise RuntimeError("steering without a path")
        elapsed_s = self._learn(sample, is_obeyed)
        place, self._near = self._place(reference, sample.pose, self._near)
        driven_m = abs(sample.speed_mps) * elapsed_s if is_obeyed else 0.0
        hidden_m = self._integral.update(place.offset_m, place.curvature_radpm, driven_m)
        wanted, arrival = self._wanted(now_ns, reference, sample, hidden_m)
        command = clamp(self._model.lead(arrival, self._calibration.wheels_for(wanted)), self._most_radpm)
        self._model.command(now_ns, command)
        offset_m = place.offset_m + reference.deviation_m(self._near)
        return Steered(place, offset_m, wrap(place.heading_error_rad - self._crab.crab_rad), command)

    def _wanted(self, now_ns: int, reference: Reference, sample: Sample, hidden_m: float) -> tuple[float, float]:
        """Curvature to drive when the command takes hold, and the wheels' curvature when it arrives."""
        sign = reference.direction
        calibration = self._calibration
        motion = Motion(sample.speed_mps, calibration.gain, calibration.offset_radpm, self._crab.crab_rad)
        ahead = self._model.predict(now_ns, sample.stamp_ns, sample.pose, motion)
        place, _ = self._place(reference, ahead.pose, self._near)
        law = Law.at(self._config, abs(sample.speed_mps), self._min_radius_m, self._rate_radpmps)
        travelled = law.curvature(place.offset_m + hidden_m, place.heading_error_rad, place.curvature_radpm)
        return clamp(sign * travelled, self._most_radpm), ahead.curvature_radpm

    def _place(self, reference: Reference, pose: Pose2, near: int) -> tuple[Place, int]:
        course = _travel_heading(pose.yaw_rad + self._crab.crab_rad, reference.direction)
        return reference.place(pose.x_m, pose.y_m, course, near)

    def _learn(self, sample: Sample, is_obeyed: bool) -> float:
        """Take in a sample; returns the time since the last one."""
        elapsed_s = 0.0 if self._last_ns is None else max(0.0, min((sample.stamp_ns - self._last_ns) * 1e-9, 0.5))
        self._last_ns = sample.stamp_ns
        self._model.measure(sample.stamp_ns, sample.curvature_radpm, is_obeyed)
        self._crab.update(sample.pose, abs(sample.speed_mps) > 0.1)
        self._calibration.update(self._model.curvature_radpm, sample.yaw_rate_radps, sample.speed_mps, elapsed_s)
        return elapsed_s


def _travel_heading(heading_rad: float, direction: int) -> float:
    return heading_rad if direction > 0 else wrap(heading_rad + math.pi)

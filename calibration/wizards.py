"""The calibrations by name: what each estimates from a recording."""

from collections.abc import Callable

from calibration.antenna_side import antenna_side
from calibration.hitch_time import hitch_times
from calibration.imu_level import imu_level
from calibration.lidar_mount import lidar_mount
from calibration.pto_time import pto_time
from calibration.recording import Recording
from calibration.result import CalibrationResult
from calibration.steering_range import steering_range
from calibration.steering_zero import steering_zero
from calibration.wheel_radius import wheel_radius
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle

Wizard = Callable[[Recording, Vehicle, MountedImplement | TrailedImplement], CalibrationResult]
LIDAR = "lidar_mount"
WIZARDS: dict[str, Wizard] = {
    "wheel_radius": lambda recording, vehicle, implement: wheel_radius(recording, vehicle),
    "steering_zero": lambda recording, vehicle, implement: steering_zero(recording, vehicle),
    "steering_range": lambda recording, vehicle, implement: steering_range(recording, vehicle),
    "antenna_side": lambda recording, vehicle, implement: antenna_side(recording, vehicle),
    "imu_level": lambda recording, vehicle, implement: imu_level(recording, vehicle),
    "hitch_time": lambda recording, vehicle, implement: hitch_times(recording, implement),
    "pto_time": lambda recording, vehicle, implement: pto_time(recording, implement),
}


def calibrations_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the calibrations of a vehicle; those of its lidars are `lidar_mount.NAME`."""
    return (*WIZARDS, *(f"{LIDAR}.{name}" for name in vehicle.sensors.lidar))


def calibrate(
    name: str, recording: Recording, vehicle: Vehicle, implement: MountedImplement | TrailedImplement
) -> CalibrationResult:
    """Result of a calibration by its name, for a vehicle without the sensors of its implement; raises NotEnough."""
    kind, _, sensor = name.partition(".")
    if kind == LIDAR:
        return lidar_mount(recording, vehicle, sensor)
    return WIZARDS[kind](recording, vehicle, implement)

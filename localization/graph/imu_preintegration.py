"""Preintegration of IMU steps between two keyframes, for gtsam's CombinedImuFactor."""

import math

import gtsam
import numpy as np

from configs.vehicle import Imu
from geometry.arrays import Float64
from localization.dead_reckoning.imu_track import STANDARD_GRAVITY_MPS2, ImuTrackConfig, Steps

INTEGRATION_SIGMA = 1e-4


def normal_gravity(latitude_rad: float, height_m: float) -> float:
    """Normal gravity, m/s² (Somigliana with WGS 84, free-air term for the height)."""
    s2 = math.sin(latitude_rad) ** 2
    return 9.7803253359 * (1.0 + 0.00193185265241 * s2) / math.sqrt(1.0 - 0.00669437999013 * s2) - 3.086e-6 * height_m


def gyro_density(imu: Imu, config: ImuTrackConfig) -> float:
    """Angle random walk with the configured factor, rad/√s."""
    return math.radians(imu.gyro_noise_dps_rthz) * config.gyro_noise_factor


def bias_sigmas(imu: Imu) -> tuple[float, float]:
    """Bias limits of the data sheet: accelerometer (m/s²) and gyro (rad/s)."""
    return imu.accelerometer_bias_mg * 1e-3 * STANDARD_GRAVITY_MPS2, math.radians(imu.gyro_bias_dph) / 3600.0


def imu_parameters(imu: Imu, config: ImuTrackConfig, gravity_mps2: float) -> gtsam.PreintegrationCombinedParams:
    """Noise parameters with z upwards, for samples in `base` axes with the origin at the IMU."""
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(gravity_mps2)
    bias_accelerometer, bias_gyro = (b / math.sqrt(config.bias_time_s) for b in bias_sigmas(imu))
    parameters.setAccelerometerCovariance(np.eye(3) * accelerometer_density(imu, config) ** 2)
    parameters.setGyroscopeCovariance(np.eye(3) * gyro_density(imu, config) ** 2)
    parameters.setIntegrationCovariance(np.eye(3) * INTEGRATION_SIGMA**2)
    parameters.setBiasAccCovariance(np.eye(3) * bias_accelerometer**2)
    parameters.setBiasOmegaCovariance(np.eye(3) * max(bias_gyro, 1e-9) ** 2)
    return parameters


def accelerometer_density(imu: Imu, config: ImuTrackConfig) -> float:
    """Velocity random walk with the configured factor, m/s/√s."""
    return imu.accelerometer_noise_ug_rthz * 1e-6 * STANDARD_GRAVITY_MPS2 * config.accelerometer_noise_factor


def vibration_density(steps: Steps) -> float:
    """Velocity random walk by the noise that the steps show, m/s/√s."""
    if len(steps.dt_s) < 3:
        return 0.0
    change = np.diff(steps.acceleration_mps2, axis=0)
    return math.sqrt(0.5 * float(np.max(np.mean(change**2, axis=0))) * float(np.mean(steps.dt_s)))


def preintegrate(
    parameters: gtsam.PreintegrationCombinedParams, bias: Float64, steps: Steps, density: float
) -> gtsam.PreintegratedCombinedMeasurements:
    """Preintegrates the steps with a bias (6,) of accelerometer, then gyro; `density` of the accelerometer."""
    parameters.setAccelerometerCovariance(np.eye(3) * density**2)
    total = gtsam.PreintegratedCombinedMeasurements(parameters, constant_bias(bias))
    for acceleration, rate, dt in zip(steps.acceleration_mps2, steps.rate_radps, steps.dt_s.tolist(), strict=True):
        total.integrateMeasurement(acceleration, rate, dt)
    return total


def constant_bias(bias: Float64) -> gtsam.imuBias.ConstantBias:
    """Converts a bias (6,) to gtsam."""
    return gtsam.imuBias.ConstantBias(bias[:3], bias[3:])

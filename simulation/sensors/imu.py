"""IMU model: mean specific force and angular rate over the interval that ends at the stamp, in the IMU frame."""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Imu
from geometry.arrays import Float64
from messages.message import Message
from messages.sensors import ImuSample
from simulation.machine.drivetrain import GRAVITY_MPS2
from simulation.sensors.sensor import WorldState, period_ns_of

RADPS_PER_DPH = math.pi / 180.0 / 3600.0


class ImuConfig(Config):
    """Vibration of the machine, and drift of the biases."""

    idle_vibration_mps2: float = Field(ge=0.0, le=5.0, description="sigma at standstill, engine running")
    idle_vibration_radps: float = Field(ge=0.0, le=1.0)
    driving_vibration_mps2_per_mps: float = Field(ge=0.0, le=5.0, description="sigma per speed")
    driving_vibration_radps_per_mps: float = Field(ge=0.0, le=1.0)
    bias_drift_share: float = Field(ge=0.0, le=1.0, description="bias change over `bias_drift_s`, relative to the bias")
    bias_drift_s: float = Field(gt=1.0, le=1e5)
    scale_sigma: float = Field(ge=0.0, le=0.1, description="relative error of the scale of each axis")


class ImuModel:
    """Exact mean: apart from its errors the output integrates to the true motion."""

    def __init__(self, imu: Imu, config: ImuConfig, random: np.random.Generator) -> None:
        self.topic = "imu"
        self.period_ns = period_ns_of(imu.rate_hz)
        self.latency_ns = 0
        self._imu, self._random = imu, random
        self._T_base_imu = imu.mount.T_base_sensor
        dt_s = self.period_ns * 1e-9
        self._bias_sigma = np.repeat(
            [imu.accelerometer_bias_mg * 1e-3 * GRAVITY_MPS2, imu.gyro_bias_dph * RADPS_PER_DPH], 3
        )
        self._bias = self._bias_sigma * random.standard_normal(6)
        self._bias_step = config.bias_drift_share * self._bias_sigma * math.sqrt(dt_s / config.bias_drift_s)
        density = [imu.accelerometer_noise_ug_rthz * 1e-6 * GRAVITY_MPS2, math.radians(imu.gyro_noise_dps_rthz)]
        self._sigma = np.repeat(density, 3) / math.sqrt(dt_s)
        limits = [imu.accelerometer_range_g * GRAVITY_MPS2, math.radians(imu.gyro_range_dps)]
        self._limit = np.repeat(limits, 3)
        self._idle_vibration = np.repeat([config.idle_vibration_mps2, config.idle_vibration_radps], 3)
        self._vibration_per_mps = np.repeat(
            [config.driving_vibration_mps2_per_mps, config.driving_vibration_radps_per_mps], 3
        )
        self._noise_last, self._noise_before = np.zeros(6), np.zeros(6)
        self._scale = 1.0 + config.scale_sigma * (
            random.standard_normal(6) if config.scale_sigma > 0.0 else np.zeros(6)
        )

    def sample(self, state: WorldState) -> Message:
        """True mean over the last interval with bias, vibration and noise, limited to the range."""
        steps = self.period_ns // state.poses.step_ns
        poses = [state.poses.steps_ago(k) @ self._T_base_imu for k in (steps, steps // 2, 0)]
        truth = mean_motion(poses[0], poses[1], poses[2], self.period_ns * 1e-9)
        self._bias = self._bias + self._bias_step * self._random.standard_normal(6)
        noise = self._bias + self._sigma * self._random.standard_normal(6) + self._vibration(state.machine.speed_mps)
        values = np.minimum(np.maximum(self._scale * truth + noise, -self._limit), self._limit)
        return ImuSample(state.stamp_ns, values[:3].copy(), values[3:].copy())

    def _vibration(self, speed_mps: float) -> Float64:
        """Second difference of white noise: its double integral stays bounded."""
        white = (self._idle_vibration + self._vibration_per_mps * abs(speed_mps)) * self._random.standard_normal(6)
        shake = (white - 2.0 * self._noise_last + self._noise_before) / math.sqrt(6.0)
        self._noise_last, self._noise_before = white, self._noise_last
        return np.asarray(shake)


def mean_motion(T_first: Float64, T_middle: Float64, T_last: Float64, interval_s: float) -> Float64:
    """Specific force and angular rate (6,) in the sensor frame from its poses at start, middle and end."""
    velocity_change = (T_last[:3, 3] - 2.0 * T_middle[:3, 3] + T_first[:3, 3]) / (0.5 * interval_s) ** 2
    velocity_change[2] += GRAVITY_MPS2
    force = T_middle[:3, :3].T @ velocity_change
    return np.concatenate([force, small_turn_rad(T_first[:3, :3].T @ T_last[:3, :3]) / interval_s])


def small_turn_rad(R: Float64) -> Float64:
    """Rotation vector (3,) of a rotation below 90 degrees: the antisymmetric part is axis times sine."""
    half = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = math.sqrt(float(half @ half))
    return half if sine < 1e-12 else half * (math.asin(min(sine, 1.0)) / sine)

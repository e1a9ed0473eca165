"""The continuous side: inertial unit and wheels become `odom`."""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Vehicle
from geometry.transforms import Float64, transform
from localization.dead_reckoning.dead_reckoning import Calibration, DeadReckoning, DeadReckoningConfig, PoseHistory
from localization.dead_reckoning.imu_track import InertialConfig, InertialTrack, Steps
from localization.dead_reckoning.initial_alignment import AlignmentConfig, Level, Standstill
from localization.dead_reckoning.plausibility import Plausibility, PlausibilityConfig
from localization.dead_reckoning.steering_offset import Steering, SteeringConfig
from localization.dead_reckoning.wheel_track import WheelConfig, WheelTrack
from localization.graph.imu_preintegration import gyro_density
from messages.errors import ConfigError
from messages.motion import Odometry
from messages.sensors import ImuSample, WheelSample


class MotionConfig(Config):
    """What the continuous pose needs."""

    inertial: InertialConfig
    wheels: WheelConfig
    dead_reckoning: DeadReckoningConfig
    steering: SteeringConfig
    plausibility: PlausibilityConfig
    history_s: float = Field(gt=1.0, le=60.0)
    acceleration_time_s: float = Field(gt=0.0, le=5.0, description="smoothing of the forward acceleration")


class Motion:
    """Dead reckoning with everything it remembers."""

    def __init__(self, vehicle: Vehicle, config: MotionConfig, alignment: AlignmentConfig) -> None:
        imu, wheels = vehicle.sensors.imu, vehicle.sensors.wheels
        if imu is None or wheels is None:
            raise ConfigError(f"vehicle {vehicle.name!r}: the localizer needs sensors.imu and sensors.wheels")
        self._config = config
        self.track = InertialTrack(imu, config.inertial.pull_time_s)
        self.wheels = WheelTrack(config.wheels.largest_speed_mps)
        self.standstill = Standstill(alignment)
        self.steering = Steering(config.steering, vehicle.drivetrain.wheelbase_m)
        self.plausibility = Plausibility(config.plausibility)
        self.history = PoseHistory(config.history_s)
        self.reckoning: DeadReckoning | None = None
        self.stamp_ns = 0
        self._gyro_density = gyro_density(imu, config.inertial)
        self._wheel_density = wheels.speed_sigma_mps / math.sqrt(wheels.rate_hz)
        self._rate = np.zeros(3)
        self._acceleration = 0.0
        self._angle = self._speed = 0.0

    @property
    def speed_mps(self) -> float:
        """Forward speed over ground."""
        return self._velocity()[0]

    def _velocity(self) -> tuple[float, float]:
        if self.reckoning is None or not len(self.track):
            return self._speed, 0.0
        return self.reckoning.calibration.motion(self._speed, self.track.last[6:])

    def add_inertial(self, sample: ImuSample) -> bool:
        """Takes a sample; False when it was dropped."""
        if not self.track.add(sample):
            return False
        self.plausibility.inertial.add(self.track.last[:6])
        self.standstill.watch(
            sample.stamp_ns, self.track.last[3:6], abs(self._speed) > self._config.wheels.standing_mps
        )
        return True

    def add_wheels(self, sample: WheelSample) -> bool:
        """Takes a sample; False when it was dropped."""
        previous_ns = self.wheels.last_ns if len(self.wheels) else sample.stamp_ns
        if not self.wheels.add(sample):
            return False
        self._speed, self._angle = sample.speed_mps, sample.steering_angle_rad
        self.steering.learn(self._angle, self.speed_mps, float(self._rate[2]), (sample.stamp_ns - previous_ns) * 1e-9)
        return True

    def forget_time(self) -> None:
        """Keeps pose and calibration but no sample: stamps before and after have nothing to do with each other."""
        self.track.clear()
        self.wheels.clear()
        self.history.clear()
        self.plausibility.clear()
        self.standstill.reset()

    def level(self) -> Level | None:
        """Roll, pitch and bias when the machine stands."""
        return self.standstill.level(self.track) if len(self.track) else None

    def begin(self, level: Level) -> None:
        """Starts `odom` level with yaw 0 where the machine stands."""
        pose = transform((0.0, 0.0, 0.0), (level.roll_rad, level.pitch_rad, 0.0))
        calibration = Calibration(level.gyro_bias_radps, self._config.wheels.start)
        self.reckoning = DeadReckoning(self._config.dead_reckoning, pose, calibration)
        self.resume()

    def resume(self) -> None:
        """Goes on from the newest sample."""
        assert self.reckoning is not None, "begin comes first"
        self.stamp_ns = self.track.last_ns
        self.history.add(self.stamp_ns, self.reckoning.T_odom_base)

    def advance(self) -> None:
        """Integrates up to the newest inertial sample."""
        if self.reckoning is None or self.track.last_ns <= self.stamp_ns:
            return
        steps = self.track.between(self.stamp_ns, self.track.last_ns)
        speed = self.wheels.speed_at(steps.middle_ns, self.stamp_ns) if len(self.wheels) else np.zeros(len(steps.dt_s))
        ends = self.stamp_ns + np.rint(np.cumsum(steps.dt_s) * 1e9).astype(np.int64)
        for end_ns, pose in zip(ends.tolist(), self.reckoning.advance(steps, speed), strict=True):
            self.history.add(end_ns, pose)
        self.stamp_ns = self.track.last_ns
        self._note(steps)

    def _note(self, steps: Steps) -> None:
        """Smooths the motion of these steps, and compares what unit and wheels say of it."""
        reckoning = self.reckoning
        assert reckoning is not None, "called by advance"
        up_x = float(reckoning.T_odom_base[2, 0])
        dt = float(np.sum(steps.dt_s))
        forward = float(np.mean(steps.acceleration_mps2[:, 0])) - 9.81 * up_x
        self._acceleration += min(1.0, dt / self._config.acceleration_time_s) * (forward - self._acceleration)
        self._rate = np.mean(steps.rate_radps, axis=0) - reckoning.calibration.gyro_bias_radps
        rate, curvature = float(self._rate[2]), self.steering.curvature(self._angle)
        self.plausibility.advance(self.stamp_ns, dt, (rate, forward), (self.speed_mps, curvature))

    def odometry(self, bias_sigma_radps: float, slip_sigma: Float64) -> Odometry:
        """The message for the newest sample, with what graph or data sheet say of bias and slip (4,)."""
        reckoning = self.reckoning
        assert reckoning is not None, "begin comes first"
        speed, drift = self._velocity()
        return Odometry(
            self.stamp_ns, reckoning.T_odom_base.copy(), speed, drift, self._acceleration, float(self._rate[2]),
            self.steering.curvature(self._angle), self._covariance(bias_sigma_radps, slip_sigma),
        )  # fmt: skip

    def _covariance(self, bias_sigma_radps: float, slip_sigma: Float64) -> Float64:
        """Of the motion over one second: densities as they are, biases times the second."""
        cfg, v = self._config.wheels, abs(self._speed)
        along = math.hypot(self._wheel_density, cfg.longitudinal_m_per_rts, slip_sigma[0] * v)
        turn = math.hypot(self._gyro_density, bias_sigma_radps)
        across = math.hypot(cfg.lateral_m_per_rts, slip_sigma[1] * v, 0.5 * turn * v)
        return np.diag(np.square([turn, turn, turn, along, across, cfg.vertical_m_per_rts]))

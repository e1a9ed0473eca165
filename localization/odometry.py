"""Odometry estimator: continuous pose in `odom` from IMU, wheels and steering."""

import math

import numpy as np

from configs.vehicle import Vehicle
from geometry.arrays import Float64
from geometry.transforms import planar, rpy_of, transform
from localization.config import OdometryConfig
from localization.dead_reckoning.dead_reckoning import Calibration, DeadReckoning, PoseHistory
from localization.dead_reckoning.imu_track import STANDARD_GRAVITY_MPS2, ImuTrack, Steps
from localization.dead_reckoning.inertial_speed import InertialSpeed
from localization.dead_reckoning.initial_alignment import InitialAlignmentConfig, Standstill, TiltEstimate
from localization.dead_reckoning.plausibility import Plausibility
from localization.dead_reckoning.steering_offset import SteeringOffset
from localization.dead_reckoning.wheel_track import WheelTrack
from localization.graph.imu_preintegration import gyro_density
from messages.errors import ConfigError
from messages.motion import Odometry
from messages.sensors import ImuSample, WheelSample

MIN_SPEED_MPS = 0.3  # of wheels, below which their noise hides their scale


class OdometryEstimator:
    """Dead reckoning with its measurement buffers, plausibility checks and pose history."""

    def __init__(self, vehicle: Vehicle, config: OdometryConfig, initial_alignment: InitialAlignmentConfig) -> None:
        imu, wheels = vehicle.sensors.imu, vehicle.sensors.wheels
        if imu is None:
            raise ConfigError(f"vehicle {vehicle.name!r}: the localizer needs sensors.imu")
        self._config = config
        self.track = ImuTrack(imu, config.imu)
        self.wheels = WheelTrack(config.wheels.max_speed_mps)
        self.standstill = Standstill(initial_alignment)
        self.steering_offset = SteeringOffset(config.steering_offset, vehicle.drivetrain.wheelbase_m)
        self.plausibility = Plausibility(config.plausibility)
        self.history = PoseHistory(config.history_s)
        self.dead_reckoning: DeadReckoning | None = None
        self.stamp_ns = 0
        self._gyro_density = gyro_density(imu, config.imu)
        self.inertial = InertialSpeed() if wheels is None else None
        self._wheel_density = 0.0 if wheels is None else wheels.speed_sigma_mps / math.sqrt(wheels.rate_hz)
        self._imu_base_m = imu.mount.T_base_sensor[:3, 3]
        self._rate, self._imu_mps, self._advanced_mps = np.zeros(3), 0.0, 0.0
        self._acceleration = 0.0
        self._angle, self._speed = (0.0 if wheels is not None else math.nan), 0.0

    @property
    def speed_mps(self) -> float:
        """Forward speed over ground."""
        return self._velocity()[0]

    def _velocity(self) -> tuple[float, float]:
        if self.dead_reckoning is None or not len(self.track):
            return self._speed, 0.0
        return self.dead_reckoning.calibration.velocity(self._speed, self.track.last[6:])

    def scale_at(self, stamp_ns: int, forward_mps: float, calibration: Calibration) -> float:
        """Scale of the wheels with which they give a forward speed at a time; that of the calibration at rest."""
        speed_mps = float(self.wheels.speed_at(np.zeros(1), stamp_ns)[0])
        if abs(speed_mps) < MIN_SPEED_MPS:
            return float(calibration.slip[0])
        return forward_mps / speed_mps + float(calibration.slip[2] * self.track.at(stamp_ns)[6])

    def add_imu(self, sample: ImuSample) -> bool:
        """Takes a valid sample; False when it was dropped."""
        if not self.track.add(sample):
            return False
        self.plausibility.imu.add(sample.stamp_ns, self.track.last[:6])
        self._add_inertial()
        # without wheels nothing tells rest from steady motion
        is_rolling = self.inertial is not None or abs(self._speed) > self._config.wheels.standstill_mps
        self.standstill.update(sample.stamp_ns, self.track.last[3:6], is_rolling)
        return True

    def _add_inertial(self) -> None:
        """Without wheels: the speed by the accelerometer in their place."""
        if self.inertial is None or self.dead_reckoning is None:
            return
        up_x, stamp_ns = float(self.dead_reckoning.T_odom_base[2, 0]), self.track.last_ns
        self.inertial.advance(stamp_ns, float(self.track.last[0]) - STANDARD_GRAVITY_MPS2 * up_x)
        self._speed = self.inertial.speed_mps
        self.wheels.add(WheelSample(stamp_ns, self._speed, math.nan))

    def add_wheels(self, sample: WheelSample) -> bool:
        """Takes a sample; False when it was dropped."""
        previous_ns = self.wheels.last_ns if len(self.wheels) else sample.stamp_ns
        if not self.wheels.add(sample):
            return False
        self._speed, self._angle = sample.speed_mps, sample.steering_angle_rad
        dt_s = (sample.stamp_ns - previous_ns) * 1e-9
        if math.isfinite(self._angle):
            self.steering_offset.update(self._angle, self.speed_mps, float(self._rate[2]), dt_s)
        return True

    def clear_samples(self) -> None:
        """Drops all samples after a gap or clock jump; keeps pose and calibration."""
        self.track.clear()
        self.wheels.clear()
        if self.inertial is not None:
            self.inertial.clear()
        self.history.clear()
        self.plausibility.clear()
        self.standstill.reset()

    def tilt(self) -> TiltEstimate | None:
        """Roll, pitch and bias at standstill."""
        return self.standstill.tilt(self.track) if len(self.track) else None

    def start(self, tilt: TiltEstimate) -> None:
        """Starts `odom` at the present position with yaw 0."""
        self._begin(tilt.roll_rad, tilt.pitch_rad, Calibration(tilt.gyro_bias_radps, self._config.wheels.start))
        self.resume()

    def start_in_motion(self, stamp_ns: int, T_map_base: Float64, calibration: Calibration) -> None:
        """Starts `odom` at a pose in the past: its origin with yaw 0; samples since then come with `advance`."""
        roll_rad, pitch_rad, _ = rpy_of(T_map_base).tolist()
        self._begin(roll_rad, pitch_rad, calibration)
        assert self.dead_reckoning is not None, "begun above"
        self.stamp_ns = stamp_ns
        self.history.add(stamp_ns, self.dead_reckoning.T_odom_base)

    def _begin(self, roll_rad: float, pitch_rad: float, calibration: Calibration) -> None:
        pose = transform((0.0, 0.0, 0.0), (roll_rad, pitch_rad, 0.0))
        self.dead_reckoning = DeadReckoning(self._config.dead_reckoning, pose, calibration)

    def resume(self) -> None:
        """Continues from the newest sample."""
        assert self.dead_reckoning is not None, "start comes first"
        self.stamp_ns = self.track.last_ns
        self.history.add(self.stamp_ns, self.dead_reckoning.T_odom_base)

    @property
    def gap_speed_mps(self) -> float:
        """The larger of the speeds before and after a gap; until `advance`."""
        return max(abs(self._advanced_mps), abs(self.speed_mps))

    def motion_in_gap(self, gap_s: float) -> Float64:
        """Motion of base (4, 4) in a time without samples, by the means of speed and turn rate before and after."""
        assert self.dead_reckoning is not None, "start comes first"
        if self.gap_speed_mps <= self._config.wheels.standstill_mps:
            return np.eye(4)
        rate = float(self.track.last[5]) - float(self.dead_reckoning.calibration.gyro_bias_radps[2])
        turn_rad = 0.5 * (float(self._rate[2]) + rate) * gap_s
        path_m = 0.5 * (self._advanced_mps + self.speed_mps) * gap_s
        return planar(path_m * math.cos(0.5 * turn_rad), path_m * math.sin(0.5 * turn_rad), turn_rad)

    def advance(self) -> None:
        """Integrates up to the newest IMU sample."""
        if self.dead_reckoning is None or self.track.last_ns <= self.stamp_ns:
            return
        steps = self.track.between(self.stamp_ns, self.track.last_ns)
        speed = self.wheels.speed_at(steps.middle_ns, self.stamp_ns) if len(self.wheels) else np.zeros(len(steps.dt_s))
        ends = self.stamp_ns + np.rint(np.cumsum(steps.dt_s) * 1e9).astype(np.int64)
        for end_ns, pose in zip(ends.tolist(), self.dead_reckoning.advance(steps, speed), strict=True):
            self.history.add(end_ns, pose)
        self.stamp_ns = self.track.last_ns
        self._update_motion(steps)

    def _update_motion(self, steps: Steps) -> None:
        """Updates rate and smoothed acceleration from the steps, and compares IMU with wheels."""
        dead_reckoning = self.dead_reckoning
        assert dead_reckoning is not None, "called by advance"
        up_x = float(dead_reckoning.T_odom_base[2, 0])
        dt = float(np.sum(steps.dt_s))
        forward = float(np.mean(steps.acceleration_mps2[:, 0])) - 9.81 * up_x
        self._acceleration += min(1.0, dt / self._config.acceleration_time_s) * (forward - self._acceleration)
        self._advanced_mps = self.speed_mps
        self._rate = np.mean(steps.rate_radps, axis=0) - dead_reckoning.calibration.gyro_bias_radps
        rate = float(self._rate[2])
        if self.inertial is not None:
            return
        # over a crest the IMU swings forward above the wheels
        imu_mps = float(self._rate[1] * self._imu_base_m[2] - self._rate[2] * self._imu_base_m[1])
        forward, self._imu_mps = forward - (imu_mps - self._imu_mps) / dt, imu_mps
        self.plausibility.advance(self.stamp_ns, dt, (rate, forward), (self.speed_mps, self._curvature()))

    def _curvature(self) -> float:
        """Curvature by the steering angle; of the present motion when the angle is unknown, which compares nothing."""
        if math.isfinite(self._angle):
            return self.steering_offset.curvature(self._angle)
        is_moving = abs(self.speed_mps) > self._config.wheels.standstill_mps
        return float(self._rate[2]) / self.speed_mps if is_moving else 0.0

    def message(self, bias_sigma_radps: float, slip_sigma: Float64) -> Odometry:
        """Builds the Odometry message at the newest sample, with sigmas of gyro bias and slip (4,)."""
        dead_reckoning = self.dead_reckoning
        assert dead_reckoning is not None, "start comes first"
        speed, drift = self._velocity()
        return Odometry(
            self.stamp_ns, dead_reckoning.T_odom_base.copy(), speed, drift, self._acceleration, float(self._rate[2]),
            self._curvature(), self._covariance(bias_sigma_radps, slip_sigma),
        )  # fmt: skip

    def _covariance(self, bias_sigma_radps: float, slip_sigma: Float64) -> Float64:
        """Covariance (6, 6) of the motion over 1 s: noise densities, and biases times 1 s."""
        cfg, v = self._config.wheels, abs(self._speed)
        along = math.hypot(self._wheel_density, cfg.longitudinal_m_per_rts, slip_sigma[0] * v)
        turn = math.hypot(self._gyro_density, bias_sigma_radps)
        across = math.hypot(cfg.lateral_m_per_rts, slip_sigma[1] * v, 0.5 * turn * v)
        return np.diag(np.square([turn, turn, turn, along, across, cfg.vertical_m_per_rts]))

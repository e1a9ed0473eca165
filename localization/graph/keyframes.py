"""Keyframe builder: predicts the state, gates the measurements and adds their factors to the graph."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from configs.vehicle import Imu, Vehicle
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import invert
from localization.dead_reckoning.imu_track import ImuTrack, ImuTrackConfig, Steps
from localization.dead_reckoning.initial_alignment import (
    InitialAlignmentConfig,
    InitialPosition,
    TiltEstimate,
    initial_pose,
)
from localization.dead_reckoning.wheel_track import NO_SLIP, WheelConfig, WheelTrack, displacement_columns
from localization.gnss_gate import GnssConfig, GnssGate, Position, RejectionReason
from localization.graph.factors import (
    B,
    C,
    E,
    M,
    V,
    X,
    gnss_factor,
    heading_factor,
    no_sideslip_factor,
    pose_factor,
    relative_pose_factor,
    skew,
    standstill_factor,
    velocity_factor,
    wheel_factor,
)
from localization.graph.fix_errors import FixErrors, position_factor, with_height
from localization.graph.imu_preintegration import (
    accelerometer_density,
    bias_sigmas,
    constant_bias,
    gyro_density,
    imu_parameters,
    normal_gravity,
    preintegrate,
    vibration_density,
)
from localization.graph.motion_start import Model, MotionStart, MotionStartConfig
from localization.graph.motion_window import MotionWindow
from localization.graph.smoother import Smoother, SmootherConfig, State
from localization.graph.uwb_factor import ranges_factor
from localization.lidar.pose_measurement import PoseMeasurement, PoseMeasurementConfig, agrees
from localization.separation import Course, OdometrySeparation, SeparationConfig
from localization.uwb.range_gate import RangeBatch, RangeGate

GRAVITY_SIGMA_MPS2 = 0.02
FOLLOW_S = 1.0  # in which the heading follows that of fixes after a turn: half the lag


@dataclass(frozen=True)
class LeverArms:
    """Antenna and base origin relative to the IMU, in `base` axes."""

    antenna_m: Float64
    base_m: Float64
    T_base_body: Float64

    @classmethod
    def of(cls, imu: Imu, antenna_xyz_m: tuple[float, float, float]) -> "LeverArms":
        """Lever arms from the mounts of IMU and antenna."""
        T = np.eye(4)
        T[:3, 3] = imu.mount.xyz_m
        return cls(np.array(antenna_xyz_m) - T[:3, 3], -T[:3, 3], T)


@dataclass(frozen=True)
class Velocity:
    """Horizontal velocity (2,) of the IMU in `map`, with its sigma."""

    stamp_ns: int
    mps: Float64
    sigma_mps: float


class KeyframeBuilder:
    """Builds keyframes from IMU steps, wheels, fixes, UWB ranges and lidar measurements.

    `columns` (3, 4): displacement per slip parameter before the newest keyframe, None without wheels.
    `late_rad`: error of the heading there if the stamps of fixes are as wrong as configured. `is_slipping`: whether the
    wheels contradicted the IMU before it. `headings_refused`: of the newest fixes in a row.
    """

    def __init__(
        self, vehicle: Vehicle, gravity_at: tuple[float, float], imu_track: ImuTrackConfig, wheels: WheelConfig,
        gnss: GnssConfig, smoother: SmootherConfig, initial_alignment: InitialAlignmentConfig,
        pose_measurement: PoseMeasurementConfig, range_gate: RangeGate | None,
    ) -> None:  # fmt: skip
        imu, antenna = vehicle.sensors.imu, vehicle.sensors.gnss[gnss.sensor]
        gnss = gnss.at_rate(antenna.rate_hz)
        assert imu is not None, "checked by the localizer"
        self.lever_arms = LeverArms.of(imu, antenna.mount.xyz_m)
        self._gravity = normal_gravity(*gravity_at)
        self._parameters = imu_parameters(imu, imu_track, self._gravity)
        self._bias_sigmas = bias_sigmas(imu)
        self._gyro_density = gyro_density(imu, imu_track)
        self._accelerometer_density = accelerometer_density(imu, imu_track)
        self._has_wheels, self._wheel_density = vehicle.sensors.wheels is not None, _wheel_density(vehicle)
        self.slip = wheels.start if self._has_wheels else NO_SLIP
        self._slip_sigma = wheels.start_sigma if self._has_wheels else np.full(4, wheels.drift_sigma)
        self._wheels, self._initial_alignment, self._gnss = wheels, initial_alignment, gnss
        self.gnss_gate = GnssGate(gnss)
        self.smoother, self._bend_m = Smoother(smoother), smoother.bend_m
        self._pending_factors: list[gtsam.NonlinearFactor] = []
        self.range_gate, self._pose_measurement = range_gate, pose_measurement
        self.columns: Float64 | None = None
        self.late_rad, self.is_slipping, self.headings_refused = 0.0, False, 0
        self._calibrated: tuple[int, int] | None = None  # key and stamp of the newest calibration in the graph
        self._course_at: tuple[int, int] | None = None  # the same of the newest angle of lidar odometry
        self._waiting_course: Course | None = None  # of motions that wait
        self._fix_errors = FixErrors()

    def separation(self, config: SeparationConfig) -> OdometrySeparation:
        """Separation of fixes from wheels and gyro, with the errors that the graph assumes."""
        wheels = self._wheels
        density = math.hypot(self._wheel_density, wheels.longitudinal_m_per_rts, wheels.lateral_m_per_rts)
        return OdometrySeparation(config, wheels.walk, density, self._gyro_density, self._gnss.stamp_s)

    def start(self, stamp_ns: int, tilt: TiltEstimate, position: InitialPosition) -> State:
        """Starts the graph at standstill, at the position of the fixes."""
        cfg, arm_m = self._initial_alignment, self.lever_arms.antenna_m
        heading_sigma = math.radians(cfg.heading_sigma_deg)
        tilt_sigma = math.hypot(math.radians(cfg.tilt_sigma_deg), tilt.sigma_rad)
        T = initial_pose(tilt, position, arm_m)
        J = np.eye(6)  # the antenna is known, and the body below it turns about it
        J[3:, :3], J[3:, 3:] = skew(arm_m), T[:3, :3].T
        sigmas = np.concatenate([[tilt_sigma, tilt_sigma, heading_sigma], position.sigma_m])
        return self.start_at(stamp_ns, tilt, T, J @ np.diag(sigmas**2) @ J.T)

    def start_at(self, stamp_ns: int, tilt: TiltEstimate, T_map_body: Float64, covariance: Float64) -> State:
        """Starts the graph at standstill, at a pose with covariance (6, 6), rotation then translation in the body."""
        cfg = self._initial_alignment
        accelerometer, gyro = self._bias_sigmas
        gyro = math.hypot(gyro, self._gyro_density / math.sqrt(cfg.window_s))  # drift, and noise of the mean
        gravity_sigma = math.hypot(GRAVITY_SIGMA_MPS2, tilt.sigma_rad * tilt.gravity_mps2)  # vibration is in its mean
        bias_sigma = np.repeat([math.hypot(accelerometer, gravity_sigma), gyro], 3)
        bias_sigma[:2] = accelerometer
        bias = np.concatenate([[0.0, 0.0, tilt.gravity_mps2 - self._gravity], tilt.gyro_bias_radps])
        pose_sigma = np.sqrt(np.diag(covariance))
        sigmas = np.concatenate([pose_sigma, np.full(3, cfg.velocity_sigma_mps), bias_sigma, self._slip_sigma])
        state = State(stamp_ns, T_map_body, np.zeros(3), bias, self.slip, covariance, sigmas)
        return self.restart(state)

    def motion_start(self, config: MotionStartConfig, imu: Imu, imu_track: ImuTrackConfig) -> MotionStart:
        """Start in motion with the errors that the graph assumes."""
        wheels, arms = self._wheels, self.lever_arms
        along = math.hypot(self._wheel_density, wheels.longitudinal_m_per_rts)
        density = np.array([along, wheels.lateral_m_per_rts, wheels.vertical_m_per_rts])
        model = Model(
            arms.antenna_m, arms.base_m, density, self.slip, self._slip_sigma, wheels.walk, wheels.standstill_rad,
            wheels.standstill_m, wheels.sideslip_mps, self._initial_alignment.max_tilt_deg,
        )  # fmt: skip
        window = MotionWindow(
            imu_parameters(imu, imu_track, self._gravity), self._accelerometer_density, wheels.standstill_mps,
            config.spacing_s, config.longest_s, config.keyframes,
        )  # fmt: skip
        return MotionStart(config, model, window)

    def restart(self, state: State) -> State:
        """Restarts the graph at a known state."""
        self._pending_factors.clear()
        self._calibrated, self._course_at, self._waiting_course, self.headings_refused = None, None, None, 0
        self._fix_errors.clear()
        self.smoother.start(state)
        return state

    def add_relative_pose(self, start: int, end: int, T_base: Float64, covariance: Float64, course: Course) -> None:
        """Adds a motion of base between two keyframes to the next update; covariance (6, 6) in base at its end.

        `course` is the angle of lidar odometry as known without this graph, which estimates it from there on.
        """
        key, T_base_body = self.smoother.next_key, self.lever_arms.T_base_body
        self._pending_factors.append(relative_pose_factor(start, end, key, T_base, T_base_body, covariance))
        self._waiting_course = course

    def add(
        self, stamp_ns: int, track: ImuTrack, wheels: WheelTrack, positions: list[Position],
        batch: RangeBatch | None = None, pose_measurements: Sequence[PoseMeasurement] = (), needs_ranges: bool = True,
        velocity: Velocity | None = None,
    ) -> list[RejectionReason]:  # fmt: skip
        """Adds a keyframe with the measurements since the last one; returns a rejection reason for each fix.

        All measurements have been propagated to `stamp_ns`, but a velocity, which is used if it is from then. Without
        `needs_ranges`, ranges are gated but not added.
        Raises SmootherFailure; `restart` comes next.
        """
        last = self.smoother.state
        assert last is not None, "start comes first"
        steps, dt_s = track.between(last.stamp_ns, stamp_ns), (stamp_ns - last.stamp_ns) * 1e-9
        turned_rad = abs(float(steps.rate_radps[:, 2] @ steps.dt_s))
        self.late_rad = max(self._gnss.stamp_s * turned_rad / dt_s, self.late_rad * math.exp(-dt_s / FOLLOW_S))
        density = max(self._accelerometer_density, vibration_density(steps))
        preintegrated = preintegrate(self._parameters, last.bias, steps, density)
        guess, key = self._predict(last, stamp_ns, preintegrated), self.smoother.next_key
        antenna = self._antenna(guess, dt_s, density)
        reasons = [self.gnss_gate.evaluate(position, *antenna) for position in positions]
        used = [p for p, reason in zip(positions, reasons, strict=True) if reason is RejectionReason.NONE]
        if any(self._bends(guess, position, *antenna) for position in used):
            self.smoother.relinearize()
            self._pending_factors, self._waiting_course = [], None  # of keyframes that are no longer in the graph
        factors, self._pending_factors = self._pending_factors, []
        variables: dict[int, Float64] = {}
        if self._waiting_course is not None:
            course_rad, factor = self._course_factor(key, stamp_ns, self._waiting_course)
            variables[M(key)] = np.array([course_rad])
            factors.append(factor)
        factors += self._wheel_factors(key, last, guess, steps, wheels, density)
        factors += self._fix_errors.factors(key, stamp_ns, used)
        for position in used:
            factors += self._fix_factors(key, guess, position, self.gnss_gate.has_height(position, *antenna))
        factors += self._pose_factors(key, guess, pose_measurements)
        if velocity is not None and velocity.stamp_ns == stamp_ns:
            by_stamp_mps = self._gnss.stamp_s * float(np.linalg.norm(guess.velocity_mps - last.velocity_mps)) / dt_s
            factors.append(velocity_factor(key, velocity.mps, math.hypot(velocity.sigma_mps, by_stamp_mps)))
        range_factors = self._range_factors(key, guess, batch, needs_ranges) if batch is not None else []
        imu_factor = gtsam.CombinedImuFactor(X(key - 1), V(key - 1), X(key), V(key), B(key - 1), B(key), preintegrated)
        if self._fix_errors.guess is not None:
            variables[E(key)] = self._fix_errors.guess
        if range_factors and self.range_gate is not None:
            factors += range_factors
            variables[C(key)] = self.range_gate.calibration
        self.smoother.add(guess, imu_factor, math.sqrt(dt_s) * self._wheels.walk, factors, variables)
        self._fix_errors.read(key, self.smoother)
        if M(key) in variables:
            self._course_at, self._waiting_course = (key, stamp_ns), None
        if C(key) in variables and self.range_gate is not None:
            self.range_gate.calibration, self.range_gate.calibration_covariance = self.smoother.calibration(key)
            self._calibrated = key, stamp_ns
        return reasons

    def _course_factor(self, key: int, stamp_ns: int, course: Course) -> tuple[float, gtsam.NonlinearFactor]:
        """First value of the angle of lidar odometry, and its factor to the one before or its prior."""
        before, sigma = self._course_at, gtsam.noiseModel.Isotropic.Sigma
        if before is None or not self.smoother.is_within_lag(before[0]):
            prior = sigma(1, math.sqrt(course.variance))
            return course.angle_rad, gtsam.PriorFactorVector(M(key), np.array([course.angle_rad]), prior)
        walk = sigma(1, math.sqrt(course.walk * (stamp_ns - before[1]) * 1e-9))
        factor = gtsam.BetweenFactorVector(M(before[0]), M(key), np.zeros(1), walk)
        return float(self.smoother.value(M(before[0]))[0]), factor

    def _pose_factors(
        self, key: int, guess: State, pose_measurements: Sequence[PoseMeasurement]
    ) -> list[gtsam.NonlinearFactor]:
        T_base_body = self.lever_arms.T_base_body
        A = gtsam.Pose3(invert(T_base_body)).AdjointMap()
        in_body = [PoseMeasurement(s.T_map_base @ T_base_body, A @ s.covariance @ A.T) for s in pose_measurements]
        return [
            pose_factor(key, s.T_map_base, s.covariance)
            for s in in_body
            if agrees(s, guess.T_map_body, guess.covariance, self._pose_measurement)
        ]

    def _range_factors(self, key: int, guess: State, batch: RangeBatch, is_needed: bool) -> list[gtsam.NonlinearFactor]:
        """Factors of the consistent ranges, and of their calibration to the previous keyframe or its prior."""
        range_gate = self.range_gate
        assert range_gate is not None, "a batch comes from the range gate"
        kept = range_gate.evaluate(batch, guess.T_map_body, guess.covariance)
        if not range_gate.accept(guess.stamp_ns, batch, kept) or not is_needed:
            return []
        factors: list[gtsam.NonlinearFactor]
        before, gaussian = self._calibrated, gtsam.noiseModel.Gaussian.Covariance
        walk = np.diag(range_gate.walk * (0 if before is None else guess.stamp_ns - before[1]) * 1e-9)
        if before is not None and self.smoother.is_within_lag(before[0]):
            factors = [gtsam.BetweenFactorVector(C(before[0]), C(key), np.zeros(len(walk)), gaussian(walk))]
        else:
            prior = gaussian(range_gate.calibration_covariance + walk)
            factors = [gtsam.PriorFactorVector(C(key), range_gate.calibration, prior)]
        factors.append(ranges_factor(key, range_gate.anchors_map_m, kept.arms_m, kept.rows, kept.range_m, kept.sigma_m))
        return factors

    def _predict(self, last: State, stamp_ns: int, preintegrated: gtsam.PreintegratedCombinedMeasurements) -> State:
        start = gtsam.NavState(gtsam.Pose3(last.T_map_body), last.velocity_mps)
        end = preintegrated.predict(start, constant_bias(last.bias))
        return replace(
            last, stamp_ns=stamp_ns, T_map_body=np.asarray(end.pose().matrix()), velocity_mps=np.asarray(end.velocity())
        )

    def _antenna(self, guess: State, dt_s: float, density: float) -> tuple[Float64, Float64]:
        """Predicted antenna position and its covariance (3, 3) in `map`; `density` of the accelerometer's noise."""
        R = guess.T_map_body[:3, :3]
        J = R @ np.hstack([-skew(self.lever_arms.antenna_m), np.eye(3)])
        velocity_mps = math.hypot(self._initial_alignment.velocity_sigma_mps, float(np.max(guess.sigmas[6:9])))
        growth = ((velocity_mps * dt_s) ** 2 + density**2 * dt_s**3 / 3.0) * np.eye(3)
        p = guess.T_map_body[:3, 3] + R @ self.lever_arms.antenna_m
        return p, J @ guess.covariance @ J.T + growth

    def _bends(self, guess: State, position: Position, predicted_m: Float64, covariance: Float64) -> bool:
        """Whether a fix turns and shifts the newest keyframes by more than the graph is linear."""
        J = guess.T_map_body[:2, :3] @ np.hstack([-skew(self.lever_arms.antenna_m), np.eye(3)])
        own = np.diag(position.expected_m[:2] ** 2)
        innovation_m = (position.p_map_m - predicted_m)[:2]
        step = guess.covariance @ J.T @ np.linalg.solve(covariance[:2, :2] + own, innovation_m)
        return float(np.linalg.norm(step[:3]) * np.linalg.norm(step[3:])) > self._bend_m

    def _fix_factors(self, key: int, guess: State, position: Position, has_height: bool) -> list[gtsam.NonlinearFactor]:
        arm_m = self.lever_arms.antenna_m
        factors: list[gtsam.NonlinearFactor] = [
            position_factor(key, position, arm_m, has_height)
            if position.is_estimated
            else gnss_factor(key, position.p_map_m, arm_m, with_height(position.sigma_m, position.has_height))
        ]
        if math.isfinite(position.heading_rad):
            R = guess.T_map_body
            error = wrap(position.heading_rad - math.atan2(R[1, 0], R[0, 0]))
            sigma = math.hypot(position.heading_sigma_rad, math.sqrt(guess.covariance[2, 2]))
            gate = max(self._gnss.heading_gate_sigma * sigma, math.radians(self._gnss.heading_floor_deg))
            if abs(error) <= gate + self.late_rad:
                factors.append(heading_factor(key, position.heading_rad, position.heading_sigma_rad))
                self.headings_refused = 0
            else:
                self.headings_refused += 1
        return factors

    def _wheel_factors(
        self, key: int, last: State, guess: State, steps: Steps, wheels: WheelTrack, accelerometer_density: float
    ) -> list[gtsam.NonlinearFactor]:
        cfg, self.columns, stamp_ns = self._wheels, None, guess.stamp_ns
        was_slipping, self.is_slipping = self.is_slipping, False
        if not self._has_wheels:
            rate_radps = (steps.rate_radps * steps.dt_s[:, None]).sum(axis=0) / float(steps.dt_s.sum())
            return [no_sideslip_factor(key, rate_radps, self.lever_arms.base_m, cfg.sideslip_mps)]
        if len(wheels) == 0 or stamp_ns - wheels.last_ns > cfg.max_gap_s * 1e9:
            return []
        speed = wheels.speed_at(steps.middle_ns, last.stamp_ns)
        self.columns = columns = displacement_columns(steps, speed, last.bias[3:])
        along = math.hypot(self._wheel_density, cfg.longitudinal_m_per_rts)
        density = np.array([along, cfg.lateral_m_per_rts, cfg.vertical_m_per_rts])
        dt_s = (stamp_ns - last.stamp_ns) * 1e-9
        sigma = density * math.sqrt(dt_s)
        slip_mps, max_slip_mps = self._slip_mps(last, guess, columns, dt_s), cfg.max_slip_mps
        max_slip_mps += 3.0 * accelerometer_density * math.sqrt(dt_s)
        if not was_slipping:
            max_slip_mps += 3.0 * float(np.max(last.sigmas[6:8]))
        self.is_slipping = slip_mps > max_slip_mps
        if self.is_slipping:
            sigma[0] = slip_mps
        elif float(np.max(np.abs(speed))) < cfg.standstill_mps:
            return [standstill_factor(key - 1, key, *self._standstill_sigmas(steps, last.bias[3:]))]
        return [wheel_factor(key - 1, key, columns, self.lever_arms.base_m, sigma)]

    def _standstill_sigmas(self, steps: Steps, gyro_bias_radps: Float64) -> tuple[Float64, Float64]:
        """Sigmas of rotation and translation (3,): the body swings on its tyres while the wheels stand."""
        swing = np.abs(((steps.rate_radps - gyro_bias_radps) * steps.dt_s[:, None]).sum(axis=0))[:2]
        height_m, turn = abs(float(self.lever_arms.base_m[2])), np.full(3, self._wheels.standstill_rad)
        moved_m = np.full(3, self._wheels.standstill_m)
        turn[:2] = np.hypot(turn[:2], swing)
        moved_m[:2] = np.hypot(moved_m[:2], height_m * swing[::-1])
        return turn, moved_m

    def _slip_mps(self, last: State, guess: State, columns: Float64, dt_s: float) -> float:
        """Difference of the speeds by the wheels and by the IMU from the last keyframe."""
        base = [T[:3, 3] + T[:3, :3] @ self.lever_arms.base_m for T in (last.T_map_body, guess.T_map_body)]
        moved_m = last.T_map_body[:3, :3].T @ (base[1] - base[0])
        return abs(float(moved_m[0] - (columns @ last.slip)[0])) / dt_s


def _wheel_density(vehicle: Vehicle) -> float:
    wheels = vehicle.sensors.wheels
    return 0.0 if wheels is None else wheels.speed_sigma_mps / math.sqrt(wheels.rate_hz)

"""From measurements to keyframes: predicts, gates, hands the factors to the graph."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from configs.vehicle import Imu, Vehicle
from geometry.angles import wrap
from geometry.transforms import Float64, invert
from localization.dead_reckoning.imu_track import InertialConfig, InertialTrack, Steps
from localization.dead_reckoning.initial_alignment import AlignmentConfig, Level, Placed, pose_of
from localization.dead_reckoning.wheel_track import WheelConfig, WheelTrack, displacement_columns
from localization.gnss_gate import GnssConfig, GnssGate, Position, Refusal
from localization.graph.factors import (
    B,
    C,
    V,
    X,
    gnss_factor,
    heading_factor,
    motion_factor,
    pose_factor,
    rest_factor,
    skew,
    wheel_factor,
)
from localization.graph.imu_preintegration import (
    bias_sigmas,
    constant_bias,
    gyro_density,
    imu_parameters,
    normal_gravity,
    preintegrate,
)
from localization.graph.smoother import Smoother, SmootherConfig, State
from localization.graph.uwb_factor import ranges_factor
from localization.lidar.pose_measurement import Sighting, SightingConfig, agrees
from localization.uwb.range_gate import Heard, Ranging

GRAVITY_SIGMA_MPS2 = 0.02


@dataclass(frozen=True)
class Arms:
    """Places in `base` axes seen from the IMU."""

    antenna_m: Float64
    base_m: Float64
    T_base_body: Float64

    @classmethod
    def of(cls, imu: Imu, antenna_xyz_m: tuple[float, float, float]) -> "Arms":
        """From the mounts."""
        T = np.eye(4)
        T[:3, 3] = imu.mount.xyz_m
        return cls(np.array(antenna_xyz_m) - T[:3, 3], -T[:3, 3], T)


class Fusion:
    """Makes keyframes out of inertial steps, wheels, fixes and lidar motions."""

    def __init__(
        self, vehicle: Vehicle, gravity_at: tuple[float, float], inertial: InertialConfig, wheels: WheelConfig,
        gnss: GnssConfig, smoother: SmootherConfig, alignment: AlignmentConfig, sighting: SightingConfig,
        ranging: Ranging | None,
    ) -> None:  # fmt: skip
        imu, main = vehicle.sensors.imu, vehicle.sensors.gnss["main"]
        assert imu is not None, "checked by the localizer"
        self.arms = Arms.of(imu, main.mount.xyz_m)
        self._gravity = normal_gravity(*gravity_at)
        self._parameters = imu_parameters(imu, inertial, self._gravity)
        self._bias_sigmas = bias_sigmas(imu)
        self._gyro_density = gyro_density(imu, inertial)
        self._wheel_density = _wheel_density(vehicle)
        self._wheels, self._alignment, self._gnss = wheels, alignment, gnss
        self.gate = GnssGate(gnss)
        self.smoother = Smoother(smoother)
        self._waiting: list[gtsam.NonlinearFactor] = []
        self.ranging, self._sighting = ranging, sighting
        self._calibrated: tuple[int, int] | None = None  # key and stamp of the newest calibration in the graph

    def start(self, stamp_ns: int, level: Level, placed: Placed) -> State:
        """Begins the graph at a standstill, where fixes say."""
        cfg = self._alignment
        tilt, heading = math.radians(cfg.tilt_sigma_deg), math.radians(cfg.heading_sigma_deg)
        pose_sigma = np.concatenate([[tilt, tilt, heading], placed.sigma_m])
        return self.start_at(stamp_ns, level, pose_of(level, placed, self.arms.antenna_m), pose_sigma)

    def start_at(self, stamp_ns: int, level: Level, T_map_body: Float64, pose_sigma: Float64) -> State:
        """Begins the graph at a standstill, at a pose known to sigmas (6,), rotation then translation."""
        cfg = self._alignment
        accelerometer, gyro = self._bias_sigmas
        gyro = math.hypot(
            gyro, self._gyro_density / math.sqrt(cfg.window_s)
        )  # the mean of a short while, and its drift
        bias_sigma = np.repeat([math.hypot(accelerometer, GRAVITY_SIGMA_MPS2), gyro], 3)
        bias_sigma[:2] = accelerometer
        bias = np.concatenate([[0.0, 0.0, level.gravity_mps2 - self._gravity], level.gyro_bias_radps])
        sigmas = np.concatenate([pose_sigma, np.full(3, cfg.velocity_sigma_mps), bias_sigma, self._wheels.start_sigma])
        state = State(stamp_ns, T_map_body, np.zeros(3), bias, self._wheels.start, np.diag(pose_sigma**2), sigmas)
        return self.restart(state)

    def restart(self, state: State) -> State:
        """Begins the graph anew at a known state."""
        self._waiting.clear()
        self._calibrated = None
        self.smoother.start(state)
        return state

    def add_motion(self, start: int, end: int, T_base: Float64, covariance: Float64) -> None:
        """Keeps a motion of base between two keyframes for the next update; covariance in base at its end."""
        T = invert(self.arms.T_base_body) @ T_base @ self.arms.T_base_body
        A = gtsam.Pose3(invert(self.arms.T_base_body)).AdjointMap()
        self._waiting.append(motion_factor(start, end, T, A @ covariance @ A.T))

    def keyframe(
        self, stamp_ns: int, track: InertialTrack, wheels: WheelTrack, positions: list[Position],
        heard: Heard | None = None, sightings: Sequence[Sighting] = (), needs_ranges: bool = True,
    ) -> list[Refusal]:  # fmt: skip
        """Adds a keyframe with what was measured since the last; says what spoke against each of the fixes.

        Fixes, ranges and sightings have been carried over to `stamp_ns`; ranges that it does not need are only judged.

        Raises SmootherFailure when the graph had to be rebuilt at the last state.
        """
        last = self.smoother.state
        assert last is not None, "start comes first"
        steps = track.between(last.stamp_ns, stamp_ns)
        inertial = preintegrate(self._parameters, last.bias, steps)
        guess, key = self._predict(last, stamp_ns, inertial), self.smoother.next_key
        factors, self._waiting = self._waiting, []
        factors += self._wheel_factors(key, last, stamp_ns, steps, wheels)
        antenna = self._antenna(guess, (stamp_ns - last.stamp_ns) * 1e-9)
        refusals = [self.gate.judge(position, *antenna) for position in positions]
        for position, refusal in zip(positions, refusals, strict=True):
            factors += self._fix_factors(key, guess, position) if refusal is Refusal.NONE else []
        factors += self._sighting_factors(key, guess, sightings)
        ranged = self._range_factors(key, guess, heard, needs_ranges) if heard is not None else []
        between = gtsam.CombinedImuFactor(X(key - 1), V(key - 1), X(key), V(key), B(key - 1), B(key), inertial)
        root = math.sqrt((stamp_ns - last.stamp_ns) * 1e-9)
        if not ranged or self.ranging is None:
            self.smoother.add(guess, between, root * self._wheels.walk, factors)
            return refusals
        ranging = self.ranging
        self.smoother.add(guess, between, root * self._wheels.walk, factors + ranged, ranging.calibration)
        ranging.calibration, ranging.calibration_covariance = self.smoother.calibration(key)
        self._calibrated = key, stamp_ns
        return refusals

    def _sighting_factors(self, key: int, guess: State, sightings: Sequence[Sighting]) -> list[gtsam.NonlinearFactor]:
        T_base_body = self.arms.T_base_body
        A = gtsam.Pose3(invert(T_base_body)).AdjointMap()
        seen = [Sighting(s.T_map_base @ T_base_body, A @ s.covariance @ A.T) for s in sightings]
        return [
            pose_factor(key, s.T_map_base, s.covariance)
            for s in seen
            if agrees(s, guess.T_map_body, guess.covariance, self._sighting)
        ]

    def _range_factors(self, key: int, guess: State, heard: Heard, is_needed: bool) -> list[gtsam.NonlinearFactor]:
        """Those that agree, with the calibration's own link to the keyframe before, or to what was known then."""
        ranging = self.ranging
        assert ranging is not None, "who hears has anchors"
        kept = ranging.judge(heard, guess.T_map_body, guess.covariance)
        if not ranging.accept(guess.stamp_ns, heard, kept) or not is_needed:
            return []
        factors: list[gtsam.NonlinearFactor]
        before, gaussian = self._calibrated, gtsam.noiseModel.Gaussian.Covariance
        walk = np.diag(ranging.walk * (0 if before is None else guess.stamp_ns - before[1]) * 1e-9)
        if before is not None and self.smoother.holds(before[0]):
            factors = [gtsam.BetweenFactorVector(C(before[0]), C(key), np.zeros(len(walk)), gaussian(walk))]
        else:
            known = gaussian(ranging.calibration_covariance + walk)
            factors = [gtsam.PriorFactorVector(C(key), ranging.calibration, known)]
        factors.append(ranges_factor(key, ranging.anchors_map_m, kept.arms_m, kept.rows, kept.range_m, kept.sigma_m))
        return factors

    def _predict(self, last: State, stamp_ns: int, inertial: gtsam.PreintegratedCombinedMeasurements) -> State:
        start = gtsam.NavState(gtsam.Pose3(last.T_map_body), last.velocity_mps)
        end = inertial.predict(start, constant_bias(last.bias))
        return replace(
            last, stamp_ns=stamp_ns, T_map_body=np.asarray(end.pose().matrix()), velocity_mps=np.asarray(end.velocity())
        )

    def _antenna(self, guess: State, dt_s: float) -> tuple[Float64, Float64]:
        """Predicted antenna and its covariance (3, 3) in map."""
        R = guess.T_map_body[:3, :3]
        J = R @ np.hstack([-skew(self.arms.antenna_m), np.eye(3)])
        growth = (self._alignment.velocity_sigma_mps * dt_s) ** 2 * np.eye(3)
        p = guess.T_map_body[:3, 3] + R @ self.arms.antenna_m
        return p, J @ guess.covariance @ J.T + growth

    def _fix_factors(self, key: int, guess: State, position: Position) -> list[gtsam.NonlinearFactor]:
        factors: list[gtsam.NonlinearFactor] = [
            gnss_factor(key, position.p_map_m, self.arms.antenna_m, position.sigma_m)
        ]
        if math.isfinite(position.heading_rad):
            R = guess.T_map_body
            off = wrap(position.heading_rad - math.atan2(R[1, 0], R[0, 0]))
            sigma = math.hypot(position.heading_sigma_rad, math.sqrt(guess.covariance[2, 2]))
            if abs(off) <= max(self._gnss.heading_gate_sigma * sigma, math.radians(self._gnss.heading_floor_deg)):
                factors.append(heading_factor(key, position.heading_rad, position.heading_sigma_rad))
        return factors

    def _wheel_factors(
        self, key: int, last: State, stamp_ns: int, steps: Steps, wheels: WheelTrack
    ) -> list[gtsam.NonlinearFactor]:
        cfg = self._wheels
        if len(wheels) == 0 or stamp_ns - wheels.last_ns > cfg.largest_gap_s * 1e9:
            return []
        speed = wheels.speed_at(steps.middle_ns, last.stamp_ns)
        columns = displacement_columns(steps, speed, last.bias[3:])
        stands = float(np.max(np.abs(speed))) < cfg.standing_mps
        along = math.hypot(self._wheel_density, cfg.longitudinal_m_per_rts)
        density = np.array([along, cfg.lateral_m_per_rts, cfg.vertical_m_per_rts])
        sigma = density * math.sqrt((stamp_ns - last.stamp_ns) * 1e-9)
        if stands:
            return [rest_factor(key - 1, key, cfg.standstill_rad, cfg.standstill_m)]
        return [wheel_factor(key - 1, key, columns, self.arms.base_m, sigma)]


def _wheel_density(vehicle: Vehicle) -> float:
    wheels = vehicle.sensors.wheels
    assert wheels is not None, "checked by the localizer"
    return wheels.speed_sigma_mps / math.sqrt(wheels.rate_hz)

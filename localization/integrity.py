"""Integrity: position source, output covariance and protection level."""

import math
from dataclasses import replace

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import invert
from localization.gnss_gate import Position, source_of
from localization.gnss_monitor import Finding
from localization.graph.smoother import State
from localization.lidar.pose_measurement import PoseMeasurementConfig
from messages.motion import PositionSource

BY_GNSS = (PositionSource.SINGLE, PositionSource.RTK_FLOAT, PositionSource.RTK_FIXED)
SIGMAS_95 = 2.45  # of a two-dimensional Gaussian
Metres = Field(ge=0.0, le=100.0)


class IntegrityConfig(Config):
    """Factor for 1e-4 per hour, and floors by source for errors outside the covariance (wrong fix, multipath)."""

    factor: float = Field(ge=1.0, le=10.0)
    rtk_fixed_m: float = Metres
    rtk_float_m: float = Metres
    uwb_m: float = Metres
    single_m: float = Metres
    dead_reckoning_m: float = Metres
    outage_s: float = Field(gt=0.0, le=60.0, description="longest time without an accepted fix before dead reckoning")

    def floor_m(self, source: PositionSource) -> float:
        """Floor of the protection level by source."""
        return {
            PositionSource.NONE: math.inf, PositionSource.DEAD_RECKONING: self.dead_reckoning_m,
            PositionSource.SINGLE: self.single_m, PositionSource.UWB: self.uwb_m,
            PositionSource.RTK_FLOAT: self.rtk_float_m, PositionSource.RTK_FIXED: self.rtk_fixed_m,
        }[source]  # fmt: skip


def position_source(fix: Position | None, age_s: float, is_uwb_active: bool, outage_s: float) -> PositionSource:
    """Position source: fixed ambiguities, else UWB where active, else the last fix until the outage time."""
    fixed = PositionSource.DEAD_RECKONING if fix is None or age_s > outage_s else source_of(fix.solution)
    return PositionSource.UWB if is_uwb_active and fixed is not PositionSource.RTK_FIXED else fixed


def slow_part(
    source: PositionSource, fix: Position | None, pose_measurement: PoseMeasurementConfig
) -> tuple[Float64, float]:
    """Slowly varying error of position (3,) and heading, which averaging does not remove."""
    if source is PositionSource.UWB or fix is None:
        return np.full(3, pose_measurement.slow_m), math.radians(pose_measurement.slow_deg)
    slow_m = np.zeros(3) if fix.is_estimated else fix.slow_m  # the graph's covariance has it already
    return slow_m, fix.heading_slow_rad if math.isfinite(fix.heading_rad) else 0.0


def output_covariance(
    at_body: Float64, T_base_body: Float64, slow_base: Float64, age_s: float, speed_mps: float, rate_sigma_radps: float
) -> Float64:
    """Covariance (6, 6) of base from that of the body, with slowly varying errors and growth over `age_s`.

    `slow_base` (3, 3) is the covariance of the slowly varying position error in base axes.
    """
    A = np.eye(6)
    x, y, z = T_base_body[:3, 3]
    A[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]  # adjoint of a pure translation
    out = A @ at_body @ A.T
    out[3:, 3:] += slow_base
    out[:3, :3] += np.eye(3) * (rate_sigma_radps * age_s) ** 2
    out[3:, 3:] += np.eye(3) * (0.01 * speed_mps * age_s) ** 2
    return 0.5 * (out + out.T)


def accuracy_and_level(
    covariance: Float64, T_map_base: Float64, source: PositionSource, config: IntegrityConfig
) -> tuple[float, float]:
    """Horizontal accuracy (95 %) and protection level of the fault-free case, m.

    Both are factors times the major semi-axis of the error ellipse; the level has a floor in addition.
    """
    R = T_map_base[:3, :3]
    flat = (R @ covariance[3:, 3:] @ R.T)[:2, :2]
    sigma_m = math.sqrt(max(0.0, float(np.linalg.eigvalsh(flat)[1])))
    return SIGMAS_95 * sigma_m, config.factor * sigma_m + config.floor_m(source)


def excluded(state: State, T_base_body: Float64, reference_m: Float64, finding: Finding) -> State:
    """The state without the positions that a finding excludes: base at `reference_m` (2,), calibration of before."""
    T, covariance, sigmas = state.T_map_body.copy(), state.covariance.copy(), state.sigmas.copy()
    offset_m = (T @ invert(T_base_body))[:2, 3] - reference_m
    if float(np.linalg.norm(offset_m)) > finding.separation.sigma_m:  # else the graph has not followed
        T[:2, 3] -= offset_m
    added = np.zeros((3, 3))
    added[:2, :2] = finding.separation.covariance
    covariance[3:, 3:] += T[:3, :3].T @ added @ T[:3, :3]
    sigmas[:6] = np.sqrt(np.diag(covariance))
    sigmas[6:9] = np.maximum(sigmas[6:9], finding.separation.sigma_m / max(finding.separation.age_s, 1.0))
    sigmas[15:19] = finding.slip_sigma
    return replace(state, T_map_body=T, covariance=covariance, slip=finding.slip, sigmas=sigmas)

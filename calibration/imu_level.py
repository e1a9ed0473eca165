"""Level of the IMU: upward direction by its accelerometer at standstill, at one place in both directions.

The ground tilts the machine by the opposite angle in the opposite direction; what remains is mount and zero errors.

    there  →  slope + level        back  ←  −slope + level
"""

import math
from dataclasses import dataclass

import numpy as np

from calibration.motion import base_positions
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of, weighted_mean
from calibration.steering_zero import heading_at
from calibration.tilt import levelled_rpy_deg
from configs.vehicle import Vehicle
from geometry.arrays import Float64

STILL_MPS = 1e-3
SETTLE_S = 1.0  # after the stop
BLOCK_S = 0.5
MIN_BLOCKS = 8
SAME_M = 1.0  # between the middles of the axles at both standstills
OPPOSITE_RAD = math.radians(10.0)
LEAST = 1e-4  # rad, of one block


@dataclass(frozen=True)
class _Standstill:
    """Upward direction along and across `base` in blocks of time (N, 2), with place and heading in `map`."""

    tilt: Float64
    middle_m: Float64
    heading_rad: float


def imu_level(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Roll and pitch of the IMU's mount (degrees), with the zero error of its accelerometer; raises NotEnough."""
    imu = vehicle.sensors.imu
    standstills = _standstills(recording, vehicle)
    pairs = [(a, b) for k, a in enumerate(standstills) for b in standstills[k + 1 :] if _are_opposite(a, b)]
    if imu is None or not pairs:
        raise NotEnough("standstills", float(min(1, len(standstills))), 2.0)
    a, b = max(pairs, key=lambda pair: min(len(pair[0].tilt), len(pair[1].tilt)))
    n = min(len(a.tilt), len(b.tilt))
    means = 0.5 * (a.tilt[:n] + b.tilt[:n])
    (along, sigma_along), (across, sigma_across) = (weighted_mean(means[:, k], LEAST) for k in (0, 1))
    up = np.array([along, across, math.sqrt(max(0.0, 1.0 - along**2 - across**2))])
    present, found = imu.mount.rpy_deg, levelled_rpy_deg(imu.mount, up)
    zero = imu.accelerometer_bias_mg * 1e-3
    sigmas = [math.degrees(math.hypot(one, zero)) for one in (sigma_across, sigma_along)]
    estimates = tuple(
        Estimate(f"vehicle.sensors.imu.mount.rpy_deg.{k}", float(found[k]), sigmas[k], present[k]) for k in (0, 1)
    )
    ratio = max(half_ratio(means[:, k], LEAST) for k in (0, 1))
    both = np.degrees(np.concatenate([a.tilt[:n, 0], b.tilt[:n, 0]]))
    level = math.degrees(along)
    plot = plot_of("block", "tilt", np.arange(float(len(both))), both, [(0.0, level), (len(both) - 1.0, level)])
    return CalibrationResult(estimates, ratio, plot)


def _standstills(recording: Recording, vehicle: Vehicle) -> list[_Standstill]:
    """Standstills with enough blocks and a known pose."""
    imu, base, wheel = vehicle.sensors.imu, base_positions(recording, vehicle), recording.wheel
    if imu is None or len(base) == 0 or len(wheel) < 2:
        return []
    is_still = np.concatenate([[False], np.abs(wheel[:, 1]) < STILL_MPS, [False]])
    changes = np.flatnonzero(np.diff(is_still.astype(int)))
    found = []
    for first, after in zip(changes[::2], changes[1::2], strict=True):
        start, end = wheel[first, 0] + SETTLE_S, wheel[after - 1, 0]
        tilt = _blocks(recording.imu, imu.mount.T_base_sensor[:3, :3], float(start), float(end))
        poses = base[(base[:, 0] >= start) & (base[:, 0] <= end)]
        if len(tilt) >= MIN_BLOCKS and len(poses):
            heading = heading_at(base, 0.5 * float(start + end))
            ahead = 0.5 * vehicle.drivetrain.wheelbase_m * np.array([math.cos(heading), math.sin(heading)])
            found.append(_Standstill(tilt, poses[:, 1:3].mean(axis=0) + ahead, heading))
    return found


def _blocks(imu: Float64, R_base_imu: Float64, start_s: float, end_s: float) -> Float64:
    """Mean upward direction along and across `base` in blocks of `BLOCK_S`, (N, 2)."""
    tilts = []
    for at in np.arange(start_s, end_s - BLOCK_S, BLOCK_S):
        inside = imu[(imu[:, 0] >= at) & (imu[:, 0] < at + BLOCK_S), 1:4]
        if len(inside):
            force = R_base_imu @ inside.mean(axis=0)
            tilts.append((force / np.linalg.norm(force))[:2])
    return np.array(tilts).reshape(-1, 2)


def _are_opposite(a: _Standstill, b: _Standstill) -> bool:
    turn = abs(math.remainder(a.heading_rad - b.heading_rad - math.pi, 2.0 * math.pi))
    return turn < OPPOSITE_RAD and float(np.linalg.norm(a.middle_m - b.middle_m)) < SAME_M

"""Wheel radius: distance by GNSS over distance by the wheels on straight pieces, with raised implement.

Uphill the wheels slip more, as the accelerometer shows; the radius is the one without longitudinal force on the IMU:
the rolling radius on level ground of the kind that the trial was on. The antenna moves back when the nose rises.

    distance by GNSS = (radius / present radius − slip per force · force over weight) · distance by the wheels
"""

import math

import numpy as np

from calibration.motion import Motion, antenna_of, base_positions, motion_of, smoothed, straight_pieces
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of
from configs.vehicle import Vehicle
from geometry.arrays import Float64

PIECE_M = 5.0
MIN_PIECES = 8
FIXES = 8  # of a piece
TILT_S = 3.0  # over which the force is averaged to a slope
GRAVITY_MPS2 = 9.81
SLIP_PER_FORCE, SLIP_PER_FORCE_SIGMA = 0.25, 0.25  # firm stubble 0.15, tilled soil 0.4
CORRELATED_M = 0.01  # slow error of fixes over the length of all pieces


def wheel_radius(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Rolling radius (m); raises NotEnough."""
    rows = _pieces(recording, vehicle, motion_of(recording, vehicle))
    if len(rows) < MIN_PIECES:
        raise NotEnough("straight_m", len(rows) * PIECE_M, MIN_PIECES * PIECE_M)
    at_m, ratio, force = rows.T
    noise = max(math.sqrt(2.0) * float(np.mean(recording.gnss[:, 7])) / PIECE_M, 1e-4)
    # the usual slip counts as one more measurement, so that a level trial gives a value too
    A = np.column_stack([np.ones(len(rows)), -force])
    A = np.vstack([A / noise, [0.0, 1.0 / SLIP_PER_FORCE_SIGMA]])
    solution = np.linalg.lstsq(A, np.append(ratio / noise, SLIP_PER_FORCE / SLIP_PER_FORCE_SIGMA), rcond=None)[0]
    level = ratio + solution[1] * force
    scatter = max(noise, float(np.std(level - solution[0], ddof=2)))
    formal = scatter / noise * math.sqrt(float(np.linalg.inv(A.T @ A)[0, 0]))
    sigma = math.hypot(formal, CORRELATED_M / (len(rows) * PIECE_M))
    present = vehicle.drivetrain.wheel_radius_m
    estimate = Estimate("vehicle.drivetrain.wheel_radius_m", float(solution[0]) * present, sigma * present, present)
    radius = float(solution[0]) * present
    plot = plot_of("distance", "radius", at_m, level * present, [(at_m[0], radius), (at_m[-1], radius)])
    return CalibrationResult((estimate,), half_ratio(level, noise), plot)


def _pieces(recording: Recording, vehicle: Vehicle, motion: Motion) -> Float64:
    """Distance driven before, GNSS over wheels, and longitudinal force over weight of each straight piece, (N, 3)."""
    base, imu, rows = base_positions(recording, vehicle), recording.imu, []
    if vehicle.sensors.imu is None or len(imu) == 0:
        return np.zeros((0, 3))
    along_imu, height_m = vehicle.sensors.imu.mount.T_base_sensor[0, :3], antenna_of(vehicle).xyz_m[2]
    tilt = smoothed(imu[:, 0], imu[:, 1:4] @ along_imu / GRAVITY_MPS2, TILT_S)
    for piece in straight_pieces(motion, PIECE_M):
        t = motion.t_s[piece]
        fixes = base[(base[:, 0] >= t[0]) & (base[:, 0] <= t[-1])]
        inside = (imu[:, 0] >= t[0]) & (imu[:, 0] <= t[-1])
        if len(fixes) < FIXES or not inside.any():
            continue
        wheel_m = np.interp(fixes[:, 0], motion.t_s, motion.distance_m)
        along = fixes[-1, 1:4] - fixes[0, 1:4]
        gnss_m = (fixes[:, 1:4] - fixes[0, 1:4]) @ (along / np.linalg.norm(along))
        gnss_m += height_m * np.interp(fixes[:, 0], imu[:, 0], tilt)
        force = along_imu @ imu[inside, 1:4].mean(axis=0) / GRAVITY_MPS2
        rows.append([wheel_m[0], np.polyfit(wheel_m, gnss_m, 1)[0], force])
    return np.array(rows).reshape(-1, 3)

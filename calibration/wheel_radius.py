"""Wheel radius: distance by GNSS over distance by the wheels on straight pieces, with raised implement.

It is the rolling radius on the ground of the trial, with the slip of the unloaded machine there.
"""

import numpy as np

from calibration.motion import base_positions, motion_of, straight_pieces
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of, weighted_mean
from configs.vehicle import Vehicle

PIECE_M = 5.0
MIN_PIECES = 6
FIXES = 8  # of a piece
CORRELATED_M = 0.008  # slow error of fixes over the length of all pieces


def wheel_radius(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Rolling radius (m); raises NotEnough."""
    motion, base, present = motion_of(recording, vehicle), base_positions(recording, vehicle), vehicle.drivetrain
    ratios, at_m, sigmas = [], [], []
    for piece in straight_pieces(motion, PIECE_M):
        t = motion.t_s[piece]
        fixes = base[(base[:, 0] >= t[0]) & (base[:, 0] <= t[-1])]
        if len(fixes) < FIXES:
            continue
        wheel_m = np.interp(fixes[:, 0], motion.t_s, motion.distance_m)
        along = fixes[-1, 1:4] - fixes[0, 1:4]
        gnss_m = (fixes[:, 1:4] - fixes[0, 1:4]) @ (along / np.linalg.norm(along))
        slope = np.polyfit(wheel_m, gnss_m, 1)[0]
        ratios.append(float(slope))
        at_m.append(float(wheel_m[0]))
        sigmas.append(float(np.mean(recording.gnss[:, 7])) * np.sqrt(2.0) / PIECE_M)
    if len(ratios) < MIN_PIECES:
        raise NotEnough("straight_m", len(ratios) * PIECE_M, MIN_PIECES * PIECE_M)
    values, least = np.array(ratios), float(np.mean(sigmas))
    mean, sigma = weighted_mean(values, least)
    radius_m = present.wheel_radius_m
    total = float(np.hypot(sigma, CORRELATED_M / (len(ratios) * PIECE_M)))
    estimate = Estimate("vehicle.drivetrain.wheel_radius_m", mean * radius_m, total * radius_m, radius_m)
    plot = plot_of("distance", "radius", np.array(at_m), values * radius_m, [
        (at_m[0], mean * radius_m), (at_m[-1], mean * radius_m)
    ])  # fmt: skip
    return CalibrationResult((estimate,), half_ratio(values, least), plot)

"""Steering range: the smallest radius of the rear axle that both ends of the steering allow.

A driver turns with the wheels at the left stop, then at the right one; the wider of both circles counts.
"""

import math

import numpy as np

from calibration.motion import MIN_MPS, antenna_of, fix_steps, motion_of
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of, weighted_mean
from configs.vehicle import Vehicle
from geometry.arrays import Float64

AT_STOP_RAD = math.radians(1.0)  # within the largest angle of the side
MIN_RAD = math.radians(10.0)  # of a circle
PIECE_RAD = math.radians(20.0)
MIN_PIECES = 4  # at each stop
LEAST_RADPM = 0.0005


def steering_range(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Smallest turning radius (m) of the side that turns less; raises NotEnough."""
    motion = motion_of(recording, vehicle)
    steps = fix_steps(recording, motion)
    angle = np.interp(steps[:, 0], motion.t_s, motion.angle_rad) if len(steps) else np.zeros(0)
    sides = [_curvatures(steps, sign * angle, float(antenna_of(vehicle).xyz_m[1])) for sign in (1.0, -1.0)]
    fewest = min(map(len, sides))
    if fewest < MIN_PIECES:
        needs = math.degrees(MIN_PIECES * PIECE_RAD)
        raise NotEnough("at_both_stops_deg", math.degrees(fewest * PIECE_RAD), needs)
    curvature, sigma = min(weighted_mean(np.abs(side), LEAST_RADPM) for side in sides)
    radius = 1.0 / curvature
    estimate = Estimate(
        "vehicle.drivetrain.min_turning_radius_m", radius, sigma * radius**2, vehicle.drivetrain.min_turning_radius_m
    )
    ratio = max(half_ratio(side, LEAST_RADPM) for side in sides)
    radii: Float64 = 1.0 / np.abs(np.concatenate(sides))
    turned = math.degrees(PIECE_RAD) * np.arange(len(radii), dtype=np.float64)
    line = [(0.0, radius), (float(turned[-1]), radius)]
    return CalibrationResult((estimate,), ratio, plot_of("turned", "turning_radius", turned, radii, line))


def _curvatures(steps: Float64, angle_rad: Float64, antenna_left_m: float) -> Float64:
    """Curvatures (N,), left positive, of pieces with the wheels at the stop of the side of positive angles."""
    most = float(np.max(angle_rad, initial=0.0))
    _, duration_s, turned, _, antenna_m, _ = steps.T
    moves = np.abs(antenna_m) > MIN_MPS * duration_s
    turns = np.column_stack([turned, antenna_m + antenna_left_m * turned])
    at_stop = moves & (angle_rad > max(most - AT_STOP_RAD, MIN_RAD))
    found, piece = [], np.zeros(2)
    for k, is_there in enumerate(at_stop.tolist()):
        piece = piece + turns[k] if is_there else np.zeros(2)
        if abs(piece[0]) >= PIECE_RAD:
            found.append(piece[0] / piece[1])
            piece = np.zeros(2)
    return np.array(found[1:])  # slip builds up in the first

"""Steering zero: measured angle of the front wheels less the one of the driven curvature, on straight pieces.

On a side slope a machine drives straight with turned wheels; both directions of one line cancel this.
"""

import math

import numpy as np

from calibration.motion import base_positions, motion_of, straight_pieces
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of, weighted_mean
from configs.vehicle import Vehicle

PIECE_M = 4.0
MIN_PIECES = 4  # in each direction
LEAST_RAD = math.radians(0.01)


def steering_zero(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Angle at straight wheels (degrees, left positive), beside the present zero; raises NotEnough."""
    motion, base = motion_of(recording, vehicle), base_positions(recording, vehicle)
    wheelbase_m, offsets, headings, at_m = vehicle.drivetrain.wheelbase_m, [], [], []
    for piece in straight_pieces(motion, PIECE_M):
        t, distance = motion.t_s[piece], motion.distance_m[piece]
        turned_rad = float(np.trapezoid(motion.yaw_rate_radps[piece], t))
        curvature = turned_rad / float(distance[-1] - distance[0])
        offsets.append(float(np.mean(motion.angle_rad[piece])) - math.atan(wheelbase_m * curvature))
        headings.append(heading_at(base, float(t[0])))
        at_m.append(float(distance[0]))
    values = np.array(offsets)
    groups = by_direction(np.array(headings))
    fewest = min(len(values[one]) for one in groups)
    if fewest < MIN_PIECES:
        raise NotEnough("both_directions_m", fewest * PIECE_M, MIN_PIECES * PIECE_M)
    means = [weighted_mean(values[one], LEAST_RAD) for one in groups]
    zero = 0.5 * (means[0][0] + means[1][0])
    sigma = 0.5 * math.hypot(means[0][1], means[1][1])
    wheels = vehicle.sensors.wheels
    present = 0.0 if wheels is None else wheels.angle_zero_deg
    estimate = Estimate(
        "vehicle.sensors.wheels.angle_zero_deg", present + math.degrees(zero), math.degrees(sigma), present
    )
    ratio = max(half_ratio(values[one], LEAST_RAD) for one in groups)
    line = [(at_m[0], math.degrees(zero)), (at_m[-1], math.degrees(zero))]
    return CalibrationResult((estimate,), ratio, plot_of("distance", "angle", np.array(at_m), np.degrees(values), line))


def heading_at(base: np.ndarray, t_s: float) -> float:
    """Heading of the fix nearest to a time; NaN without one."""
    if len(base) == 0:
        return math.nan
    return float(base[int(np.argmin(np.abs(base[:, 0] - t_s))), 4])


def by_direction(heading_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (N,) of the headings within 20 degrees of the first, and of those opposite to it."""
    if len(heading_rad) == 0:
        nothing = np.zeros(0, bool)
        return nothing, nothing
    away = np.cos(heading_rad - heading_rad[0])
    return away > math.cos(math.radians(20.0)), away < -math.cos(math.radians(20.0))

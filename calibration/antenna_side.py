"""Side of the GNSS antenna: it moves further than the middle of the machine in turns to the other side.

    distance of the antenna along the heading = scale · distance by the wheels − side · turned angle + slope · way

Slip and roll change circles to the left and to the right alike, and so are part of the scale; on a slope the wheels
slip more uphill.
"""

import math

import numpy as np

from calibration.motion import antenna_of, fix_steps, motion_of
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, plot_of
from configs.vehicle import Vehicle
from geometry.arrays import Float64

TURN_RADPM = 0.05  # least curvature of a turn
PIECE_RAD = math.radians(30.0)
MIN_PIECES = 6  # to each side
LEAST_M = 0.003  # standard deviation of the distance of a piece
STEP_S = 0.35  # longest between two fixes


def antenna_side(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Place of the antenna to the left of the middle of the machine (m); raises NotEnough."""
    pieces = _pieces(recording, vehicle)
    both = [pieces[sign * pieces[:, 0] > 0.0] for sign in (1.0, -1.0)]
    fewest = min(map(len, both))
    if fewest < MIN_PIECES:
        raise NotEnough("both_circles_deg", math.degrees(fewest * PIECE_RAD), math.degrees(MIN_PIECES * PIECE_RAD))
    scale, side_m, sigma = _fit(pieces)
    first, second = (_fit(np.vstack(half)) for half in zip(*(np.array_split(one, 2) for one in both), strict=True))
    key = f"vehicle.sensors.gnss.{next(iter(vehicle.sensors.gnss))}.mount.xyz_m.1"
    estimate = Estimate(key, side_m, sigma, float(antenna_of(vehicle).xyz_m[1]))
    ratio = abs(first[1] - second[1]) / math.hypot(first[2], second[2])
    turned, wheels_m, antenna_m = pieces[:, :3].T
    xs = np.degrees(np.cumsum(np.abs(turned)))
    line = [(0.0, side_m), (float(xs[-1]), side_m)]
    plot = plot_of("turned", "antenna_side", xs, (scale * wheels_m - antenna_m) / turned, line)
    return CalibrationResult((estimate,), ratio, plot)


def _fit(pieces: Float64) -> tuple[float, float, float]:
    """Scale of the wheels, side (m) and its standard deviation."""
    turned, wheels_m, antenna_m, east_m, north_m = pieces.T
    A = np.column_stack([wheels_m, -turned, east_m, north_m])
    solution = np.linalg.lstsq(A, antenna_m, rcond=None)[0]
    residuals = antenna_m - A @ solution
    noise = max(LEAST_M, math.sqrt(float(residuals @ residuals) / (len(pieces) - A.shape[1])))
    return float(solution[0]), float(solution[1]), noise * math.sqrt(float(np.linalg.inv(A.T @ A)[1, 1]))


def _pieces(recording: Recording, vehicle: Vehicle) -> Float64:
    """Turned angle, distance by the wheels, of the antenna ahead, and by the wheels east and north, of each (N, 5)."""
    _, duration_s, turned, wheels_m, antenna_m, heading = fix_steps(recording, motion_of(recording, vehicle)).T
    steps = np.column_stack([turned, wheels_m, antenna_m, wheels_m * np.cos(heading), wheels_m * np.sin(heading)])
    is_turn = (np.abs(turned) > TURN_RADPM * np.abs(wheels_m)) & (wheels_m != 0.0) & (duration_s < STEP_S)
    found, piece = [], np.zeros(5)
    for step, turns in zip(steps, is_turn.tolist(), strict=True):
        piece = piece + step if turns and step[0] * piece[0] >= 0.0 else np.zeros(5)
        if abs(piece[0]) >= PIECE_RAD:
            found.append(piece)
            piece = np.zeros(5)
    return np.array(found).reshape(-1, 5)

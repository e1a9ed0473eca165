"""Lateral offset of the GNSS antenna: its speed against that of the rear axle while turning.

    antenna left of the axle's middle by y: v_antenna = scale · v_wheels − yaw rate · y

The offset along x acts like the side slip of the tyres and cannot be separated from it.
"""

import math

import numpy as np

from calibration.motion import antenna_of, motion_of
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, plot_of
from configs.vehicle import Vehicle
from geometry.arrays import Float64

TURNING_RADPS = 0.1
MIN_TURN_S = 6.0
MIN_MPS = 0.5
FIX_S = 0.1
CORRELATED = 4.0  # fixes in a row with one error: shaking of the body


def antenna_side(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Lateral offset of the antenna (m, left positive); raises NotEnough."""
    motion, gnss = motion_of(recording, vehicle), recording.gnss[np.isfinite(recording.gnss[:, 6])]
    if len(motion.t_s) == 0:
        raise NotEnough("turn_s", 0.0, MIN_TURN_S)
    speed, rate, free = (
        np.interp(gnss[:, 0], motion.t_s, values)
        for values in (motion.speed_mps, motion.yaw_rate_radps, motion.is_free)
    )
    used = (speed > MIN_MPS) & (free > 0.99)
    gnss, speed, rate = gnss[used], speed[used], rate[used]
    turn_s = float(np.sum(np.abs(rate) > TURNING_RADPS)) * FIX_S
    if turn_s < MIN_TURN_S:
        raise NotEnough("turn_s", turn_s, MIN_TURN_S)
    along = gnss[:, 4] * np.cos(gnss[:, 6]) + gnss[:, 5] * np.sin(gnss[:, 6])
    value, sigma, scale = _fit(speed, rate, along)
    halves = [_fit(speed[k::2], rate[k::2], along[k::2]) for k in (0, 1)]
    ratio = abs(halves[0][0] - halves[1][0]) / math.hypot(halves[0][1], halves[1][1])
    present = antenna_of(vehicle).xyz_m[1]
    name = next(iter(vehicle.sensors.gnss))
    estimate = Estimate(f"vehicle.sensors.gnss.{name}.mount.xyz_m.1", value, sigma, present)
    ends = [float(rate.min()), float(rate.max())]
    line = [(end, -end * value) for end in ends]
    return CalibrationResult((estimate,), ratio, plot_of("yaw_rate", "speed_difference", rate, along - scale * speed, line))


def _fit(speed: Float64, rate: Float64, along: Float64) -> tuple[float, float, float]:
    """Offset, its standard deviation, and scale of the wheels."""
    A = np.column_stack([speed, -rate])
    solution = np.linalg.lstsq(A, along, rcond=None)[0]
    rest = along - A @ solution
    variance = float(rest @ rest) / max(1, len(along) - 2) * np.linalg.inv(A.T @ A) * CORRELATED
    return float(solution[1]), math.sqrt(float(variance[1, 1])), float(solution[0])

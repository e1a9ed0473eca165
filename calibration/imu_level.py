"""Level of the IMU: upward direction by its accelerometer on one line driven in both directions.

The ground tilts the machine by the opposite angle in the opposite direction; what remains is mount and zero errors.

    there  →  slope + level        back  ←  −slope + level
"""

import math

import numpy as np

from calibration.motion import Motion, base_positions, motion_of, straight_pieces
from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of, weighted_mean
from calibration.steering_zero import by_direction
from calibration.tilt import levelled_rpy_deg
from configs.vehicle import Imu, Vehicle
from geometry.arrays import Float64

PIECE_M = 1.5
NEAR_M = 1.0  # between places that are compared
MIN_PAIRS = 8
LEAST = 1e-4  # rad


def imu_level(recording: Recording, vehicle: Vehicle) -> CalibrationResult:
    """Roll and pitch of the IMU's mount (degrees); raises NotEnough."""
    imu, motion, base = vehicle.sensors.imu, motion_of(recording, vehicle), base_positions(recording, vehicle)
    if imu is None or len(motion.t_s) == 0:
        raise NotEnough("both_directions_m", 0.0, MIN_PAIRS * PIECE_M)
    tilts, places = _tilts(recording, imu, motion, base)
    half_m = 0.5 * vehicle.drivetrain.wheelbase_m
    # the front axle pivots: rear wheels set the roll, both axles the pitch
    roll = _paired(tilts[:, 1], places, 0.0)
    pitch = _paired(tilts[:, 0], places, half_m)
    if min(len(roll), len(pitch)) < MIN_PAIRS:
        raise NotEnough("both_directions_m", min(len(roll), len(pitch)) * PIECE_M, MIN_PAIRS * PIECE_M)
    (along, sigma_along), (across, sigma_across) = (weighted_mean(pairs[:, 1], LEAST) for pairs in (pitch, roll))
    up = np.array([along, across, math.sqrt(max(0.0, 1.0 - along**2 - across**2))])
    present, found = imu.mount.rpy_deg, levelled_rpy_deg(imu.mount, up)
    zero = imu.accelerometer_bias_mg * 1e-3
    sigmas = [math.degrees(math.hypot(one, zero)) for one in (sigma_across, sigma_along)]
    estimates = tuple(
        Estimate(f"vehicle.sensors.imu.mount.rpy_deg.{k}", float(found[k]), sigmas[k], present[k]) for k in (0, 1)
    )
    ratio = max(half_ratio(pairs[:, 1], LEAST) for pairs in (pitch, roll))
    line = [(pitch[0, 0], math.degrees(along)), (pitch[-1, 0], math.degrees(along))]
    return CalibrationResult(estimates, ratio, plot_of("place", "tilt", pitch[:, 0], np.degrees(pitch[:, 1]), line))


def _tilts(recording: Recording, imu: Imu, motion: Motion, base: Float64) -> tuple[Float64, Float64]:
    """Upward direction along and across `base` (N, 2) of short straight pieces, and x, y and heading there (N, 3)."""
    R, samples, tilts, places = imu.mount.T_base_sensor[:3, :3], recording.imu, [], []
    for piece in straight_pieces(motion, PIECE_M):
        t = motion.t_s[piece]
        inside = samples[(samples[:, 0] >= t[0]) & (samples[:, 0] <= t[-1])]
        if len(inside) < 10 or len(base) < 2:
            continue
        force = R @ inside[:, 1:4].mean(axis=0)
        force[0] -= float(np.mean(motion.acceleration_mps2[piece]))
        force[1] -= float(np.mean(motion.speed_mps[piece] * motion.yaw_rate_radps[piece]))
        tilts.append((force / np.linalg.norm(force))[:2])
        middle = 0.5 * float(t[0] + t[-1])
        k = int(np.argmin(np.abs(base[:, 0] - middle)))
        heading = base[k, 4]
        places.append([np.interp(middle, base[:, 0], base[:, 1]), np.interp(middle, base[:, 0], base[:, 2]), heading])
    return np.array(tilts).reshape(-1, 2), np.array(places).reshape(-1, 3)


def _paired(tilt: Float64, places: Float64, ahead_m: float) -> Float64:
    """Place along the line and mean of the tilt in both directions there, (N, 2), at a point ahead of `base`."""
    there, back = by_direction(places[:, 2])
    if there.sum() < 2 or back.sum() < 2:
        return np.zeros((0, 2))
    heading = places[there, 2][0]
    along = (places[:, 0] + ahead_m * np.cos(places[:, 2])) * math.cos(heading)
    along += (places[:, 1] + ahead_m * np.sin(places[:, 2])) * math.sin(heading)
    across = places[:, 1] * math.cos(heading) - places[:, 0] * math.sin(heading)
    order = np.argsort(along[back])
    s, values, aside = along[back][order], tilt[back][order], across[back][order]
    pairs = []
    for at, here, y in zip(along[there], tilt[there], across[there], strict=True):
        gap = float(np.min(np.abs(s - at)))
        if s[0] <= at <= s[-1] and gap < PIECE_M and abs(float(np.interp(at, s, aside)) - y) < NEAR_M:
            pairs.append([at, 0.5 * (here + float(np.interp(at, s, values)))])
    return np.array(pairs).reshape(-1, 2)

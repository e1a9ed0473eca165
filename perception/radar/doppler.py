"""Compensation of the machine's motion in the Doppler: speed of a target over ground along the line of sight.

A static target in direction u of a sensor with velocity v has the Doppler -u·v (away positive).
"""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Bool, Float64
from geometry.transforms import apply
from messages.motion import Odometry
from messages.sensors import RadarScan


@dataclass(frozen=True)
class Echoes:
    """The detections of one cycle, N: position (N, 3) and line of sight (N, 2) in `base`, horizontal `range_m` (N,) and
    `azimuth_rad` (N,) in `base`, speed over ground along the line of sight (N,), cross-section (N,)."""

    p_base_m: Float64
    line_of_sight: Float64
    range_m: Float64
    azimuth_rad: Float64
    radial_mps: Float64
    rcs_dbsm: Float64


def is_well_formed(scan: RadarScan) -> bool:
    """Whether all arrays have the same length and one dimension."""
    arrays = (scan.range_m, scan.azimuth_rad, scan.elevation_rad, scan.doppler_mps, scan.rcs_dbsm)
    return all(a.shape == (len(scan.range_m),) for a in arrays) if scan.range_m.ndim == 1 else False


def usable(scan: RadarScan, range_m: tuple[float, float], half_view_rad: float) -> Bool:
    """Which detections (N,) are valid and within the sensor's range and view; only elevation may be missing (NaN)."""
    finite = np.isfinite(scan.range_m) & np.isfinite(scan.azimuth_rad)
    finite &= np.isfinite(scan.doppler_mps) & np.isfinite(scan.rcs_dbsm)
    near, far = range_m
    with np.errstate(invalid="ignore"):
        inside = (scan.range_m >= near) & (scan.range_m <= far) & (np.abs(scan.azimuth_rad) <= half_view_rad)
    return np.asarray(finite & inside)


def lines_of_sight(azimuth_rad: Float64, elevation_rad: Float64) -> Float64:
    """Unit vectors (N, 3) in the sensor's frame; a missing elevation counts as 0."""
    elevation = np.where(np.isfinite(elevation_rad), elevation_rad, 0.0)
    lines, flat = np.empty((len(elevation), 3)), np.cos(elevation)
    lines[:, 0], lines[:, 1], lines[:, 2] = flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation)
    return lines


def sensor_velocity(odom: Odometry, T_base_sensor: Float64) -> Float64:
    """Velocity (3,) over ground of the sensor, in `base`, with the lever arm of the yaw rate."""
    x, y = T_base_sensor[0, 3], T_base_sensor[1, 3]
    turn = odom.yaw_rate_radps
    return np.array([odom.speed_mps - turn * y, odom.lateral_mps + turn * x, 0.0])


def to_base(scan: RadarScan, which: Bool, T_base_sensor: Float64, velocity_mps: Float64) -> Echoes:
    """Detections in `base` of a sensor with velocity `velocity_mps` (3,) in `base`."""
    lines = lines_of_sight(scan.azimuth_rad[which], scan.elevation_rad[which])
    u = lines @ T_base_sensor[:3, :3].T
    p = np.asarray(apply(T_base_sensor, lines * scan.range_m[which, None]), np.float64)
    level = np.maximum(np.hypot(u[:, 0], u[:, 1]), 1e-9)
    line_of_sight = u[:, :2] / level[:, None]
    # targets move horizontally: their speed along the slanted line is smaller by the cosine
    radial = (scan.doppler_mps[which] + u @ velocity_mps) / level
    azimuth = np.arctan2(line_of_sight[:, 1], line_of_sight[:, 0])
    return Echoes(p, line_of_sight, scan.range_m[which] * level, azimuth, radial, scan.rcs_dbsm[which].copy())


def estimate_velocity(scan: RadarScan, which: Bool, gate_mps: float, tries: int = 200) -> tuple[Float64, Bool]:
    """Horizontal velocity (2,) of the sensor in its frame from the Doppler of a static majority, and the inliers (N,).

    Kellner 2013, "Instantaneous ego-motion estimation using Doppler radar": consensus over pairs, then least squares.
    Pairs are taken at fixed strides, so that the result is reproducible. NaN with fewer than two detections.
    """
    lines = lines_of_sight(scan.azimuth_rad[which], scan.elevation_rad[which])[:, :2]
    doppler, n = scan.doppler_mps[which], int(which.sum())
    best = np.zeros(n, np.bool_)
    for k in range(tries if n >= 2 else 0):
        i, j = k * 7919 % n, (k * 7919 + 1 + k * 104729 % (n - 1)) % n
        velocity = _solve(lines[[i, j]], doppler[[i, j]])
        agrees = np.abs(doppler + lines @ velocity) <= gate_mps
        if agrees.sum() > best.sum():
            best = np.asarray(agrees)
    if best.sum() < 2:
        return np.full(2, np.nan), best
    velocity = _solve(lines[best], doppler[best])
    return velocity, np.asarray(np.abs(doppler + lines @ velocity) <= gate_mps)


def _solve(lines: Float64, doppler: Float64) -> Float64:
    # a small prior on zero keeps two parallel lines solvable
    return np.asarray(np.linalg.solve(lines.T @ lines + 1e-6 * np.eye(2), -lines.T @ doppler), np.float64)

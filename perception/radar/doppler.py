"""Doppler freed of the machine's own motion: what remains is how fast a target moves along the line of sight.

A standing target seen in direction u from a sensor that moves with v has the Doppler -u·v (away positive).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from geometry.transforms import apply
from messages.message import Float64
from messages.motion import Odometry
from messages.sensors import RadarScan

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Echoes:
    """The detections of one cycle, N: position (N, 3) and line of sight (N, 2) in `base`, level `range_m` (N,) and
    `azimuth_rad` (N,) in `base`, speed over ground along the line of sight (N,), cross-section (N,)."""

    p_base_m: Float64
    sight: Float64
    range_m: Float64
    azimuth_rad: Float64
    radial_mps: Float64
    rcs_dbsm: Float64


def is_well_formed(scan: RadarScan) -> bool:
    """Whether all arrays have the same length and one dimension."""
    arrays = (scan.range_m, scan.azimuth_rad, scan.elevation_rad, scan.doppler_mps, scan.rcs_dbsm)
    return all(a.shape == (len(scan.range_m),) for a in arrays) if scan.range_m.ndim == 1 else False


def usable(scan: RadarScan, range_m: tuple[float, float], half_view_rad: float) -> Bools:
    """Which detections (N,) are measurements within the sensor's reach; elevation alone may be missing (NaN)."""
    finite = np.isfinite(scan.range_m) & np.isfinite(scan.azimuth_rad)
    finite &= np.isfinite(scan.doppler_mps) & np.isfinite(scan.rcs_dbsm)
    near, far = range_m
    with np.errstate(invalid="ignore"):
        inside = (scan.range_m >= near) & (scan.range_m <= far) & (np.abs(scan.azimuth_rad) <= half_view_rad)
    return np.asarray(finite & inside)


def sight_lines(azimuth_rad: Float64, elevation_rad: Float64) -> Float64:
    """Unit vectors (N, 3) in the sensor's frame; a missing elevation counts as level."""
    elevation = np.where(np.isfinite(elevation_rad), elevation_rad, 0.0)
    lines, flat = np.empty((len(elevation), 3)), np.cos(elevation)
    lines[:, 0], lines[:, 1], lines[:, 2] = flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation)
    return lines


def sensor_velocity(odom: Odometry, T_base_sensor: Float64) -> Float64:
    """Velocity (3,) over ground of the place where the sensor sits, in `base`: the lever arm turns with the machine."""
    x, y = T_base_sensor[0, 3], T_base_sensor[1, 3]
    turn = odom.yaw_rate_radps
    return np.array([odom.speed_mps - turn * y, odom.lateral_mps + turn * x, 0.0])


def to_base(scan: RadarScan, which: Bools, T_base_sensor: Float64, velocity_mps: Float64) -> Echoes:
    """The chosen detections in `base`, for a sensor that moves with `velocity_mps` (3,) in `base`."""
    lines = sight_lines(scan.azimuth_rad[which], scan.elevation_rad[which])
    u = lines @ T_base_sensor[:3, :3].T
    p = np.asarray(apply(T_base_sensor, lines * scan.range_m[which, None]), np.float64)
    level = np.maximum(np.hypot(u[:, 0], u[:, 1]), 1e-9)
    sight = u[:, :2] / level[:, None]
    # a target moves level, so what the slant line sees of it is less by the cosine
    radial = (scan.doppler_mps[which] + u @ velocity_mps) / level
    azimuth = np.arctan2(sight[:, 1], sight[:, 0])
    return Echoes(p, sight, scan.range_m[which] * level, azimuth, radial, scan.rcs_dbsm[which].copy())


def estimate_velocity(scan: RadarScan, which: Bools, gate_mps: float, tries: int = 200) -> tuple[Float64, Bools]:
    """Level velocity (2,) of the sensor in its own frame from the Doppler of a standing majority, and who agrees (N,).

    Kellner 2013, "Instantaneous ego-motion estimation using Doppler radar": consensus over pairs, then least squares.
    Pairs are taken at fixed strides, so that the same scan gives the same answer. NaN with fewer than two detections.
    """
    lines = sight_lines(scan.azimuth_rad[which], scan.elevation_rad[which])[:, :2]
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
    # a little weight on zero keeps two parallel lines solvable
    return np.asarray(np.linalg.solve(lines.T @ lines + 1e-6 * np.eye(2), -lines.T @ doppler), np.float64)

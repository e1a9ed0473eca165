"""Mount of a lidar against the ground: plane through its returns from flat ground, at standstill.

The plane gives roll, pitch and height. Yaw, x and y cannot be seen on the ground.
"""

import math

import numpy as np

from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, half_ratio, plot_of, weighted_mean
from calibration.tilt import levelled_rpy_deg
from configs.vehicle import Vehicle
from geometry.arrays import Float32, Float64
from geometry.transforms import apply

MIN_SCANS = 8
MIN_POINTS = 300
SEARCH_M = 0.35  # height above the ground by the present mount
TRIMS_M = (0.35, 0.12, 0.06, 0.05)
LEAST_M, LEAST_RAD = 1e-3, 1e-4
BEAM_DEG = 0.05  # error of the elevation of a beam, by the calibration sheets of makers


def lidar_mount(recording: Recording, vehicle: Vehicle, name: str) -> CalibrationResult:
    """Roll and pitch (degrees) and height (m) of a lidar; raises NotEnough."""
    scans, mount = recording.scans.get(name, ()), vehicle.sensors.lidar[name].mount
    T = mount.T_base_sensor
    planes, bends = [], []
    for scan in scans:
        points = _in_base(T, scan)
        plane = ground_plane(points)
        if plane is not None:
            planes.append(plane)
            bends.append(_bend(points, plane))
    if len(planes) < MIN_SCANS:
        raise NotEnough("scans", len(planes), MIN_SCANS)
    found = np.array(planes)
    bent = np.mean(np.array(bends), axis=0)
    means = [weighted_mean(found[:, k], LEAST_RAD) for k in range(3)]
    slope_x, slope_y, offset = (mean for mean, _ in means)
    up = np.array([-slope_x, -slope_y, 1.0]) / math.sqrt(1.0 + slope_x**2 + slope_y**2)
    rpy = levelled_rpy_deg(mount, up)
    # distance of the lidar from the plane
    x, y, z = mount.xyz_m
    height = float((z - slope_x * x - slope_y * y - offset) * up[2])
    # the ground is bent, and no beam looks exactly where its maker says
    least = (math.radians(BEAM_DEG), math.radians(BEAM_DEG), LEAST_M)
    sigma = [
        math.sqrt(one**2 + (0.5 * float(bend)) ** 2 + error**2)
        for (_, one), bend, error in zip(means, bent, least, strict=True)
    ]
    height_sigma = math.sqrt(sigma[2] ** 2 + (x * sigma[0]) ** 2 + (y * sigma[1]) ** 2)
    key = f"vehicle.sensors.lidar.{name}.mount"
    estimates = (
        Estimate(f"{key}.rpy_deg.0", float(rpy[0]), math.degrees(sigma[1]), mount.rpy_deg[0]),
        Estimate(f"{key}.rpy_deg.1", float(rpy[1]), math.degrees(sigma[0]), mount.rpy_deg[1]),
        Estimate(f"{key}.xyz_m.2", height, height_sigma, z),
    )
    ratio = max(half_ratio(found[:, k], least_one) for k, least_one in enumerate(least))
    points = _in_base(T, scans[-1])
    near = points[np.abs(points[:, 2] - points[:, :2] @ [slope_x, slope_y] - offset) < SEARCH_M]
    ends = [float(near[:, 0].min()), float(near[:, 0].max())]
    line = [(end, slope_x * end + offset) for end in ends]
    return CalibrationResult(estimates, ratio, plot_of("ahead", "height", near[:, 0], near[:, 2], line))


def ground_plane(points_base_m: Float64) -> Float64 | None:
    """Slope along x and y and height at `base` (3,) of the ground, trimmed; None without enough returns."""
    plane = np.zeros(3)
    for trim_m in TRIMS_M:
        away = points_base_m[:, 2] - points_base_m[:, :2] @ plane[:2] - plane[2]
        inside = points_base_m[np.abs(away) < trim_m]
        if len(inside) < MIN_POINTS:
            return None
        A = np.column_stack([inside[:, :2], np.ones(len(inside))])
        plane = np.linalg.lstsq(A, inside[:, 2], rcond=None)[0]
    return np.asarray(plane)


def _bend(points_base_m: Float64, plane: Float64) -> Float64:
    """Difference (3,) between the planes of the near and of the far half of the ground: it is not flat."""
    away = points_base_m[:, 2] - points_base_m[:, :2] @ plane[:2] - plane[2]
    ground = points_base_m[np.abs(away) < TRIMS_M[-1]]
    distance = np.hypot(ground[:, 0], ground[:, 1])
    halves = [ground[distance <= np.median(distance)], ground[distance > np.median(distance)]]
    planes = [
        np.linalg.lstsq(np.column_stack([half[:, :2], np.ones(len(half))]), half[:, 2], rcond=None)[0]
        for half in halves
    ]
    return np.asarray(np.abs(planes[0] - planes[1]))


def _in_base(T_base_lidar: Float64, points: Float32) -> Float64:
    return np.asarray(apply(T_base_lidar, points.astype(np.float64)), np.float64)

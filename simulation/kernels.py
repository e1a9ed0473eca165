"""Compiled kernels: ground height, pose on the ground, pose interpolation, and rays of a lidar sweep."""

import math

import numpy as np
import numpy.typing as npt

from geometry.arrays import Float32, Float64, UInt8, UInt16
from geometry.jit import kernel
from simulation.environment.ground_kernels import COLUMNS, feature_height

UInt32 = npt.NDArray[np.uint32]
CONTACT_M = (0.5, 0.4)  # length and width of the contact area of a tractor's tyre on soil


@kernel
def height_at(x: float, y: float, profile: Float64, waves: Float64, features: Float64, field: Float64) -> float:
    """Height of the smooth ground; arrays as in `simulation.environment.terrain.Terrain`."""
    x0, y0, c, s, flat, rise_u, k_u, rise_v, k_v, zero, west, south, east, north, blend = profile
    share = 1.0
    if blend > 0.0:
        share = math.hypot(max(west - x, x - east, 0.0), max(south - y, y - north, 0.0)) / blend
        if share == 0.0:
            return 0.0
        share = min(share, 1.0)
        share = share * share * (3.0 - 2.0 * share)
    u = (x - x0) * c + (y - y0) * s
    v = (y - y0) * c - (x - x0) * s
    z = 0.5 * rise_u * (1.0 - math.cos(k_u * max(abs(u) - flat, 0.0)))
    z += 0.5 * rise_v * (1.0 - math.cos(k_v * max(abs(v) - flat, 0.0)))
    for i in range(waves.shape[0]):
        z += waves[i, 0] * math.sin(waves[i, 1] * x + waves[i, 2] * y + waves[i, 3])
    if features.shape[0] > 0:
        z += feature_height(x, y, features, field)
    return float(share * (z - zero))


@kernel
def heights_at(xy: Float64, profile: Float64, waves: Float64, features: Float64, field: Float64) -> Float64:
    """Heights at (N, 2)."""
    out = np.empty(xy.shape[0])
    for i in range(xy.shape[0]):
        out[i] = height_at(xy[i, 0], xy[i, 1], profile, waves, features, field)
    return out


@kernel
def wheel_height(
    x: float, y: float, c: float, s: float, profile: Float64, waves: Float64, features: Float64, field: Float64
) -> float:  # fmt: skip
    """Height of a wheel that rolls in the direction (c, s): the mean over the contact area where there are features."""
    if features.shape[0] == 0:
        return float(height_at(x, y, profile, waves, features, field))
    total = 0.0
    for i in range(5):
        for k in range(3):
            u, v = ((i + 0.5) / 5.0 - 0.5) * CONTACT_M[0], ((k + 0.5) / 3.0 - 0.5) * CONTACT_M[1]
            total += height_at(x + u * c - v * s, y + u * s + v * c, profile, waves, features, field)
    return total / 15.0


@kernel
def pose_on_ground(
    x: float, y: float, yaw: float, wheelbase: float, track: float, profile: Float64, waves: Float64, features: Float64,
    field: Float64,
) -> Float64:  # fmt: skip
    """Pose (4, 4) of a machine whose rear wheels and front axle centre touch the ground."""
    c, s, half = math.cos(yaw), math.sin(yaw), 0.5 * track
    fx, fy = x + wheelbase * c, y + wheelbase * s
    left = wheel_height(x - half * s, y + half * c, c, s, profile, waves, features, field)
    right = wheel_height(x + half * s, y - half * c, c, s, profile, waves, features, field)
    front = wheel_height(fx - half * s, fy + half * c, c, s, profile, waves, features, field)
    front = 0.5 * (front + wheel_height(fx + half * s, fy - half * c, c, s, profile, waves, features, field))
    rear = 0.5 * (left + right)
    pitch, roll = -math.atan2(front - rear, wheelbase), math.atan2(left - right, track)
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    T = np.eye(4)
    T[0, 0], T[0, 1], T[0, 2], T[0, 3] = c * cp, c * sp * sr - s * cr, c * sp * cr + s * sr, x
    T[1, 0], T[1, 1], T[1, 2], T[1, 3] = s * cp, s * sp * sr + c * cr, s * sp * cr - c * sr, y
    T[2, 0], T[2, 1], T[2, 2], T[2, 3] = -sp, cp * sr, cp * cr, rear
    return T


@kernel
def blend_poses(poses: Float64, steps_ago: Float64) -> Float64:
    """Poses (N, 4, 4) `steps_ago` (N,) before the first of `poses`, which are one step apart, newest first."""
    out = np.empty((steps_ago.shape[0], 4, 4))
    for n in range(steps_ago.shape[0]):
        k = int(steps_ago[n])
        share = steps_ago[n] - k
        for i in range(4):
            for j in range(4):
                out[n, i, j] = (1.0 - share) * poses[k, i, j] + share * poses[k + 1, i, j]
    return out


@kernel
def sweep_rays(T_map_lidar: Float64, directions: Float32, is_open: UInt8) -> Float32:
    """Origin and direction (N, 6) in `map` of the open rays, ring by ring.

    `T_map_lidar` (columns, 4, 4), `directions` (rings, columns, 3) in the sensor frame, `is_open` (rings, columns).
    """
    rays = np.empty((np.count_nonzero(is_open), 6), np.float32)
    n = 0
    for r in range(directions.shape[0]):
        for k in range(directions.shape[1]):
            if is_open[r, k]:
                T = T_map_lidar[k]
                for i in range(3):
                    rays[n, i] = T[i, 3]
                    d = directions[r, k]
                    rays[n, 3 + i] = T[i, 0] * d[0] + T[i, 1] * d[1] + T[i, 2] * d[2]
                n += 1
    return rays


@kernel
def rays_near_ball(rays: Float32, center: Float64, radius: float) -> UInt8:
    """Mask (N,) of rays (N, 6) that pass within `radius` of a point ahead of them."""
    out = np.zeros(rays.shape[0], np.uint8)
    for n in range(rays.shape[0]):
        along = 0.0
        square = 0.0
        for i in range(3):
            to = center[i] - rays[n, i]
            along += to * rays[n, 3 + i]
            square += to * to
        out[n] = along > -radius and square - along * along < radius * radius
    return out


@kernel
def signal_of(rays: Float32, normals: Float32, mesh: UInt32, reflectivity: Float32) -> Float32:
    """Reflectivity times cosine of incidence, (N,); a `mesh` beyond `reflectivity` takes its last value."""
    out, last = np.empty(rays.shape[0], np.float32), np.uint32(reflectivity.shape[0] - 1)
    for n in range(rays.shape[0]):
        cosine = rays[n, 3] * normals[n, 0] + rays[n, 4] * normals[n, 1] + rays[n, 5] * normals[n, 2]
        out[n] = reflectivity[min(mesh[n], last)] * abs(cosine)
    return out


@kernel
def ranges_mm(
    distance: Float32, signal: Float32, detection_draw: Float32, dust_m: Float32, noise: Float32, parameters: Float32
) -> UInt16:
    """Measured ranges (N,), 0 without a return.

    `detection_draw`: uniform random numbers; `dust_m`: range of a dust return, infinite without. `parameters`: range at
    10 % reflectivity, highest detection probability, range sigma, shortest and longest range (m), steps per m,
    mm per step.
    """
    reference_m, max_probability, sigma, low, high, per_m, step_mm = parameters
    out = np.empty(distance.shape[0], np.uint16)
    for n in range(distance.shape[0]):  # no branches: random data defeats branch prediction
        share = reference_m / max(distance[n], np.float32(0.1))
        chance = min(np.float32(10.0) * signal[n] * (share * share), max_probability)
        range_m = min(distance[n] + sigma * noise[n], dust_m[n])
        is_back = ((detection_draw[n] < chance) | (dust_m[n] < np.inf)) & (range_m >= low) & (range_m <= high)
        out[n] = np.uint16(np.rint((range_m if is_back else np.float32(0.0)) * per_m) * step_mm)
    return out


def warm() -> None:
    """Compile or load every kernel, so that no step waits for it."""
    profile, waves, one = np.zeros(15), np.zeros((1, 4)), np.zeros((1, 6), np.float32)
    features, field = np.zeros((0, COLUMNS)), np.zeros((1, 2))
    heights_at(np.zeros((1, 2)), profile, waves, features, field)
    pose_on_ground(0.0, 0.0, 0.0, 1.0, 1.0, profile, waves, features, field)
    sweep_rays(np.eye(4)[None], np.zeros((1, 1, 3), np.float32), np.ones((1, 1), np.uint8))
    rays_near_ball(one, np.zeros(3), 1.0)
    signal_of(one, np.zeros((1, 3), np.float32), np.zeros(1, np.uint32), np.zeros(1, np.float32))
    blend_poses(np.zeros((2, 4, 4)), np.zeros(1))
    ranges_mm(one[0], one[0], one[0], one[0], one[0], np.zeros(7, np.float32))

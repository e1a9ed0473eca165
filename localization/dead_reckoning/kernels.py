"""Compiled loops: dead reckoning, voxel filter, deskewing."""

import math

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.jit import kernel


@kernel
def _rotation(x: float, y: float, z: float) -> Float64:
    """Rotation matrix by Rodrigues' formula, with its series near zero."""
    a2 = x * x + y * y + z * z
    a = math.sqrt(a2)
    s, c = 1.0 - a2 / 6.0, 0.5 - a2 / 24.0
    if a > 1e-6:
        s, c = math.sin(a) / a, (1.0 - math.cos(a)) / a2
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
    return R


@kernel
def _multiply(A: Float64, B: Float64) -> Float64:
    """Product of two (3, 3), in a fixed order of sums (a BLAS need not keep one)."""
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
    return C


@kernel
def integrate(
    T: Float64, dt_s: Float64, rate_radps: Float64, speed_mps: Float64, force: Float64, now: Float64, goal: Float64,
    tilt_rad: Float64, slew_s: float, tilt_s: float, max_tilt_rate_radps: float,
) -> Float64:  # fmt: skip
    """Poses (n, 4, 4) after each of n steps from T, with tyre force (n, 2) over weight.

    `now` and `goal` (7,) are gyro bias and slip (see wheel_track.py): `now` approaches `goal`, in place; `tilt_rad`
    (3,) is the remaining rotation in the outer frame, reduced in place.
    """
    out = np.empty((dt_s.size, 4, 4))
    R, p = T[:3, :3].copy(), T[:3, 3].copy()
    for k in range(dt_s.size):
        share = min(1.0, dt_s[k] / slew_s)
        for i in range(7):
            now[i] += share * (goal[i] - now[i])
        dt, rate = dt_s[k], rate_radps[k]
        ax, ay, az = (rate[0] - now[0]) * dt, (rate[1] - now[1]) * dt, (rate[2] - now[2]) * dt
        x = (now[3] - now[5] * force[k, 0]) * speed_mps[k] * dt
        y = (now[4] - now[6] * force[k, 1]) * speed_mps[k] * dt
        # displacement plus half the rotation times it
        wx, wy, wz = x - 0.5 * az * y, y + 0.5 * az * x, 0.5 * (ax * y - ay * x)
        for i in range(3):
            p[i] += R[i, 0] * wx + R[i, 1] * wy + R[i, 2] * wz
        length = math.sqrt(tilt_rad[0] ** 2 + tilt_rad[1] ** 2 + tilt_rad[2] ** 2) / tilt_s
        part = dt / tilt_s * (max_tilt_rate_radps / length if length > max_tilt_rate_radps else 1.0)
        tilting = _rotation(tilt_rad[0] * part, tilt_rad[1] * part, tilt_rad[2] * part)
        R = _multiply(_multiply(tilting, R), _rotation(ax, ay, az))
        for i in range(3):
            tilt_rad[i] -= tilt_rad[i] * part
        out[k, :3, :3], out[k, :3, 3] = R, p
        out[k, 3, :3], out[k, 3, 3] = 0.0, 1.0
    return out


@kernel
def _first_in_voxel(points: Float64, voxel_m: float, slots: Int64) -> Int64:
    """Open addressing: `slots` (a power of two, more than the points) holds indices, -1 is empty."""
    kept, count, mask = np.empty(len(points), np.int64), 0, len(slots) - 1
    cells = np.empty((len(points), 3), np.int64)
    for i in range(len(points)):
        for j in range(3):
            cells[i, j] = math.floor(points[i, j] / voxel_m)
        slot = (cells[i, 0] * 73856093 ^ cells[i, 1] * 19349669 ^ cells[i, 2] * 83492791) & mask
        while slots[slot] >= 0:
            k = slots[slot]
            if cells[k, 0] == cells[i, 0] and cells[k, 1] == cells[i, 1] and cells[k, 2] == cells[i, 2]:
                break
            slot = (slot + 1) & mask
        if slots[slot] < 0:
            slots[slot] = i
            kept[count] = i
            count += 1
    return kept[:count]


def first_in_voxel(points_m: Float64, voxel_m: float) -> Int64:
    """Indices of the first point of each cube of edge `voxel_m`, in order; points are (N, 3)."""
    slots = np.full(1 << max(4, (2 * len(points_m)).bit_length()), -1, np.int64)
    return _first_in_voxel(points_m, voxel_m, slots)


@kernel
def move_points(points_m: Float64, share: Float64, rotation_rad: Float64, translation_m: Float64) -> Float64:
    """Points (N, 3) after shares (N,) of a small rotation (3,), to second order, and of a translation (3,)."""
    out = np.empty((len(points_m), 3))
    for i in range(len(points_m)):
        x, y, z = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        a, b, c = share[i] * rotation_rad[0], share[i] * rotation_rad[1], share[i] * rotation_rad[2]
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        out[i, 0] = x + u + 0.5 * (b * w - c * v) + share[i] * translation_m[0]
        out[i, 1] = y + v + 0.5 * (c * u - a * w) + share[i] * translation_m[1]
        out[i, 2] = z + w + 0.5 * (a * v - b * u) + share[i] * translation_m[2]
    return out


def warm_up() -> None:
    """Compiles the kernels or loads them from the cache."""
    first_in_voxel(np.zeros((1, 3)), 1.0)
    move_points(np.zeros((1, 3)), np.zeros(1), np.zeros(3), np.zeros(3))
    one, still = np.ones(1), np.zeros(7)
    integrate(np.eye(4), one, np.zeros((1, 3)), one, np.zeros((1, 2)), still, still.copy(), np.zeros(3), 1.0, 1.0, 1.0)

"""Inner loops, compiled: dead reckoning and thinning of points."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.jit import kernel
from geometry.transforms import Float64


@kernel
def _rotation(x: float, y: float, z: float) -> Any:
    """Rodrigues, with its series near zero."""
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
def _multiply(A: Any, B: Any) -> Any:
    """Of two (3, 3), in a fixed order of sums (a BLAS need not keep one)."""
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
    return C


@kernel
def _reckon(
    T: Any,
    dt: Any,
    rate: Any,
    speed: Any,
    pull: Any,
    now: Any,
    goal: Any,
    tilt: Any,
    slew: float,
    tilt_s: float,
    most: float,
) -> Any:
    out = np.empty((dt.size, 4, 4))
    R, p = T[:3, :3].copy(), T[:3, 3].copy()
    for k in range(dt.size):
        share = min(1.0, dt[k] / slew)
        for i in range(7):
            now[i] += share * (goal[i] - now[i])
        ax, ay, az = (rate[k, 0] - now[0]) * dt[k], (rate[k, 1] - now[1]) * dt[k], (rate[k, 2] - now[2]) * dt[k]
        x = (now[3] - now[5] * pull[k, 0]) * speed[k] * dt[k]
        y = (now[4] - now[6] * pull[k, 1]) * speed[k] * dt[k]
        wx, wy, wz = x - 0.5 * az * y, y + 0.5 * az * x, 0.5 * (ax * y - ay * x)  # half the turn, crossed with the way
        for i in range(3):
            p[i] += R[i, 0] * wx + R[i, 1] * wy + R[i, 2] * wz
        length = math.sqrt(tilt[0] ** 2 + tilt[1] ** 2 + tilt[2] ** 2) / tilt_s
        part = dt[k] / tilt_s * (most / length if length > most else 1.0)
        R = _multiply(_multiply(_rotation(tilt[0] * part, tilt[1] * part, tilt[2] * part), R), _rotation(ax, ay, az))
        for i in range(3):
            tilt[i] -= tilt[i] * part
        out[k, :3, :3], out[k, :3, 3] = R, p
        out[k, 3, :3], out[k, 3, 3] = 0.0, 1.0
    return out


def reckon(
    T: Float64, dt_s: Float64, rate_radps: Float64, speed_mps: Float64, pull: Float64, now: Float64, goal: Float64,
    tilt_rad: Float64, slew_s: float, tilt_s: float, largest_tilt_rate_radps: float,
) -> Float64:  # fmt: skip
    """Poses (n, 4, 4) after each of n steps from T.

    `now` and `goal` (7,) are gyro bias and slip (see wheels.py): `now` glides to `goal` in place; `tilt_rad` (3,) is
    the turn in the outer frame still to be made, reduced in place.
    """
    poses: Float64 = _reckon(
        T, dt_s, rate_radps, speed_mps, pull, now, goal, tilt_rad, slew_s, tilt_s, largest_tilt_rate_radps
    )
    return poses


@kernel
def _first_in_voxel(points: Any, voxel_m: float, slots: Any) -> Any:
    """Open addressing: `slots` (a power of two, larger than the points) holds indices, -1 is empty."""
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


def first_in_voxel(points_m: Float64, voxel_m: float) -> npt.NDArray[np.int64]:
    """Indices of the first point of each cube of edge `voxel_m`, in order; points are (N, 3)."""
    slots = np.full(1 << max(4, (2 * len(points_m)).bit_length()), -1, np.int64)
    kept: npt.NDArray[np.int64] = _first_in_voxel(points_m, voxel_m, slots)
    return kept


@kernel
def _moved_back(points: Any, share: Any, turn: Any, way: Any) -> Any:
    out = np.empty((len(points), 3))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a, b, c = share[i] * turn[0], share[i] * turn[1], share[i] * turn[2]
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        out[i, 0] = x + u + 0.5 * (b * w - c * v) + share[i] * way[0]
        out[i, 1] = y + v + 0.5 * (c * u - a * w) + share[i] * way[1]
        out[i, 2] = z + w + 0.5 * (a * v - b * u) + share[i] * way[2]
    return out


def moved_back(points_m: Float64, share: Float64, turn_rad: Float64, way_m: Float64) -> Float64:
    """Points (N, 3) after shares (N,) of a small turn (3,), to second order, and of a way (3,)."""
    moved: Float64 = _moved_back(points_m, share, turn_rad, way_m)
    return moved


def warm() -> None:
    """Compiles, or loads what an earlier run compiled."""
    first_in_voxel(np.zeros((1, 3)), 1.0)
    moved_back(np.zeros((1, 3)), np.zeros(1), np.zeros(3), np.zeros(3))
    one, still = np.ones(1), np.zeros(7)
    reckon(np.eye(4), one, np.zeros((1, 3)), one, np.zeros((1, 2)), still, still.copy(), np.zeros(3), 1.0, 1.0, 1.0)

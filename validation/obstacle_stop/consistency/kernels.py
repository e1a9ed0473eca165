"""Reduction of a scan to points in base, and to its vertical structure in the plane."""

import math

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.jit import kernel

CELL_M = 1.0  # ground cells
CELLS = 80  # per side, centred on base
VOXEL_M = 0.25
VOXELS = 320
MIN_HEIGHT_M, MAX_HEIGHT_M = 0.5, 4.0  # of structure above the lowest return within a cell and its neighbours


@kernel
def reduce_scan(
    points_m: Float32, offset_s: Float32, stride: int, T: Float64, speed_mps: float, turn_radps: float,
    rings: Float64, max_range_m: float,
) -> Float32:  # fmt: skip
    """Every `stride`-th return (M, 3) in base at the stamp, without those on the machine.

    `rings` (K, 3) are rear, front and half width of the bodies of the machine.
    """
    out = np.empty((len(points_m) // stride + 1, 3), np.float32)
    count = 0
    for k in range(0, len(points_m), stride):
        a, b, c = points_m[k, 0], points_m[k, 1], points_m[k, 2]
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        range_m = math.sqrt(a * a + b * b + c * c)
        if not (0.3 < range_m < max_range_m):
            continue
        is_own = False
        for j in range(len(rings)):
            is_own |= rings[j, 0] < x < rings[j, 1] and abs(y) < rings[j, 2]
        if is_own:
            continue
        dt = offset_s[k]
        turn = dt * turn_radps
        out[count, 0] = x - turn * y + dt * speed_mps
        out[count, 1] = y + turn * x
        out[count, 2] = z
        count += 1
    return out[:count]


@kernel
def structure_of(points_m: Float32) -> Float64:
    """Means (K, 2) of voxels with returns well above the lowest return around them: walls, trunks, poles, bushes.

    Ground is left out: its rings look the same at every position, so that matching them gives no motion.
    """
    half = 0.5 * CELLS * CELL_M
    lowest = np.full((CELLS + 2, CELLS + 2), np.float32(1e9))
    for k in range(len(points_m)):
        i, j = int((points_m[k, 0] + half) / CELL_M) + 1, int((points_m[k, 1] + half) / CELL_M) + 1
        if abs(points_m[k, 0]) < half and abs(points_m[k, 1]) < half:
            lowest[i, j] = min(lowest[i, j], points_m[k, 2])
    sums = np.zeros((VOXELS, VOXELS, 3), np.float32)
    used = np.empty(len(points_m), np.int32)
    count = 0
    for k in range(len(points_m)):
        x, y, z = points_m[k]
        if abs(x) >= half or abs(y) >= half:
            continue
        i, j = int((x + half) / CELL_M) + 1, int((y + half) / CELL_M) + 1
        base = lowest[i - 1 : i + 2, j - 1 : j + 2].min()
        if not (MIN_HEIGHT_M < z - base < MAX_HEIGHT_M):
            continue
        u, v = int((x + half) / VOXEL_M), int((y + half) / VOXEL_M)
        if sums[u, v, 2] == 0.0:
            used[count] = u * VOXELS + v
            count += 1
        sums[u, v, 0] += x
        sums[u, v, 1] += y
        sums[u, v, 2] += 1.0
    out = np.empty((count, 2))
    for k in range(count):
        s = sums[used[k] // VOXELS, used[k] % VOXELS]
        out[k, 0], out[k, 1] = s[0] / s[2], s[1] / s[2]
    return out

"""Planar registration of the structure of two scans, and in which directions it determines the motion.

Point to line (to point where the surroundings have no direction), with Cauchy weights, by Gauss-Newton (Segal,
Haehnel, Thrun 2009: generalized ICP). `inlier_share` at other motions shows whether a motion is determined: a share
that does not fall when the scan is displaced means that this direction is not observable.
"""

import math

import numpy as np

from geometry.arrays import Float64, Int32
from geometry.jit import kernel

CELL_M = 0.8
CELLS = 102
HALF_M = 0.5 * CELL_M * CELLS
INLIER_M = 0.2
MAX_ITERATIONS = 25
MAX_POINTS = 1500


@kernel
def sort_into_cells(xy_m: Float64) -> tuple[Int32, Int32]:
    """Starts (CELLS² + 1,) and order (N,) of the points (N, 2) by cell."""
    cell = np.empty(len(xy_m), np.int32)
    starts = np.zeros(CELLS * CELLS + 1, np.int32)
    for k in range(len(xy_m)):
        i, j = int((xy_m[k, 0] + HALF_M) / CELL_M), int((xy_m[k, 1] + HALF_M) / CELL_M)
        cell[k] = min(max(i, 0), CELLS - 1) * CELLS + min(max(j, 0), CELLS - 1)
        starts[cell[k] + 1] += 1
    starts = np.cumsum(starts).astype(np.int32)
    place, order = starts.copy(), np.empty(len(xy_m), np.int32)
    for k in range(len(xy_m)):
        order[place[cell[k]]] = k
        place[cell[k]] += 1
    return starts, order


@kernel
def _nearest(x: float, y: float, xy_m: Float64, starts: Int32, order: Int32) -> tuple[int, float]:
    """Index of the nearest point and its squared distance; −1 when none lies in the cells around."""
    i, j = int((x + HALF_M) / CELL_M), int((y + HALF_M) / CELL_M)
    best, best_d2 = -1, 1e9
    if i < 1 or j < 1 or i >= CELLS - 1 or j >= CELLS - 1:
        return best, best_d2
    for a in range(i - 1, i + 2):
        for n in range(starts[a * CELLS + j - 1], starts[a * CELLS + j + 2]):
            k = order[n]
            dx, dy = xy_m[k, 0] - x, xy_m[k, 1] - y
            d2 = dx * dx + dy * dy
            if d2 < best_d2:
                best, best_d2 = k, d2
    return best, best_d2


@kernel
def normals_of(xy_m: Float64, starts: Int32, order: Int32) -> Float64:
    """Per point (N, 3): unit normal of the line through its surroundings, and how much of a line it is (0 to 1)."""
    out = np.zeros((len(xy_m), 3))
    for k in range(len(xy_m)):
        x, y = xy_m[k]
        i, j = int((x + HALF_M) / CELL_M), int((y + HALF_M) / CELL_M)
        n, sx, sy, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for a in range(max(i - 1, 0), min(i + 2, CELLS)):
            for m in range(starts[a * CELLS + max(j - 1, 0)], starts[a * CELLS + min(j + 2, CELLS)]):
                dx, dy = xy_m[order[m], 0] - x, xy_m[order[m], 1] - y
                if dx * dx + dy * dy < CELL_M * CELL_M:
                    n, sx, sy = n + 1.0, sx + dx, sy + dy
                    xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
        if n < 3.0:
            continue
        xx, xy, yy = xx / n - (sx / n) ** 2, xy / n - sx * sy / n**2, yy / n - (sy / n) ** 2
        root = math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        large, small = 0.5 * (xx + yy) + root, 0.5 * (xx + yy) - root
        angle = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi
        out[k, 0], out[k, 1] = math.cos(angle), math.sin(angle)
        out[k, 2] = 1.0 - math.sqrt(max(small, 0.0) / large) if large > 1e-6 else 0.0
    return out


@kernel
def register(
    source_m: Float64, xy_m: Float64, normals: Float64, starts: Int32, order: Int32, start: Float64
) -> Float64:
    """Motion (3,): forward, left, yaw of the pose of `source_m` (N, 2) in the frame of the reference, from a guess."""
    motion = start.copy()
    for iteration in range(MAX_ITERATIONS):
        scale2 = max(0.15, 0.6 * 0.75**iteration) ** 2
        c, s = math.cos(motion[2]), math.sin(motion[2])
        H, g = np.zeros((3, 3)), np.zeros(3)
        for k in range(len(source_m)):
            rx, ry = c * source_m[k, 0] - s * source_m[k, 1], s * source_m[k, 0] + c * source_m[k, 1]
            n, d2 = _nearest(rx + motion[0], ry + motion[1], xy_m, starts, order)
            if n < 0 or d2 > 9.0 * scale2:
                continue
            ex, ey = rx + motion[0] - xy_m[n, 0], ry + motion[1] - xy_m[n, 1]
            nx, ny, line = normals[n]
            along = (1.0 - line) ** 2  # weight along the line against that across it
            wxx = nx * nx + along * ny * ny
            wxy = (1.0 - along) * nx * ny
            wyy = ny * ny + along * nx * nx
            w = 1.0 / (1.0 + (ex * (wxx * ex + wxy * ey) + ey * (wxy * ex + wyy * ey)) / scale2) ** 2
            # derivatives of the point by yaw
            jx, jy = -ry, rx
            fx, fy = w * (wxx * ex + wxy * ey), w * (wxy * ex + wyy * ey)
            g[0] += fx
            g[1] += fy
            g[2] += fx * jx + fy * jy
            H[0, 0] += w * wxx
            H[0, 1] += w * wxy
            H[1, 1] += w * wyy
            H[0, 2] += w * (wxx * jx + wxy * jy)
            H[1, 2] += w * (wxy * jx + wyy * jy)
            H[2, 2] += w * (jx * (wxx * jx + wxy * jy) + jy * (wxy * jx + wyy * jy))
        H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
        H[0, 0] += 0.1
        H[1, 1] += 0.1
        H[2, 2] += 10.0
        step = np.linalg.solve(H, -g)
        motion += step
        if iteration > 6 and abs(step[0]) + abs(step[1]) < 1e-3 and abs(step[2]) < 1e-4:
            break
    return motion


@kernel
def inlier_share(source_m: Float64, xy_m: Float64, starts: Int32, order: Int32, motion: Float64) -> float:
    """Share of the points with a reference point within INLIER_M at a motion."""
    c, s = math.cos(motion[2]), math.sin(motion[2])
    count = 0
    for k in range(len(source_m)):
        x, y = source_m[k]
        n, d2 = _nearest(c * x - s * y + motion[0], s * x + c * y + motion[1], xy_m, starts, order)
        if n >= 0 and d2 < INLIER_M * INLIER_M:
            count += 1
    return count / max(len(source_m), 1)

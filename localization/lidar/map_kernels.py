"""Compiled loops of the lidar map: insertion of points, and matching of points with surfaces.

A pose here is (x, y, yaw); points (N, 5) are x, y, z about base in level axes without yaw, then x, y of their lidar.
A surface is stored by the side it is measured from, so that the two faces of a thin wall never mix.
"""

import math

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.jit import kernel

Table = tuple[Int64, Float64, Int64]  # keys (n,), sums (n, 6), number of scans and last scan (n, 2)
LAYER_M = 1.0
EMPTY = -1
NONE, FACE, POST = 0, 1, 2


@kernel
def _key(x: float, y: float, z: float, dx: float, dy: float, cell_m: float) -> int:
    """Key of cell, height layer and quadrant of the lidar."""
    layer = math.floor(z / LAYER_M) & 15
    side = (1 if dx > 0.0 else 0) + (2 if dy > 0.0 else 0)
    column, row = math.floor(x / cell_m) + (1 << 24), math.floor(y / cell_m) + (1 << 24)
    return (((column << 25) | row) << 6) | (layer << 2) | side


@kernel
def _slot(keys: Int64, key: int) -> int:
    """Slot of a key, or the empty slot for it (open addressing)."""
    mask = len(keys) - 1
    slot = ((key * 0x9E3779B97F4A7C1) >> 20) & mask
    while keys[slot] != EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel
def insert(
    keys: Int64, sums: Float64, scans: Int64, points: Float64, pose: Float64, cell_m: float, max_count: float, scan: int
) -> int:
    """Adds points of scan number `scan` to the sums (n, x, y, xx, xy, yy about the cell corner), in place.

    Returns the number of new cells.
    """
    c, s, added = math.cos(pose[2]), math.sin(pose[2]), 0
    for i in range(len(points)):
        x, y = pose[0] + c * points[i, 0] - s * points[i, 1], pose[1] + s * points[i, 0] + c * points[i, 1]
        ex, ey = points[i, 3] - points[i, 0], points[i, 4] - points[i, 1]
        key = _key(x, y, points[i, 2], c * ex - s * ey, s * ex + c * ey, cell_m)
        k = _slot(keys, key)
        if keys[k] == EMPTY:
            keys[k] = key
            added += 1
        if sums[k, 0] >= max_count:
            for j in range(6):
                sums[k, j] *= 0.5
        u, v = x - math.floor(x / cell_m) * cell_m, y - math.floor(y / cell_m) * cell_m
        sums[k, 0] += 1.0
        sums[k, 1] += u
        sums[k, 2] += v
        sums[k, 3] += u * u
        sums[k, 4] += u * v
        sums[k, 5] += v * v
        if scans[k, 1] != scan:
            scans[k, 0] += 1
            scans[k, 1] = scan
    return added


@kernel
def _nearest_surveyed(
    x: float, y: float, ex: float, ey: float, faces: Float64, posts: Float64, gate: float, out: Float64
) -> int:
    """Nearest surveyed surface within the gate that faces the lidar at (ex, ey): normal and distance in `out`."""
    kind, best = NONE, gate
    for j in range(len(faces)):
        ax, ay, bx, by, nx, ny = faces[j]
        off = (x - ax) * nx + (y - ay) * ny
        if abs(off) >= best or (ex - ax) * nx + (ey - ay) * ny <= 0.0:
            continue
        length = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length
        if along < 0.0 or along > length:
            continue
        kind, best = FACE, abs(off)
        out[0], out[1], out[2] = nx, ny, off
    for j in range(len(posts)):
        dx, dy = x - posts[j, 0], y - posts[j, 1]
        d = math.sqrt(dx * dx + dy * dy)
        if d < 1e-6 or abs(d - posts[j, 2]) >= best or dx * (ex - x) + dy * (ey - y) <= 0.0:
            continue
        kind, best = POST, abs(d - posts[j, 2])
        out[0], out[1], out[2] = dx / d, dy / d, d - posts[j, 2]
    return kind


@kernel
def scores(points: Float64, poses: Float64, faces: Float64, posts: Float64, gate: float) -> Float64:
    """Number of points within the gate of a surveyed surface at each of the poses (P, 3)."""
    counts, out = np.zeros(len(poses)), np.zeros(4)
    for k in range(len(poses)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(len(points)):
            x = poses[k, 0] + c * points[i, 0] - s * points[i, 1]
            y = poses[k, 1] + s * points[i, 0] + c * points[i, 1]
            ex = poses[k, 0] + c * points[i, 3] - s * points[i, 4]
            ey = poses[k, 1] + s * points[i, 3] + c * points[i, 4]
            counts[k] += _nearest_surveyed(x, y, ex, ey, faces, posts, gate, out) != NONE
    return counts


@kernel
def _learned_directions(x: float, y: float, cell_m: float, total: Float64, max_thickness2: float, out: Float64) -> int:
    """Thin directions of a cell: rows of normal, distance and variance in `out`; returns their number."""
    n = total[0]
    mx, my = total[1] / n, total[2] / n
    xx, xy, yy = total[3] / n - mx * mx, total[4] / n - mx * my, total[5] / n - my * my
    half, root = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    if half - root > max_thickness2:
        return 0
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)  # of the longer axis
    dx, dy = x - math.floor(x / cell_m) * cell_m - mx, y - math.floor(y / cell_m) * cell_m - my
    out[0, 0], out[0, 1], out[0, 3] = -math.sin(angle), math.cos(angle), max(half - root, 0.0)
    out[0, 2] = out[0, 0] * dx + out[0, 1] * dy
    if half + root > max_thickness2:
        return 1
    out[1, 0], out[1, 1], out[1, 3] = math.cos(angle), math.sin(angle), half + root
    out[1, 2] = out[1, 0] * dx + out[1, 1] * dy
    return 2


@kernel
def _continues(
    x: float, y: float, z: float, dx: float, dy: float, ux: float, uy: float, cell_m: float, keys: Int64
) -> bool:
    """Whether one of the two next cells along (ux, uy) is occupied: part of a wall, not a post."""
    for step in (-cell_m, cell_m):
        if keys[_slot(keys, _key(x + step * ux, y + step * uy, z, dx, dy, cell_m))] != EMPTY:
            return True
    return False


@kernel
def _accumulate(A: Float64, b: Float64, row: Float64, variance: float, lx: float, ly: float, robust2: float) -> None:
    """Adds one residual (normal, distance) with Cauchy weight; (lx, ly) is the point relative to base in map axes."""
    w = 1.0 / (variance * (1.0 + row[2] * row[2] / (variance * robust2)))
    turn = row[1] * lx - row[0] * ly
    J = (row[0], row[1], turn)
    for p in range(3):
        b[p] += w * J[p] * row[2]
        for q in range(3):
            A[p, q] += w * J[p] * J[q]


@kernel
def _normal_equations(
    points: Float64, pose: Float64, faces: Float64, posts: Float64, keys: Int64, sums: Float64, scans: Int64,
    cell_m: float, gate: float, sigma: float, max_thickness: float, robust_sigmas: float, min_scans: int,
    A: Float64, b: Float64,
) -> int:  # fmt: skip
    """Information (3, 3) and gradient (3,) of all points at a pose; returns the number of points with a surface."""
    c, s, found = math.cos(pose[2]), math.sin(pose[2]), 0
    out, var, robust2 = np.zeros((2, 4)), sigma * sigma, robust_sigmas * robust_sigmas
    A[:], b[:] = 0.0, 0.0
    for i in range(len(points)):
        lx, ly = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        x, y = pose[0] + lx, pose[1] + ly
        ex = pose[0] + c * points[i, 3] - s * points[i, 4]
        ey = pose[1] + s * points[i, 3] + c * points[i, 4]
        if _nearest_surveyed(x, y, ex, ey, faces, posts, gate, out[0]) != NONE:
            _accumulate(A, b, out[0], var, lx, ly, robust2)
            found += 1
            continue
        k = _slot(keys, _key(x, y, points[i, 2], ex - x, ey - y, cell_m))
        if keys[k] == EMPTY or scans[k, 0] < min_scans or sums[k, 0] < 2 * min_scans:
            continue
        directions = _learned_directions(x, y, cell_m, sums[k], max_thickness * max_thickness, out)
        if directions == 2 and _continues(
            x, y, points[i, 2], ex - x, ey - y, -out[0, 1], out[0, 0], cell_m, keys
        ):  # fmt: skip
            directions = 1
        for j in range(directions):
            _accumulate(A, b, out[j], var + out[j, 3], lx, ly, robust2)
        found += directions > 0
    return found


@kernel
def _match(
    points: Float64, guess: Float64, faces: Float64, posts: Float64, keys: Int64, sums: Float64, scans: Int64,
    cell_m: float, gate: float, sigma: float, max_thickness: float, robust_sigmas: float, min_scans: int,
    iterations: int,
) -> tuple[Float64, Float64, int]:  # fmt: skip
    pose, A, b = guess.copy(), np.zeros((3, 3)), np.zeros(3)
    found = 0
    for _ in range(iterations):
        found = _normal_equations(
            points, pose, faces, posts, keys, sums, scans, cell_m, gate, sigma, max_thickness, robust_sigmas,
            min_scans, A, b,
        )  # fmt: skip
        step = np.linalg.solve(A + 1e-3 * np.eye(3), b)
        pose -= step
        if max(abs(step[0]), abs(step[1])) < 1e-4 and abs(step[2]) < 1e-5:
            break
    return pose, A, found


@kernel
def _keep_near(
    keys: Int64, sums: Float64, scans: Int64, x: float, y: float, cell_m: float, radius_m: float
) -> tuple[Table, int]:
    new_keys, new_sums, new_scans = np.full_like(keys, EMPTY), np.zeros_like(sums), np.zeros_like(scans)
    count = 0
    for i in range(len(keys)):
        if keys[i] == EMPTY:
            continue
        cx = ((keys[i] >> 31) - (1 << 24) + 0.5) * cell_m
        cy = (((keys[i] >> 6) & ((1 << 25) - 1)) - (1 << 24) + 0.5) * cell_m
        if (cx - x) ** 2 + (cy - y) ** 2 > radius_m * radius_m:
            continue
        k = _slot(new_keys, keys[i])
        new_keys[k], new_sums[k], new_scans[k] = keys[i], sums[i], scans[i]
        count += 1
    return (new_keys, new_sums, new_scans), count


def keep_near(table: Table, at_m: tuple[float, float], cell_m: float, radius_m: float) -> tuple[Table, int]:
    """The table without cells farther than `radius_m` from a position, and the number of remaining cells."""
    return _keep_near(*table, *at_m, cell_m, radius_m)


def match(
    points: Float64, guess: Float64, surveyed: tuple[Float64, Float64], table: Table,
    cell_m: float, gate_m: float, sigma_m: float, max_thickness_m: float, robust_sigmas: float, min_scans: int,
    iterations: int,
) -> tuple[Float64, Float64, int]:  # fmt: skip
    """Pose that matches points with surveyed faces (M, 6), posts (K, 3) and cells; information (3, 3) and count."""
    (faces, posts), (keys, sums, scans) = surveyed, table
    return _match(
        points, guess, faces, posts, keys, sums, scans, cell_m, gate_m, sigma_m, max_thickness_m, robust_sigmas,
        min_scans, iterations,
    )  # fmt: skip

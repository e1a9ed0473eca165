"""Inner loops of the lidar map, compiled: what returns hit, and the pose that lays them on it.

A pose here is (x, y, yaw); points (N, 5) are x, y, z about base in level axes turned by no yaw, then x, y of the lidar
that saw them. A surface is seen from one side only, so that the two faces of a thin wall never mix.
"""

import math
from typing import Any

import numpy as np

from geometry.jit import kernel
from geometry.transforms import Float64
from messages.message import Int64

Table = tuple[Int64, Float64, Int64]  # keys, sums (n, 6), and how often and when last seen (n, 2)
LAYER_M = 1.0
EMPTY = -1
NONE, FACE, POST, CELL = 0, 1, 2, 3


@kernel
def _key(x: float, y: float, z: float, dx: float, dy: float, cell_m: float) -> int:
    """Cell, layer of height and the quadrant from which it is seen, in one number."""
    layer = math.floor(z / LAYER_M) & 15
    side = (1 if dx > 0.0 else 0) + (2 if dy > 0.0 else 0)
    column, row = math.floor(x / cell_m) + (1 << 24), math.floor(y / cell_m) + (1 << 24)
    return (((column << 25) | row) << 6) | (layer << 2) | side


@kernel
def _slot(keys: Any, key: int) -> int:
    """Where a key is, or the empty slot where it would be (open addressing)."""
    mask = len(keys) - 1
    slot = ((key * 0x9E3779B97F4A7C1) >> 20) & mask
    while keys[slot] != EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel
def _insert(keys: Any, sums: Any, seen: Any, points: Any, pose: Any, cell_m: float, most: float, look: int) -> int:
    """Adds points to sums (n, x, y, xx, xy, yy about the cell's corner); gives the number of new cells."""
    c, s, added = math.cos(pose[2]), math.sin(pose[2]), 0
    for i in range(len(points)):
        x, y = pose[0] + c * points[i, 0] - s * points[i, 1], pose[1] + s * points[i, 0] + c * points[i, 1]
        ex, ey = points[i, 3] - points[i, 0], points[i, 4] - points[i, 1]
        key = _key(x, y, points[i, 2], c * ex - s * ey, s * ex + c * ey, cell_m)
        k = _slot(keys, key)
        if keys[k] == EMPTY:
            keys[k] = key
            added += 1
        if sums[k, 0] >= most:
            for j in range(6):
                sums[k, j] *= 0.5
        u, v = x - math.floor(x / cell_m) * cell_m, y - math.floor(y / cell_m) * cell_m
        sums[k, 0] += 1.0
        sums[k, 1] += u
        sums[k, 2] += v
        sums[k, 3] += u * u
        sums[k, 4] += u * v
        sums[k, 5] += v * v
        if seen[k, 1] != look:
            seen[k, 0] += 1
            seen[k, 1] = look
    return added


@kernel
def _surveyed(x: float, y: float, ex: float, ey: float, faces: Any, posts: Any, gate: float, out: Any) -> int:
    """The nearest surveyed surface within the gate that the lidar at (ex, ey) may see: normal and distance in `out`."""
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
def _learnt(x: float, y: float, cell_m: float, total: Any, thin2: float, out: Any) -> int:
    """The thin directions of a cell: rows of normal, distance and variance in `out`; how many there are."""
    n = total[0]
    mx, my = total[1] / n, total[2] / n
    xx, xy, yy = total[3] / n - mx * mx, total[4] / n - mx * my, total[5] / n - my * my
    half, root = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    if half - root > thin2:
        return 0
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)  # of the longer axis
    dx, dy = x - math.floor(x / cell_m) * cell_m - mx, y - math.floor(y / cell_m) * cell_m - my
    out[0, 0], out[0, 1], out[0, 3] = -math.sin(angle), math.cos(angle), max(half - root, 0.0)
    out[0, 2] = out[0, 0] * dx + out[0, 1] * dy
    if half + root > thin2:
        return 1
    out[1, 0], out[1, 1], out[1, 3] = math.cos(angle), math.sin(angle), half + root
    out[1, 2] = out[1, 0] * dx + out[1, 1] * dy
    return 2


@kernel
def _goes_on(
    x: float, y: float, z: float, dx: float, dy: float, ux: float, uy: float, cell_m: float, keys: Any
) -> bool:
    """Whether the next cell along (ux, uy), either way, shows something too: a piece of a wall, not a post."""
    for way in (-cell_m, cell_m):
        if keys[_slot(keys, _key(x + way * ux, y + way * uy, z, dx, dy, cell_m))] != EMPTY:
            return True
    return False


@kernel
def _gather(A: Any, b: Any, row: Any, variance: float, lx: float, ly: float, bound2: float) -> None:
    """Adds one residual (normal, distance) with Cauchy's weight; (lx, ly) is the point seen from base, in map axes."""
    w = 1.0 / (variance * (1.0 + row[2] * row[2] / (variance * bound2)))
    turn = row[1] * lx - row[0] * ly
    J = (row[0], row[1], turn)
    for p in range(3):
        b[p] += w * J[p] * row[2]
        for q in range(3):
            A[p, q] += w * J[p] * J[q]


@kernel
def _normal(
    points: Any, pose: Any, faces: Any, posts: Any, keys: Any, sums: Any, seen: Any, cell_m: float, gate: float,
    sigma: float, thin: float, bound: float, least: int, A: Any, b: Any,
) -> int:  # fmt: skip
    """Information (3, 3) and gradient (3,) of all points at a pose; gives how many found a surface."""
    c, s, found = math.cos(pose[2]), math.sin(pose[2]), 0
    out, var, bound2 = np.zeros((2, 4)), sigma * sigma, bound * bound
    A[:], b[:] = 0.0, 0.0
    for i in range(len(points)):
        lx, ly = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        x, y = pose[0] + lx, pose[1] + ly
        ex = pose[0] + c * points[i, 3] - s * points[i, 4]
        ey = pose[1] + s * points[i, 3] + c * points[i, 4]
        if _surveyed(x, y, ex, ey, faces, posts, gate, out[0]) != NONE:
            _gather(A, b, out[0], var, lx, ly, bound2)
            found += 1
            continue
        k = _slot(keys, _key(x, y, points[i, 2], ex - x, ey - y, cell_m))
        if keys[k] == EMPTY or seen[k, 0] < least or sums[k, 0] < 2 * least:
            continue
        directions = _learnt(x, y, cell_m, sums[k], thin * thin, out)
        if directions == 2 and _goes_on(
            x, y, points[i, 2], ex - x, ey - y, -out[0, 1], out[0, 0], cell_m, keys
        ):  # fmt: skip
            directions = 1
        for j in range(directions):
            _gather(A, b, out[j], var + out[j, 3], lx, ly, bound2)
        found += directions > 0
    return found


@kernel
def _match(
    points: Any, guess: Any, faces: Any, posts: Any, keys: Any, sums: Any, seen: Any, cell_m: float, gate: float,
    sigma: float, thin: float, bound: float, least: int, iterations: int,
) -> Any:  # fmt: skip
    pose, A, b = guess.copy(), np.zeros((3, 3)), np.zeros(3)
    found = 0
    for _ in range(iterations):
        found = _normal(
            points, pose, faces, posts, keys, sums, seen, cell_m, gate, sigma, thin, bound, least, A, b
        )  # fmt: skip
        step = np.linalg.solve(A + 1e-3 * np.eye(3), b)
        pose -= step
        if max(abs(step[0]), abs(step[1])) < 1e-4 and abs(step[2]) < 1e-5:
            break
    return pose, A, found


@kernel
def _keep_near(keys: Any, sums: Any, seen: Any, x: float, y: float, cell_m: float, reach_m: float) -> Any:
    new_keys, new_sums, new_seen = np.full_like(keys, EMPTY), np.zeros_like(sums), np.zeros_like(seen)
    count = 0
    for i in range(len(keys)):
        if keys[i] == EMPTY:
            continue
        cx = ((keys[i] >> 31) - (1 << 24) + 0.5) * cell_m
        cy = (((keys[i] >> 6) & ((1 << 25) - 1)) - (1 << 24) + 0.5) * cell_m
        if (cx - x) ** 2 + (cy - y) ** 2 > reach_m * reach_m:
            continue
        k = _slot(new_keys, keys[i])
        new_keys[k], new_sums[k], new_seen[k] = keys[i], sums[i], seen[i]
        count += 1
    return (new_keys, new_sums, new_seen), count


def insert(
    keys: Int64, sums: Float64, seen: Int64, points: Float64, pose: Float64, cell_m: float, most: float, look: int
) -> int:
    """Adds points seen from a pose to the table in place; gives the number of new cells. `look` numbers the scans."""
    added: int = _insert(keys, sums, seen, points, pose, cell_m, most, look)
    return added


def keep_near(table: Table, at_m: tuple[float, float], cell_m: float, reach_m: float) -> tuple[Table, int]:
    """The table without what lies farther than `reach_m` from a place, and how many cells are left."""
    kept: tuple[Table, int] = _keep_near(*table, *at_m, cell_m, reach_m)
    return kept


def match(
    points: Float64, guess: Float64, surveyed: tuple[Float64, Float64], table: Table,
    cell_m: float, gate_m: float, sigma_m: float, thin_m: float, bound: float, least: int, iterations: int,
) -> tuple[Float64, Float64, int]:  # fmt: skip
    """The pose that lays points on surveyed faces (M, 6), posts (K, 3) and cells: with information (3, 3) and count."""
    found: tuple[Float64, Float64, int] = _match(
        points, guess, *surveyed, *table, cell_m, gate_m, sigma_m, thin_m, bound, least, iterations
    )
    return found

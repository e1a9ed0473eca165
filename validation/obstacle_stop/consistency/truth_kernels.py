"""How well boxes hold the returns: share of the returns at the faces of a box among those in and around it."""

import math

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.jit import kernel
from validation.obstacle_stop.boxes import Box

FACE_M = 0.25  # returns this far outside of a box still belong to its faces: accuracy of labels, noise
DEPTH_M = 0.45  # and this far inside
AROUND_M = 0.8  # an object stands free of others by this much, or its label has a lower score at every shift
ABOVE_M = 1.0
CELL_M = 0.2
GROUND_M = 0.25  # lowest part of a box, with returns of the ground


@kernel
def points_around(points_m: Float32, x: float, y: float, reach_m: float, lowest_m: float) -> Float32:
    """Points (K, 3) in a square around a place, none below `lowest_m`."""
    out = np.empty((len(points_m), 3), np.float32)
    count = 0
    for k in range(len(points_m)):
        if points_m[k, 2] < lowest_m:
            continue
        if abs(points_m[k, 0] - x) < reach_m and abs(points_m[k, 1] - y) < reach_m:
            out[count] = points_m[k]
            count += 1
    return out[:count]


def foot_m(box: Box) -> float:
    """Height in base below which no return counts for a box, 1 mm less: most returns around an object are ground."""
    height_m = float(box.size_m[2])
    return float(box.center_m[2]) - 0.5 * height_m + min(GROUND_M, 0.4 * height_m) - 1e-3


@kernel
def score_at(points_m: Float32, center_m: Float64, size_m: Float64, yaw_rad: float, needed: float) -> float:
    """Score (0 to 1) of one box: returns at its faces over returns in and around it, less when few of `needed`."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    a, b, h = 0.5 * size_m[0], 0.5 * size_m[1], 0.5 * size_m[2]
    foot = -h + min(GROUND_M, 0.4 * size_m[2])
    face, around = 0, 0
    for k in range(len(points_m)):
        dx, dy, dz = points_m[k, 0] - center_m[0], points_m[k, 1] - center_m[1], points_m[k, 2] - center_m[2]
        x, y = abs(c * dx + s * dy), abs(c * dy - s * dx)
        if x > a + AROUND_M or y > b + AROUND_M or dz < foot or dz > h + ABOVE_M:
            continue
        if dz <= h + 0.15:
            around += 1
            if x <= a + FACE_M and y <= b + FACE_M and not (x < a - DEPTH_M and y < b - DEPTH_M):
                face += 1
        elif x <= a and y <= b:
            around += 1
    return face / around * min(1.0, face / needed) if around > 0 else 0.0


@kernel
def _sum(image: Float64, i0: int, i1: int, j0: int, j1: int) -> float:
    n = len(image) - 1
    i0, i1 = min(max(i0, 0), n), min(max(i1, 0), n)
    j0, j1 = min(max(j0, 0), n), min(max(j1, 0), n)
    return float(image[i1, j1] - image[i0, j1] - image[i1, j0] + image[i0, j0])


@kernel
def scores_of_shifts(
    points_m: Float32, center_m: Float64, size_m: Float64, yaw_rad: float, needed: float, shifts_m: Float64
) -> Float64:
    """`score_at` (S,) for displacements (S, 2) of the box in base, by counts in cells of 0.2 m."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    a, b, h = 0.5 * size_m[0], 0.5 * size_m[1], 0.5 * size_m[2]
    reach = 0.0
    for k in range(len(shifts_m)):
        reach = max(reach, math.hypot(shifts_m[k, 0], shifts_m[k, 1]))
    reach += max(a, b) + AROUND_M
    cells = int(2.0 * reach / CELL_M) + 2
    body, above = np.zeros((cells + 1, cells + 1)), np.zeros((cells + 1, cells + 1))
    foot = -h + min(GROUND_M, 0.4 * size_m[2])
    for k in range(len(points_m)):
        dx, dy, dz = points_m[k, 0] - center_m[0], points_m[k, 1] - center_m[1], points_m[k, 2] - center_m[2]
        x, y = c * dx + s * dy + reach, c * dy - s * dx + reach
        if dz < foot or dz > h + ABOVE_M or x < 0.0 or y < 0.0:
            continue
        i, j = int(x / CELL_M), int(y / CELL_M)
        if i < cells and j < cells:
            if dz <= h + 0.15:
                body[i + 1, j + 1] += 1.0
            else:
                above[i + 1, j + 1] += 1.0
    for i in range(1, cells + 1):
        for j in range(1, cells + 1):
            body[i, j] += body[i - 1, j] + body[i, j - 1] - body[i - 1, j - 1]
            above[i, j] += above[i - 1, j] + above[i, j - 1] - above[i - 1, j - 1]
    out = np.zeros(len(shifts_m))
    for k in range(len(shifts_m)):
        x = c * shifts_m[k, 0] + s * shifts_m[k, 1] + reach
        y = c * shifts_m[k, 1] - s * shifts_m[k, 0] + reach
        around = _box(body, x, y, a + AROUND_M, b + AROUND_M) + _box(above, x, y, a, b)
        if around == 0.0:
            continue
        face = _box(body, x, y, a + FACE_M, b + FACE_M)
        if a > DEPTH_M and b > DEPTH_M:
            face -= _box(body, x, y, a - DEPTH_M, b - DEPTH_M)
        out[k] = face / around * min(1.0, face / needed)
    return out


@kernel
def _box(image: Float64, x: float, y: float, a: float, b: float) -> float:
    i0, i1 = round((x - a) / CELL_M), round((x + a) / CELL_M)
    j0, j1 = round((y - b) / CELL_M), round((y + b) / CELL_M)
    return _sum(image, i0, i1, j0, j1)

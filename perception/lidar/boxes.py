"""What a cluster looks like: upright box that fits it most closely, height, and the return nearest to the front.

Two sides of a vehicle make an L, whose boxes of least area lie along its sides and across its corner alike. The returns
lie on the sides, so a box counts by how close they lie to its edges (Zhang et al., Efficient L-Shape Fitting, IV 2017),
over its area, lest it claim free ground.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.jit import kernel
from messages.message import Float32, Float64, Int32, UInt8
from perception.lidar.clusters import Clusters

DIRECTIONS = 16  # extreme returns are kept in so many directions; 11° off costs 2 % of a side
HALF = DIRECTIONS // 2
LEAST_SIZE_M = 0.05
EDGE_M = 0.1  # a return nearer to an edge than this is on it
MOST_RETURNS = 128  # of a cluster that are asked how close they lie to the edges
SIDES = 30  # fewer returns show no sides, and
BODY_M = 10.0  # what is longer is no vehicle: of both the box of least area is taken


@dataclass(frozen=True)
class Boxes:
    """`center_m` and `size_m` (K, 3), `yaw_rad` (K,), `nearest_m` (K, 3), `top_m` (K,) above the ground."""

    center_m: Float64
    size_m: Float64
    yaw_rad: Float64
    nearest_m: Float64
    top_m: Float64


def describe(
    clusters: Clusters, points_base_m: Float32, above_m: Float32, level: UInt8, front: tuple[float, float]
) -> Boxes:
    """Boxes in `base`; `front` is the machine's foremost x and half width, which `nearest_m` is nearest to."""
    k = len(clusters.offsets) - 1
    boxes = Boxes(np.zeros((k, 3)), np.zeros((k, 3)), np.zeros(k), np.zeros((k, 3)), np.zeros(k))
    _upright(clusters.offsets, clusters.indices, points_base_m, boxes.center_m, boxes.size_m, boxes.yaw_rad)
    _nearest(
        clusters.offsets, clusters.indices, points_base_m, above_m, level, front[0], front[1],
        boxes.nearest_m, boxes.top_m,
    )  # fmt: skip
    return boxes


@kernel
def _upright(offsets: Int32, indices: Int32, points: Float32, center: Float64, size: Float64, yaw: Float64) -> None:
    """The closest box over all directions of edges between neighbouring extreme returns."""
    turn = np.arange(HALF) * (2.0 * math.pi / DIRECTIONS)
    cosine, sine = np.cos(turn).astype(np.float32), np.sin(turn).astype(np.float32)
    least, most = np.empty(HALF, np.float32), np.empty(HALF, np.float32)
    extreme = np.empty(DIRECTIONS, np.int32)
    hull, some = np.empty((DIRECTIONS, 2)), np.empty((MOST_RETURNS, 2))
    for k in range(offsets.shape[0] - 1):
        z_low, z_high = np.inf, -np.inf
        least[:], most[:] = np.inf, -np.inf
        for i in indices[offsets[k] : offsets[k + 1]]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            z_low, z_high = min(z_low, z), max(z_high, z)
            for d in range(HALF):
                along = cosine[d] * x + sine[d] * y
                is_ahead, is_behind = along > most[d], along < least[d]
                most[d] = along if is_ahead else most[d]
                extreme[d] = i if is_ahead else extreme[d]
                least[d] = along if is_behind else least[d]
                extreme[d + HALF] = i if is_behind else extreme[d + HALF]
        for d in range(DIRECTIONS):
            hull[d, 0], hull[d, 1] = points[extreme[d], 0], points[extreme[d], 1]
        count, n = offsets[k + 1] - offsets[k], 0
        for j in range(0, count, 1 + (count - 1) // MOST_RETURNS):
            i = indices[offsets[k] + j]
            some[n, 0], some[n, 1] = points[i, 0], points[i, 1]
            n += 1
        _closest(hull, some[:n], k, center, size, yaw)
        center[k, 2], size[k, 2] = (z_low + z_high) / 2.0, max(z_high - z_low, LEAST_SIZE_M)


@kernel
def _closest(hull: Float64, some: Float64, k: int, center: Float64, size: Float64, yaw: Float64) -> None:
    """Box `k` about the convex hull with `some` (N, 2) of the returns."""
    axis, low, high = np.empty((2, DIRECTIONS)), np.empty((2, DIRECTIONS)), np.empty((2, DIRECTIONS))
    for d in range(DIRECTIONS):
        e = (d + 1) % DIRECTIONS
        ex, ey = hull[e, 0] - hull[d, 0], hull[e, 1] - hull[d, 1]
        long = math.hypot(ex, ey)
        if long < LEAST_SIZE_M:
            # neighbours are one return: an axis-parallel candidate keeps lone points and lines defined
            ex, ey, long = 1.0, 0.0, 1.0
        c, s = ex / long, ey / long
        u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
        for j in range(DIRECTIONS):
            u, v = c * hull[j, 0] + s * hull[j, 1], -s * hull[j, 0] + c * hull[j, 1]
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        axis[0, d], axis[1, d] = c, s
        low[0, d], low[1, d], high[0, d], high[1, d] = u0, v0, u1, v1
    has_sides = some.shape[0] >= SIDES and _width(hull) <= BODY_M
    worth = _closeness(some, axis, low, high) if has_sides else np.ones(DIRECTIONS)
    best = 0.0
    for d in range(DIRECTIONS):
        du, dv = max(high[0, d] - low[0, d], LEAST_SIZE_M), max(high[1, d] - low[1, d], LEAST_SIZE_M)
        worth[d] *= 1.0 / (du * dv)
        if worth[d] > best * (1.0 + 1e-9):
            best = worth[d]
            c, s, u, v = axis[0, d], axis[1, d], (low[0, d] + high[0, d]) / 2.0, (low[1, d] + high[1, d]) / 2.0
            center[k, 0], center[k, 1] = c * u - s * v, s * u + c * v
            turned = 0.0 if du >= dv else math.pi / 2.0  # the longer side is the length
            size[k, 0], size[k, 1] = max(du, dv), min(du, dv)
            yaw[k] = _half_turn(math.atan2(s, c) + turned)


@kernel
def _width(hull: Float64) -> float:
    """The greatest distance between opposite extreme returns."""
    most = 0.0
    for d in range(HALF):
        most = max(most, math.hypot(hull[d, 0] - hull[d + HALF, 0], hull[d, 1] - hull[d + HALF, 1]))
    return most


@kernel
def _closeness(some: Float64, axis: Float64, low: Float64, high: Float64) -> Float64:
    """Of each box (16,), by its axis and corners: the sum over returns of one over their way to the nearest edge."""
    total = np.zeros(DIRECTIONS)
    for i in range(some.shape[0]):
        x, y = some[i, 0], some[i, 1]
        # innermost over boxes: the processor's vectors take several at once
        for d in range(DIRECTIONS):
            u, v = axis[0, d] * x + axis[1, d] * y, -axis[1, d] * x + axis[0, d] * y
            near = min(min(u - low[0, d], high[0, d] - u), min(v - low[1, d], high[1, d] - v))
            total[d] += 1.0 / max(near, EDGE_M)
    return total


@kernel
def _half_turn(angle: float) -> float:
    """The same axis within [-pi/2, pi/2)."""
    return (angle + math.pi / 2.0) % math.pi - math.pi / 2.0


@kernel
def _nearest(
    offsets: Int32, indices: Int32, points: Float32, above: Float32, level: UInt8, front_x: float, half: float,
    nearest: Float64, top: Float64,
) -> None:  # fmt: skip
    """Only solid returns count: no ghost below the ground and no ground at its feet brings an obstacle nearer."""
    for k in range(offsets.shape[0] - 1):
        best = np.inf
        for i in indices[offsets[k] : offsets[k + 1]]:
            if level[i] != 2:
                continue
            top[k] = max(top[k], above[i])
            x, y = points[i, 0], points[i, 1]
            aside = max(abs(y) - half, 0.0)
            d = (x - front_x) * (x - front_x) + aside * aside
            if d < best:
                best = d
                for j in range(3):
                    nearest[k, j] = points[i, j]

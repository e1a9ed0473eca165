"""Upright bounding box of each cluster, its height, and the return nearest to the machine's front.

Two visible sides of a vehicle form an L; the boxes of least area lie both along its sides and across its corner.
The score of a box is therefore the closeness of the sides that the lidar sees to its edges (after Zhang et al.,
Efficient L-Shape Fitting, IV 2017) divided by its area, so that the box does not cover free ground. The sides are those
of the convex hull that face the lidar: of sides that lean inwards most returns are away from the edges.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.jit import kernel
from perception.lidar.clusters import Clusters

DIRECTIONS = 16  # directions of the extreme returns; an error of 11° shortens a side by 2 %
HALF = DIRECTIONS // 2
MIN_SIZE_M = 0.05
EDGE_M = 0.1  # distance below which a return lies on an edge
SIDE_STEP_M = 0.05  # between points on the visible sides
MAX_SIDE_POINTS = 256
MIN_L_SHAPE_RETURNS = 30  # below it the box of least area is taken
MAX_L_SHAPE_M = 10.0  # greatest length of a vehicle; above it the box of least area is taken


@dataclass(frozen=True)
class Boxes:
    """`center_m` and `size_m` (K, 3), `yaw_rad` (K,), `nearest_m` (K, 3), `top_m` (K,) above the ground."""

    center_m: Float64
    size_m: Float64
    yaw_rad: Float64
    nearest_m: Float64
    top_m: Float64


def fit_boxes(
    clusters: Clusters, points_base_m: Float32, above_m: Float32, point_class: UInt8, front: tuple[float, float],
    origin_m: Float64,
) -> Boxes:  # fmt: skip
    """Boxes in `base`; `nearest_m` is the return nearest to `front`, the machine's foremost x and half width.

    `origin_m` (2,): the lidar in `base`.
    """
    k = len(clusters.offsets) - 1
    boxes = Boxes(np.zeros((k, 3)), np.zeros((k, 3)), np.zeros(k), np.zeros((k, 3)), np.zeros(k))
    _fit_boxes(clusters.offsets, clusters.indices, points_base_m, origin_m, boxes.center_m, boxes.size_m, boxes.yaw_rad)
    _nearest(
        clusters.offsets, clusters.indices, points_base_m, above_m, point_class, front[0], front[1],
        boxes.nearest_m, boxes.top_m,
    )  # fmt: skip
    return boxes


@kernel
def _fit_boxes(
    offsets: Int32, indices: Int32, points: Float32, origin: Float64, center: Float64, size: Float64, yaw: Float64
) -> None:
    """Best box over the directions of all edges between neighbouring extreme returns."""
    angle = np.arange(HALF) * (2.0 * math.pi / DIRECTIONS)
    cosine, sine = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    lowest, highest = np.empty(HALF, np.float32), np.empty(HALF, np.float32)
    extreme = np.empty(DIRECTIONS, np.int32)
    hull = np.empty((DIRECTIONS, 2))
    for k in range(offsets.shape[0] - 1):
        z_low, z_high = np.inf, -np.inf
        lowest[:], highest[:] = np.inf, -np.inf
        for i in indices[offsets[k] : offsets[k + 1]]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            z_low, z_high = min(z_low, z), max(z_high, z)
            for d in range(HALF):
                along = cosine[d] * x + sine[d] * y
                is_ahead, is_behind = along > highest[d], along < lowest[d]
                highest[d] = along if is_ahead else highest[d]
                extreme[d] = i if is_ahead else extreme[d]
                lowest[d] = along if is_behind else lowest[d]
                extreme[d + HALF] = i if is_behind else extreme[d + HALF]
        for d in range(DIRECTIONS):
            hull[d, 0], hull[d, 1] = points[extreme[d], 0], points[extreme[d], 1]
        has_sides = offsets[k + 1] - offsets[k] >= MIN_L_SHAPE_RETURNS and _width(hull) <= MAX_L_SHAPE_M
        _fit_box(hull, _visible_sides(hull, origin) if has_sides else hull[:0], k, center, size, yaw)
        center[k, 2], size[k, 2] = (z_low + z_high) / 2.0, max(z_high - z_low, MIN_SIZE_M)


@kernel
def _fit_box(hull: Float64, sides: Float64, k: int, center: Float64, size: Float64, yaw: Float64) -> None:
    """Box `k` about the convex hull, by points (N, 2) on its visible sides; of least area without them."""
    axis, low, high = np.empty((2, DIRECTIONS)), np.empty((2, DIRECTIONS)), np.empty((2, DIRECTIONS))
    for d in range(DIRECTIONS):
        e = (d + 1) % DIRECTIONS
        ex, ey = hull[e, 0] - hull[d, 0], hull[e, 1] - hull[d, 1]
        length = math.hypot(ex, ey)
        if length < MIN_SIZE_M:
            # both extremes are one return: an axis-parallel candidate defines single points and lines
            ex, ey, length = 1.0, 0.0, 1.0
        c, s = ex / length, ey / length
        u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
        for j in range(DIRECTIONS):
            u, v = c * hull[j, 0] + s * hull[j, 1], -s * hull[j, 0] + c * hull[j, 1]
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        axis[0, d], axis[1, d] = c, s
        low[0, d], low[1, d], high[0, d], high[1, d] = u0, v0, u1, v1
    score = _closeness(sides, axis, low, high) if len(sides) else np.ones(DIRECTIONS)
    best = 0.0
    for d in range(DIRECTIONS):
        du, dv = max(high[0, d] - low[0, d], MIN_SIZE_M), max(high[1, d] - low[1, d], MIN_SIZE_M)
        score[d] *= 1.0 / (du * dv)
        if score[d] > best * (1.0 + 1e-9):
            best = score[d]
            c, s, u, v = axis[0, d], axis[1, d], (low[0, d] + high[0, d]) / 2.0, (low[1, d] + high[1, d]) / 2.0
            center[k, 0], center[k, 1] = c * u - s * v, s * u + c * v
            quarter = 0.0 if du >= dv else math.pi / 2.0  # the longer side is the length
            size[k, 0], size[k, 1] = max(du, dv), min(du, dv)
            yaw[k] = _wrap_axis(math.atan2(s, c) + quarter)


@kernel
def _width(hull: Float64) -> float:
    """Greatest distance between opposite extreme returns."""
    highest = 0.0
    for d in range(HALF):
        highest = max(highest, math.hypot(hull[d, 0] - hull[d + HALF, 0], hull[d, 1] - hull[d + HALF, 1]))
    return highest


@kernel
def _visible_sides(hull: Float64, origin: Float64) -> Float64:
    """Points (N, 2) on the sides of the convex hull, counter-clockwise, that face the lidar at `origin`."""
    points, n = np.empty((MAX_SIDE_POINTS, 2)), 0
    for d in range(DIRECTIONS):
        e = (d + 1) % DIRECTIONS
        ex, ey = hull[e, 0] - hull[d, 0], hull[e, 1] - hull[d, 1]
        if ey * (origin[0] - hull[d, 0]) - ex * (origin[1] - hull[d, 1]) <= 0.0:
            continue
        steps = math.ceil(math.hypot(ex, ey) / SIDE_STEP_M)
        for j in range(min(steps, MAX_SIDE_POINTS - n)):
            points[n, 0], points[n, 1] = hull[d, 0] + j / steps * ex, hull[d, 1] + j / steps * ey
            n += 1
    return points[:n]


@kernel
def _closeness(sides: Float64, axis: Float64, low: Float64, high: Float64) -> Float64:
    """Sum over points (N, 2) of 1 / distance to the nearest edge, for each box (16,) given by axis and corners."""
    total = np.zeros(DIRECTIONS)
    for i in range(sides.shape[0]):
        x, y = sides[i, 0], sides[i, 1]
        # inner loop over boxes: vectorized
        for d in range(DIRECTIONS):
            u, v = axis[0, d] * x + axis[1, d] * y, -axis[1, d] * x + axis[0, d] * y
            near = min(min(u - low[0, d], high[0, d] - u), min(v - low[1, d], high[1, d] - v))
            total[d] += 1.0 / max(near, EDGE_M)
    return total


@kernel
def _wrap_axis(angle: float) -> float:
    """Direction of the axis within [-pi/2, pi/2)."""
    return (angle + math.pi / 2.0) % math.pi - math.pi / 2.0


@kernel
def _nearest(
    offsets: Int32, indices: Int32, points: Float32, above: Float32, point_class: UInt8, front_x: float, half: float,
    nearest: Float64, top: Float64,
) -> None:  # fmt: skip
    """Nearest return and top of each cluster, from obstacle points alone (class 2 or more): no ghosts, no ground."""
    for k in range(offsets.shape[0] - 1):
        best = np.inf
        for i in indices[offsets[k] : offsets[k + 1]]:
            if point_class[i] < 2:
                continue
            top[k] = max(top[k], above[i])
            x, y = points[i, 0], points[i, 1]
            lateral = max(abs(y) - half, 0.0)
            d = (x - front_x) * (x - front_x) + lateral * lateral
            if d < best:
                best = d
                for j in range(3):
                    nearest[k, j] = points[i, j]

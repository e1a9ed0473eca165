"""Separation of bodies that one cluster joins: a person, animal or vehicle that comes near a car, wall or other body.

Each was a track of its own before. The returns of the cluster go to the track whose box is nearest to them, and each
part becomes an obstacle of its own; otherwise the smaller body is lost in the larger one, and with it its motion.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Bool, Float64, Int64
from geometry.transforms import apply, yaw_of
from messages.perception import Obstacles
from perception.lidar.boxes import fit_boxes
from perception.lidar.clusters import Clusters

PART = -1


class SeparationConfig(Config):
    """Limits of the clusters that are divided."""

    max_length_m: float = Field(gt=0.0, le=50.0, description="longer clusters are fences or hedges")
    max_size_share: float = Field(gt=0.0, le=1.0, description="of the length of a body in that of its cluster")
    min_returns: int = Field(ge=1, le=100, description="of a part")


def separate(
    obstacles: Obstacles, T_odom_base: Float64, p_m: Float64, size_m: Float64, yaw_rad: Float64, may_move: Bool,
    config: SeparationConfig,
) -> Obstacles:  # fmt: skip
    """Obstacles of a lidar with joined clusters divided; tracks (T,) in `odom`: boxes, and which are of a moving class.

    The parts have no class of their own; the indices of their returns are those of the cluster in another order.
    """
    joined = _joined(obstacles, T_odom_base, p_m, size_m, may_move, config)
    if not joined:
        return obstacles
    parts, source = list[Int64](), list[int]()
    for k, (first, last) in enumerate(pairwise(obstacles.offsets.tolist())):
        rows, tracks = np.arange(first, last), joined.get(k)
        own = [rows]
        if tracks is not None:
            points = np.asarray(apply(T_odom_base, obstacles.points_base_m[rows]), np.float64)
            away_m = distance_to_boxes_m(points, p_m[tracks], size_m[tracks], yaw_rad[tracks])
            found = [rows[away_m.argmin(axis=1) == n] for n in range(len(tracks))]
            own = found if min(map(len, found)) >= config.min_returns else own
        parts += own
        source += [k] if len(own) == 1 else [PART] * len(own)
    return _rebuilt(obstacles, parts, np.array(source))


def _joined(
    obstacles: Obstacles, T_odom_base: Float64, p_m: Float64, size_m: Float64, may_move: Bool,
    config: SeparationConfig,
) -> dict[int, Int64]:  # fmt: skip
    """Clusters that hold the centres of two tracks or more, one of which may move, with the rows of these tracks."""
    length = obstacles.size_m[:, 0]
    centers = np.asarray(apply(T_odom_base, obstacles.center_base_m), np.float64)
    yaw = obstacles.yaw_rad + yaw_of(T_odom_base)
    inside = distance_to_boxes_m(p_m, centers, obstacles.size_m, yaw) <= 0.0
    inside &= size_m[:, :1] <= config.max_size_share * length
    is_joined = (length <= config.max_length_m) & (inside.sum(axis=0) >= 2) & (inside & may_move[:, None]).any(axis=0)
    # the smaller box first: it keeps the returns that lie in both
    by_size = np.argsort(size_m[:, 0] * size_m[:, 1], kind="stable")
    return {int(k): by_size[inside[by_size, k]] for k in np.flatnonzero(is_joined)}


def distance_to_boxes_m(points: Float64, center_m: Float64, size_m: Float64, yaw_rad: Float64) -> Float64:
    """Distance of points (N, ..) from boxes (K, ..) in the level plane, 0 inside, (N, K)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    dx, dy = points[:, :1] - center_m[:, 0], points[:, 1:2] - center_m[:, 1]
    along = np.maximum(np.abs(c * dx + s * dy) - 0.5 * size_m[:, 0], 0.0)
    across = np.maximum(np.abs(c * dy - s * dx) - 0.5 * size_m[:, 1], 0.0)
    return np.asarray(np.hypot(along, across))


def _rebuilt(obstacles: Obstacles, parts: list[Int64], source: Int64) -> Obstacles:
    """Obstacles with the returns `parts` (K); `source` (K,): the obstacle that they were, or `PART` of one."""
    order = np.concatenate(parts)
    points = np.asfortranarray(obstacles.points_base_m[order])
    offsets = np.cumsum([0, *map(len, parts)], dtype=np.int32)
    n, is_part = len(points), source == PART
    clusters = Clusters(offsets, np.arange(n, dtype=np.int32))
    boxes = fit_boxes(clusters, points, points[:, 2].copy(), np.full(n, 2, np.uint8), (0.0, 0.0))

    def of(new: Float64, old: Float64) -> Float64:
        return np.where(is_part[:, None], new, old[source])

    scores = np.full((len(source), obstacles.class_scores.shape[1]), 1.0 / obstacles.class_scores.shape[1])
    return replace(
        obstacles,
        center_base_m=of(boxes.center_m, obstacles.center_base_m),
        size_m=of(boxes.size_m, obstacles.size_m),
        yaw_rad=np.where(is_part, boxes.yaw_rad, obstacles.yaw_rad[source]),
        nearest_base_m=of(boxes.nearest_m, obstacles.nearest_base_m),
        velocity_mps=np.full((len(source), 2), np.nan),
        class_scores=of(scores, obstacles.class_scores),
        offsets=offsets,
        indices=obstacles.indices[order],
        points_base_m=np.ascontiguousarray(points),
    )

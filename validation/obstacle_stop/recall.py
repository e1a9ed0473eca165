"""Detection of one true object in one scan, for recall and detection ranges."""

import numpy as np

from geometry.arrays import Float32, Float64
from messages.perception import Obstacles
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.observation import Setting


def detection_of(
    mine: np.ndarray, points: Float32, box: Box, obstacles: Obstacles | None, association_m: float
) -> tuple[bool, bool]:
    """`is_detected` and `is_detected_strictly` for the returns with indices `mine`."""
    sizes = np.diff(obstacles.offsets) if obstacles is not None else np.empty(0, np.int64)
    if obstacles is None or not len(mine) or not len(sizes):
        return False, False
    is_mine = np.zeros(len(points), bool)
    is_mine[mine] = True
    hits = np.bincount(np.repeat(np.arange(len(sizes)), sizes), is_mine[obstacles.indices], len(sizes))
    k = int(hits.argmax())
    is_detected = bool(hits.sum() >= 0.5 * len(mine))
    if hits[k] < 0.5 * len(mine):
        return is_detected, False
    own = points[obstacles.indices[obstacles.offsets[k] : obstacles.offsets[k + 1]]]
    return True, bool(box.contains(own, association_m).mean() >= 0.5)


def front_distance_m(points_m: Float32 | Float64, setting: Setting) -> float:
    """Horizontal distance of the nearest point from the front edge of the vehicle."""
    ahead = np.maximum(points_m[:, 0] - setting.front_m, 0.0)
    aside = np.maximum(np.abs(points_m[:, 1]) - 0.5 * setting.width_m, 0.0)
    return float(np.hypot(ahead, aside).min())

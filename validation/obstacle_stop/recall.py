"""Detection of one true object in one scan, for recall and detection ranges."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int32, Int64
from messages.perception import Obstacles
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.observation import Setting


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of one scan with returns `points_m` (N, 3); `cluster` (N,) is that of each return, -1 for none."""

    obstacles: Obstacles
    points_m: Float32
    cluster: Int32

    @classmethod
    def of(cls, obstacles: Obstacles, points_m: Float32) -> "Clusters":
        """Clusters of a message; a return belongs to one at most."""
        sizes = np.diff(obstacles.offsets)
        cluster = np.full(len(points_m), -1, np.int32)
        cluster[obstacles.indices] = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
        return cls(obstacles, points_m, cluster)

    def hits(self, mine: Int64) -> Int64:
        """Number of the returns `mine` (indices) in each cluster (K,)."""
        cluster = self.cluster[mine]
        return np.bincount(cluster[cluster >= 0], minlength=max(0, len(self.obstacles.offsets) - 1))

    def returns_m(self, k: int) -> Float32:
        """Returns (M, 3) of cluster `k`."""
        a, b = self.obstacles.offsets[k], self.obstacles.offsets[k + 1]
        return self.points_m[self.obstacles.indices[a:b]]


def detection_of(mine: Int64, box: Box, clusters: Clusters | None, association_m: float) -> tuple[bool, bool]:
    """`is_detected` and `is_detected_strictly` for the returns with indices `mine`."""
    hits = clusters.hits(mine) if clusters is not None and len(mine) else np.empty(0, np.int64)
    if clusters is None or not len(hits):
        return False, False
    k = int(hits.argmax())
    is_detected = bool(hits.sum() >= 0.5 * len(mine))
    if hits[k] < 0.5 * len(mine):
        return is_detected, False
    return True, bool(box.contains(clusters.returns_m(k), association_m).mean() >= 0.5)


def front_distance_m(points_m: Float32 | Float64, setting: Setting) -> float:
    """Horizontal distance of the nearest point from the front edge of the vehicle."""
    ahead = np.maximum(points_m[:, 0] - setting.front_m, 0.0)
    aside = np.maximum(np.abs(points_m[:, 1]) - 0.5 * setting.width_m, 0.0)
    return float(np.hypot(ahead, aside).min())

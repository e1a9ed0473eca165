"""Bodies of a person's size that stand close to something larger: their returns leave its cluster.

Clusters join over gaps in which a sparse or partly hidden body would fall apart, so that a person 0.2 m from a wall, a
car or a hedge belongs to its cluster. Above the knees, returns of one body lie closer to each other than that: parts of
a cluster that are joined over little more than a column of beams, and have the size of a person, are clusters of their
own. What is left of the cluster stays one.
"""

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.jit import kernel
from perception.lidar.clusters import ClusterConfig, Clusters, find_clusters, new_cell_grid
from perception.lidar.grid import take_rows

FOOT_M = 0.15  # by which feet stand out of a body


class BodyConfig(Config):
    """Joining distance within a cluster, and the size of a body."""

    range_m: float = Field(ge=10.0, le=60.0, description="from the sensor, within which clusters are examined")
    cell_m: float = Field(ge=0.05, le=0.5)
    join_distance_m: float = Field(gt=0.0, le=0.5)
    join_columns: float = Field(ge=0.0, le=10.0, description="added, in columns at the distance of the returns")
    knee_m: float = Field(ge=0.0, le=1.0, description="lower returns join nothing")
    min_returns: int = Field(ge=3, le=100)
    max_length_m: float = Field(gt=0.0, le=3.0, description="along x and y of base")
    min_height_m: float = Field(gt=0.0, le=2.0, description="from the lowest to the highest return above the knees")
    top_m: tuple[float, float] = Field(description="least and greatest height above the ground")


class BodySplitter:
    """Holds only values derived from configuration, and a buffer."""

    def __init__(self, config: BodyConfig, clusters: ClusterConfig, column_rad: float) -> None:
        self._config = config
        joining = {
            "cell_m": config.cell_m, "max_range_m": config.range_m, "min_returns": config.min_returns,
            "join_distance_m": config.join_distance_m, "join_growth": config.join_columns * column_rad,
        }  # fmt: skip
        self._joining = clusters.model_copy(update=joining)
        self._cell_grid = new_cell_grid(self._joining)

    def split(
        self, clusters: Clusters, points_base_m: Float32, above_m: Float32, point_class: UInt8, center_m: Float64
    ) -> Clusters:
        """Clusters of returns (N, 3) in `base` without bodies, followed by these.

        `above_m` (N,): height above the ground; `point_class` as in `find_clusters`.
        """
        config = self._config
        limits = config.range_m, config.knee_m, config.max_length_m, config.min_returns
        some = _candidates(
            clusters.offsets, clusters.indices, points_base_m, above_m, point_class, center_m, *limits
        )  # fmt: skip
        if len(some) == 0:
            return clusters
        every = np.full(len(some), 2, np.uint8)
        parts = find_clusters(take_rows(points_base_m, some), every, center_m, self._joining, self._cell_grid)
        size = config.max_length_m, config.min_height_m, *config.top_m
        offsets, indices = _separate(
            clusters.offsets, clusters.indices, parts.offsets, some[parts.indices], points_base_m, above_m,
            config.knee_m, *size,
        )  # fmt: skip
        return Clusters(offsets, indices)


@kernel
def _candidates(
    offsets: Int32, indices: Int32, points: Float32, above: Float32, point_class: UInt8, center: Float64,
    range_m: float, knee_m: float, length_m: float, least: int,
) -> Int32:  # fmt: skip
    """Obstacle returns above the knees of the clusters that are larger than a body and come within the range."""
    out, n = np.empty(indices.shape[0] + 1, np.int32), 0
    for k in range(offsets.shape[0] - 1):
        start, nearest = n, np.inf
        x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
        for i in indices[offsets[k] : offsets[k + 1]]:
            x, y = points[i, 0], points[i, 1]
            away = (x - center[0]) ** 2 + (y - center[1]) ** 2
            if point_class[i] >= 2 and above[i] >= knee_m and away < range_m * range_m:
                x0, x1, y0, y1, nearest = min(x0, x), max(x1, x), min(y0, y), max(y1, y), min(nearest, away)
                out[n] = i
                n += 1
        if n - start < 2 * least or max(x1 - x0, y1 - y0) < 0.8 * length_m:
            n = start
    return out[:n]


@kernel
def _separate(
    offsets: Int32, indices: Int32, part_offsets: Int32, part_indices: Int32, points: Float32, above: Float32,
    knee_m: float, length_m: float, height_m: float, lowest_m: float, highest_m: float,
) -> tuple[Int32, Int32]:  # fmt: skip
    """Offsets and indices of the clusters without the parts that are bodies, followed by these."""
    clusters, parts = offsets.shape[0] - 1, part_offsets.shape[0] - 1
    label = np.full(points.shape[0], -1, np.int32)  # of its cluster, or of its body
    for k in range(clusters):
        label[indices[offsets[k] : offsets[k + 1]]] = k
    box, first = np.empty((parts, 4)), np.full(clusters + parts, -1, np.int32)
    following, count = np.full(parts, -1, np.int32), 0
    for p in range(parts):
        x0, x1, y0, y1, z0, z1, top = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf, -np.inf
        for i in part_indices[part_offsets[p] : part_offsets[p + 1]]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            x0, x1, y0, y1, z0, z1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y), min(z0, z), max(z1, z)
            top = max(top, above[i])
        is_body = max(x1 - x0, y1 - y0) <= length_m and z1 - z0 >= height_m and lowest_m <= top <= highest_m
        if not is_body:
            continue
        own = label[part_indices[part_offsets[p]]]
        following[count], first[own] = first[own], count
        box[count] = x0 - FOOT_M, x1 + FOOT_M, y0 - FOOT_M, y1 + FOOT_M
        for i in part_indices[part_offsets[p] : part_offsets[p + 1]]:
            label[i] = clusters + count
        count += 1
    if count == 0:
        return offsets, indices
    size = np.zeros(clusters + count, np.int32)
    for i in indices:
        k = label[i]
        if k < clusters and above[i] < knee_m:  # feet
            b = first[k]
            while b >= 0:
                x, y = points[i, 0], points[i, 1]
                if box[b, 0] <= x <= box[b, 1] and box[b, 2] <= y <= box[b, 3]:
                    label[i] = clusters + b
                    break
                b = following[b]
        size[label[i]] += 1
    starts, n = np.zeros(clusters + count + 1, np.int32), 0  # of the clusters that are left
    fill, out = np.zeros(clusters + count, np.int32), np.empty(indices.shape[0], np.int32)
    for k in range(clusters + count):
        if size[k] > 0:
            fill[k] = starts[n]
            starts[n + 1] = starts[n] + size[k]
            n += 1
    for i in indices:
        out[fill[label[i]]] = i
        fill[label[i]] += 1
    return starts[: n + 1].copy(), out

"""Bodies of a person's size that stand close to something larger: their returns leave its cluster.

Clusters join over gaps in which a sparse or partly hidden body would fall apart, so that a person 0.2 m from a wall, a
car or a hedge belongs to its cluster. Above the knees, returns of one body lie closer to each other than that: parts of
a cluster that are joined over little more than a column of beams, and have the size of a person, are clusters of their
own. What is left of the cluster stays one; a rider is not taken off a bicycle.

           ┌────────────────┐ wall, hedge, fence, vehicle     whole:   nothing taken off
    gap    └────────────────┘                                 body:    a person or a post, equally likely
               ( )  body                                      may hold a body: no more a vehicle than unknown
"""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.jit import inline_kernel, kernel
from perception.lidar.clusters import ClusterConfig, Clusters, find_clusters, new_cell_grid, select
from perception.lidar.expected_points import Beams
from perception.lidar.grid import take_rows

LOOSE, OTHER = -1, -2  # marks of returns in no part, and in a part that is no body
WHOLE, BODY, MAY_HOLD_BODY = 0, 1, 2  # kinds of clusters: nothing taken off; a body; part of it may be one
FOOT_M = 0.15  # by which feet and other loose returns stand out of a body
DOUBT_FILL = 0.6  # of `min_fill`: with fewer returns not even a doubt, such as in the far half of a slanted face
LOW_M = 0.45  # returns of the ground this near to a body would widen the box of what it stands beside
BICYCLE_M = (2.2, 1.15)  # length, and height without the rider
MIN_JOINS = 1.5  # joining distances of the extent of a body: single columns of a slanted face have less


class BodyConfig(Config):
    """Joining distance within a cluster, and the size of a body."""

    range_m: float = Field(ge=10.0, le=60.0, description="from the sensor, within which clusters are examined")
    min_share: float = Field(ge=0.0, le=1.0, description="of the beams that return; gaps of a thinner scan are none")
    cell_m: float = Field(ge=0.05, le=0.5)
    join_distance_m: float = Field(gt=0.0, le=0.5)
    join_columns: float = Field(ge=0.0, le=10.0, description="added, in columns at the distance of the returns")
    knee_m: float = Field(ge=0.0, le=1.0, description="lower returns join nothing")
    min_returns: int = Field(ge=3, le=100)
    min_fill: float = Field(
        ge=0.0, le=1.0, description="returns over beams that cross the outline: not a part in a gap"
    )
    sufficient_returns: int = Field(ge=3, le=1000, description="number from which `min_fill` is not required")
    max_length_m: float = Field(gt=0.0, le=3.0, description="along x and y of base")
    max_bodies: int = Field(ge=1, le=100, description="of a cluster; one of more parts falls apart: a slanted face")
    min_height_m: float = Field(gt=0.0, le=2.0, description="from the lowest to the highest return above the knees")
    top_m: tuple[float, float] = Field(description="least and greatest height above the ground")
    min_rest: float = Field(ge=0.0, le=10.0, description="returns of the rest of its cluster over those of a body")


class BodySplitter:
    """Holds only values derived from configuration, and a buffer."""

    def __init__(self, config: BodyConfig, clusters: ClusterConfig, beams: Beams, columns: int) -> None:
        self._least_returns = config.min_share * len(beams.tangents) * columns
        self._config, column_rad = config, beams.column_rad
        ring_rad = float(np.median(np.diff(np.arctan(beams.tangents)))) if len(beams.tangents) > 1 else math.pi
        self._beam_rad2 = column_rad * ring_rad
        joining = {
            "cell_m": config.cell_m, "max_range_m": config.range_m, "min_returns": config.min_returns,
            "join_distance_m": config.join_distance_m, "join_growth": config.join_columns * column_rad,
        }  # fmt: skip
        self._joining = clusters.model_copy(update=joining)
        self._cell_grid = new_cell_grid(self._joining)

    def split(
        self, clusters: Clusters, points_base_m: Float32, above_m: Float32, point_class: UInt8, center_m: Float64
    ) -> tuple[Clusters, UInt8]:
        """Clusters of returns (N, 3) in `base` without bodies, followed by these; and their kinds (K,), as above.

        `above_m` (N,): height above the ground; `point_class` as in `find_clusters`.
        """
        config, kinds = self._config, np.full(len(clusters.offsets) - 1, WHOLE, np.uint8)
        if len(points_base_m) < self._least_returns:
            return clusters, kinds
        limits = config.range_m, config.knee_m, config.max_length_m, config.min_returns, config.top_m[0]
        some, cluster = _candidates(
            clusters.offsets, clusters.indices, points_base_m, above_m, point_class, center_m, *limits
        )  # fmt: skip
        if len(some) == 0:
            return clusters, kinds
        every = np.full(len(some), 2, np.uint8)
        parts = find_clusters(take_rows(points_base_m, some), every, center_m, self._joining, self._cell_grid)
        joining = self._joining
        size = config.max_length_m, config.min_height_m, *config.top_m, config.min_rest
        fill = config.min_fill / self._beam_rad2, float(config.sufficient_returns)
        apart = MIN_JOINS * joining.join_distance_m, MIN_JOINS * joining.join_growth, float(config.max_bodies)
        offsets, indices = _separate(
            clusters.offsets, clusters.indices, parts.offsets, some[parts.indices], cluster[parts.indices],
            points_base_m, above_m, point_class, center_m, config.knee_m, *size, *fill, *apart, kinds,
        )  # fmt: skip
        kinds = np.concatenate([kinds, np.full(len(offsets) - len(clusters.offsets), BODY, np.uint8)])
        has_rest = np.diff(offsets) > 0  # two bodies may be all of a cluster
        return select(Clusters(offsets, indices), has_rest), kinds[has_rest]


@kernel
def _candidates(
    offsets: Int32, indices: Int32, points: Float32, above: Float32, point_class: UInt8, center: Float64,
    range_m: float, knee_m: float, length_m: float, least: int, lowest_m: float,
) -> tuple[Int32, Int32]:  # fmt: skip
    """Obstacle returns above the knees of the clusters that are larger than a body and come within the range, and the
    cluster of each."""
    out, cluster, n = np.empty(indices.shape[0] + 1, np.int32), np.empty(indices.shape[0] + 1, np.int32), 0
    for k in range(offsets.shape[0] - 1):
        start, top = n, 0.0
        x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
        for i in indices[offsets[k] : offsets[k + 1]]:
            x, y = points[i, 0], points[i, 1]
            away = (x - center[0]) ** 2 + (y - center[1]) ** 2
            if point_class[i] >= 2 and above[i] >= knee_m and away < range_m * range_m:
                x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
                top = max(top, above[i])
                out[n], cluster[n] = i, k
                n += 1
        if n - start < 2 * least or max(x1 - x0, y1 - y0) < length_m or top < lowest_m:
            n = start
    return out[:n], cluster[:n]


@kernel
def _separate(
    offsets: Int32, indices: Int32, part_offsets: Int32, part_indices: Int32, cluster: Int32, points: Float32,
    above: Float32, point_class: UInt8, center: Float64,
    knee_m: float, length_m: float, height_m: float, lowest_m: float, highest_m: float, min_rest: float,
    per_rad2: float, sufficient: float, least_m: float, growth: float, most: float, kinds: UInt8,
) -> tuple[Int32, Int32]:  # fmt: skip
    """Offsets and indices of the clusters without the parts that are bodies, followed by these.

    `cluster`: that of each of `part_indices`. Sets `kinds` of clusters with a part that has the outline of a body and
    is not taken off.
    """
    clusters, parts = offsets.shape[0] - 1, part_offsets.shape[0] - 1
    own, box, is_body = np.empty(parts, np.int32), np.empty((parts, 5)), np.zeros(parts, np.bool_)
    has_outline = np.zeros(parts, np.bool_)
    for p in range(parts):
        own[p] = cluster[part_offsets[p]]
        x0, x1, y0, y1, z0, z1, top = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf, -np.inf
        for i in part_indices[part_offsets[p] : part_offsets[p + 1]]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            x0, x1, y0, y1, z0, z1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y), min(z0, z), max(z1, z)
            top = max(top, above[i])
        is_body[p] = max(x1 - x0, y1 - y0) <= length_m and z1 - z0 >= height_m and lowest_m <= top <= highest_m
        has_outline[p] = is_body[p]
        box[p] = x0, x1, y0, y1, top
        x, y = (x0 + x1) / 2.0 - center[0], (y0 + y1) / 2.0 - center[1]
        away2 = max(x * x + y * y, 0.25)
        across = (abs(y) * (x1 - x0) + abs(x) * (y1 - y0)) / math.sqrt(away2)
        n = part_offsets[p + 1] - part_offsets[p]
        filled = n * away2 / max(per_rad2 * across * (z1 - z0), 1e-9)
        is_body[p] &= n >= sufficient or filled >= 1.0
        has_outline[p] &= n >= sufficient or filled >= DOUBT_FILL
        is_body[p] &= max(x1 - x0, y1 - y0) >= least_m + growth * math.sqrt(away2)
    bodies = np.zeros(clusters, np.int32)
    for p in range(parts):
        is_body[p] = is_body[p] and _has_rest(p, own, box, part_offsets, length_m, min_rest)
        bodies[own[p]] += is_body[p]
    body, first = np.full(points.shape[0], LOOSE, np.int32), np.full(clusters, LOOSE, np.int32)
    body[part_indices] = OTHER
    following, count = np.full(parts, LOOSE, np.int32), 0
    for p in range(parts):
        if has_outline[p] and not (is_body[p] and bodies[own[p]] <= most):
            kinds[own[p]] = MAY_HOLD_BODY
        if is_body[p] and bodies[own[p]] <= most:
            following[p], first[own[p]] = first[own[p]], p
            body[part_indices[part_offsets[p] : part_offsets[p + 1]]] = p
            count += 1
    if count == 0:
        return offsets, indices
    starts, out = np.zeros(clusters + count + 1, np.int32), np.empty(indices.shape[0], np.int32)
    n = k = 0
    for c in range(clusters):
        if first[c] < 0:
            m = n + offsets[c + 1] - offsets[c]
            out[n:m] = indices[offsets[c] : offsets[c + 1]]
            n = m
        else:
            for i in indices[offsets[c] : offsets[c + 1]]:
                if body[i] == LOOSE:
                    body[i] = _body_near(points[i, 0], points[i, 1], first[c], following, box, FOOT_M)
                if body[i] >= 0:
                    continue
                if point_class[i] > 1 or _body_near(points[i, 0], points[i, 1], first[c], following, box, LOW_M) < 0:
                    out[n] = i
                    n += 1
        k += 1
        starts[k] = n
    for c in range(clusters):
        p = first[c]
        while p >= 0:
            for i in indices[offsets[c] : offsets[c + 1]]:
                if body[i] == p:
                    out[n] = i
                    n += 1
            k += 1
            starts[k] = n
            p = following[p]
    return starts, out[:n]


@inline_kernel
def _body_near(x: float, y: float, first: int, following: Int32, box: Float64, near_m: float) -> int:
    """The body of a list of parts near whose box a return lies, else `LOOSE`."""
    p = first
    while p >= 0:
        if box[p, 0] - near_m <= x <= box[p, 1] + near_m and box[p, 2] - near_m <= y <= box[p, 3] + near_m:
            break
        p = following[p]
    return p


@inline_kernel
def _has_rest(p: int, own: Int32, box: Float64, part_offsets: Int32, length_m: float, min_rest: float) -> bool:
    """Whether the other parts of the cluster of part `p` are together larger than a body, and have enough returns."""
    x0, x1, y0, y1, top, n = np.inf, -np.inf, np.inf, -np.inf, 0.0, 0
    for q in range(own.shape[0]):
        if q != p and own[q] == own[p]:
            x0, x1, y0, y1 = min(x0, box[q, 0]), max(x1, box[q, 1]), min(y0, box[q, 2]), max(y1, box[q, 3])
            top = max(top, box[q, 4])
            n += part_offsets[q + 1] - part_offsets[q]
    rest_m = max(x1 - x0, y1 - y0)
    is_larger = rest_m > BICYCLE_M[0] or (rest_m > length_m and top > BICYCLE_M[1])
    return is_larger and n >= min_rest * (part_offsets[p + 1] - part_offsets[p])

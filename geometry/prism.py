"""Upright prisms: solids as stacks of slabs, and their distance in 3-D."""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from geometry.arrays import Float32, Float64, Int32

SLAB_M = 0.25  # height of the slabs of a solid
FACE_M = 1e-3  # faces whose distances differ by less touch together
NEAR_M = 0.01  # distance below which the place is the middle of all touching faces
THIN_M = 0.002  # half width given to a slab without area


@dataclass(frozen=True, eq=False)
class Prism:
    """A convex outline (N, 2) from `low_m` to `high_m`; `name` is the part that it belongs to."""

    name: str
    outline_m: Float64
    low_m: float
    high_m: float


@dataclass(frozen=True, eq=False)
class Solids:
    """K prisms as arrays: polygons (K,), heights (K, 2), names."""

    polygons: np.ndarray
    z_m: Float64
    names: tuple[str, ...]

    @staticmethod
    def of(prisms: list[Prism]) -> "Solids":
        """The prisms as arrays."""
        polygons = np.array([shapely.Polygon(p.outline_m) for p in prisms], dtype=object)
        return Solids(polygons, np.array([[p.low_m, p.high_m] for p in prisms]).reshape(-1, 2),
                      tuple(p.name for p in prisms))  # fmt: skip

    def moved(self, x_m: float, y_m: float, yaw_rad: float, up_m: float = 0.0) -> "Solids":
        """Turned about the origin by `yaw_rad`, then moved."""
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        turn, shift = np.array([[c, s], [-s, c]]), [x_m, y_m]
        return Solids(shapely.transform(self.polygons, lambda p: p @ turn + shift), self.z_m + up_m, self.names)

    def scaled(self, width: float) -> "Solids":
        """With y multiplied by `width`."""
        return Solids(shapely.transform(self.polygons, lambda p: p * [1.0, width]), self.z_m, self.names)


@dataclass(frozen=True)
class Nearest:
    """Distance between two groups of solids; part of the first, and the place on it (3,)."""

    distance_m: float
    part: str
    point_m: tuple[float, float, float]


def nearest(a: Solids, b: Solids) -> Nearest:
    """Smallest distance in 3-D between two groups, 0 in contact; infinite without solids."""
    if not len(a.polygons) or not len(b.polygons):
        return Nearest(math.inf, "", (math.nan,) * 3)
    above = b.z_m[None, :, 0] - a.z_m[:, None, 1]
    below = a.z_m[:, None, 0] - b.z_m[None, :, 1]
    gap = np.maximum(np.maximum(above, below), 0.0)
    flat = shapely.distance(a.polygons[:, None], b.polygons[None, :])
    apart = np.hypot(flat, gap)
    least = float(apart.min())
    i, j = (int(k) for k in np.unravel_index(int(apart.argmin()), apart.shape))
    if least > NEAR_M:
        x, y = shapely.get_coordinates(shapely.shortest_line(a.polygons[i], b.polygons[j])).mean(axis=0).tolist()
        return Nearest(least, a.names[i], (x, y, _middle_m(a, b, i, j)))
    pairs = np.argwhere(apart <= least + FACE_M).tolist()
    faces = [shapely.intersection(a.polygons[m], shapely.buffer(b.polygons[n], NEAR_M + FACE_M)) for m, n in pairs]
    weights = [face.area + 1e-12 for face in faces]
    points = [(*shapely.get_coordinates(face.centroid)[0], _middle_m(a, b, m, n))
              for face, (m, n) in zip(faces, pairs, strict=True)]  # fmt: skip
    x, y, z = np.average(points, axis=0, weights=weights).tolist()
    return Nearest(least, a.names[i], (x, y, z))


def _middle_m(a: Solids, b: Solids, i: int, j: int) -> float:
    """Middle of the heights that two prisms share, or of the gap between them."""
    z = sorted((a.z_m[i, 0], a.z_m[i, 1], b.z_m[j, 0], b.z_m[j, 1]))
    return float(0.5 * (z[1] + z[2]))


def slabs_of(name: str, vertices_m: Float32 | Float64, triangles: Int32, slab_m: float = SLAB_M) -> list[Prism]:
    """A triangle mesh (N, 3), (M, 3) as slabs, each the convex hull of what lies between its heights."""
    v = np.asarray(vertices_m, np.float64)
    low, high = float(v[:, 2].min()), float(v[:, 2].max())
    levels = np.linspace(low, high, max(1, math.ceil((high - low) / slab_m - 1e-6)) + 1)
    edges = np.unique(np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), 1), axis=0)
    a, b = v[edges[:, 0]], v[edges[:, 1]]
    return [Prism(name, hull_of(np.vstack([v[(v[:, 2] >= z0) & (v[:, 2] <= z1), :2], _crossings(a, b, z0),
                                           _crossings(a, b, z1)])), z0, z1)
            for z0, z1 in zip(levels[:-1].tolist(), levels[1:].tolist(), strict=True)]  # fmt: skip


def _crossings(a: Float64, b: Float64, z: float) -> Float64:
    """Points (K, 2) at which edges from a to b (N, 3) cross a height."""
    crosses = (a[:, 2] - z) * (b[:, 2] - z) < 0.0
    p, q = a[crosses], b[crosses]
    share = ((z - p[:, 2]) / (q[:, 2] - p[:, 2]))[:, None]
    return np.asarray(p[:, :2] + share * (q[:, :2] - p[:, :2]))


def hull_of(points_m: Float64) -> Float64:
    """Convex hull (K, 2) of points (N, 2), with a width of at least twice `THIN_M`."""
    hull = shapely.MultiPoint(points_m).convex_hull
    if hull.geom_type != "Polygon":
        hull = hull.buffer(THIN_M, cap_style="square", quad_segs=1)
    return np.asarray(shapely.get_coordinates(hull), np.float64)[:-1]

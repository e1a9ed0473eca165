"""Footprint of a rigid machine with its implement at a pose and along a path."""

import numpy as np
import numpy.typing as npt
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64, Int64
from geometry.rectangle import Rectangle

Bodies = tuple[Rectangle, ...]
STRAIGHT_RAD = 0.01
BAND_STEPS = 24  # of two edge lines that are one polygon, where its outline does not cross itself


def place(points_base_m: Float64, p_map_m: Float64, heading_rad: Float64) -> Float64:
    """Points (K, 2) of `base` at N poses, as (N, K, 2) in `map`."""
    c, s = np.cos(heading_rad)[:, None], np.sin(heading_rad)[:, None]
    x, y = points_base_m[:, 0][None], points_base_m[:, 1][None]
    return np.stack([p_map_m[:, :1] + c * x - s * y, p_map_m[:, 1:2] + s * x + c * y], axis=-1)


def footprints(bodies: Bodies, p_map_m: Float64, heading_rad: Float64) -> npt.NDArray[np.object_]:
    """The bodies as polygons, (N, B)."""
    columns = [np.asarray(shapely.polygons(place(b.corners_m, p_map_m, heading_rad))) for b in bodies]
    return np.stack(columns, axis=1)


def is_inside(bodies: Bodies, p_map_m: Float64, heading_rad: Float64, allowed: BaseGeometry) -> Bool:
    """Whether all bodies lie completely within `allowed` at each pose, (N,)."""
    shapely.prepare(allowed)
    return np.asarray(shapely.covers(allowed, footprints(bodies, p_map_m, heading_rad)).all(axis=1), np.bool_)


def sweep(bodies: Bodies, p_map_m: Float64, heading_rad: Float64) -> BaseGeometry:
    """Area swept along the poses: union of the convex hulls of consecutive footprints."""
    shapes = []
    for body in bodies:
        corners = place(body.corners_m, p_map_m, heading_rad)
        pairs = np.concatenate([corners[:-1], corners[1:]], axis=1) if len(corners) > 1 else corners
        shapes.append(shapely.union_all(shapely.convex_hull(shapely.multipoints(pairs))))
    return shapely.union_all(shapes)


def corners_of(heading_rad: Float64) -> Int64:
    """Indices between which the heading changes by less than `STRAIGHT_RAD`, with both ends, (M,)."""
    level = np.floor((heading_rad - heading_rad[0]) / STRAIGHT_RAD + 0.5)
    changes = np.flatnonzero(np.diff(level))
    return np.unique(np.concatenate([[0], changes, changes + 1, [len(heading_rad) - 1]]))


def worked(left_m: Float64, right_m: Float64) -> BaseGeometry:
    """Area between two edge lines (N, 2), exact also where one edge rests or reverses."""
    steps = np.stack([left_m[:-1], left_m[1:], right_m[1:], right_m[:-1]], axis=1)
    sides = np.roll(steps, -1, axis=1) - steps
    following = np.roll(sides, -1, axis=1)
    turns = sides[..., 0] * following[..., 1] - sides[..., 1] * following[..., 0]
    shapes = list[BaseGeometry]()
    for first in range(0, len(steps), BAND_STEPS):
        part = slice(first, first + BAND_STEPS)
        is_convex = (turns[part] >= 0.0).all() or (turns[part] <= 0.0).all()  # each step, all in the same sense
        left, right = (line[first : first + BAND_STEPS + 1] for line in (left_m, right_m))
        band = Polygon(np.concatenate([left, right[::-1]]))
        if is_convex and band.is_valid:
            shapes.append(band)
        else:
            shapes.append(shapely.union_all(shapely.convex_hull(shapely.multipoints(steps[part]))))
    return shapely.union_all(shapes)

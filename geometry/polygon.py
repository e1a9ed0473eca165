"""Polygons: morphological opening and closing, rings and edge angles."""

import math
from collections.abc import Iterable

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64

ARC_SEGMENTS = 32  # per quarter turn: an arc of 5 m is 1.5 mm off
ARC_ERROR_M = 0.003
GRID_M = 1e-6


def parts(shape: BaseGeometry, min_area_m2: float = 0.0) -> list[Polygon]:
    """Polygons of a shape larger than `min_area_m2`, ordered by their lower left corner."""
    if isinstance(shape, Polygon):
        found = [shape]
    elif hasattr(shape, "geoms"):
        found = [g for g in shape.geoms if isinstance(g, Polygon)]
    else:
        found = []
    found = [p for p in found if not p.is_empty and p.area > min_area_m2]
    return sorted(found, key=lambda p: (p.bounds[0], p.bounds[1], p.area))


def united(shapes: Iterable[BaseGeometry]) -> BaseGeometry:
    """Union of areas, vertices rounded to `GRID_M`.

    Without a grid GEOS (3.14) may drop areas whose edges lie on each other but for rounding, as those of swaths do.
    """
    return shapely.union_all(list(shapes), grid_size=GRID_M)


def as_polygon(shape: BaseGeometry) -> Polygon:
    """The shape as one polygon; raises ValueError for other shapes."""
    if not isinstance(shape, Polygon):
        raise ValueError(f"one polygon is needed, not {shape.geom_type}")
    return shape


def shrink(shape: BaseGeometry, by_m: float) -> BaseGeometry:
    """Shape eroded by `by_m`: convex corners stay sharp, concave ones become arcs."""
    return shape.buffer(-by_m, quad_segs=ARC_SEGMENTS)


def grow(shape: BaseGeometry, by_m: float) -> BaseGeometry:
    """Shape dilated by `by_m`, with rounded convex corners."""
    return shape.buffer(by_m, quad_segs=ARC_SEGMENTS)


def open_by(shape: BaseGeometry, radius_m: float) -> BaseGeometry:
    """Opening by a disc of `radius_m`: convex corners become arcs, narrow necks are removed."""
    return grow(shrink(shape, radius_m), radius_m)


def close_by(shape: BaseGeometry, radius_m: float) -> BaseGeometry:
    """Closing by a disc of `radius_m`: concave corners become arcs."""
    return shrink(grow(shape, radius_m), radius_m)


def rounded(shape: BaseGeometry, radius_m: float) -> BaseGeometry:
    """Closing, then opening by a disc: all corners become arcs of at least `radius_m`; narrow necks are removed."""
    for by_m in (radius_m, -2.0 * radius_m, radius_m):
        shape = shape.simplify(ARC_ERROR_M).buffer(by_m, quad_segs=ARC_SEGMENTS)
    return shape


def polygon_of(shape: BaseGeometry) -> MultiPolygon:
    """The areas of any shape as one MultiPolygon."""
    return MultiPolygon(parts(shape))


def ring_points(polygon: Polygon) -> list[Float64]:
    """Outline and holes as closed polylines (first point repeated): outline counter-clockwise, holes clockwise."""
    polygon = shapely.geometry.polygon.orient(polygon, 1.0)
    return [np.asarray(ring.coords, np.float64)[:, :2] for ring in (polygon.exterior, *polygon.interiors)]


def edge_angles(polygon: Polygon) -> list[tuple[float, float]]:
    """Direction (0 to π) and length of each edge of the outline, longest first."""
    d = np.diff(np.asarray(polygon.exterior.coords)[:, :2], axis=0)
    edges = [(math.atan2(y, x) % math.pi, math.hypot(x, y)) for x, y in d]
    return sorted(edges, key=lambda e: (-round(e[1], 6), e[0]))


def place_of(shape: BaseGeometry) -> tuple[float, float]:
    """A point inside the shape."""
    point = shape.representative_point()
    return float(point.x), float(point.y)

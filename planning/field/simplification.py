"""Simplification of a polygon inwards: the result has fewer vertices and lies within the original."""

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64
from geometry.polygon import as_polygon, ring_points

TOLERANCE_M = 0.02
SHRUNK_M = (0.02, 0.05, 0.1)
MANY_VERTICES = 2000
ROUNDS = 200
ROUNDING_M = 1e-6


def simplified_inwards(polygon: Polygon) -> Polygon:
    """Polygon without vertices that lie up to 2 cm outside the line through their neighbours.

    With more than 2,000 vertices left it is shrunk by 2, 5 or 10 cm and simplified by as much. The polygon itself where
    the result would not lie within it.
    """
    outer = polygon.buffer(ROUNDING_M, join_style="mitre")
    best = _within(outer, Polygon(*_rings(polygon, TOLERANCE_M))) or polygon
    for by_m in SHRUNK_M:
        if len(shapely.get_coordinates(best)) <= MANY_VERTICES:
            break
        best = _within(outer, polygon.buffer(-by_m, join_style="mitre").simplify(0.99 * by_m)) or best
    return best


def _within(outer: BaseGeometry, found: BaseGeometry) -> Polygon | None:
    is_inside = isinstance(found, Polygon) and found.is_valid and not found.is_empty and outer.covers(found)
    return as_polygon(found) if is_inside else None


def _rings(polygon: Polygon, tolerance_m: float) -> tuple[Float64, list[Float64]]:
    outline, *holes = (_thinned(points, tolerance_m) for points in ring_points(polygon))
    return outline, holes


def _thinned(ring_m: Float64, tolerance_m: float) -> Float64:
    """A ring (N, 2), interior to its left, without convex vertices within the tolerance.

    `cut` is the largest distance of the removed vertices from the edge that begins at a vertex, as an upper bound.
    """
    points, cut = ring_m[:-1], np.zeros(len(ring_m) - 1)
    for _ in range(ROUNDS):
        if len(points) <= 4:
            break
        before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
        chord = after - before
        length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-9)
        # positive where the vertex is right of the chord: removing it cuts the interior
        out_m = -(chord[:, 0] * (points - before)[:, 1] - chord[:, 1] * (points - before)[:, 0]) / length
        total = out_m + np.maximum(np.roll(cut, 1), cut)
        is_between = ((points - before) * chord).sum(axis=1) * ((after - points) * chord).sum(axis=1) > 0.0
        removed = _not_adjacent((out_m >= 0.0) & (total <= tolerance_m) & is_between, total)
        if not removed.any() or len(points) - removed.sum() < 4:
            break
        cut = np.where(np.roll(removed, -1), np.roll(total, -1), cut)[~removed]
        points = points[~removed]
    return np.vstack([points, points[:1]])


def _not_adjacent(candidates: Bool, cost: Float64) -> Bool:
    """Candidates that cost less than both neighbours; equal ones by their index."""
    rank = np.empty(len(cost), np.int64)
    rank[np.lexsort((np.arange(len(cost)) % 2, np.where(candidates, cost, np.inf)))] = np.arange(len(cost))
    return candidates & (rank < np.roll(rank, 1)) & (rank < np.roll(rank, -1))

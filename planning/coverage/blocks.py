"""Blocks of an area to be worked: parts that are cheaper to work in a direction each than together.

The number of swaths of an area in one direction is its altitude over the working width: half the length of its boundary
across that direction (Huang 2001, minimal sum of altitudes). An area is cut at a reflex corner, along one of the edges
there, where that lowers the sum.
"""

import math

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.polygon import orient
from shapely.ops import split

from geometry.arrays import Float64
from geometry.polygon import parts, ring_points

SIMPLER = 1.0 / 3.0  # of the working width: arcs of headland passes become corners
REFLEX_RAD = math.radians(20.0)
MAX_CORNERS = 12
MAX_DEPTH, TRIED = 3, 4
LEAST_GAIN = 0.05  # of the cost
BLOCK_SWATHS = 1.5  # cost of one more block, in swaths
MIN_BLOCK_WIDTHS = 4.0  # least area of a block, in squared working widths


def blocks_of(area: Polygon, width_m: float, depth: int = 0) -> list[Polygon]:
    """Blocks that cover the area, which is one of them itself where no cuts pay."""
    best: tuple[float, list[Polygon]] = ((1.0 - LEAST_GAIN) * _cost(area, width_m), [area])
    least_m2 = MIN_BLOCK_WIDTHS * width_m**2
    if depth == MAX_DEPTH or area.area < 2.0 * least_m2:
        return best[1]
    halves = [parts(split(area, cut)) for cut in _cuts(area, SIMPLER * width_m)]
    halves = [h for h in halves if len(h) > 1 and min(p.area for p in h) > least_m2]
    for half in sorted(halves, key=lambda h: round(sum(_cost(p, width_m) for p in h), 6))[:TRIED]:
        blocks = [block for piece in half for block in blocks_of(piece, width_m, depth + 1)]
        cost = sum(_cost(p, width_m) for p in blocks)
        if cost < best[0] - 1e-6:
            best = cost, blocks
    return best[1]


def _cost(area: Polygon, width_m: float) -> float:
    """Number of swaths in the best direction, and a constant for each block."""
    edges = np.vstack([np.diff(ring, axis=0) for ring in ring_points(area)])
    longest = edges[np.argsort(-np.hypot(*edges.T), kind="stable")[:MAX_CORNERS]]
    normals = np.column_stack([-longest[:, 1], longest[:, 0]]) / np.hypot(*longest.T)[:, None]
    altitude = 0.5 * np.abs(edges @ normals.T).sum(axis=0)
    return float(altitude.min()) / width_m + BLOCK_SWATHS


def _cuts(area: Polygon, simpler_m: float) -> list[LineString]:
    """Lines within the area through a reflex corner along one of its edges, sharpest corners first."""
    plain = area.simplify(simpler_m)
    if not isinstance(plain, Polygon):
        return []
    corners: list[tuple[float, Float64, Float64, Float64]] = []
    for ring in ring_points(orient(plain, 1.0)):
        before, after = np.roll(np.diff(ring, axis=0), 1, axis=0), np.diff(ring, axis=0)
        turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
        corners += [(float(turn[k]), ring[k], before[k], after[k]) for k in np.flatnonzero(turn < -REFLEX_RAD)]
    reach = math.hypot(area.bounds[2] - area.bounds[0], area.bounds[3] - area.bounds[1])
    found = []
    for _, corner, before, after in sorted(corners, key=lambda c: (round(c[0], 6), *c[1]))[:MAX_CORNERS]:
        for edge in (before, after):
            along = edge / np.hypot(*edge) * reach
            line = LineString([corner - along, corner + along]).intersection(area)
            lines = [g for g in shapely.get_parts(line) if isinstance(g, LineString)]
            near = [g for g in lines if g.distance(shapely.Point(corner)) < 2.0 * simpler_m]
            found += [_longer(g) for g in near if g.length > 1.0]
    return found


def _longer(line: LineString) -> LineString:
    """The line a little beyond both ends, so that it cuts the outline."""
    a, b = (np.asarray(line.coords[k]) for k in (0, -1))
    beyond = 0.01 * (b - a) / np.hypot(*(b - a))
    return LineString([a - beyond, b + beyond])

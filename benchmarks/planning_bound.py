"""Upper bound of the share of a field that a machine with an implement can work, whatever it drives.

Work needs a pose at which machine and implement are inside the field less its margin, and which the machine with the
folded implement can reach. Poses are tried at headings `STEP_RAD` apart with bodies smaller, and a working line longer,
by what a heading in between may differ: the bound is not below the true one. It shares no code with the planner.
"""

import math
from collections.abc import Iterator

import numpy as np
import shapely
from shapely.affinity import rotate, translate
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from configs.vehicle import MountedImplement, Vehicle

STEP_RAD = math.radians(2.0)
MAX_EDGES = 24  # whose directions are tried first
CRUMB_M2, ENOUGH = 0.02, 1e-4  # parts of what is left, and share of the field, that count as workable

Box = tuple[float, float, float, float]  # rear, right, front and left of a rectangle of `base`


def workable_share(field: Polygon, margin_m: float, vehicle: Vehicle, implement: MountedImplement) -> float:
    """Greatest share of the field that is worked from poses connected with each other by the folded rig."""
    inner = field.buffer(-margin_m, quad_segs=2)
    body, half_m = vehicle.body, 0.5 * implement.working_width_m
    machine = -body.rear_m, -0.5 * body.width_m, body.front_m, 0.5 * body.width_m
    behind = implement.rear_end_m, -0.5 * implement.width_m, implement.front_end_m, 0.5 * implement.width_m
    reach_m = max(math.hypot(max(abs(b[0]), abs(b[2])), b[3]) for b in (machine, behind))
    slack_m = 0.5 * STEP_RAD * reach_m
    bodies = [(b[0] + slack_m, b[1] + slack_m, b[2] - slack_m, b[3] - slack_m) for b in (machine, behind)]
    line_x_m = implement.working_point_m
    line = line_x_m - slack_m, -half_m - slack_m, line_x_m + slack_m, half_m + slack_m
    disc_m = 0.5 * min(body.width_m, body.front_m + body.rear_m)  # around a point of the machine, as near to `base`
    disc_m, centre_m = disc_m - 1e-3, disc_m - body.rear_m
    rooms = [part for part in shapely.get_parts(inner.buffer(-disc_m)) if part.area > 0.0]
    shares = [
        1.0 - _unworkable(inner, room.buffer(abs(centre_m) + 0.01), bodies, line, reach_m + slack_m) / inner.area
        for room in sorted(rooms, key=lambda part: -part.area)
    ]
    return float(max(shares, default=0.0) * inner.area / field.area)


def _unworkable(inner: BaseGeometry, room: BaseGeometry, bodies: list[Box], line: Box, reach_m: float) -> float:
    """Area that no pose with `base` in a room works, m²."""
    left, edges = inner, np.concatenate([_edges(part) for part in shapely.get_parts(inner)])
    lines = shapely.linestrings(edges)
    for heading in _headings(edges):
        left = MultiPolygon([p for p in shapely.get_parts(left) if p.area > CRUMB_M2])
        if left.area < ENOUGH * inner.area:
            return 0.0
        shapely.prepare(left)
        near = edges[shapely.dwithin(lines, left, 2.0 * reach_m)]
        places = left.buffer(reach_m, quad_segs=2).intersection(inner).intersection(room)
        worked = _worked(places, near, heading, bodies, line)
        left = _areas(left.difference(worked))
    return float(left.area)


def _worked(places: BaseGeometry, edges: np.ndarray, heading: float, bodies: list[Box], line: Box) -> BaseGeometry:
    """Area of the working line at all positions of `base` in `places` where no body meets an edge."""
    c, s = math.cos(heading), math.sin(heading)
    edges = edges @ np.array([[c, -s], [s, c]])
    met = [_sums(edges, (-b[2], -b[3], -b[0], -b[1])) for b in bodies]
    free = rotate(places, -heading, (0.0, 0.0), use_radians=True).difference(shapely.union_all(np.concatenate(met)))
    polygons = [p for p in shapely.get_parts(_areas(free)) if not p.is_empty]
    if not polygons:
        return Polygon()
    swept = _sums(np.concatenate([_edges(p) for p in polygons]), line)
    moved = translate(free, 0.5 * (line[0] + line[2]), 0.0)
    return rotate(shapely.union_all([*swept, moved]), heading, (0.0, 0.0), use_radians=True)


def _sums(edges: np.ndarray, box: Box) -> np.ndarray:
    """Minkowski sum of each edge (E, 2, 2) with a rectangle."""
    x0, y0, x1, y1 = box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    points = (edges[:, :, None] + corners).reshape(len(edges), -1, 2)
    return np.asarray(shapely.convex_hull(shapely.multipoints(points)))


def _edges(polygon: Polygon) -> np.ndarray:
    """Edges of all rings, (E, 2, 2)."""
    rings = [np.asarray(ring.coords)[:, :2] for ring in (polygon.exterior, *polygon.interiors)]
    return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])


def _areas(shape: BaseGeometry) -> BaseGeometry:
    return MultiPolygon([p for p in shapely.get_parts(shape) if isinstance(p, Polygon) and not p.is_empty])


def _headings(edges: np.ndarray) -> Iterator[float]:
    """Those along the longest edges, both ways, and then all of a regular grid, far ones first."""
    along = edges[:, 1] - edges[:, 0]
    for k in np.argsort(-np.hypot(*along.T), kind="stable")[:MAX_EDGES]:
        for turn in (0.0, math.pi):
            yield math.atan2(along[k, 1], along[k, 0]) + turn
    count = math.ceil(2.0 * math.pi / STEP_RAD)
    stride = next(n for n in range(int(0.38 * count), count) if math.gcd(n, count) == 1)
    yield from (2.0 * math.pi * (k * stride % count) / count for k in range(count))

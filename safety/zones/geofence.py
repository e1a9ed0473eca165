"""Geofence: the autonomous operating zone (ISO 18497-3) as polygons in map.

Points are tested by crossing numbers in numpy: the safety channel uses no geometry library.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from configs.site import Bay, Lane, Shed, Site
from geometry.arrays import Float64
from safety.zones.footprint import Box, bounding_box

GATE_DEPTH_M = 1.0  # on either side of the line between the posts
OUTSIDE_M = -1.0
APRON_M, APRON_ASIDE_M = 4.0, 2.0  # before a bay and beside it: room to turn into it
ROOF_EDGE_M = 0.1  # overlap of the apron with the roof, up to the posts
BESIDE_TOLERANCE_M = 1e-6  # a point farther outside a polygon is outside whatever the rounding
LANE_OVERLAP_M = 1.0  # of a lane with the areas at its ends, so that no seam is outside


@dataclass(frozen=True)
class Geofence:
    """Polygons (E, 2) in map: permitted is the union of `allowed` less `forbidden`; rings need not be closed.

    `posts` (P, 2) are surveyed posts of gates, on its edge.
    """

    allowed: tuple[Float64, ...]
    forbidden: tuple[Float64, ...] = ()
    posts: Float64 = field(default_factory=lambda: np.empty((0, 2)))

    def contains_box(self, box: Box) -> bool:
        """Whether a box in map surely lies inside: within one allowed ring, with no side near; may miss, never errs."""
        if any(ring.may_intersect(box) for ring in self._forbidden):
            return False
        corner = np.array([[box.x_m[0], box.y_m[0]]])
        rings = (ring for ring in self._allowed if ring.may_intersect(box) and not ring.has_side_in(box))
        return any(bool(is_within(corner, ring.corners)[0]) for ring in rings)

    @cached_property
    def _allowed(self) -> tuple["Ring", ...]:
        return tuple(Ring(corners) for corners in self.allowed)

    @cached_property
    def _forbidden(self) -> tuple["Ring", ...]:
        return tuple(Ring(corners) for corners in self.forbidden)

    def contains(self, points_map_m: Float64) -> np.ndarray:
        """Whether each point (N, 2) in map is permitted, (N,) bool."""
        inside = np.zeros(len(points_map_m), bool)
        if len(points_map_m) == 0:
            return inside
        box = bounding_box(points_map_m)
        for ring in self._allowed:
            if not ring.may_intersect(box):
                continue
            rest = np.flatnonzero(~inside)  # most points lie in one ring
            if len(rest) == 0:
                break
            inside[rest] = is_within(points_map_m[rest], ring.corners)
        for ring in self._forbidden:
            if ring.may_intersect(box):
                inside &= ~is_within(points_map_m, ring.corners)
        return inside


class Ring:
    """Polygon (E, 2) with the boxes about it and about its sides."""

    def __init__(self, corners: Float64) -> None:
        self.corners = corners
        ends = np.stack([corners, np.roll(corners, -1, axis=0)])
        self._low, self._high = ends.min(axis=0).T, ends.max(axis=0).T
        self._box = bounding_box(corners)

    def may_intersect(self, box: Box) -> bool:
        """Whether a box may intersect the polygon; True for NaN."""
        own, near = self._box, BESIDE_TOLERANCE_M
        is_beside = box.x_m[1] < own.x_m[0] - near or box.x_m[0] > own.x_m[1] + near
        return not (is_beside or box.y_m[1] < own.y_m[0] - near or box.y_m[0] > own.y_m[1] + near)

    def has_side_in(self, box: Box) -> bool:
        """Whether the box about any side intersects a box."""
        (x_low, y_low), (x_high, y_high) = self._low, self._high
        meets = (x_low <= box.x_m[1]) & (x_high >= box.x_m[0]) & (y_low <= box.y_m[1]) & (y_high >= box.y_m[0])
        return bool(meets.any())


def geofence_of(site: Site) -> Geofence:
    """Field, yard, lanes, gates and bays of a site, less its no-go areas."""
    areas = [np.array(site.boundary_m), np.array(site.yard.outline_m)]
    areas += [ring for bay in site.shed.bays for ring in bay_rings(site.shed, bay)] if site.shed is not None else []
    areas += [ring for lane in site.lanes for ring in lane_rings(lane)]
    areas += [band(np.array(gate.posts_m), GATE_DEPTH_M) for gate in site.gates]
    posts = np.array([post for gate in site.gates for post in gate.posts_m], np.float64).reshape(-1, 2)
    return Geofence(tuple(areas), tuple(np.array(area.outline_m) for area in site.no_go), posts)


def lane_rings(lane: Lane) -> list[Float64]:
    """Rectangle about each segment of a lane; inner ends overlap by half the width, so that bends have no gap."""
    center, half = np.array(lane.center_m), 0.5 * lane.width_m
    rings = []
    for k, (a, b) in enumerate(pairwise(center)):
        along = (b - a) / max(math.hypot(*(b - a)), 1e-9)
        before = LANE_OVERLAP_M if k == 0 else half
        after = LANE_OVERLAP_M if k == len(center) - 2 else half
        rings.append(band(np.array([a - before * along, b + after * along]), half))
    return rings


def bay_rings(shed: Shed, bay: Bay) -> tuple[Float64, Float64]:
    """Bay from the back wall to the roof's edge at its free width, and the wider apron before it."""
    dock, heading = np.array([bay.dock.x_m, bay.dock.y_m]), math.radians(bay.dock.heading_deg)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    roof = np.array(shed.outline_m)
    edge = dock + distance_across(dock, ahead, roof) * ahead
    back = dock - (distance_across(dock, -ahead, roof) - 0.5 * shed.wall_thickness_m) * ahead
    apron = np.array([edge - ROOF_EDGE_M * ahead, edge + APRON_M * ahead])
    return band(np.array([back, edge]), 0.5 * bay.width_m), band(apron, 0.5 * bay.width_m + APRON_ASIDE_M)


def distance_across(start: Float64, ahead: Float64, ring: Float64) -> float:
    """Distance from a point inside a polygon (E, 2) to its edge in a direction (unit vector); 0 when none is met."""
    side = np.roll(ring, -1, axis=0) - ring
    to_corner = ring - start
    across = ahead[0] * side[:, 1] - ahead[1] * side[:, 0]
    slanted = np.abs(across) > 1e-9
    distances = (to_corner[slanted, 0] * side[slanted, 1] - to_corner[slanted, 1] * side[slanted, 0]) / across[slanted]
    share = (to_corner[slanted, 0] * ahead[1] - to_corner[slanted, 1] * ahead[0]) / across[slanted]
    met = distances[(distances > 0.0) & (share >= 0.0) & (share <= 1.0)]
    return float(met.min(initial=math.inf)) if len(met) else 0.0


def band(line: Float64, half_m: float) -> Float64:
    """Rectangle (4, 2) about the line between two points."""
    along = (line[1] - line[0]) / max(math.hypot(*(line[1] - line[0])), 1e-9)
    left = half_m * np.array([-along[1], along[0]])
    return np.array([line[0] + left, line[0] - left, line[1] - left, line[1] + left])


def is_within(points: Float64, ring: Float64) -> np.ndarray:
    """Whether each point (N, 2) lies in a polygon (E, 2), (N,) bool: an odd number of edges crossed towards +x."""
    x, y = points.T
    x0, y0 = ring.T[:, :, None]  # edges by points: fewer edges than points
    x1, y1 = np.concatenate([ring[1:], ring[:1]]).T[:, :, None]
    is_spanned = (y0 <= y) != (y1 <= y)
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    is_right = x < x0 + (y - y0) / rise * (x1 - x0)
    return np.asarray(np.logical_xor.reduce(is_spanned & is_right, axis=0))


def distance_inside_m(geofence: Geofence, points_map_m: Float64, distances_m: Float64, spacing_m: float) -> float:
    """Distance along the path that the outline points (P, 2), reached after `distances_m` (P,), stay inside.

    Infinite when all do, -1 when one is outside now.
    """
    outside = ~geofence.contains(points_map_m)
    if not np.any(outside):
        return math.inf
    first_m = float(distances_m[outside].min())
    return OUTSIDE_M if first_m <= 0.0 else max(0.0, first_m - spacing_m)

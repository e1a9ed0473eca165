"""Exact distances of the bodies from walls, posts, the edge of the yard and obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import Shed, Site
from geometry.arrays import Float64
from geometry.footprint import Bodies, place
from geometry.rectangle import Rectangle


@dataclass(frozen=True)
class Bounds:
    """K straight edges not to be touched, from `first_m` to `last_m` (K, 2), with half their thickness (K,)."""

    first_m: Float64
    last_m: Float64
    thickness_m: Float64


def yard_of(site: Site, shed: Shed) -> BaseGeometry:
    """Area of docking: yard, shed and lanes, less no-go areas."""
    lanes = [LineString(lane.center_m).buffer(lane.width_m / 2.0, cap_style="flat") for lane in site.lanes]
    no_go = shapely.union_all([Polygon(area.outline_m) for area in site.no_go])
    return shapely.union_all([Polygon(site.yard.outline_m), Polygon(shed.outline_m), *lanes]).difference(no_go)


def bounds_of(site: Site, shed: Shed, outlines: Sequence[Polygon], larger_m: float) -> Bounds:
    """Bounds of yard and shed, and outlines of obstacles enlarged by `larger_m`."""
    lines = [(line, 0.0) for line in shapely.get_parts(yard_of(site, shed).boundary)]
    lines += [(LineString(wall), shed.wall_thickness_m / 2.0) for wall in shed.walls_m]
    lines += [(LineString(gate.posts_m), 0.0) for gate in site.gates]  # docking ends at the gate
    lines += [(outline.exterior, larger_m) for outline in outlines]
    edges = [(a, b, thick) for line, thick in lines for a, b in _edges(line)]
    edges += [(at, at, post.radius_m) for post in shed.posts for at in [np.array(post.at_m)]]
    first, last, thick = (np.array(column, np.float64) for column in zip(*edges, strict=True))
    return Bounds(first, last, thick)


def clearance_m(bounds: Bounds, bodies: Bodies, p_map_m: Float64, heading_rad: Float64) -> Float64:
    """Distance of the bodies from the nearest bound at each of N poses, (N,), m.

    Of two disjoint convex shapes one has its nearest point at a corner: corners of the bodies to the edges, and ends
    of the edges to the bodies. Poses must be dense enough that no edge is passed between two of them.
    """
    found = [_min_distance(_corners_to_edges(b, bounds, p_map_m, heading_rad), bounds) for b in bodies]
    found += [
        _min_distance(_points_to_body(ends, b, p_map_m, heading_rad), bounds)
        for b in bodies
        for ends in (bounds.first_m, bounds.last_m)
    ]
    return np.asarray(np.min(found, axis=0), np.float64)


def nearest_place(bounds: Bounds, p_map_m: Float64) -> tuple[float, float]:
    """Nearest position on a bound to a point (2,)."""
    along = _nearest_points(bounds, p_map_m[None])[0]
    k = int(np.argmin(np.hypot(*(along - p_map_m).T) - bounds.thickness_m))
    return float(along[k, 0]), float(along[k, 1])


def _edges(line: BaseGeometry) -> list[tuple[Float64, Float64]]:
    points = np.asarray(line.coords)[:, :2]
    return list(pairwise(points))


def _min_distance(distance_m: Float64, bounds: Bounds) -> Float64:
    """Minimum of (N, P, K) or (N, K) over all but the poses, less the thickness of the edges."""
    clearance = distance_m - bounds.thickness_m
    return np.asarray(clearance.reshape(len(clearance), -1).min(axis=1), np.float64)


def _corners_to_edges(body: Rectangle, bounds: Bounds, p_map_m: Float64, heading_rad: Float64) -> Float64:
    corners = place(body.corners_m, p_map_m, heading_rad)
    flat = corners.reshape(-1, 2)
    gap = _nearest_points(bounds, flat) - flat[:, None]
    return np.asarray(np.hypot(gap[..., 0], gap[..., 1]).reshape(len(corners), -1, len(bounds.first_m)), np.float64)


def _nearest_points(bounds: Bounds, points_m: Float64) -> Float64:
    """Nearest position on each edge to each of M points, (M, K, 2)."""
    d = bounds.last_m - bounds.first_m
    square = np.maximum((d * d).sum(axis=1), 1e-12)
    share = ((points_m[:, None] - bounds.first_m) * d).sum(axis=2) / square
    return np.asarray(bounds.first_m + np.clip(share, 0.0, 1.0)[..., None] * d, np.float64)


def _points_to_body(points_m: Float64, body: Rectangle, p_map_m: Float64, heading_rad: Float64) -> Float64:
    """Distance of K points from a body at N poses, (N, K); 0 inside."""
    c, s = np.cos(heading_rad)[:, None], np.sin(heading_rad)[:, None]
    dx, dy = points_m[:, 0] - p_map_m[:, :1], points_m[:, 1] - p_map_m[:, 1:]
    x, y = c * dx + s * dy, c * dy - s * dx
    middle, half = 0.5 * (body.front_m + body.rear_m), 0.5 * (body.front_m - body.rear_m)
    outside = np.maximum(np.abs(x - middle) - half, 0.0), np.maximum(np.abs(y) - body.width_m / 2.0, 0.0)
    return np.asarray(np.hypot(*outside), np.float64)

"""Static obstacles as outlines in `map`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.affinity import translate
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.footprint import Bodies, sweep
from geometry.polygon import as_polygon
from geometry.transforms import apply, yaw_of
from messages.perception import ObstacleClass, Track, Tracks

LIVING_CLASSES = frozenset({ObstacleClass.PERSON, ObstacleClass.ANIMAL})  # are not driven around
POSSIBLY_LIVING_CLASSES = LIVING_CLASSES | {ObstacleClass.UNKNOWN}  # a person beside something larger has no class


@dataclass(frozen=True)
class StaticObstacle:
    """Static obstacle: class and the observed part of its outline."""

    label: ObstacleClass
    outline: Polygon


def static_obstacles(
    tracks: Tracks | None, T_map_odom: Float64, max_speed_mps: float, within: BaseGeometry, merge_distance_m: float
) -> list[StaticObstacle]:
    """Confirmed tracks slower than `max_speed_mps` in an area; those within `merge_distance_m` merged."""
    found: list[StaticObstacle] = []
    for track in sorted(tracks.tracks if tracks is not None else (), key=lambda t: t.id):
        if track.is_confirmed and float(np.hypot(*track.velocity_mps[:2])) < max_speed_mps:
            outline = box_outline(track, T_map_odom)
            if outline.centroid.within(within):
                found.append(StaticObstacle(track.label, outline))
    return merged(found, merge_distance_m)


def merged(found: Sequence[StaticObstacle], merge_distance_m: float) -> list[StaticObstacle]:
    """Obstacles closer to each other than `merge_distance_m` as one, with the class of the largest.

    Wheels, bed and cab of a vehicle may be tracked as three objects. With one that is or may be a person the whole is
    unclassified: somebody beside a vehicle is not driven around with it.
    """
    groups: list[list[StaticObstacle]] = []
    for obstacle in found:
        near = [g for g in groups if any(o.outline.distance(obstacle.outline) < merge_distance_m for o in g)]
        groups = [g for g in groups if g not in near] + [[obstacle, *(o for g in near for o in g)]]
    return [_union(group) for group in groups]


def _union(group: Sequence[StaticObstacle]) -> StaticObstacle:
    largest = max(group, key=lambda s: round(s.outline.area, 6))
    hull = as_polygon(shapely.union_all([s.outline for s in group]).convex_hull)
    if len(group) == 1:
        return largest
    may_be_person = any(s.label in POSSIBLY_LIVING_CLASSES for s in group)
    return StaticObstacle(ObstacleClass.UNKNOWN if may_be_person else largest.label, hull)


def box_outline(track: Track, T_map_odom: Float64) -> Polygon:
    """Ground outline of a track's box in `map`."""
    x, y = np.maximum(track.size_m[:2], 0.1) / 2.0
    p = apply(T_map_odom, np.append(track.p_odom_m[:2], 0.0)[None])[0, :2]
    yaw = track.yaw_rad + yaw_of(T_map_odom)
    c, s = np.cos(yaw), np.sin(yaw)
    return Polygon(p + np.array([[x, y], [-x, y], [-x, -y], [x, -y]]) @ np.array([[c, s], [-s, c]]))


def obstacle_from_points(hits_map_m: Float64) -> StaticObstacle | None:
    """Obstacle around raw returns (N, 2) without a track, or None without returns."""
    if len(hits_map_m) == 0:
        return None
    hull = as_polygon(shapely.MultiPoint(hits_map_m).convex_hull.buffer(0.2, quad_segs=2))
    return StaticObstacle(ObstacleClass.UNKNOWN, hull)


def first_on_path(
    found: Sequence[StaticObstacle], bodies: Bodies, p_map_m: Float64, heading_rad: Float64
) -> StaticObstacle | None:
    """First obstacle in the sweep of the bodies along N poses, or None."""
    if len(p_map_m) < 2:
        return None
    line = LineString(p_map_m)
    swept = sweep(bodies, p_map_m, heading_rad).buffer(0.5)
    hit = [s for s in found if s.outline.intersects(swept)]
    return min(hit, key=lambda s: (line.project(s.outline.centroid), s.outline.centroid.x), default=None)


def extended_depth(outline: Polygon, from_m: Float64, min_depth_m: float) -> Polygon:
    """Outline extended away from the sensor at `from_m` (2,) to `min_depth_m`: only its face may have been observed."""
    away = np.array(outline.centroid.coords[0]) - from_m
    away = away / max(float(np.hypot(*away)), 1e-9)
    depths = np.asarray(outline.exterior.coords) @ away
    by_m = max(0.0, min_depth_m - float(np.ptp(depths)))
    moved = translate(outline, *(away * by_m))
    return as_polygon(shapely.union(outline, moved).convex_hull)

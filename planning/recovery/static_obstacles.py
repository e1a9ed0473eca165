"""What stands in the way, as outlines in `map`."""

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

ALIVE = frozenset({ObstacleClass.PERSON, ObstacleClass.ANIMAL})


@dataclass(frozen=True)
class Standing:
    """Something that stands: its outline as far as seen, and what it is."""

    label: ObstacleClass
    outline: Polygon


def standing(
    tracks: Tracks | None, T_map_odom: Float64, slowest_mps: float, within: BaseGeometry, join_m: float
) -> list[Standing]:
    """What stands in an area: confirmed tracks slower than `slowest_mps`, those within `join_m` as one thing."""
    found: list[Standing] = []
    for track in sorted(tracks.tracks if tracks is not None else (), key=lambda t: t.id):
        if track.is_confirmed and float(np.hypot(*track.velocity_mps[:2])) < slowest_mps:
            outline = box_of(track, T_map_odom)
            if outline.centroid.within(within):
                found.append(Standing(track.label, outline))
    return joined(found, join_m)


def joined(found: Sequence[Standing], join_m: float) -> list[Standing]:
    """Things nearer to each other than `join_m` as one, called by what its largest part is.

    A sensor may see the wheels, the bed and the cab of a vehicle as three things.
    """
    groups: list[list[Standing]] = []
    for thing in found:
        near = [g for g in groups if any(o.outline.distance(thing.outline) < join_m for o in g)]
        groups = [g for g in groups if g not in near] + [[thing, *(o for g in near for o in g)]]
    return [_as_one(group) for group in groups]


def _as_one(group: Sequence[Standing]) -> Standing:
    largest = max(group, key=lambda s: round(s.outline.area, 6))
    hull = as_polygon(shapely.union_all([s.outline for s in group]).convex_hull)
    return largest if len(group) == 1 else Standing(largest.label, hull)


def box_of(track: Track, T_map_odom: Float64) -> Polygon:
    """The box of a track on the ground."""
    x, y = np.maximum(track.size_m[:2], 0.1) / 2.0
    p = apply(T_map_odom, np.append(track.p_odom_m[:2], 0.0)[None])[0, :2]
    yaw = track.yaw_rad + yaw_of(T_map_odom)
    c, s = np.cos(yaw), np.sin(yaw)
    return Polygon(p + np.array([[x, y], [-x, y], [-x, -y], [x, -y]]) @ np.array([[c, s], [-s, c]]))


def from_hits(hits_map_m: Float64) -> Standing | None:
    """What raw returns (N, 2) without a track stand for, or None without any."""
    if len(hits_map_m) == 0:
        return None
    hull = as_polygon(shapely.MultiPoint(hits_map_m).convex_hull.buffer(0.2, quad_segs=2))
    return Standing(ObstacleClass.UNKNOWN, hull)


def first_in_way(found: Sequence[Standing], bodies: Bodies, p_map_m: Float64, heading_rad: Float64) -> Standing | None:
    """The one that the bodies would meet first along the poses ahead, or None."""
    if len(p_map_m) < 2:
        return None
    way = LineString(p_map_m)
    swept = sweep(bodies, p_map_m, heading_rad).buffer(0.5)
    met = [s for s in found if s.outline.intersects(swept)]
    return min(met, key=lambda s: (way.project(s.outline.centroid), s.outline.centroid.x), default=None)


def deepened(outline: Polygon, from_m: Float64, least_m: float) -> Polygon:
    """The outline prolonged away from a viewer, who may have seen its face only, to `least_m` in all."""
    away = np.array(outline.centroid.coords[0]) - from_m
    away = away / max(float(np.hypot(*away)), 1e-9)
    seen = np.asarray(outline.exterior.coords) @ away
    by_m = max(0.0, least_m - float(np.ptp(seen)))
    moved = translate(outline, *(away * by_m))
    return as_polygon(shapely.union(outline, moved).convex_hull)

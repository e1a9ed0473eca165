"""Independent check of a plan: a second implementation of the sweep, of the worked area, and of the curvature.

It reads the outline of machine and implement, the polygon of the field and the points of the paths, and shares no code
with the planner.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from configs.vehicle import MountedImplement, Vehicle
from messages.plan import Path

STRAIGHT_RAD = 0.005


@dataclass(frozen=True)
class Finding:
    """Distance outside the free area, share of the field worked, greatest curvature and gap, lengths by use."""

    outside_m: float
    coverage: float
    curvature_radpm: float
    gap_m: float
    length_m: float
    working_m: float
    reverse_m: float
    cusps: int
    uncovered: BaseGeometry


def check(
    paths: Sequence[Path], field: BaseGeometry, free: BaseGeometry, vehicle: Vehicle, implement: MountedImplement
) -> Finding:
    """Checks complete paths; `field` is what is to be worked, `free` where machine and implement may be."""
    machine = -vehicle.body.rear_m, vehicle.body.front_m, vehicle.body.width_m
    transport_m = implement.width_m if implement.fold is None else implement.fold.width_m
    ends = implement.rear_end_m, implement.front_end_m
    hulls = np.concatenate(
        [
            _hulls(path, *body)
            for path in paths
            for body in (machine, (*ends, transport_m if path.is_transport else implement.width_m))
        ]
    )
    shapely.prepare(free)
    out = hulls[~shapely.covers(free, hulls)]
    outside = max((_depth(h, free) for h in out), default=0.0)
    strips = np.concatenate([_strips(path, implement) for path in paths])
    missed = field.difference(shapely.union_all(strips))
    return Finding(
        outside,
        1.0 - missed.area / field.area,
        max(_curvature(path) for path in paths),
        max((_gap(a, b) for a, b in pairwise(paths)), default=0.0),
        sum(float(np.hypot(*np.diff(p.p_map_m, axis=0).T).sum()) for p in paths),
        sum(float((np.hypot(*np.diff(p.p_map_m, axis=0).T) * (p.is_working[1:] > 0)).sum()) for p in paths),
        sum(float(np.hypot(*np.diff(p.p_map_m, axis=0).T).sum()) for p in paths if p.direction < 0),
        sum(a.direction != b.direction for a, b in pairwise(paths)),
        missed,
    )


def _steps(path: Path) -> np.ndarray:
    """Indices of poses between which the rig goes straight or turns by less than `STRAIGHT_RAD`, both ends included."""
    level = np.floor(np.unwrap(path.heading_rad) / STRAIGHT_RAD)
    work = path.is_working > 0
    changes = np.flatnonzero((np.diff(level) != 0) | (work[1:] != work[:-1]))
    return np.unique(np.concatenate([[0], changes, changes + 1, [len(level) - 1]]))


def _hulls(path: Path, rear: float, front: float, width: float) -> np.ndarray:
    """Hulls of the footprints at both ends of each step."""
    along, across = np.array([rear, front, front, rear]), np.array([-1.0, -1.0, 1.0, 1.0]) * width / 2.0
    at = _steps(path)
    z = path.p_map_m[at, 0] + 1j * path.p_map_m[at, 1]
    corners = z[:, None] + np.exp(1j * path.heading_rad[at])[:, None] * (along + 1j * across)
    pairs = np.concatenate([corners[:-1], corners[1:]], axis=1)
    return np.asarray(shapely.convex_hull(shapely.multipoints(np.stack([pairs.real, pairs.imag], axis=-1))))


def _depth(hull: BaseGeometry, free: BaseGeometry) -> float:
    """Greatest distance of the part outside from the free area."""
    out = hull.difference(free)
    return max((float(free.distance(shapely.Point(p))) for p in shapely.get_coordinates(out)), default=0.0)


def _strips(path: Path, implement: MountedImplement) -> np.ndarray:
    """Hulls of the working line at both ends of each step with work."""
    h, at = implement.working_width_m / 2.0, _steps(path)
    z = path.p_map_m[at, 0] + 1j * path.p_map_m[at, 1]
    line = implement.working_point_m + 1j * np.array([h, -h])
    ends = z[:, None] + np.exp(1j * path.heading_rad[at])[:, None] * line
    work = path.is_working[at] > 0
    pairs = np.concatenate([ends[:-1], ends[1:]], axis=1)[work[:-1] & work[1:]]
    return np.asarray(shapely.convex_hull(shapely.multipoints(np.stack([pairs.real, pairs.imag], axis=-1))))


def _curvature(path: Path) -> float:
    """Greatest curvature of the circle through points about 0.5 m apart."""
    p = path.p_map_m[:, 0] + 1j * path.p_map_m[:, 1]
    if len(p) < 11:
        return 0.0
    a, b, c = p[:-10], p[5:-5], p[10:]
    double = np.abs(((b - a).conj() * (c - a)).imag)
    return float((2.0 * double / (abs(b - a) * abs(c - b) * abs(c - a))).max())


def _gap(before: Path, after: Path) -> float:
    turn = math.remainder(float(after.heading_rad[0] - before.heading_rad[-1]), 2.0 * math.pi)
    return float(np.hypot(*(after.p_map_m[0] - before.p_map_m[-1]))) + abs(turn)

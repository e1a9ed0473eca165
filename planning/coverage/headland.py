"""Headland passes: closed paths along the field edge, pushed inwards where a body would leave the field.

A pass starts as the field outline moved inwards, with all corners rounded to the turning radius. Where a body at a pose
on it leaves the allowed area, the pass is pushed inwards there, with a smooth transition (a sharp bend would swing the
tail out again), and its corners are rounded again, until no body is outside.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64
from geometry.footprint import intrusion, is_inside, worked
from geometry.polygon import close_by, open_by, parts, ring_points, shrink
from geometry.polyline import arc_length, headings, resample, smooth
from messages.errors import FieldError
from planning.field.drivable_area import DrivableArea, describe
from planning.rig import Rig
from planning.turns.turn import STEP_M

COARSE_M = 0.4
PUSHES = 25
MIN_RING_M2 = 1.0


@dataclass(frozen=True)
class HeadlandPass:
    """Closed path of `base` (first point repeated) in driving order; `number` counts from the edge, from 0.

    Its corners are arcs: curvature becomes continuous when the complete path is smoothed (`planning/turns/turn.py`).
    """

    number: int
    points_m: Float64
    is_around_obstacle: bool


def headland_passes_of(drivable: DrivableArea, rig: Rig, count: int, overlap_m: float) -> list[HeadlandPass]:
    """All passes from the edge inwards; raises FieldError when none fits."""
    found: list[HeadlandPass] = []
    for k in range(count):
        shape = shrink(drivable.free, depth_m(drivable, rig, overlap_m, k))
        found += [r for part in parts(shape, MIN_RING_M2) for r in _passes_in(part, drivable, rig, k)]
    if not found:
        x, y = drivable.field.centroid.coords[0]
        min_m = 2.0 * (depth_m(drivable, rig, overlap_m, 0) + rig.radius_m)
        raise FieldError(
            f"field of {drivable.field.area:.0f} m² around {describe(drivable.site, x, y)} is too small for this "
            f"machine: one headland pass of {rig.working_width_m:g} m needs at least {min_m:.1f} m in each direction; "
            "use a narrower implement"
        )
    return sorted(found, key=lambda r: (r.is_around_obstacle, r.number))


def depth_m(drivable: DrivableArea, rig: Rig, overlap_m: float, number: int) -> float:
    """Distance of the centre line of pass `number` from the edge."""
    first = drivable.margin_m + rig.width_m / 2.0 + rig.config.edge_slack_m
    return first + number * (rig.working_width_m - overlap_m)


def pass_coverage(ring: HeadlandPass, rig: Rig) -> BaseGeometry:
    """Area worked by a pass."""
    points = smooth(ring.points_m, rig.config.smoothing_m, is_closed=True)
    left, right = rig.working_edges(points, headings(points, is_closed=True))
    keep = np.unique(np.append(np.arange(0, len(points), 4), len(points) - 1))
    return worked(left[keep], right[keep]).buffer(0.01)


def _passes_in(part: Polygon, drivable: DrivableArea, rig: Rig, number: int) -> list[HeadlandPass]:
    shape: BaseGeometry = part
    for _ in range(PUSHES):
        shape = open_by(close_by(shape, rig.radius_m), rig.radius_m)
        pieces = parts(shape, MIN_RING_M2)
        raw = [(resample(ring, STEP_M), k > 0) for p in pieces for k, ring in enumerate(ring_points(p))]
        rings = [smooth(ring, rig.config.smoothing_m, is_closed=True) for ring, _ in raw]
        depths = [_outside(ring, drivable, rig) for ring in rings]
        if all(d.max() <= 0.0 for d in depths):
            return [HeadlandPass(number, ring, is_hole) for ring, is_hole in raw]
        shape = _pushed(pieces, [ring for ring, _ in raw], depths)
    worst = max(range(len(rings)), key=lambda k: depths[k].max())
    x, y = rings[worst][int(np.argmax(depths[worst]))]
    raise FieldError(f"headland pass {number + 1} cannot be driven inside the field at {describe(drivable.site, x, y)}")


def _outside(ring: Float64, drivable: DrivableArea, rig: Rig) -> Float64:
    heading = headings(ring, is_closed=True)
    stride = max(1, int(COARSE_M / STEP_M))
    outline = np.vstack([b.outline_m(0.5) for b in rig.bodies])
    coarse = intrusion(outline, ring[::stride], heading[::stride], drivable.inner)
    out = np.repeat(coarse, stride)[: len(ring)]
    if out.max() <= 0.0:
        inside = is_inside(rig.bodies, ring, heading, drivable.inner)
        out = np.where(inside, 0.0, 0.01)
    return out


def _pushed(pieces: list[Polygon], rings: list[Float64], depths: list[Float64]) -> BaseGeometry:
    outlines = []
    for ring, depth in zip(rings, depths, strict=True):
        heading = headings(ring, is_closed=True)
        push = _spread(depth, arc_length(ring), is_left=np.gradient(heading) > -1e-3)
        outlines.append(ring + push[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)]))
    out, k = [], 0
    for piece in pieces:
        holes = len(piece.interiors)
        out.append(Polygon(outlines[k], outlines[k + 1 : k + 1 + holes]).buffer(0.0))
        k += 1 + holes
    return shapely.union_all(out)


def _spread(depth: Float64, s: Float64, is_left: Bool) -> Float64:
    """Push of each point, m: full around a point outside, falling smoothly to 0.

    In a left bend the tail swings out at its beginning: the points before it are pushed. Around an inward corner (right
    bend) the inner end of the implement cuts the corner: the complete bend is pushed, and more, since rounding takes
    part of it back.
    """
    total, out = s[-1], np.zeros(len(s))
    for k in np.flatnonzero(depth > 0.0):
        ahead = (s[k] - s + total / 2.0) % total - total / 2.0  # > 0: point k is ahead
        push, flat, after = (1.05, 1.0, 5.0) if is_left[k] else (1.5, 4.0, 12.0)
        reach = np.where(ahead > 0.0, 12.0, after)
        u = np.clip((np.abs(ahead) - flat) / reach, 0.0, 1.0)
        out = np.maximum(out, (push * depth[k] + 0.005) * (0.5 + 0.5 * np.cos(np.pi * u)))
    return np.asarray(out, np.float64)

"""Swaths over what the headland passes leave: the area inside them, gaps between them, narrow necks."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from shapely.geometry.base import BaseGeometry

from configs.mission import Work
from geometry.arrays import Float64
from geometry.polygon import open_by, parts, polygon_of, shrink, united
from planning.coverage.blocks import blocks_of
from planning.coverage.curved_swath import CurvedSwath, area_of, curved_swaths_over
from planning.coverage.headland import HeadlandPass, pass_coverage
from planning.coverage.remains import strip_of, swaths_over_remains, worth_of
from planning.coverage.swath import Swath, strips_of, swaths_on
from planning.field.drivable_area import DrivableArea
from planning.guidance.line import curved_line_of
from planning.rig import Rig
from planning.turns.free_space import FreeSpace
from planning.turns.search import Leg

AnySwath = Swath | CurvedSwath
SLIVER_M = 0.3  # thinner remains are no reason for a swath
WIDE = 0.6  # of the working width: parts as wide get evenly spaced swaths
GROWN_M = 0.05
REMAINS_M = 0.5  # thinner remains of evenly spaced swaths


def swaths_inside(
    drivable: DrivableArea, rig: Rig, passes: Sequence[HeadlandPass], work: Work, space: FreeSpace
) -> list[AnySwath]:
    """Swaths over all that the passes leave bare, numbered; `space` is the free space of the rig."""
    bare = _workable(drivable, rig)
    if passes:
        bare = bare.difference(united([pass_coverage(p, rig) for p in passes]))
    found = swaths_over(bare, rig, work, space)
    return [replace(s, number=k) for k, s in enumerate(found)]


def fill_bare(
    drivable: DrivableArea, rig: Rig, work: Work, space: FreeSpace, around: BaseGeometry, legs: Sequence[Leg],
    insert: Callable[[Sequence[AnySwath], float], bool],
) -> None:  # fmt: skip
    """Inserts swaths over what passes, which work the area `around`, and `legs` of lines leave bare into a tour.

    `insert` returns whether it took any of some swaths, for at most a time of ways to them.
    """
    covered = united([around, *(area_of(leg, rig) for leg in legs)])
    found = swaths_over(wide_bare(drivable, rig, covered), rig, work, space)
    insert(found, math.inf)
    covered = united([covered, *(area_worked(s, rig) for s in found)])
    share = covered.intersection(drivable.free).area / drivable.free.area
    remains = open_by(_workable(drivable, rig).difference(covered), REMAINS_M / 2.0)
    worth = worth_of(rig, share < rig.config.small_remains_share)
    swaths_over_remains(remains, rig, space, worth, lambda swath, most_s: insert([swath], most_s))


def wide_bare(drivable: DrivableArea, rig: Rig, covered: BaseGeometry) -> BaseGeometry:
    """Wide parts of what is not covered."""
    return open_by(_workable(drivable, rig).difference(covered), WIDE * rig.working_width_m / 2.0)


def area_worked(swath: AnySwath, rig: Rig) -> BaseGeometry:
    """Area worked by a swath in its longer direction."""
    return swath.area(rig) if isinstance(swath, CurvedSwath) else strip_of(swath, rig.working_width_m)


def _workable(drivable: DrivableArea, rig: Rig) -> BaseGeometry:
    """What the implement could reach beside every edge."""
    return shrink(drivable.free, drivable.margin_m + rig.width_m / 2.0 - rig.working_width_m / 2.0)


def swaths_over(bare: BaseGeometry, rig: Rig, work: Work, space: FreeSpace) -> list[AnySwath]:
    """Swaths over an area: along the curve of the mission, in its direction, or the cheapest of each part."""
    area = polygon_of(open_by(bare, SLIVER_M / 2.0))
    curved = curved_line_of(work)
    if curved is not None:
        wide = polygon_of(united(parts(area, worth_of(rig, False).least_m2)))
        return [*curved_swaths_over(wide, curved, rig, work.overlap_m, space)]
    direction = None if work.swath_direction_deg is None else float(np.radians(work.swath_direction_deg))
    min_m = rig.min_swath_m
    found, number = list[AnySwath](), 0
    for part in parts(area, worth_of(rig, False).least_m2):
        for block in blocks_of(part, rig.working_width_m) if direction is None else [part]:
            grown = block.buffer(GROWN_M, join_style="mitre")
            for strip in strips_of(grown, rig.working_width_m, work.overlap_m, min_m, direction, work.swath_through_m):
                found += [replace(s, block=number, row=_row(strip)) for s in swaths_on(strip, rig, space)]
            number += 1
    return found


def _row(strip: Float64) -> float:
    """Distance of the line through a strip (2, 2) from the origin, left positive; equal along one line."""
    (x, y), (dx, dy) = strip[0], strip[1] - strip[0]
    return round(float(dx * y - dy * x) / math.hypot(dx, dy), 2)

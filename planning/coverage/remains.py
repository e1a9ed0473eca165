"""Swaths over what evenly spaced swaths leave bare: tips and tails of a field, where a strip along an edge is not free.

Each is the best of lines in several directions at closely spaced offsets: the one that works most of the bare area.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.affinity import rotate
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.polygon import parts
from planning.coverage.swath import Swath, directions_of, swaths_on
from planning.rig import Rig
from planning.turns.free_space import FreeSpace

OFFSETS = 6.0  # per working width
FLUSH_M, FLUSH_GAIN = 0.01, 1.1
ENOUGH = 4.0, 0.1, 0.2  # least area in m² and in squared working widths, least share of the worked area
SHORT = 2.0, 0.03, 0.08
MAX_SWATHS = 6  # over one part


@dataclass(frozen=True)
class Worth:
    """Least bare area that a swath works, m² and share of all that it works."""

    least_m2: float
    least_share: float


def worth_of(rig: Rig, is_short: bool) -> Worth:
    """What is worth a swath; less where the field is short of its share."""
    least_m2, per_square, share = SHORT if is_short else ENOUGH
    return Worth(max(least_m2, per_square * rig.working_width_m**2), share)


def swaths_over_remains(area: BaseGeometry, rig: Rig, space: FreeSpace, worth: Worth) -> list[Swath]:
    """Swaths over the area that are each worth it; numbers are left 0."""
    found = []
    for part in parts(area, worth.least_m2):
        left: BaseGeometry = part
        for _ in range(MAX_SWATHS):
            best = _best(left, part, rig, space, worth)
            if best is None:
                break
            found.append(best)
            left = left.difference(strip_of(best, rig.working_width_m))
            if left.area < worth.least_m2:
                break
    return found


def strip_of(swath: Swath, width_m: float) -> Polygon:
    """Area worked by a swath in its longer direction."""
    ends = [e for e in (swath.onwards_m, swath.back_m) if e is not None]
    return _area_of(max(ends, key=lambda e: float(np.hypot(*(e[1] - e[0])))), width_m)


def _area_of(ends_m: Float64, width_m: float) -> Polygon:
    a, b = ends_m
    side = 0.5 * width_m * np.array([a[1] - b[1], b[0] - a[0]]) / np.hypot(*(b - a))
    return Polygon([a + side, b + side, b - side, a - side])


def _best(left: BaseGeometry, part: Polygon, rig: Rig, space: FreeSpace, worth: Worth) -> Swath | None:
    best: tuple[float, Swath | None] = (worth.least_m2, None)
    shapely.prepare(left)
    for angle_rad in directions_of(part):
        for strip, more in _strips(left, rig.working_width_m, angle_rad):
            if left.intersection(_area_of(strip, rig.working_width_m)).area <= more * best[0]:
                continue
            for swath in _swaths_near(strip, rig, space):
                worked = strip_of(swath, rig.working_width_m)
                gain = round(float(left.intersection(worked).area), 3)
                if gain > more * best[0] and gain > worth.least_share * worked.area:
                    best = gain, swath
    return best[1]


def _swaths_near(strip: Float64, rig: Rig, space: FreeSpace) -> list[Swath]:
    """Swaths on a line over an area and a little beyond, each no longer than the area and the shortest swath need."""
    least_m = rig.config.min_swath_m
    length = float(np.hypot(*(strip[1] - strip[0])))
    along = (strip[1] - strip[0]) / length
    found = swaths_on(strip + np.array([[-least_m], [least_m]]) * along, rig, space)

    def cut(ends: Float64 | None) -> Float64 | None:
        if ends is None:
            return None
        a, b = sorted((ends - strip[0]) @ along)
        low, high = max(a, min(0.0, b - least_m)), min(b, max(length, a + least_m))
        kept: Float64 = strip[0] + np.array([[low], [high]]) * along
        return kept if (ends[1] - ends[0]) @ along > 0.0 else kept[::-1]

    return [replace(s, onwards_m=cut(s.onwards_m), back_m=cut(s.back_m)) for s in found]


def _strips(left: BaseGeometry, width_m: float, angle_rad: float) -> list[tuple[Float64, float]]:
    """Lines (2, 2) in one direction over an area, as long as it: closely spaced, and two flush with its sides.

    With each the factor by which it has to work more than others: beside an edge a line is harder to reach.
    """
    x0, y0, x1, y1 = rotate(left, -angle_rad, origin=(0.0, 0.0), use_radians=True).bounds
    low, high = y0 - 0.5 * width_m, y1 + 0.5 * width_m
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    R = np.array([[c, -s], [s, c]])
    offsets = np.linspace(low, high, max(2, math.ceil((high - low) / width_m * OFFSETS)))[1:-1]
    flush = (y0 + 0.5 * width_m + FLUSH_M, y1 - 0.5 * width_m - FLUSH_M)
    lines = [*((y, 1.0) for y in offsets), *((y, FLUSH_GAIN) for y in flush)]
    return [(np.array([[x0, y], [x1, y]]) @ R.T, more) for y, more in lines]

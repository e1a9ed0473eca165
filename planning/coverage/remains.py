"""Swaths over what evenly spaced swaths leave bare: tips and tails of a field, where a strip along an edge is not free.

Each is the best of lines in several directions at closely spaced offsets, and of those along edges of the field: the
one that works most of the bare area. Beside an edge the rig is free on lines exactly parallel to it alone.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from itertools import islice

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
MAX_EDGES, MIN_EDGE_M = 6, 1.0  # edges beside which lines are tried
OFF_EDGE_M = (0.0, 0.05, 0.15, 0.4, 0.8)  # from the line along an edge: its neighbours may reach further inwards
ENOUGH = 4.0, 0.1, 0.2, 10.0  # least area in m² and in squared working widths, share of what is worked; most s for 1 m²
SHORT = 2.0, 0.03, 0.08, 30.0
MAX_SWATHS = 6  # over one part
MAX_OFFERS, DIFFERING_M = 6, 0.08
ALIKE = 0.9  # of what the better direction of a swath works
SIMPLER_M = 0.02


@dataclass(frozen=True)
class Worth:
    """Least bare area that a swath works, m² and share of all that it works, and most time for each m² of it."""

    least_m2: float
    least_share: float
    most_s_per_m2: float


def worth_of(rig: Rig, is_short: bool) -> Worth:
    """What is worth a swath; less where the field is short of its share."""
    least_m2, per_square, share, most_s_per_m2 = SHORT if is_short else ENOUGH
    return Worth(max(least_m2, per_square * rig.working_width_m**2), share, most_s_per_m2)


def swaths_over_remains(
    area: BaseGeometry, rig: Rig, space: FreeSpace, worth: Worth, is_taken: Callable[[Swath, float], bool]
) -> list[Swath]:
    """Swaths over the area that are each worth it and are taken for the most time of each; numbers are left 0.

    Of those that differ, the next best is offered where one is not taken, up to `MAX_OFFERS`.
    """
    found = []
    for part in parts(area.simplify(SIMPLER_M), worth.least_m2):
        left: BaseGeometry = part
        for _ in range(MAX_SWATHS):
            offers = islice(_differing(_best_first(left, part, rig, space, worth)), MAX_OFFERS)
            taken = next((s for s, gain_m2 in offers if is_taken(s, worth.most_s_per_m2 * gain_m2)), None)
            if taken is None:
                break
            found.append(taken)
            left = left.difference(strip_of(taken, rig.working_width_m))
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


def _best_first(
    left: BaseGeometry, part: Polygon, rig: Rig, space: FreeSpace, worth: Worth
) -> Iterator[tuple[Swath, float]]:
    """Swaths with what they work of an area, m², most first: what a whole strip works bounds each of its swaths."""
    width_m = rig.working_width_m
    strips = [strip for angle_rad in directions_of(part) for strip in _strips(left, width_m, angle_rad)]
    strips += [(strip, FLUSH_GAIN) for strip in _beside_edges(left, rig, space)]
    areas = np.array([_area_of(strip, width_m) for strip, _ in strips])
    bounds = shapely.area(shapely.intersection(areas, left)) / np.array([more for _, more in strips])
    queue: list[tuple[float, int, Swath | None, float]] = [
        (-float(bound), k, None, 0.0) for k, bound in enumerate(bounds.round(3)) if bound > worth.least_m2
    ]
    heapify(queue)
    count = len(strips)
    while queue:
        _, k, swath, gain_m2 = heappop(queue)
        if swath is not None:
            yield swath, gain_m2
            continue
        strip, more = strips[k]
        for near, worked, gain_m2 in _ways(_swaths_near(strip, rig, space), left, width_m):
            if gain_m2 > more * worth.least_m2 and gain_m2 > worth.least_share * worked.area:
                heappush(queue, (-round(gain_m2 / more, 3), count, near, gain_m2))
                count += 1


def _ways(swaths: Sequence[Swath], left: BaseGeometry, width_m: float) -> Iterator[tuple[Swath, Polygon, float]]:
    """Swaths with the area each works, and what of an area that is, m².

    The two directions of a swath are offered apart where one works much less than the other.
    """
    for swath in swaths:
        ways = [replace(swath, back_m=None)] if swath.onwards_m is not None else []
        ways += [replace(swath, onwards_m=None)] if swath.back_m is not None else []
        areas = [strip_of(way, width_m) for way in ways]
        gains_m2 = [float(left.intersection(area).area) for area in areas]
        if min(gains_m2) > ALIKE * max(gains_m2):
            ways, areas, gains_m2 = [swath], areas[:1], [min(gains_m2)]
        yield from zip(ways, areas, gains_m2, strict=True)


def _differing(offers: Iterable[tuple[Swath, float]]) -> Iterator[tuple[Swath, float]]:
    """Those that differ from each before in direction, or by some distance."""
    seen = list[Float64]()
    for swath, gain_m2 in offers:
        ends = swath.onwards_m if swath.onwards_m is not None else swath.back_m
        assert ends is not None
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        across = np.array([-along[1], along[0]])
        same = (other for other in seen if (other[1] - other[0]) @ along > 0.0)
        if not any(np.abs((other - ends[0]) @ across).max() < DIFFERING_M for other in same):
            seen.append(ends)
            yield swath, gain_m2


def _beside_edges(left: BaseGeometry, rig: Rig, space: FreeSpace) -> list[Float64]:
    """Lines (2, 2) parallel to the longest edges of the allowed area around an area, as long as it, beside the edge."""
    half_m = 0.5 * rig.width_m
    edges = space.grid.edges_m
    ends = np.asarray(shapely.linestrings(edges.reshape(-1, 2, 2)))
    near = np.flatnonzero((shapely.distance(ends, left) < half_m) & (shapely.length(ends) > MIN_EDGE_M))
    longest = near[np.argsort(-shapely.length(ends[near]).round(3), kind="stable")[:MAX_EDGES]]
    points, found = shapely.get_coordinates(left), []
    for first, last in edges[longest].reshape(-1, 2, 2):
        along = (last - first) / np.hypot(*(last - first))
        inwards = np.array([-along[1], along[0]])
        inwards *= np.sign((points.mean(axis=0) - first) @ inwards)
        s = (points - first) @ along
        for off_m in OFF_EDGE_M:
            base = first + (half_m + rig.config.edge_slack_m + off_m) * inwards
            found.append(base + np.array([[s.min()], [s.max()]]) * along)
    return found


def _swaths_near(strip: Float64, rig: Rig, space: FreeSpace) -> list[Swath]:
    """Swaths on a line over an area and a little beyond, each no longer than the area and the shortest swath need."""
    least_m = rig.min_swath_m
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

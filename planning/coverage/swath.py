"""Swaths: parallel strips over the area inside the headland passes, split where that area is split."""

import math
from dataclasses import dataclass

import numpy as np
from shapely.affinity import rotate
from shapely.geometry import MultiPolygon, Polygon, box
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.polygon import edge_angles, grow, open_by, parts, polygon_of, shrink
from geometry.pose2 import Pose2
from planning.turns.free_space import FreeSpace
from planning.turns.turn import is_free

MIN_STRIP_M2 = 0.5
REMAINS_RIM_M = 1.0
REMAINS_THICK_M = 2.4
REMAINS_LEAST_SQUARES = (
    0.6  # of the squared working width: smaller remains are corners of passes that no swath can leave
)
TRIM_M = 0.5
TURN_COST_M = 20.0  # cost of one more swath in turns, as distance


@dataclass(frozen=True)
class Swath:
    """A straight line of the implement's working line, worked from one end to the other in either direction."""

    number: int
    a_m: Float64
    b_m: Float64

    @property
    def length_m(self) -> float:
        """End to end."""
        return float(np.hypot(*(self.b_m - self.a_m)))

    def poses(self, is_reversed: bool, lead_m: float) -> tuple[Pose2, Pose2]:
        """Poses of `base` at start and end of work; `lead_m` is the distance of `base` ahead of the working line."""
        first, last = (self.b_m, self.a_m) if is_reversed else (self.a_m, self.b_m)
        heading = math.atan2(*(last - first)[::-1])
        ends = [Pose2(float(p[0]), float(p[1]), heading).ahead(lead_m) for p in (first, last)]
        return ends[0], ends[1]


def swaths_of(
    area: BaseGeometry, width_m: float, overlap_m: float, min_m: float, direction_rad: float | None
) -> list[Swath]:
    """Swaths that cover the area; without a direction along the edge of lowest cost.

    `width_m` is the width of one swath; neighbours overlap by at least `overlap_m`.
    """
    if area.is_empty:
        return []
    angles = [direction_rad] if direction_rad is not None else _directions(area)
    tried = [_along(area, width_m, overlap_m, min_m, angle) for angle in angles]
    return min(tried, key=lambda swaths: round(sum(s.length_m + TURN_COST_M for s in swaths), 3))


def _directions(area: BaseGeometry) -> list[float]:
    angles: list[float] = []
    for part in parts(area):
        for angle, length in edge_angles(part)[:12]:
            is_new = all(abs((angle - a + math.pi / 2) % math.pi - math.pi / 2) > math.radians(1.0) for a in angles)
            if is_new and length > 3.0:
                angles.append(angle)
    return angles or [0.0]


def _along(area: BaseGeometry, width_m: float, overlap_m: float, min_m: float, angle_rad: float) -> list[Swath]:
    flat = rotate(area, -angle_rad, origin=(0.0, 0.0), use_radians=True)
    pieces = [strip for part in parts(flat, MIN_STRIP_M2) for strip in _strips(part, width_m, overlap_m, min_m)]
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    R = np.array([[c, -s], [s, c]])
    return [Swath(k, R @ np.array([x0, y]), R @ np.array([x1, y])) for k, (x0, x1, y) in enumerate(pieces)]


def _strips(part: Polygon, width_m: float, overlap_m: float, min_m: float) -> list[tuple[float, float, float]]:
    """Start, end and height of the strips of a polygon along x, from below."""
    x0, y0, x1, y1 = part.bounds
    height = y1 - y0
    count = max(1, math.ceil((height - overlap_m) / (width_m - overlap_m) - 1e-9))
    pitch = (height - width_m) / (count - 1) if count > 1 else 0.0
    middles = [y0 + width_m / 2.0 + k * pitch for k in range(count)] if count > 1 else [(y0 + y1) / 2.0]
    found = []
    for k, y in enumerate(middles):
        # neighbours share the overlap: each strip covers up to its middle
        reach = pitch / 2.0 + 1e-6 if count > 1 else width_m / 2.0
        low = y0 if k == 0 else y - reach
        high = y1 if k == count - 1 else y + reach
        for piece in parts(part.intersection(box(x0 - 1.0, low, x1 + 1.0, high)), MIN_STRIP_M2):
            a, _, b, _ = piece.bounds
            found.append((*_min_length(a, b, min_m), y))
    return found


def _min_length(a: float, b: float, min_m: float) -> tuple[float, float]:
    more = max(0.0, min_m - (b - a)) / 2.0
    return a - more, b + more


def remains(free: BaseGeometry, worked: BaseGeometry, inner: BaseGeometry, width_m: float) -> BaseGeometry:
    """Area left by passes and swaths that is large enough for a swath of its own."""
    left = shrink(free, REMAINS_RIM_M).difference(worked).difference(grow(inner, 0.05))
    return polygon_of(MultiPolygon(parts(open_by(left, REMAINS_THICK_M / 2.0), REMAINS_LEAST_SQUARES * width_m**2)))


def trimmed(swath: Swath, lead_m: float, space: FreeSpace, min_m: float) -> Swath | None:
    """Longest part of a swath whose straight path is free, in steps of `TRIM_M`, or None."""
    count = int(swath.length_m / TRIM_M)
    along = (swath.b_m - swath.a_m) / max(swath.length_m, 1e-9)
    cuts = [(i, k - i) for k in range(count) for i in range(k + 1)] if count <= 60 else [(0, 0)]
    for first, last in cuts:
        part = Swath(swath.number, swath.a_m + first * TRIM_M * along, swath.b_m - last * TRIM_M * along)
        if part.length_m < min_m:
            return None
        ends = [part.poses(is_reversed, lead_m) for is_reversed in (False, True)]
        if all(is_free(np.array([[a.x_m, a.y_m], [b.x_m, b.y_m]]), space) for a, b in ends[:1]):
            return part
    return None

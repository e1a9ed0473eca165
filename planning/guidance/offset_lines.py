"""Lines beside an adaptive curve or a circle at whole spacings, prolonged over an area and kept drivable.

An adaptive curve is smoothed, prolonged along its tangents, and moved to either side: all places at that distance, so
that an inner bend loses its loop. A bend that then is tighter than the turning radius becomes an arc of that radius
(rolling a disc along either side).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.polygon import parts, rounded
from geometry.polyline import arc_length, curvatures, headings, polyline, resample, simplified, smooth
from messages.errors import FieldError
from planning.guidance.line import Circle, Curve

STEP_M = 0.1
RECORDED_M = 2.4  # averaging window of a recorded curve: against the noise of its positions
TANGENT_M = 2.0  # at the ends of a curve
ERROR_M = 0.001  # of a line moved
ARC_STEP_M = 0.5
MAX_ARC_SEGMENTS = 128  # per quarter turn
BEYOND_M = 30.0  # of the area
ASIDE = 0.45  # of a spacing: what of a line lies farther from its drivable form is a line of its own
CLOSED_M = 1.0  # between first and last point of a closed curve
MIN_LINE_M = 3.0


@dataclass(frozen=True)
class OffsetLine:
    """Line `number`, left positive (of a circle outwards): points 0.1 m apart, heading and curvature (N,).

    A closed one repeats its first point at the end.
    """

    number: int
    points_m: Float64
    heading_rad: Float64
    curvature_radpm: Float64
    is_closed: bool


def lines_over(
    area: BaseGeometry, guide: Curve | Circle, pitch_m: float, radius_m: float, smoothing_m: float
) -> Iterator[OffsetLine]:
    """Lines at whole spacings within half a spacing of an area, with bends of at least `radius_m`, by number.

    Raises FieldError for a curve that crosses itself.
    """
    if isinstance(guide, Circle):
        yield from _circles(area, guide, pitch_m, radius_m)
        return
    check_simple(guide)
    curve = _smoothed(guide)
    is_closed = _is_closed(curve) and float(arc_length(curve)[-1]) > 2.0 * math.pi * radius_m
    base = LineString([*curve, curve[0]]) if is_closed else _prolonged(curve, area)
    corners = shapely.get_coordinates(shapely.segmentize(area, 5.0))
    most = math.ceil(float(shapely.distance(base, shapely.points(corners)).max()) / pitch_m + 0.5)
    around = box(*area.bounds).buffer(BEYOND_M, join_style="mitre")
    simple = LineString(simplified(np.asarray(base.coords), ERROR_M))
    for number in range(-most, most + 1):
        exact, drivable = (_rings if is_closed else _pieces)(simple, number * pitch_m, radius_m)
        left_out = exact.difference(drivable.buffer(ASIDE * pitch_m))
        for shape, is_ring in ((drivable, is_closed), (left_out, False)):
            for points in _along(base, shape if is_ring else shape.intersection(around)):
                line = smooth(resample(points, STEP_M), smoothing_m, is_ring)
                heading = headings(line, is_ring)
                yield OffsetLine(number, line, heading, curvatures(heading, arc_length(line)), is_ring)


def _circles(area: BaseGeometry, circle: Circle, pitch_m: float, radius_m: float) -> Iterator[OffsetLine]:
    """Counter-clockwise circles around the centre that are not smaller than the turning radius."""
    centre = Point(circle.center_m)
    corners = np.asarray(shapely.points(shapely.get_coordinates(area)))
    most_m = float(shapely.distance(centre, corners).max()) + 0.5 * pitch_m
    least_m = max(radius_m, float(centre.distance(area)) - 0.5 * pitch_m)
    first = math.ceil((least_m - circle.radius_m) / pitch_m - 1e-9)
    for number in range(first, math.floor((most_m - circle.radius_m) / pitch_m) + 1):
        radius = circle.radius_m + number * pitch_m
        count = math.ceil(2.0 * math.pi * radius / STEP_M)
        angle = np.linspace(0.0, 2.0 * math.pi, count + 1)
        points = np.array(circle.center_m) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        points[-1] = points[0]
        yield OffsetLine(number, points, angle + 0.5 * math.pi, np.full(count + 1, 1.0 / radius), True)


def check_simple(curve: Curve) -> None:
    """Raises FieldError for a curve that crosses itself."""
    line = _smoothed(curve)
    if not (shapely.LinearRing(line) if _is_closed(line) else LineString(line)).is_simple:
        raise FieldError("the curve crosses itself, so that nothing is parallel to it: shorten it before the loop")


def _smoothed(curve: Curve) -> Float64:
    """Points 0.1 m apart, without most of the noise of recorded positions."""
    return smooth(resample(polyline(curve.points_m), STEP_M), RECORDED_M)


def _is_closed(line_m: Float64) -> bool:
    return float(np.hypot(*(line_m[-1] - line_m[0]))) < CLOSED_M and float(arc_length(line_m)[-1]) > 4.0 * CLOSED_M


def _prolonged(curve: Float64, area: BaseGeometry) -> LineString:
    """The curve prolonged straight at both ends over the area; an end that meets the line again stops before that."""
    low = np.minimum(curve.min(axis=0), np.array(area.bounds[:2]))
    high = np.maximum(curve.max(axis=0), np.array(area.bounds[2:]))
    reach = float(np.hypot(*(high - low))) + BEYOND_M
    back = max(1, min(round(TANGENT_M / STEP_M), len(curve) - 1))
    line = LineString(curve)
    ends = []
    for end, before in ((curve[0], curve[back]), (curve[-1], curve[-1 - back])):
        along = (end - before) / np.hypot(*(end - before))
        ray = LineString([end + 2.0 * STEP_M * along, end + reach * along])
        ends.append(_until(ray, line))
    if ends[0].intersects(ends[1]):
        meeting = ends[0].intersection(ends[1])
        ends = [_until(ray, meeting) for ray in ends]
    before, after = (np.asarray(ray.coords)[-1] for ray in ends)
    return LineString(np.vstack([before, curve, after]))


def _until(ray: LineString, other: BaseGeometry) -> LineString:
    """A ray from its start to shortly before it meets a shape."""
    meeting = ray.intersection(other)
    if meeting.is_empty:
        return ray
    start = np.asarray(ray.coords)[0]
    length = max(STEP_M, Point(start).distance(meeting) - 1.0)
    along = (np.asarray(ray.coords)[-1] - start) / ray.length
    return LineString([start, start + length * along])


def _pieces(base: LineString, by_m: float, radius_m: float) -> tuple[BaseGeometry, BaseGeometry]:
    """An open line moved to the left, exactly and with bends that are not too tight."""
    shape: BaseGeometry = base
    for step_m in (by_m + radius_m, -2.0 * radius_m, radius_m):
        shape = _moved(shape, step_m)
    return _moved(base, by_m), shape


def _along(base: LineString, shape: BaseGeometry) -> list[Float64]:
    """Lines of a shape as points in the direction of the base line, those near its beginning first."""
    found = []
    for piece in shapely.get_parts(shape if shape.geom_type == "LineString" else shapely.line_merge(shape)):
        if piece.length > MIN_LINE_M:
            points = np.asarray(piece.coords, np.float64)
            near = 0.01 if piece.is_ring else 1.0  # of a ring, whose ends meet, a short way tells the direction
            first, later = (base.project(piece.interpolate(at, normalized=True)) for at in (0.0, near))
            found.append((min(first, later), points[::-1] if first > later else points))
    return [points for _, points in sorted(found, key=lambda one: round(one[0], 6))]


def _moved(shape: BaseGeometry, to_left_m: float) -> BaseGeometry:
    """Lines moved to the left, each without loops."""
    if abs(to_left_m) < ERROR_M:  # GEOS fails for some
        return shape
    segments = min(MAX_ARC_SEGMENTS, max(8, math.ceil(abs(to_left_m) * 0.5 * math.pi / ARC_STEP_M)))
    moved = [shapely.offset_curve(line, to_left_m, quad_segs=segments) for line in shapely.get_parts(shape)]
    lines = [line.simplify(ERROR_M) for one in moved for line in shapely.get_parts(one) if line.length > STEP_M]
    return shapely.MultiLineString(lines)


def _rings(base: LineString, to_left_m: float, radius_m: float) -> tuple[BaseGeometry, BaseGeometry]:
    """A closed line moved to the left, exactly and with bends that are not too tight: the rings that are left of it."""
    inside = Polygon(base)
    moved = inside.buffer(-to_left_m if inside.exterior.is_ccw else to_left_m, quad_segs=MAX_ARC_SEGMENTS)
    exact, drivable = (
        shapely.MultiLineString([part.exterior for part in parts(shape, 1.0)])
        for shape in (moved, rounded(moved, radius_m))
    )
    return exact, drivable

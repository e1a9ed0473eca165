"""Reader of one field from a file; each error names value and position."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import DatumConfig
from geometry.arrays import Float64
from geometry.geodesy import Datum
from geometry.polygon import as_polygon
from messages.errors import FieldError
from planning.field.feature_choice import Choice, choose
from planning.field.formats.contents import FieldFile, LonLat, RecordedLine, Ring
from planning.field.formats.known_formats import read_file
from planning.field.simplification import simplified_inwards

MIN_AREA_M2 = 100.0
MAX_EXTENT_M = 5000.0
MAX_POINTS = 200_000
SAME_POINT_M = 0.002
MIN_NO_GO_M2 = 0.1
OBSTACLE_M = 1.0  # kept clear around obstacles without area


@dataclass(frozen=True)
class FieldOutline:
    """A field in `map` about `datum`.

    `polygon` has its outline and, as holes, areas without work; it lies within `original`, from which it was
    simplified (None: it was not). `no_go` are further areas with their names, which may overlap the outline. `lines`
    are the guidance lines of the file for this field, `notes` what the file holds beside it.
    """

    name: str
    datum: DatumConfig
    polygon: Polygon
    original: Polygon | None = None
    no_go: tuple[tuple[str, Polygon], ...] = ()
    lines: tuple[RecordedLine, ...] = ()
    notes: tuple[str, ...] = ()


def read_field(path: Path, feature: str | None = None) -> FieldOutline:
    """The field of a file that `feature` names (name, number from 1, with `.` the part), or the only one.

    Raises FieldError.
    """
    return outline_of(read_file(path), path, feature)


def outline_of(contents: FieldFile, path: Path, feature: str | None = None) -> FieldOutline:
    """The same from the contents of the file."""
    choice = choose(contents, feature, str(path))
    try:
        original, datum, no_go = _in_map(choice)
    except FieldError as error:
        raise FieldError(f"{path}: {error}") from error
    polygon = simplified_inwards(original)
    lines = tuple(line for line in contents.lines if line.feature in (None, choice.index))
    return FieldOutline(
        choice.name or path.stem, datum, polygon, original, no_go, lines, (*contents.notes, *_notes(original, polygon))
    )


def with_no_go(outline: FieldOutline, rings_m: Sequence[Sequence[tuple[float, float]]]) -> FieldOutline:
    """Outline with further areas to keep out of, in `map`; raises FieldError for one that is no area of the field."""
    areas = []
    for number, ring in enumerate(rings_m, 1):
        area = Polygon(ring)
        if not area.is_valid or area.area < MIN_NO_GO_M2:
            raise FieldError(f"no-go area {number} crosses itself or has less than {MIN_NO_GO_M2:g} m²; draw it again")
        if not area.intersects(outline.polygon):
            raise FieldError(f"no-go area {number} is outside the field")
        areas.append((f"drawn no-go area {number}", area))
    no_go = (*outline.no_go, *areas)
    left_m2 = outline.polygon.difference(shapely.union_all([area for _, area in no_go])).area
    if left_m2 < MIN_AREA_M2:
        raise FieldError(f"the no-go areas leave {left_m2:.1f} m² of the field (at least {MIN_AREA_M2:g} m²)")
    return replace(outline, no_go=no_go)


def _notes(original: Polygon, polygon: Polygon) -> tuple[str, ...]:
    before, after = (len(shapely.get_coordinates(p)) for p in (original, polygon))
    return (f"simplified inwards: {before} vertices to {after}",) if before - after > 1000 else ()


def _in_map(choice: Choice) -> tuple[Polygon, DatumConfig, tuple[tuple[str, Polygon], ...]]:
    """Polygon as in the file, its datum, and further no-go areas; raises FieldError without the name of the file."""
    if sum(map(len, choice.rings)) > MAX_POINTS:
        raise FieldError(f"more than {MAX_POINTS} points; simplify the outline")
    rings = _continuous([*choice.rings, *(ring for _, ring in choice.feature.no_go)])
    for ring in rings[: len(choice.rings)]:
        if len(ring) < 4:
            raise FieldError(f"{len(ring)} points have no area; a ring has three corners and its first point again")
    datum = _datum(rings[0])
    in_map = [_to_map(ring, datum.datum) for ring in rings]
    count = len(choice.rings)
    polygon = Polygon(in_map[0], in_map[1:count])
    _check(polygon, datum.datum)
    names = [name for name, _ in choice.feature.no_go]
    areas = [(name, _to_avoid(ring)) for name, ring in zip(names, in_map[count:], strict=True) if len(ring)]
    no_go = tuple((name, area) for name, area in areas if area.intersects(polygon))
    left_m2 = polygon.difference(shapely.union_all([area for _, area in no_go])).area
    if left_m2 < MIN_AREA_M2:
        raise FieldError(f"its no-go areas leave {left_m2:.1f} m² of the field (at least {MIN_AREA_M2:g} m²)")
    return as_polygon(shapely.remove_repeated_points(polygon, SAME_POINT_M).normalize()), datum, no_go


def _continuous(rings: list[Ring]) -> list[Ring]:
    """Rings of a field on both sides of 180° with longitudes above 180°."""
    longitudes = [point[0] for ring in rings for point in ring]
    if not longitudes or max(longitudes) - min(longitudes) <= 180.0:
        return rings
    return [[(x + 360.0 if x < 0.0 else x, y) for x, y in ring] for ring in rings]


def _to_avoid(points_m: Float64) -> Polygon:
    """Area of a closed ring, or its hull where it crosses itself; 1 m around lines, points, rings without area."""
    is_closed = len(points_m) >= 4 and bool((points_m[0] == points_m[-1]).all())
    area: BaseGeometry = Polygon(points_m) if is_closed else Polygon()
    if not area.is_valid:
        area = area.convex_hull
    if not isinstance(area, Polygon) or area.is_empty:
        area = shapely.MultiPoint(points_m) if len(points_m) == 1 else shapely.LineString(points_m)
        area = area.buffer(OBSTACLE_M, quad_segs=4)
    return as_polygon(area)


def _datum(ring: Ring) -> DatumConfig:
    """Origin near the south-west corner, rounded to 1e-6 degrees."""
    lon, lat = np.min(np.array(ring), axis=0)
    return DatumConfig(latitude_deg=round(float(lat), 6), longitude_deg=round(float(lon), 6), height_m=0.0)


def _to_map(ring: Ring, datum: Datum) -> Float64:
    return np.round(datum.points_to_map(np.array(ring, np.float64)), 4)


def _check(polygon: Polygon, datum: Datum) -> None:
    if not np.isfinite(polygon.bounds).all() or max(polygon.bounds[2:]) - min(polygon.bounds[:2]) > MAX_EXTENT_M:
        raise FieldError(f"wider than {MAX_EXTENT_M / 1000:g} km; points are [longitude, latitude] in degrees")
    if not polygon.is_valid:
        raise FieldError(f"{_invalid(polygon, datum)}; draw the outline without crossings")
    if polygon.area < MIN_AREA_M2:
        raise FieldError(f"{polygon.area:.1f} m² is too small for a field (at least {MIN_AREA_M2:g} m²)")


def _invalid(polygon: Polygon, datum: Datum) -> str:
    reason = shapely.is_valid_reason(polygon)
    text, _, place = reason.partition("[")
    if not place:
        return reason
    x, y = (float(v) for v in place.rstrip("]").split())
    lat, lon, _ = datum.to_ellipsoid(x, y, 0.0)
    known = {"Self-inter": "outline crosses itself", "Ring Self-": "outline crosses itself"}
    text = known.get(text[:10], "less than three corners" if text.startswith("Too few") else text.lower())
    return f"{text} at {_at((math.degrees(lon), math.degrees(lat)))}"


def _at(point: LonLat) -> str:
    return f"longitude {point[0]:.7g}, latitude {point[1]:.7g}"

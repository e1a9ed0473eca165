"""Reader of fields from GeoJSON (RFC 7946: longitude, latitude on WGS 84); each error names value and position."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import Polygon

from configs.site import DatumConfig
from geometry.geodesy import Datum
from geometry.polygon import as_polygon
from messages.errors import FieldError

MIN_AREA_M2 = 100.0
MAX_EXTENT_M = 5000.0
MAX_POINTS = 20_000
MAX_BYTES = 20_000_000
LonLat = list[tuple[float, float]]


@dataclass(frozen=True)
class FieldOutline:
    """Outline and no-go areas (holes) of a field in `map` about `datum`."""

    name: str
    datum: DatumConfig
    polygon: Polygon


def read_field(path: Path) -> FieldOutline:
    """The single field of a GeoJSON file; raises FieldError."""
    name, rings = _only_polygon(_content(path), path)
    for ring in rings:
        _check_closed(ring, path)
    datum = _datum(rings[0])
    polygon = Polygon(_to_map(rings[0], datum.datum), [_to_map(r, datum.datum) for r in rings[1:]])
    _check(polygon, datum.datum, path)
    return FieldOutline(name or path.stem, datum, as_polygon(shapely.remove_repeated_points(polygon, 0.01).normalize()))


def _content(path: Path) -> Any:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FieldError(f"{path}: larger than {MAX_BYTES // 10**6} MB; export the outline of one field alone")
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise FieldError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise FieldError(f"{path}: not valid JSON ({error}); export the field as GeoJSON") from error


def _only_polygon(content: Any, path: Path) -> tuple[str, list[LonLat]]:
    found = _polygons(content, "", path)
    if len(found) != 1:
        count = f"{len(found)} fields" if found else "no polygon"
        raise FieldError(f"{path}: holds {count}; give a file with one Polygon")
    name, coordinates = found[0]
    if not isinstance(coordinates, list) or not coordinates or not coordinates[0]:
        raise FieldError(f"{path}: the polygon is empty; give it an outline")
    rings = [[_lon_lat(p, path) for p in _list(ring, path)] for ring in coordinates]
    if sum(map(len, rings)) > MAX_POINTS:
        raise FieldError(f"{path}: more than {MAX_POINTS} points; simplify the outline")
    return name, rings


def _polygons(node: Any, name: str, path: Path) -> list[tuple[str, Any]]:
    """All polygons at or below a GeoJSON object, with the name of their feature."""
    kind = node.get("type") if isinstance(node, dict) else None
    if kind == "FeatureCollection":
        return [p for feature in _list(node.get("features"), path) for p in _polygons(feature, name, path)]
    if kind == "Feature":
        properties = node.get("properties")
        own = [v for k, v in properties.items() if k.lower() == "name"] if isinstance(properties, dict) else []
        return _polygons(node.get("geometry"), str(own[0]) if own else name, path)
    if kind == "GeometryCollection":
        return [p for g in _list(node.get("geometries"), path) for p in _polygons(g, name, path)]
    if kind == "MultiPolygon":
        return [(name, polygon) for polygon in _list(node.get("coordinates"), path)]
    if kind == "Polygon":
        return [(name, node.get("coordinates"))]
    raise FieldError(f"{path}: {kind or type(node).__name__!s} where a Polygon is needed; draw the field as a polygon")


def _list(value: Any, path: Path) -> list[Any]:
    if not isinstance(value, list):
        raise FieldError(f"{path}: {_short(value)} where a list is needed; export the field as GeoJSON again")
    return value


def _lon_lat(point: Any, path: Path) -> tuple[float, float]:
    numbers = isinstance(point, list) and len(point) >= 2
    if not numbers or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in point[:2]):
        raise FieldError(f"{path}: point {_short(point)} is not [longitude, latitude] in degrees")
    try:
        longitude, latitude = float(point[0]), float(point[1])
    except OverflowError:
        longitude = latitude = math.inf
    if not (math.isfinite(longitude) and math.isfinite(latitude)):
        raise FieldError(f"{path}: point {_short(point)} is not a finite number; correct or remove it")
    if abs(latitude) > 90.0:
        raise FieldError(
            f"{path}: latitude {latitude:g} is beyond ±90°; points are [longitude, latitude], in this order"
        )
    if abs(longitude) > 180.0:
        raise FieldError(
            f"{path}: longitude {longitude:g} is beyond ±180°; points are [longitude, latitude] in degrees"
        )
    return longitude, latitude


def _check_closed(ring: LonLat, path: Path) -> None:
    if len(ring) < 4:
        raise FieldError(f"{path}: {len(ring)} points have no area; a ring has three corners and its first point again")
    if ring[0] != ring[-1]:
        raise FieldError(f"{path}: not closed: {_at(ring[0])} is not the last point too; repeat it at the end")


def _datum(ring: LonLat) -> DatumConfig:
    """Origin near the south-west corner, rounded to 1e-6 degrees."""
    lon, lat = np.min(np.array(ring), axis=0)
    return DatumConfig(latitude_deg=round(float(lat), 6), longitude_deg=round(float(lon), 6), height_m=0.0)


def _to_map(ring: LonLat, datum: Datum) -> list[tuple[float, float]]:
    points = [datum.to_map(math.radians(lat), math.radians(lon), 0.0) for lon, lat in ring]
    return [(round(x, 4), round(y, 4)) for x, y, _ in points]


def _check(polygon: Polygon, datum: Datum, path: Path) -> None:
    if not np.isfinite(polygon.bounds).all() or max(polygon.bounds[2:]) - min(polygon.bounds[:2]) > MAX_EXTENT_M:
        raise FieldError(f"{path}: wider than {MAX_EXTENT_M / 1000:g} km; points are [longitude, latitude] in degrees")
    if not polygon.is_valid:
        raise FieldError(f"{path}: {_invalid(polygon, datum)}; draw the outline without crossings")
    if polygon.area < MIN_AREA_M2:
        raise FieldError(f"{path}: {polygon.area:.1f} m² is too small for a field (at least {MIN_AREA_M2:g} m²)")


def _invalid(polygon: Polygon, datum: Datum) -> str:
    reason = shapely.is_valid_reason(polygon)
    text, _, place = reason.partition("[")
    if not place:
        return reason
    x, y = (float(v) for v in place.rstrip("]").split())
    lat, lon, _ = datum.to_ellipsoid(x, y, 0.0)
    text = "outline crosses itself" if text.startswith(("Self-inter", "Ring Self")) else text.lower()
    return f"{text} at {_at((math.degrees(lon), math.degrees(lat)))}"


def _at(point: tuple[float, float]) -> str:
    return f"longitude {point[0]:.7g}, latitude {point[1]:.7g}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

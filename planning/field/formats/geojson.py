"""GeoJSON (RFC 7946), and the member `crs` of its former edition."""

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

from messages.errors import FieldError
from planning.field.formats.contents import (
    Feature,
    FieldFile,
    LonLat,
    RecordedLine,
    Ring,
    Rings,
    ignored_note,
    line_of,
    name_in,
)
from planning.field.formats.coordinates import CoordinateError, CoordinateSystem
from planning.field.formats.source import Source

NAME = "GeoJSON"
BEGINS = re.compile(rb"(?:\xef\xbb\xbf)?\s*[\[{]|\xff\xfe(?:\s\x00)*[\[{]\x00|\xfe\xff(?:\x00\s)*\x00[\[{]|\s*null")
POLYGONS, LINES, POINTS = ("Polygon", "MultiPolygon"), ("LineString", "MultiLineString"), ("Point", "MultiPoint")


def sniff(source: Source) -> Callable[[], FieldFile] | None:
    """Reads a file that begins as JSON does, and the single JSON file of an archive."""
    if BEGINS.match(source.head):
        return lambda: read_geojson(source.read(), str(source.path))
    found = source.named(".geojson", ".json")
    if len(found) == 1:
        return lambda: read_geojson(source.read(found[0]), f"{source.path}: {found[0]}")
    return None


def read_geojson(data: bytes, where: str) -> FieldFile:
    """Fields and lines of a document; raises FieldError that begins with `where`."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FieldError(f"{where}: not valid JSON ({error}); export the field as GeoJSON") from error
    try:
        return _Document(content).contents()
    except CoordinateError as error:
        raise FieldError(f"{where}: {error}") from error
    except RecursionError as error:
        raise FieldError(f"{where}: nested too deep; export the field as GeoJSON") from error


class _Document:
    """Features by the order of the file; raises CoordinateError for what is no GeoJSON."""

    def __init__(self, content: Any) -> None:
        self._system = CoordinateSystem(_crs(content))
        self._system.check()
        self._features: list[Feature] = []
        self._lines: list[RecordedLine] = []
        self._points = self._empty = 0
        self._unread: list[str] = []
        for node in _features(content):
            self._add(node)

    def contents(self) -> FieldFile:
        empty = [f"{self._empty} without geometry"] if self._empty else []
        notes = ignored_note(self._points, [*empty, *self._unread])
        return FieldFile(tuple(self._features), tuple(self._lines), (*notes, *self._system.notes))

    def _add(self, node: Any) -> None:
        """Takes a feature or a geometry; what is wrong with a polygon is kept until it is chosen."""
        is_feature = isinstance(node, dict) and node.get("type") == "Feature"
        if is_feature and node.get("geometry") is None:
            self._empty += 1
            return
        name = (name_in(node.get("properties")) or name_in({"id": node.get("id")})) if is_feature else ""
        parts: list[Rings] = []
        problem = ""
        has_polygon = False
        for kind, coordinates in _geometries(node["geometry"] if is_feature else node):
            has_polygon |= kind in POLYGONS
            try:
                if kind in POLYGONS:
                    parts += self._polygons(coordinates if kind.startswith("Multi") else [coordinates])
                elif kind in LINES:
                    self._add_lines(name, coordinates if kind.startswith("Multi") else [coordinates])
                else:
                    self._points += len(_list(coordinates)) if kind.startswith("Multi") else 1
            except CoordinateError as error:
                if kind in POLYGONS:
                    problem = problem or str(error)
                else:
                    self._unread.append(f"line {name!r} ({error})")
        if has_polygon:
            problem = problem or ("" if parts else "the polygon is empty; give it an outline")
            self._features.append(Feature(name, tuple(parts), problem))

    def _polygons(self, polygons: Any) -> list[Rings]:
        found = []
        for rings in _list(polygons):
            if not _list(rings) or not rings[0]:
                raise CoordinateError("the polygon is empty; give it an outline")
            found.append(tuple(_closed(self._ring(ring)) for ring in rings))
        return found

    def _add_lines(self, name: str, lines: Any) -> None:
        for points in _list(lines):
            if len(_list(points)) >= 2:
                self._lines.append(line_of(name, self._ring(points)))

    def _ring(self, points: Any) -> Ring:
        return self._system.to_degrees([_point(p) for p in _list(points)])


def _features(node: Any) -> Iterator[Any]:
    if isinstance(node, dict) and node.get("type") == "FeatureCollection":
        for feature in _list(node.get("features")):
            yield from _features(feature)
    else:
        yield node


def _geometries(node: Any) -> Iterator[tuple[str, Any]]:
    kind = node.get("type") if isinstance(node, dict) else None
    if kind == "GeometryCollection":
        for geometry in _list(node.get("geometries")):
            yield from _geometries(geometry)
    elif kind in (*POLYGONS, *LINES, *POINTS):
        yield kind, node.get("coordinates")
    else:
        found = kind if isinstance(kind, str) else type(node).__name__
        raise CoordinateError(f"{_short(found)[1:-1]} where a Polygon is needed; draw the field as a polygon")


def _crs(content: Any) -> str | None:
    """Code or name of the member `crs`; raises CoordinateError for one that is not understood."""
    crs = content.get("crs") if isinstance(content, dict) else None
    if crs is None:
        return None
    properties = crs.get("properties") if isinstance(crs, dict) else None
    found = properties.get("name", properties.get("code")) if isinstance(properties, dict) else None
    if isinstance(found, int) and not isinstance(found, bool):
        return f"EPSG:{found}"
    if not isinstance(found, str) or not found:
        raise CoordinateError(f"crs {_short(crs)} has no name; export the field as WGS 84 (EPSG:4326)")
    return found


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise CoordinateError(f"{_short(value)} where a list is needed; export the field as GeoJSON again")
    return value


def _point(point: Any) -> LonLat:
    is_pair = isinstance(point, list) and len(point) >= 2
    if not is_pair or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in point[:2]):
        raise CoordinateError(f"point {_short(point)} is not [longitude, latitude] in degrees")
    try:
        return float(point[0]), float(point[1])
    except OverflowError as error:
        raise CoordinateError(f"point {_short(point)} is not a finite number; correct or remove it") from error


def _closed(ring: Ring) -> Ring:
    if ring and ring[0] != ring[-1]:
        x, y = ring[0]
        raise CoordinateError(
            f"not closed: longitude {x:.7g}, latitude {y:.7g} is not the last point too; repeat it at the end"
        )
    return ring


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

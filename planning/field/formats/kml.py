"""KML and KMZ: polygons, rings and lines of the placemarks in every folder; heights are not used."""

import re
from collections.abc import Callable, Iterator
from xml.etree.ElementTree import Element

from planning.field.formats.contents import (
    Feature,
    FieldFile,
    RecordedLine,
    Ring,
    Rings,
    count_of,
    ignored_note,
    line_of,
    plain_name,
)
from planning.field.formats.coordinates import CoordinateError, CoordinateSystem, closed
from planning.field.formats.source import Source
from planning.field.formats.xml_tree import parse_xml

NAME = "KML"
ROOTS = ("kml", "Document", "Folder", "Placemark")
COMMA = re.compile(r"\s*,\s*")
LINKED = (".kml", ".kmz")
POINTS = ("Point", "Model")
SYSTEM = CoordinateSystem(None, "longitude,latitude")


def sniff(source: Source) -> Callable[[], FieldFile] | None:
    """Reads XML with a root of KML, and the KML files of an archive or folder."""
    root = source.xml
    if root is not None:
        return (lambda: read_kml([root])) if root.tag in ROOTS else None
    found = source.named(".kml")
    # the main file may do no more than link to the others
    return (lambda: read_kml([parse_xml(source.read(n), f"{source.path}: {n}") for n in found])) if found else None


def read_kml(roots: list[Element]) -> FieldFile:
    """Fields and lines of documents."""
    features: list[Feature] = []
    lines: list[RecordedLine] = []
    unread: list[str] = []
    points = links = 0
    for root in roots:
        hrefs = [(node.text or "").strip().lower() for node in root.iter("href")]
        links += sum(href.endswith(LINKED) and (len(roots) == 1 or "://" in href) for href in hrefs)
        for placemark, folder in _placemarks(root, ""):
            name = plain_name(placemark.findtext("name")) or folder
            points += sum(1 for kind in POINTS for _ in placemark.iter(kind))
            try:
                lines += _lines(placemark, name)
            except CoordinateError as error:
                unread.append(f"line {name!r} ({error})")
            if (feature := _feature(placemark, name)) is not None:
                features.append(feature)
    notes = ignored_note(points, [*([count_of(links, "file link")] if links else []), *unread])
    return FieldFile(tuple(features), tuple(lines), notes)


def _placemarks(node: Element, folder: str) -> Iterator[tuple[Element, str]]:
    """Every placemark with the name of its folder."""
    if node.tag == "Placemark":
        yield node, folder
        return
    name = plain_name(node.findtext("name")) if node.tag in ("Folder", "Document") else ""
    for child in node:
        yield from _placemarks(child, name or folder)


def _feature(placemark: Element, name: str) -> Feature | None:
    """The polygons of a placemark; rings that are no boundary of a polygon count as polygons."""
    polygons = list(placemark.iter("Polygon"))
    in_polygons = {id(ring) for p in polygons for ring in p.iter("LinearRing")}
    bare = [ring for ring in placemark.iter("LinearRing") if id(ring) not in in_polygons]
    if not polygons and not bare:
        return None
    try:
        parts = [_rings(p) for p in polygons] + [(closed(_points(ring)),) for ring in bare]
    except CoordinateError as error:
        return Feature(name, (), str(error))
    return Feature(name, tuple(parts))


def _rings(polygon: Element) -> Rings:
    outer = [_points(ring) for boundary in polygon.iter("outerBoundaryIs") for ring in boundary.iter("LinearRing")]
    inner = [_points(ring) for boundary in polygon.iter("innerBoundaryIs") for ring in boundary.iter("LinearRing")]
    if len(outer) != 1 or not outer[0]:
        raise CoordinateError("the polygon is empty; give it an outline" if not outer or not outer[0] else
                              f"the polygon has {len(outer)} outlines; give it one")  # fmt: skip
    return closed(outer[0]), *(closed(ring) for ring in inner if ring)


def _lines(placemark: Element, name: str) -> list[RecordedLine]:
    drawn = [_points(line) for line in placemark.iter("LineString")]
    tracks = [[_point(c.text or "", None) for c in track.iter("coord")] for track in placemark.iter("Track")]
    return [line_of(name, SYSTEM.to_degrees(points)) for points in (*drawn, *tracks) if len(points) >= 2]


def _points(ring: Element) -> Ring:
    """Points of a ring or line: `longitude,latitude[,height]`, separated by white space."""
    text = " ".join(node.text or "" for node in ring.iter("coordinates"))
    return SYSTEM.to_degrees([_point(t, ",") for t in COMMA.sub(",", text).split()])


def _point(text: str, separator: str | None) -> tuple[float, float]:
    numbers = text.split(separator)
    try:
        if not 2 <= len(numbers) <= 3:
            raise ValueError
        return float(numbers[0]), float(numbers[1])
    except ValueError:
        raise CoordinateError(f"coordinates {text[:40]!r} are not longitude,latitude,height in degrees") from None

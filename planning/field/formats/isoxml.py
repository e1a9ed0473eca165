"""ISOXML task data (ISO 11783-10, versions 3 and 4): partfields, areas to keep out of, and guidance patterns."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from xml.etree.ElementTree import Element

from messages.errors import FieldError
from planning.field.formats.contents import (
    Feature,
    FieldFile,
    RecordedLine,
    Ring,
    Rings,
    count_of,
    ignored_note,
    plain_name,
)
from planning.field.formats.coordinates import CoordinateError, CoordinateSystem, closed
from planning.field.formats.isoxml_guidance import guidance_lines
from planning.field.formats.source import Source
from planning.field.formats.xml_tree import parse_xml

NAME = "ISOXML"
ROOTS = ("ISO11783_TaskData", "XFC")
BOUNDARY = "1"
NO_GO = {"3": "water", "4": "building", "5": "road", "6": "obstacle", "12": "windbreak"}  # types of PLN
EXTERIOR, INTERIOR, LINE_OBSTACLE, POINT_OBSTACLE = "1", "2", "9", "5"
SYSTEM = CoordinateSystem(None, "latitude in C, longitude in D")


def sniff(source: Source) -> Callable[[], FieldFile] | None:
    """Reads a TASKDATA.XML, a part of it, and the folder or archive of one."""
    if source.xml is not None:
        root = source.xml
        return (lambda: _read(root, source.beside, str(source.path))) if root.tag in ROOTS else None
    found = source.named("taskdata.xml")
    if not found:
        return None
    main = min(found, key=lambda name: (name.count("/"), name))
    folder = main[: -len("taskdata.xml")].lower()
    members = {name.lower(): name for name in source.names}

    def beside(name: str) -> bytes | None:
        member = members.get(folder + name.lower())
        return source.read(member) if member is not None else None

    where = f"{source.path}: {main}"
    return lambda: _read(parse_xml(source.read(main), where), beside, where)


def _read(root: Element, beside: Callable[[str], bytes | None], where: str) -> FieldFile:
    if root.tag not in ROOTS:
        raise FieldError(f"{where}: root <{root.tag[:40]}> instead of <{ROOTS[0]}>; export the task data again")
    features: list[Feature] = []
    lines: list[RecordedLine] = []
    unread: list[str] = []
    zones = without = 0
    for partfield in _partfields(root, beside, where):
        has_boundary, feature = _feature(partfield)
        zones += sum(1 for _ in partfield.iter("TZN"))
        if not has_boundary:
            without += 1
            lines += _guidance(partfield, unread)
            continue
        lines += [replace(line, feature=len(features)) for line in _guidance(partfield, unread)]
        features.append(feature)
    zones += sum(1 for task in root.iter("TSK") for _ in task.iter("TZN"))
    others = [count_of(zones, "treatment zone")] if zones else []
    others += [f"{count_of(without, 'partfield')} without boundary"] if without else []
    return FieldFile(tuple(features), tuple(lines), ignored_note(0, [*others, *unread]))


def _partfields(root: Element, beside: Callable[[str], bytes | None], where: str) -> Iterator[Element]:
    """Partfields of the document and of the files that it names."""
    yield from root.iter("PFD")
    for reference in root.iter("XFR"):
        name = reference.get("A", "")
        if not name.upper().startswith("PFD"):
            continue
        name = name if name.lower().endswith(".xml") else f"{name}.XML"
        content = beside(name) if "/" not in name and "\\" not in name else None
        if content is None:
            raise FieldError(f"{where}: the file {name[:40]!r} with its partfields is missing beside it")
        yield from parse_xml(content, f"{where}: {name}").iter("PFD")


def _feature(partfield: Element) -> tuple[bool, Feature]:
    """Whether a partfield has a boundary, and the field."""
    name = plain_name(partfield.get("C")) or plain_name(partfield.get("B")) or plain_name(partfield.get("A"))
    boundaries = [p for p in partfield.findall("PLN") if p.get("A") == BOUNDARY]
    try:
        parts = [rings for p in boundaries for rings in _polygons(p)]
        no_go = tuple(_no_go(partfield))
    except CoordinateError as error:
        return True, Feature(name, (), str(error))
    problem = "" if parts or not boundaries else "the boundary has no outline (LSG of type 1)"
    return bool(boundaries), Feature(name, tuple(parts), problem, no_go)


def _no_go(partfield: Element) -> Iterator[tuple[str, Ring]]:
    """Areas, lines and points to keep out of, with their names; lines are not closed."""
    for area in partfield.findall("PLN"):
        if area.get("A") in NO_GO:
            name = f"{NO_GO[area.get('A', '')]} {plain_name(area.get('B'))}".strip()
            yield from ((name, closed(_points(ring))) for ring in area.findall("LSG") if ring.get("A") == EXTERIOR)
    for line in partfield.findall("LSG"):
        if line.get("A") == LINE_OBSTACLE:
            yield f"obstacle {plain_name(line.get('B'))}".strip(), _points(line)
    for point in partfield.findall("PNT"):
        if point.get("A") == POINT_OBSTACLE:
            yield f"obstacle {plain_name(point.get('B'))}".strip(), SYSTEM.to_degrees([_point(point)])


def _polygons(area: Element) -> list[Rings]:
    """Outlines of a PLN, each with the holes that begin within it."""
    rings = [(ring.get("A"), closed(_points(ring))) for ring in area.findall("LSG")]
    outer = [points for kind, points in rings if kind == EXTERIOR and points]
    holes = [points for kind, points in rings if kind == INTERIOR and points]
    if len(outer) == 1:
        return [(outer[0], *holes)]
    return [(ring, *(h for h in holes if _is_inside(h, ring))) for ring in outer]


def _is_inside(hole: Ring, outline: Ring) -> bool:
    """True if the first point of a hole is inside an outline, by the crossings of a ray."""
    x, y = hole[0]
    inside = False
    for (x0, y0), (x1, y1) in pairwise(outline):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            inside = not inside
    return inside


def _guidance(partfield: Element, unread: list[str]) -> list[RecordedLine]:
    """Guidance patterns; a pattern that cannot be read is put into `unread`."""
    try:
        return guidance_lines(partfield, _points)
    except CoordinateError as error:
        unread.append(f"guidance patterns ({error})")
        return []


def _points(line: Element) -> Ring:
    return SYSTEM.to_degrees([_point(node) for node in line.findall("PNT")])


def _point(node: Element) -> tuple[float, float]:
    latitude, longitude = node.get("C"), node.get("D")
    if latitude is None or longitude is None:
        more = " (a binary file of points is not read)" if node.get("I") else ""
        raise CoordinateError(f"a point without latitude or longitude{more}")
    try:
        return float(longitude), float(latitude)
    except ValueError:
        raise CoordinateError(f"point {longitude[:20]!r}, {latitude[:20]!r} is no longitude and latitude") from None

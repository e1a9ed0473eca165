"""Guidance patterns of ISOXML: GPN in groups (version 4), lines of type 5 in a partfield (version 3)."""

import math
from collections.abc import Callable, Iterator
from xml.etree.ElementTree import Element

from planning.field.formats.contents import RecordedLine, Ring, plain_name
from planning.field.formats.coordinates import CoordinateError

GUIDANCE = "5"  # type of LSG
AB, A_PLUS, CURVE, PIVOT = "1", "2", "3", "4"  # types of GPN
A, B, CENTRE = "6", "7", "8"  # types of PNT
CLOCKWISE = "1"
EARTH_M_PER_RAD = 6_371_000.0


def guidance_lines(partfield: Element, points: Callable[[Element], Ring]) -> list[RecordedLine]:
    """All patterns of a partfield that have their points; `points` reads those of an LSG. Raises CoordinateError."""
    found = (_line(name, pattern, line, points(line)) for name, pattern, line in _patterns(partfield))
    return [line for line in found if line is not None]


def _patterns(partfield: Element) -> Iterator[tuple[str, Element, Element]]:
    """Name, GPN and LSG of each pattern; an empty GPN for version 3."""
    for group in partfield.findall("GGP"):
        for pattern in group.findall("GPN"):
            name = plain_name(pattern.get("B")) or plain_name(group.get("B")) or plain_name(pattern.get("A"))
            yield from ((name, pattern, line) for line in pattern.findall("LSG"))
    for line in partfield.findall("LSG"):
        if line.get("A") == GUIDANCE:
            yield plain_name(line.get("B")), Element("GPN"), line


def _line(name: str, pattern: Element, line: Element, points: Ring) -> RecordedLine | None:
    """A pattern, None for one without the points of its type; without a type it is AB or a curve."""
    kind = pattern.get("C") or (AB if len(points) == 2 else CURVE)
    width_m = _number(line.get("C"), 0.001)
    by_type = {node.get("A"): point for node, point in zip(line.findall("PNT"), points, strict=True)}
    if kind == AB and len(points) >= 2:
        ends = [by_type.get(A, points[0]), by_type.get(B, points[-1])]
        return RecordedLine(name, "ab", ends, width_m=width_m)
    if kind == A_PLUS and points:
        heading_deg = _number(pattern.get("G"))
        a = by_type.get(A, points[0])
        return None if heading_deg is None else RecordedLine(name, "a_plus", [a], heading_deg, width_m=width_m)
    if kind == CURVE and len(points) >= 2:
        return RecordedLine(name, "curve", points, width_m=width_m)
    if kind == PIVOT and points:
        centre = by_type.get(CENTRE, points[0])
        rim = [p for p in points if p != centre]
        radius_m = _number(pattern.get("H"), 0.001) or (_distance_m(centre, rim[0]) if rim else None)
        is_clockwise = pattern.get("D") == CLOCKWISE
        if radius_m is not None:
            return RecordedLine(name, "pivot", [centre], None, radius_m, is_clockwise, width_m)
    return None


def _number(text: str | None, scale: float = 1.0) -> float | None:
    if text is None or not text.strip():
        return None
    try:
        value = float(text) * scale
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CoordinateError(f"{text[:20]!r} is not a number")
    return value


def _distance_m(a: tuple[float, float], b: tuple[float, float]) -> float:
    east = math.radians(b[0] - a[0]) * math.cos(math.radians(a[1]))
    return EARTH_M_PER_RAD * math.hypot(east, math.radians(b[1] - a[1]))

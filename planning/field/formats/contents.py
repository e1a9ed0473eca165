"""What a field file holds, in longitude and latitude on WGS 84, before any of it is chosen or checked."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

LonLat = tuple[float, float]
Ring = list[LonLat]
Rings = tuple[Ring, ...]  # outline, then holes
NAME_KEYS = ("name", "field_name", "fieldname", "title", "label", "id")


@dataclass(frozen=True)
class Feature:
    """A field: one polygon, or several parts.

    `problem` says why it cannot be read; it is raised when the feature is chosen. `no_go` are areas to keep out of,
    with their names, which may overlap the outline.
    """

    name: str
    parts: tuple[Rings, ...]
    problem: str = ""
    no_go: tuple[tuple[str, Ring], ...] = ()


@dataclass(frozen=True)
class RecordedLine:
    """A guidance line of a file; `heading_deg` is clockwise from north, `feature` the index of its field, None: any.

    `points` are A and B, A alone, the points of a curve, or the centre and a point on a circle.
    """

    name: str
    kind: Literal["ab", "a_plus", "curve", "pivot"]
    points: Ring
    heading_deg: float | None = None
    radius_m: float | None = None
    is_clockwise: bool = False
    width_m: float | None = None
    feature: int | None = None


@dataclass(frozen=True)
class FieldFile:
    """Fields and guidance lines of a file in its order, and notes on what is not used."""

    features: tuple[Feature, ...]
    lines: tuple[RecordedLine, ...] = ()
    notes: tuple[str, ...] = field(default=())


def line_of(name: str, points: Ring) -> RecordedLine:
    """A drawn line: AB with two points, else a curve."""
    return RecordedLine(name, "ab" if len(points) == 2 else "curve", points)


def name_in(properties: Any) -> str:
    """Name among the properties of a feature; a number is a name only under a key that says name, title or label."""
    if not isinstance(properties, dict):
        return ""
    by_key = {str(key).lower(): value for key, value in properties.items()}
    for key in NAME_KEYS:
        value = by_key.get(key)
        text = "" if value is None or isinstance(value, dict | list) else plain_name(str(value))
        if text and not (key == "id" and text.lstrip("-").replace(".", "", 1).isdigit()):
            return text
    return ""


def plain_name(text: str | None) -> str:
    """Name on one line, of printable characters, at most 80."""
    return "".join(c for c in " ".join((text or "").split()) if c.isprintable())[:80].strip()


def count_of(count: int, noun: str) -> str:
    """`1 line`, `2 lines`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def ignored_note(points: int, others: Sequence[str] = ()) -> tuple[str, ...]:
    """Note on points and other content that is not used."""
    found = [*([count_of(points, "point")] if points else []), *others]
    return (f"ignored: {', '.join(found)}",) if found else ()

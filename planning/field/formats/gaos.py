"""GAOS parcels (XML of Wageningen's field geometry service): the polygon of each `Field`."""

from collections.abc import Callable
from xml.etree.ElementTree import Element

from messages.errors import FieldError
from planning.field.formats.contents import Feature, FieldFile, Ring, Rings, count_of, plain_name
from planning.field.formats.coordinates import CoordinateError, CoordinateSystem, closed
from planning.field.formats.source import Source

NAME = "GAOS"
GEODETIC = "EPSG:4326"


def sniff(source: Source) -> Callable[[], FieldFile] | None:
    """Reads XML with the root `GAOS_parcel`."""
    root = source.xml
    return (lambda: read_gaos(root, str(source.path))) if root is not None and root.tag == "GAOS_parcel" else None


def read_gaos(root: Element, where: str) -> FieldFile:
    """Fields of a parcel; its edges and strips are not used. Raises FieldError that begins with `where`."""
    features: list[Feature] = []
    notes: list[str] = []
    for field in root.iter("Field"):
        for polygon in field.iter("Polygon"):
            system = CoordinateSystem(polygon.get("srsName", GEODETIC), "longitude,latitude")
            name = plain_name(field.get("name"))
            try:
                features.append(Feature(name, (_rings(polygon, system),)))
            except CoordinateError as error:
                features.append(Feature(name, (), str(error)))
            notes += [note for note in system.notes if note not in notes]
    if not features:
        raise FieldError(f"{where}: the GAOS parcel has no Field with a polygon")
    edges = sum(1 for _ in root.iter("Edge"))
    notes += [f"ignored: {count_of(edges, 'edge')}"] if edges else []
    return FieldFile(tuple(features), (), tuple(notes))


def _rings(polygon: Element, system: CoordinateSystem) -> Rings:
    outer = [r for tag in ("outerBoundaryIs", "exterior") for b in polygon.iter(tag) for r in b.iter("LinearRing")]
    inner = [r for tag in ("innerBoundaryIs", "interior") for b in polygon.iter(tag) for r in b.iter("LinearRing")]
    if len(outer) != 1:
        raise CoordinateError(f"the polygon has {len(outer)} outlines; give it one")
    return tuple(closed(system.to_degrees(_points(ring))) for ring in (*outer, *inner))


def _points(ring: Element) -> Ring:
    """Points of `coordinates` (`x,y x,y`), `posList` or `pos` (`x y x y`)."""
    texts = [node.text or "" for tag in ("coordinates", "posList", "pos") for node in ring.iter(tag)]
    try:
        if next(ring.iter("coordinates"), None) is not None:
            return [(float(x), float(y)) for x, y in (t.split(",")[:2] for t in " ".join(texts).split())]
        numbers = [float(t) for t in " ".join(texts).split()]
        return list(zip(numbers[::2], numbers[1::2], strict=True))
    except ValueError as error:
        raise CoordinateError(f"coordinates are no pairs of numbers ({error}); export the parcel again") from None

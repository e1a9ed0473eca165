"""A plan as KML 2.2: folders for the field, guidance lines, the path, and uncovered areas."""

from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import Site
from geometry.arrays import Float64
from geometry.polygon import parts
from planning.export.shapes import (
    CURVE_ERROR_M,
    curved_swath_lines,
    degrees_of,
    field_of,
    in_degrees,
    name_of,
    pass_lines,
    swath_lines,
)  # fmt: skip
from planning.plan import Plan

NAMESPACE = "http://www.opengis.net/kml/2.2"
STYLES = {  # line and area as AABBGGRR
    "field": ("ff000000", "00000000"), "no_go": ("ffe4c49c", "80e4c49c"), "line": ("ff377f1a", "00000000"),
    "path": ("ff2b82d9", "00000000"), "uncovered": ("ff2827d6", "802827d6"),
}  # fmt: skip


def write_kml(plan: Plan, site: Site, file: FilePath) -> None:
    """Writes a plan."""
    root = Element("kml", xmlns=NAMESPACE)
    document = SubElement(root, "Document")
    SubElement(document, "name").text = name_of(site)
    for style, (line, area) in STYLES.items():
        node = SubElement(document, "Style", id=style)
        SubElement(SubElement(node, "LineStyle"), "color").text = line
        SubElement(SubElement(node, "PolyStyle"), "color").text = area
    degrees = degrees_of(site.datum)
    field, no_go = field_of(site)
    paths = [
        (f"path {k + 1}, {s.section_type}", LineString(points).simplify(CURVE_ERROR_M))
        for k, path in enumerate(plan.paths)
        for s in path.sections
        if len(points := path.p_map_m[s.first : s.last + 2]) > 1
    ]
    uncovered = [(u.reason, shape) for u in plan.uncovered for shape in parts(u.outline)]
    _folder(document, "Field", "field", [(name_of(site), field)], degrees)
    _folder(document, "No-go areas", "no_go", no_go, degrees)
    _folder(
        document, "Guidance lines", "line", [*swath_lines(plan), *curved_swath_lines(plan), *pass_lines(plan)], degrees
    )
    _folder(document, "Path", "path", paths, degrees)
    _folder(document, "Uncovered", "uncovered", uncovered, degrees)
    indent(root)
    ElementTree(root).write(file, encoding="UTF-8", xml_declaration=True)


def _folder(
    document: Element,
    name: str,
    style: str,
    shapes: Sequence[tuple[str, BaseGeometry]],
    degrees: Callable[[Float64], Float64],
) -> None:
    if not shapes:
        return
    folder = SubElement(document, "Folder")
    SubElement(folder, "name").text = name
    for title, shape in shapes:
        placemark = SubElement(folder, "Placemark")
        SubElement(placemark, "name").text = title
        SubElement(placemark, "styleUrl").text = f"#{style}"
        if not isinstance(shape, Polygon):
            line = SubElement(placemark, "LineString")
            SubElement(line, "tessellate").text = "1"
            _coordinates(line, shape, degrees)
            continue
        polygon = SubElement(placemark, "Polygon")
        for tag, ring in [("outerBoundaryIs", shape.exterior), *(("innerBoundaryIs", r) for r in shape.interiors)]:
            _coordinates(SubElement(SubElement(polygon, tag), "LinearRing"), ring, degrees)


def _coordinates(parent: Element, line: BaseGeometry, degrees: Callable[[Float64], Float64]) -> None:
    SubElement(parent, "coordinates").text = " ".join(f"{x:.9f},{y:.9f}" for x, y in in_degrees(line, degrees))

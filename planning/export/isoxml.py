"""A plan as ISOXML task data, version 4 (ISO 11783-10): the partfield with its boundary and guidance patterns."""

from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from configs.site import Site
from geometry.arrays import Float64
from planning.export.shapes import (
    curved_swath_lines,
    degrees_of,
    field_of,
    in_degrees,
    name_of,
    pass_lines,
    swath_lines,
)  # fmt: skip
from planning.plan import Plan

MAX_NAME = 32
BOUNDARY, OBSTACLE = "1", "6"  # types of PLN
EXTERIOR, INTERIOR, GUIDANCE = "1", "2", "5"  # types of LSG
OTHER, A, B, ON_LINE = "2", "6", "7", "9"  # types of PNT
AB, CURVE = "1", "3"  # types of GPN
NO_PROPAGATION, NO_EXTENSION = "4", "4"


def write_isoxml(plan: Plan, site: Site, folder: FilePath, version: str) -> None:
    """Writes TASKDATA.XML into a new folder; `version` is that of the software."""
    folder.mkdir()
    root = Element(
        "ISO11783_TaskData", VersionMajor="4", VersionMinor="3", ManagementSoftwareManufacturer="Headland",
        ManagementSoftwareVersion=version, DataTransferOrigin="1",
    )  # fmt: skip
    degrees = degrees_of(site.datum)
    field, no_go = field_of(site)
    partfield = SubElement(root, "PFD", A="PFD1", C=name_of(site)[:MAX_NAME], D=str(round(field.area)))
    area = SubElement(partfield, "PLN", A=BOUNDARY, B=name_of(site)[:MAX_NAME], C=str(round(field.area)))
    _line(area, EXTERIOR, field.exterior, degrees)
    for hole in field.interiors:
        _line(area, INTERIOR, hole, degrees)
    for name, shape in no_go:
        _line(SubElement(partfield, "PLN", A=OBSTACLE, B=name[:MAX_NAME]), EXTERIOR, shape.exterior, degrees)
    width_mm = round(1000.0 * plan.rig.working_width_m)
    number = 1
    for name, kind, lines in (
        ("swaths", AB, swath_lines(plan)), ("curved swaths", CURVE, curved_swath_lines(plan)),
        ("headland", CURVE, pass_lines(plan)),
    ):  # fmt: skip
        _group(partfield, name, kind, lines, number, width_mm, degrees)
        number += len(lines)
    indent(root)
    ElementTree(root).write(folder / "TASKDATA.XML", encoding="UTF-8", xml_declaration=True)


def _group(
    partfield: Element, name: str, kind: str, lines: Sequence[tuple[str, LineString]], first: int, width_mm: int,
    degrees: Callable[[Float64], Float64],
) -> None:  # fmt: skip
    """One GGP; patterns are numbered from `first` on in the file."""
    if not lines:
        return
    group = SubElement(partfield, "GGP", A=f"GGP{len(partfield.findall('GGP')) + 1}", B=name)
    for k, (title, line) in enumerate(lines, first):
        pattern = SubElement(group, "GPN", A=f"GPN{k}", B=title, C=kind, E=NO_PROPAGATION, F=NO_EXTENSION)
        _line(pattern, GUIDANCE, line, degrees, width_mm)


def _line(
    parent: Element, kind: str, line: BaseGeometry, degrees: Callable[[Float64], Float64], width_mm: int | None = None
) -> None:
    node = SubElement(parent, "LSG", A=kind)
    if width_mm is not None:
        node.set("C", str(width_mm))
    points = in_degrees(line, degrees)
    for k, (longitude, latitude) in enumerate(points):
        at = OTHER if kind != GUIDANCE else A if k == 0 else B if k == len(points) - 1 else ON_LINE
        SubElement(node, "PNT", A=at, C=f"{latitude:.9f}", D=f"{longitude:.9f}")

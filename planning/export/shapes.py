"""Shapes of a plan for export: the field, areas to keep out of, guidance lines, and coordinates in degrees."""

from collections.abc import Callable

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from configs.site import DatumConfig, Site
from geometry.arrays import Float64
from planning.field.formats.contents import plain_name
from planning.plan import Plan

CURVE_ERROR_M = 0.005  # of an exported curve
DECIMALS = 9  # of degrees: 0.1 mm


def degrees_of(datum: DatumConfig) -> Callable[[Float64], Float64]:
    """Function from points in `map` (N, 2) to longitude and latitude in degrees (N, 2)."""
    converter = datum.datum

    def degrees(points: Float64) -> Float64:
        found = [converter.to_ellipsoid(float(x), float(y), 0.0)[:2] for x, y in points]
        return np.asarray(np.round(np.degrees(np.array(found)[:, ::-1]), DECIMALS), np.float64)

    return degrees


def field_of(site: Site) -> tuple[Polygon, list[tuple[str, Polygon]]]:
    """Field with its holes, and the no-go areas that are no holes since they touch or cross the outline or another."""
    outline = Polygon(site.boundary_m)
    holes: list[Polygon] = []
    others: list[tuple[str, Polygon]] = []
    for area in site.no_go:
        shape = Polygon(area.outline_m)
        if outline.contains_properly(shape) and not any(shape.intersects(hole) for hole in holes):
            holes.append(shape)
        else:
            others.append((area.name, shape))
    return Polygon(outline.exterior, [hole.exterior for hole in holes]), others


def swath_lines(plan: Plan) -> list[tuple[str, LineString]]:
    """Straight guidance lines: the worked line of each swath, in the longer direction."""
    found = []
    for swath in plan.swaths:
        ends = [e for e in (swath.onwards_m, swath.back_m) if e is not None]
        longest = max(ends, key=lambda e: float(np.hypot(*(e[1] - e[0]))))
        found.append((f"swath {swath.number + 1}", LineString(longest)))
    return found


def pass_lines(plan: Plan) -> list[tuple[str, LineString]]:
    """Curved guidance lines: the path of `base` on each headland pass."""
    lines = [LineString(p.points_m).simplify(CURVE_ERROR_M) for p in plan.headland_passes]
    return [(f"headland {k + 1}", line) for k, line in enumerate(lines) if isinstance(line, LineString)]


def name_of(site: Site) -> str:
    """Name of the site on one line."""
    return plain_name(site.name) or "field"


def in_degrees(line: shapely.geometry.base.BaseGeometry, degrees: Callable[[Float64], Float64]) -> list[list[float]]:
    """Points of a line or ring as longitude and latitude."""
    return [[float(x), float(y)] for x, y in degrees(np.asarray(line.coords, np.float64)[:, :2])]

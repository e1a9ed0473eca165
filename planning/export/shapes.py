"""Shapes of a plan for export: the field, areas to keep out of, guidance lines, and coordinates in degrees."""

from collections.abc import Callable, Iterable

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from configs.site import DatumConfig, Site
from geometry.arrays import Float64
from planning.coverage.curved_swath import CurvedSwath
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
    """Straight guidance lines: the worked line of each straight swath, in the longer direction."""
    found = []
    for swath in plan.swaths:
        if isinstance(swath, CurvedSwath):
            continue
        ends = [e for e in (swath.onwards_m, swath.back_m) if e is not None]
        longest = max(ends, key=lambda e: float(np.hypot(*(e[1] - e[0]))))
        found.append((f"swath {swath.number + 1}", LineString(longest)))
    return found


def curved_swath_lines(plan: Plan) -> list[tuple[str, LineString]]:
    """Curved guidance lines: the path of `base` on each curved swath, in the longer direction."""
    return _curves((f"swath {s.number + 1}", s.longer.p_map_m) for s in plan.swaths if isinstance(s, CurvedSwath))


def pass_lines(plan: Plan) -> list[tuple[str, LineString]]:
    """Curved guidance lines: the path of `base` on each headland pass."""
    return _curves((f"headland {k + 1}", p.points_m) for k, p in enumerate(plan.headland_passes))


def _curves(named: Iterable[tuple[str, Float64]]) -> list[tuple[str, LineString]]:
    lines = [(name, LineString(points).simplify(CURVE_ERROR_M)) for name, points in named]
    return [(name, line) for name, line in lines if isinstance(line, LineString)]


def name_of(site: Site) -> str:
    """Name of the site on one line."""
    return plain_name(site.name) or "field"


def in_degrees(line: shapely.geometry.base.BaseGeometry, degrees: Callable[[Float64], Float64]) -> list[list[float]]:
    """Points of a line or ring as longitude and latitude."""
    return [[float(x), float(y)] for x, y in degrees(np.asarray(line.coords, np.float64)[:, :2])]

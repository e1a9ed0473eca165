"""Drivable area: field, lanes, gate and yard less fence, posts and no-go areas."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from configs.mission import EdgeMargin
from configs.site import Outline, Site
from geometry.polygon import grow, parts, polygon_of, shrink
from messages.errors import FieldError

GATE_DEPTH_M = 1.2  # maximum distance of a fence outside the field
LEAST_STRETCH_M = 0.1
FENCE_M = 0.001  # half the thickness of a fence, less than the slack of planning
POST_M = 0.1  # half the thickness of a gate post
PASSAGE_SLACK_M = 0.1  # of half the width, where a passage is narrower than the rig
PASSAGE_WIDTHS = 1.2  # of the rig: through a narrower passage it drives folded, or not at all
LEAST_REGION_SHARE = 0.01  # of the field: a smaller region is not worth folding the implement for


@dataclass(frozen=True)
class DrivableArea:
    """`field` as surveyed, `whole` less no-go areas, `free` less what larger margins add, `inner` less the margin.

    `allowed` is `inner` with lanes, gate and yard.
    """

    site: Site
    margin_m: float
    field: Polygon
    whole: BaseGeometry
    free: BaseGeometry
    inner: BaseGeometry
    allowed: BaseGeometry
    fence: BaseGeometry


def drivable_area_of(
    site: Site, margin_m: float, edges: Sequence[EdgeMargin] = (), slack_m: float = 0.0
) -> DrivableArea:
    """Drivable area of a site with `margin_m` to every edge, or that of `edges`, and `slack_m`; raises FieldError."""
    margin_m, more_m = margin_m + slack_m, margin_m
    field = _area(site.boundary_m, f"field of site {site.name!r}")
    excluded = [_area(a.outline_m, f"no-go area {a.name!r}") for a in site.no_go]
    if site.shed is not None:
        excluded.append(_area(site.shed.outline_m, "shed"))
    no_go = shapely.union_all(excluded)
    lanes = [
        LineString(lane.center_m).buffer(lane.width_m / 2.0, cap_style="flat", join_style="mitre")
        for lane in site.lanes
    ]
    fence = field.exterior.difference(_openings(site, lanes))
    whole = field.difference(no_go)
    wide = kept_off(field, edges, more_m)
    free = whole if wide.is_empty else whole.difference(wide)
    connector = shapely.union_all([free, *lanes, _area(site.yard.outline_m, "yard")]).difference(no_go)
    posts = shapely.MultiPoint([p for gate in site.gates for p in gate.posts_m]).buffer(POST_M + margin_m)
    allowed = shrink(connector, margin_m).difference(fence.buffer(max(margin_m, FENCE_M))).difference(posts)
    inner = shrink(free, margin_m).difference(posts)
    return DrivableArea(site, margin_m, field, whole, free, polygon_of(inner), polygon_of(allowed), fence)


def kept_off(field: Polygon, edges: Sequence[EdgeMargin], margin_m: float) -> BaseGeometry:
    """What the larger margins of `edges` add to one of `margin_m`; raises FieldError for one without length."""
    wide = [_stretch(field, e).buffer(e.margin_m - margin_m, quad_segs=16) for e in edges if e.margin_m > margin_m]
    return shapely.union_all(wide).intersection(field)


def _stretch(field: Polygon, edge: EdgeMargin) -> LineString:
    """Part of the outline to which a margin belongs; raises FieldError for one without length."""
    ring = field.exterior
    first, last = sorted(ring.project(Point(p)) for p in (edge.from_m, edge.to_m))
    if last - first > 0.5 * ring.length:  # over the end of the ring
        parts_m = [substring(ring, last, ring.length), substring(ring, 0.0, first)]
        points = [p for part in parts_m for p in part.coords]
    else:
        points = list(substring(ring, first, last).coords)
    line = LineString(points) if len(points) > 1 else LineString()
    if not line.length > LEAST_STRETCH_M:
        raise FieldError(
            f"margin {edge.reason!r}: from {edge.from_m} and to {edge.to_m} are at the same place of the outline"
        )
    return line


def regions_of(drivable: DrivableArea, width_m: float, transport_m: float) -> list[DrivableArea]:
    """The area with `free` reduced to each region that passages hardly wider than a rig `width_m` wide separate.

    The first one is that of the start; further ones are larger than `LEAST_REGION_SHARE` of the field. Passages and
    smaller regions belong to a region next to them, and what a rig `transport_m` wide does not reach belongs to none.
    """
    site = drivable.site
    start = Point(site.lanes[-1].center_m[-1] if site.lanes else (site.start.x_m, site.start.y_m))
    passage_m = PASSAGE_WIDTHS * width_m
    wide = wide_parts(drivable.inner, passage_m)
    if not wide:
        return [drivable]
    least_m2 = LEAST_REGION_SHARE * drivable.free.area
    first, *others = sorted(wide, key=lambda part: part.distance(start))
    passable = wide_parts(drivable.inner, transport_m)
    out_of_reach = shapely.union_all([part for part in passable if not part.intersects(first)])
    reached = (part for part in others if not part.intersects(out_of_reach))
    large = [first, *(part for part in reached if grow(part, passage_m / 2.0).area > least_m2)]
    near = [drivable.free.intersection(grow(part, passage_m / 2.0 + PASSAGE_SLACK_M)) for part in large]
    near.append(Polygon())  # what belongs to none
    for rest in parts(drivable.free.difference(shapely.union_all(near))):
        k = -1 if rest.intersects(out_of_reach) else int(np.argmin([rest.distance(area) for area in near[:-1]]))
        near[k] = shapely.union_all([near[k], rest])
    others_of = [shapely.union_all([*near[:k], *near[k + 1 :]]) for k in range(len(large))]
    return [replace(drivable, free=polygon_of(drivable.free.difference(other))) for other in others_of]


def wide_parts(area: BaseGeometry, width_m: float) -> list[Polygon]:
    """Where the middle of a rig `width_m` wide may be; no passage connects two of the parts."""
    return parts(shrink(area, width_m / 2.0 - PASSAGE_SLACK_M), 1.0)


def _openings(site: Site, lanes: list[Polygon]) -> BaseGeometry:
    gates = [LineString(g.posts_m).buffer(GATE_DEPTH_M, cap_style="flat") for g in site.gates]
    return shapely.union_all(gates if site.is_fenced else [*gates, *lanes])


def _area(outline: Outline, name: str) -> Polygon:
    polygon = Polygon(outline)
    if not polygon.is_valid or polygon.area <= 0.0:
        raise FieldError(f"{name}: {shapely.is_valid_reason(polygon)}; draw its outline without crossings")
    return polygon


def describe(site: Site, x_m: float, y_m: float) -> str:
    """Text of a position: map coordinates, latitude and longitude."""
    lat, lon, _ = site.datum.datum.to_ellipsoid(x_m, y_m, 0.0)
    return f"x {x_m:.1f} m, y {y_m:.1f} m (latitude {math.degrees(lat):.6f}, longitude {math.degrees(lon):.6f})"

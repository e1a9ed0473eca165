"""Site of a bare field: gate, lane and yard outside its longest suitable edge, or a start within the field."""

import math
from collections.abc import Iterator

import numpy as np
import shapely
from shapely.affinity import rotate
from shapely.geometry import LinearRing, LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from configs.mission import Work
from configs.site import Area, Gate, Lane, Point, PoseConfig, Site
from configs.vehicle import Implement, Vehicle
from geometry.arrays import Float64
from geometry.polygon import as_polygon, grow, polygon_of, shrink
from messages.errors import FieldError
from planning.field.drivable_area import kept_off, wide_parts
from planning.field.field import FieldOutline

LANE_M = 25.0
STRAIGHT_M = 6.0  # of a drawn lane, before the gate
LEAST_STEP_M = 1.0  # between two points of it
IN_YARD_M = 4.0  # length of a lane there
INTO_FIELD_M = 6.0
GATE_SPARE_M = 1.6  # width beyond body and margins, both sides together
YARD_DEPTH_M = 24.0
START_M = 8.0  # of the start before the far side of the yard, at least
BEHIND_M = 1.0  # free behind the rig, beyond the margin
POSTS_OUT_M = 0.5  # distance of the fence outside the field edge
SPARE_M = 0.1  # at the start, beyond the margin to the edge
CENTRE_ERROR_M = 0.1
MOST_OFF_M, BESIDE_GATE = 25.0, 20  # along the outline from where a gate is chosen; points of it to either side
RECESS_M = 3.0  # by which the outline in a gate may be inside of its line
EDGE_SHARES = (0.5, 0.35, 0.65, 0.2, 0.8)
TURN_DEG = (15, 30, 45, 60, 75, 90)  # headings of the turn off an edge at which there is room


def site_of(outline: FieldOutline, vehicle: Vehicle, implement: Implement, work: Work) -> Site:
    """Site of a bare field: with a gate where an edge has room for it, else the machine starts within the field.

    It starts where it is furthest from all edges, parallel to the longest one. Raises FieldError when it has no place,
    and when a chosen gate has none.
    """
    if (site := site_around(outline, vehicle, implement, work)) is not None:
        return site
    if work.lane_m:
        (x, y), (u, v) = work.lane_m[0], work.lane_m[-1]
        raise FieldError(
            f"field {outline.name!r}: no room for gate, lane and yard from x {x:.1f}, y {y:.1f} to x {u:.1f}, "
            f"y {v:.1f}: lane and yard lie outside of the field and of no-go areas"
        )
    if work.gate_m is not None:
        x, y = work.gate_m
        raise FieldError(f"field {outline.name!r}: no room for gate and yard at the edge next to x {x:.1f}, y {y:.1f}")
    return _site_at_centre(outline, vehicle, implement, work) or site_within(outline, vehicle, implement, work)


def _site_at_centre(outline: FieldOutline, vehicle: Vehicle, implement: Implement, work: Work) -> Site | None:
    """Site without gate whose start is furthest from all edges, parallel to the longest one."""
    extent = _extent(vehicle, implement)
    room = _room(outline, extent[2], work)
    if room.is_empty:
        return None
    circle = shapely.maximum_inscribed_circle(polygon_of(room), CENTRE_ERROR_M)
    a, b = _edges(outline.polygon)[0]
    centre, along = np.array(circle.coords[0]), (b - a) / np.hypot(*(b - a))
    return _start_at(outline, centre, along, extent, room)


def _inner(outline: FieldOutline, work: Work) -> BaseGeometry:
    """The field less its margins and areas to keep out of."""
    wide_margins = kept_off(outline.polygon, work.margins, work.boundary_margin_m)
    free = outline.polygon.difference(shapely.union_all([wide_margins, *(area for _, area in outline.no_go)]))
    return shrink(free, work.boundary_margin_m + SPARE_M)


def _room(outline: FieldOutline, half_m: float, work: Work, is_largest: bool = True) -> BaseGeometry:
    """The field less the margins, without passages too narrow for a rig 2 `half_m` wide: the largest part, or all."""
    inner = _inner(outline, work)
    wide = wide_parts(inner, 2.0 * half_m)
    if len(wide) < 2:
        return inner
    kept = max(wide, key=lambda part: part.area) if is_largest else shapely.union_all(wide)
    return inner.intersection(grow(kept, half_m))


def site_around(outline: FieldOutline, vehicle: Vehicle, implement: Implement, work: Work) -> Site | None:
    """Site of a bare field with a gate, None when no edge has room for gate and yard."""
    widest = max(vehicle.body.width_m, implement.width_m)
    gate_m = widest + 2.0 * work.boundary_margin_m + GATE_SPARE_M
    rear_m, front_m, half_m = _extent(vehicle, implement)
    start_m = max(START_M, BEHIND_M + work.boundary_margin_m - rear_m)
    drawn = _from_the_field(outline.polygon, np.array(work.lane_m)) if work.lane_m else np.empty((0, 2))
    chosen_m = (float(drawn[0, 0]), float(drawn[0, 1])) if len(drawn) else work.gate_m
    inner, room = _inner(outline, work), _room(outline, half_m, work, is_largest=chosen_m is None)
    for middle, along in _gate_places(outline.polygon, chosen_m, gate_m):
        site = _site(outline, middle, along, gate_m, drawn, start_m, _depth_m(outline, work, middle, along))
        is_in = room.covers(shapely.Point(site.lanes[0].center_m[-1])) and inner.covers(_at_end(site, front_m, half_m))
        if is_in and _is_clear(site, outline.polygon) and not _meets_no_go(site, outline):
            return site
    return None


def _at_end(site: Site, front_m: float, half_m: float) -> Polygon:
    """Ground of a machine at the end of the lane of a site, from there to its front."""
    before, end = (np.array(p) for p in site.lanes[0].center_m[-2:])
    ahead = (end - before) / np.hypot(*(end - before))
    return as_polygon(LineString([end, end + front_m * ahead]).buffer(half_m, cap_style="flat"))


def _depth_m(outline: FieldOutline, work: Work, middle: Float64, along: Float64) -> float:
    """Distance from a point of an edge, straight inwards, at which the larger margins there end."""
    beyond = middle + outline.polygon.length * np.array([-along[1], along[0]])
    wide_margins = grow(kept_off(outline.polygon, work.margins, work.boundary_margin_m), SPARE_M)
    return float(LineString([middle, beyond]).difference(wide_margins).distance(shapely.Point(middle)))


def _from_the_field(polygon: Polygon, drawn_m: Float64) -> Float64:
    """Points (N, 2) of a lane in the order away from the field, whichever way they were drawn."""
    first, last = (polygon.exterior.distance(shapely.Point(drawn_m[k])) for k in (0, -1))
    return drawn_m if first <= last else drawn_m[::-1]


def _gate_places(
    polygon: Polygon, chosen_m: tuple[float, float] | None, gate_m: float
) -> Iterator[tuple[Float64, Float64]]:
    """Middles of a gate and directions of the outline there: on long edges, or along the outline from next to a point.

    Along the outline the direction is that of the chord over twice the width of the gate; that lies outside the field.
    """
    if chosen_m is None:
        for a, b in _edges(polygon):
            length = float(np.hypot(*(b - a)))
            yield from ((a + s * (b - a), (b - a) / length) for s in EDGE_SHARES if min(s, 1.0 - s) * length >= gate_m)
        return
    ring = orient(polygon, 1.0).exterior
    at_m, beside_m = ring.project(shapely.Point(chosen_m)), np.linspace(-gate_m, gate_m, 2 * BESIDE_GATE + 1)
    for by_m in sorted(np.arange(-MOST_OFF_M, MOST_OFF_M + 1.0), key=abs):
        points = shapely.get_coordinates(ring.interpolate((at_m + by_m + beside_m) % ring.length))
        along = (points[-1] - points[0]) / np.hypot(*(points[-1] - points[0]))
        away = np.array([along[1], -along[0]])
        from_middle = points - points[BESIDE_GATE]
        is_within = np.abs(from_middle @ along) < 0.5 * gate_m + POSTS_OUT_M
        yield points[BESIDE_GATE] + (from_middle[is_within] @ away).max() * away, along


def site_within(outline: FieldOutline, vehicle: Vehicle, implement: Implement, work: Work) -> Site:
    """Site of a bare field without gate: the start is along an edge, else furthest from all; raises FieldError.

    The edge is so far away that the tail stays inside when the machine turns off it. Edges come first beside which
    there is room for that turn: no step in the outline is ahead.
    """
    extent, radius_m = _extent(vehicle, implement), 1.0 / vehicle.drivetrain.max_curvature_radpm
    room, outer_m = _room(outline, extent[2], work), radius_m + extent[2]
    off_m = work.boundary_margin_m + SPARE_M + math.hypot(outer_m, extent[0]) - outer_m + extent[2]
    shapely.prepare(room)
    beside = list[Site]()
    for a, b in _edges(outline.polygon):
        along = (b - a) / np.hypot(*(b - a))
        out = np.array([along[1], -along[0]])
        for share in EDGE_SHARES:
            middle = a + share * (b - a) - off_m * out
            if (site := _start_at(outline, middle, along, extent, room)) is None:
                continue
            ground, centre = Polygon(site.yard.outline_m), middle - radius_m * out
            if all(room.covers(rotate(ground, angle, tuple(centre))) for angle in TURN_DEG):
                return site
            beside.append(site)
    if site := next(iter(beside), None) or _site_at_centre(outline, vehicle, implement, work):
        return site
    raise FieldError(f"field {outline.name!r}: no place for a machine {2.0 * extent[2]:.1f} m wide along any edge")


def _extent(vehicle: Vehicle, implement: Implement) -> tuple[float, float, float]:
    """Rear and front of the machine with its implement along x of `base`, and half the width."""
    rear = max(vehicle.body.rear_m, -implement.ends_m[1])
    return -rear, vehicle.body.front_m, 0.5 * max(vehicle.body.width_m, implement.width_m)


def _start_at(
    outline: FieldOutline, at: Float64, along: Float64, extent: tuple[float, float, float], room: BaseGeometry
) -> Site | None:
    """Site without gate whose start is at a point, heading along a unit vector; None when it leaves `room`."""
    (rear, front, half), left = extent, np.array([-along[1], along[0]])
    ends = [at + x * along + y * left for x, y in ((rear, -half), (front, -half), (front, half), (rear, half))]
    if not room.covers(Polygon(ends)):
        return None
    yard = Area(name="start", outline_m=tuple((round(float(x), 3), round(float(y), 3)) for x, y in ends))
    heading = math.degrees(math.atan2(along[1], along[0]))
    start = PoseConfig(x_m=round(float(at[0]), 3), y_m=round(float(at[1]), 3), heading_deg=heading)
    return _bare(outline, yard, start)


def _bare(outline: FieldOutline, yard: Area, start: PoseConfig) -> Site:
    return Site(
        name=outline.name, version=1, datum=outline.datum, boundary_m=_points(outline.polygon.exterior),
        no_go=_no_go(outline, outline.polygon), yard=yard, start=start, is_fenced=False,
    )  # fmt: skip


def site_of_original(site: Site, outline: FieldOutline) -> Site:
    """The site with the outline of the field as in its file, before simplification."""
    if outline.original is None:
        return site
    boundary = _points(outline.original.exterior)
    return site.model_copy(update={"boundary_m": boundary, "no_go": _no_go(outline, outline.original)})


def _no_go(outline: FieldOutline, polygon: Polygon) -> tuple[Area, ...]:
    """Holes of the polygon, and the further areas to keep out of."""
    holes = (Area(name=f"no-go area {k + 1}", outline_m=_points(r)) for k, r in enumerate(polygon.interiors))
    return (*holes, *(Area(name=name, outline_m=_points(area.exterior)) for name, area in outline.no_go))


def _points(ring: LinearRing) -> tuple[Point, ...]:
    return tuple((float(x), float(y)) for x, y in ring.coords[:-1])


def _edges(polygon: Polygon) -> list[tuple[Float64, Float64]]:
    """Edges of the outline, counter-clockwise, nearly collinear ones merged, longest first."""
    plain = orient(as_polygon(polygon.simplify(0.05)), 1.0)
    points = np.asarray(plain.exterior.coords)[:, :2]
    edges = [(points[k], points[k + 1]) for k in range(len(points) - 1)]
    return sorted(edges, key=lambda e: (-round(float(np.hypot(*(e[1] - e[0]))), 3), float(e[0][0]), float(e[0][1])))


def _site(
    outline: FieldOutline, middle: Float64, along: Float64, gate_m: float, drawn_m: Float64, start_m: float,
    depth_m: float,
) -> Site:  # fmt: skip
    """Site with a gate at the middle of an edge, and a straight lane or a drawn one (N, 2), away from the field.

    The start is `start_m` before the far side of the yard; the lane ends within the field beyond a margin of `depth_m`.
    """
    out = np.array([along[1], -along[0]])  # the field is left of its edge

    def at(origin: Float64, sideways: float, aside: Float64, outwards: float, ahead: Float64) -> Point:
        x, y = origin + sideways * aside + outwards * ahead
        return round(float(x), 3), round(float(y), 3)

    def post(sideways: float) -> Point:
        return at(middle, sideways, along, POSTS_OUT_M, out)

    lane, end, ahead = _lane(middle, out, drawn_m)
    aside = np.array([-ahead[1], ahead[0]])
    half, wide, near = gate_m / 2.0, gate_m / 2.0 + 6.0, -IN_YARD_M
    far = near + YARD_DEPTH_M
    start = at(end, 0.0, aside, far - start_m, ahead)
    corners = ((-wide, near), (-wide, far), (wide, far), (wide, near))
    points = [at(point, 0.0, along, 0.0, out) for point in (*lane[::-1], middle - (depth_m + INTO_FIELD_M) * out)]
    return Site(
        name=outline.name,
        version=1,
        datum=outline.datum,
        boundary_m=_points(outline.polygon.exterior),
        no_go=_no_go(outline, outline.polygon),
        lanes=(Lane(name="lane", center_m=tuple(points), width_m=gate_m),),
        gates=(Gate(name="gate", posts_m=(post(-half), post(half))),),
        yard=Area(name="yard", outline_m=tuple(at(end, s, aside, o, ahead) for s, o in corners)),
        start=PoseConfig(x_m=start[0], y_m=start[1], heading_deg=math.degrees(math.atan2(-ahead[1], -ahead[0]))),
        is_fenced=False,
    )


def _lane(middle: Float64, out: Float64, drawn_m: Float64) -> tuple[list[Float64], Float64, Float64]:
    """Points of a lane away from the gate, its end, and the direction there; it is straight before the gate."""
    if len(drawn_m) == 0:
        end = middle + (LANE_M + IN_YARD_M) * out
        return [end], end, out
    lane = [middle + STRAIGHT_M * out]
    for point in drawn_m:
        is_beyond = len(lane) > 1 or (point - middle) @ out > STRAIGHT_M + LEAST_STEP_M
        if is_beyond and np.hypot(*(point - lane[-1])) >= LEAST_STEP_M:
            lane.append(point)
    before = middle if len(lane) == 1 else lane[-2]
    return lane, lane[-1], (lane[-1] - before) / np.hypot(*(lane[-1] - before))


def _meets_no_go(site: Site, outline: FieldOutline) -> bool:
    """True if lane or yard meet an area to keep out of that is no hole of the field."""
    lane = LineString(site.lanes[0].center_m).buffer(site.lanes[0].width_m / 2.0, cap_style="flat")
    used = shapely.union_all([lane, Polygon(site.yard.outline_m)])
    return any(bool(area.intersects(used)) for _, area in outline.no_go)


def _is_clear(site: Site, field: Polygon) -> bool:
    """True if lane and yard are outside the field, except the end of the lane, which is inside."""
    full = Polygon(field.exterior)
    *others, end = (np.array(p) for p in site.lanes[0].center_m)
    inwards = (end - others[-1]) / np.hypot(*(end - others[-1]))
    edge = np.mean(site.gates[0].posts_m, axis=0) + POSTS_OUT_M * inwards
    outside = LineString([*others, edge - inwards * 0.5])
    corridor = outside.buffer(site.lanes[0].width_m / 2.0, cap_style="flat")
    inside = LineString([edge + RECESS_M * inwards, end]).buffer(site.lanes[0].width_m / 2.0 - 0.05, cap_style="flat")
    beyond = shapely.union_all([corridor, Polygon(site.yard.outline_m)])
    return not beyond.intersects(full) and bool(field.buffer(0.5).covers(inside))

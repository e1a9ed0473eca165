"""Complete route as pieces: from the yard along the lane, headland passes, swaths, and back.

Regions behind narrow passages are worked first: the rig drives there folded, and back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from configs.mission import Work
from geometry.arrays import Float64
from geometry.footprint import is_inside
from geometry.polygon import parts, united
from geometry.polyline import arc_length, curvatures, headings, polyline, resample, smooth
from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.coverage.headland import HeadlandPass, pass_coverage
from planning.coverage.insertion import Stop, Tour, inserted
from planning.coverage.interior import AnySwath, area_worked, fill_bare, wide_bare
from planning.coverage.line_route import drive_lines
from planning.coverage.pass_route import drive_passes, opened, places_on, turn_pieces
from planning.coverage.refill import RefillCut, refill_spots, with_refills
from planning.coverage.remains import worth_of
from planning.coverage.swath import directions_of
from planning.coverage.swath_order import is_ordered
from planning.coverage.work_line import WorkLine, lines_of
from planning.field.drivable_area import describe
from planning.rig import Rig
from planning.turns.connector import PathConnector, RoutePiece
from planning.turns.free_space import FreeSpace
from planning.turns.search import STEP_M, Connection, Leg, straight
from planning.turns.transport import TransportWays

CENTRE_ERROR_M = 0.1
LEAST_RADIUS_SHARE = 0.95  # of the radius of the rig, in corners of a lane: a fillet in steps is 1 % sharper
PLACES = 4  # of a headland pass to which the swaths before it may lead
MIN_VISITED_M = 4.0  # line that the folded rig is driven to
FILLINGS = 3  # times that what a tour leaves bare gets swaths, at most


@dataclass(frozen=True)
class Region:
    """What the rig works without folding: connections, with the headland passes, and swaths."""

    connector: PathConnector
    swaths: Sequence[AnySwath]


@dataclass(frozen=True)
class Route:
    """All pieces in order, with the swaths and headland passes that they work.

    `moved`: number of swaths that are not worked in the order of the mission.
    """

    pieces: list[RoutePiece]
    swaths: list[AnySwath]
    headland_passes: list[HeadlandPass]
    moved: int = 0
    refills: Sequence[RefillCut] = ()

    def area(self, rig: Rig) -> BaseGeometry:
        """Area that swaths and passes work."""
        passes = (pass_coverage(p, rig) for p in self.headland_passes)
        return united([*passes, *(area_worked(s, rig) for s in self.swaths)])


def route(regions: Sequence[Region], transport: FreeSpace, work: Work) -> Route:
    """Complete route, the start is in the first region; raises FieldError where no connection is found.

    `transport` is the free space of the folded rig.
    """
    connector = regions[0].connector
    spots = [] if work.refill is None else refill_spots(connector, work.refill)
    lane = lane_leg(connector) if connector.drivable.site.lanes else None
    entry, pose = _entry(connector, lane)
    ways, visits = TransportWays(pose, transport, connector.rig.turn_times), list[Route]()
    for region in regions[1:]:
        visits.append(_visit(region, ways, work, _free_number(regions, visits)))
    home = None if lane is None else _reversed_end(lane)
    tour, found = _worked(regions[0], pose, home, work, _free_number(regions, visits))
    if connector.rig.trailer is None:
        visits += _visits_to_lines(regions, ways, work, [*visits, found])
    routes = [*visits, found]
    worked = [*_joined(visits, ways), *found.pieces]
    if not worked:
        return Route([], [], [])
    back = [] if lane is None else _return(connector, tour, lane)
    pieces, cuts = [*entry, *worked, *back], list[RefillCut]()
    if work.refill is not None:
        pieces, cuts = with_refills(pieces, [region.connector for region in regions], work.refill, spots)
    return Route(
        pieces, [s for one in routes for s in one.swaths], [p for one in routes for p in one.headland_passes],
        sum(one.moved for one in routes), cuts,
    )  # fmt: skip


def _free_number(regions: Sequence[Region], routes: Sequence[Route]) -> int:
    """Number from which swaths have none."""
    planned = sum(len(region.swaths) for region in regions)
    return max([planned, *(s.number + 1 for one in routes for s in one.swaths)])


def _worked(region: Region, start: Pose2, home: Pose2 | None, work: Work, number: int) -> tuple[Tour, Route]:
    """Tour of a region after its passes, or what is driven after them, and all pieces.

    Further swaths are numbered from `number`. Without headland work the passes are only ways along the edge.
    """
    connector = region.connector
    if work.headland == "last":
        return _worked_last(region, start, home, work, number)
    if work.headland == "none":
        tour = drive_lines(connector, start, home, lines_of(region.swaths, (), -connector.rig.working_x_m), work)
        return _filled_route(connector, home, tour, work, [], number)
    lines, rings = _lines(connector, region.swaths, []), [p for p in connector.headland_passes if p.is_closed]
    goals = [e[0] for line in lines for r in (False, True) if (e := line.ends(r))]
    headland = drive_passes(connector, start, goals if home is None else [*goals, home], rings)
    if home is None and not headland.pieces:
        headland = drive_passes(connector, start, None, rings)  # nothing else is reached: the last may end anywhere
    if headland.missed and is_ordered(work):
        tour, onto = _drive_to(connector, headland.end, lines, headland.missed, home, work)
        tour, found = _filled_route(connector, onto, tour, work, rings, number)
        tour, found = _passes_after(connector, tour, found, headland.missed, home, work)
        return tour, replace(found, pieces=[*headland.pieces, *found.pieces])
    tour = drive_lines(connector, headland.end, home, _lines(connector, region.swaths, headland.missed), work)
    closed = [p for p in rings if not any(p is m for m in headland.missed)]
    tour, found = _filled_route(connector, home, tour, work, closed, number)
    return tour, replace(found, pieces=[*headland.pieces, *found.pieces])


def _worked_last(region: Region, start: Pose2, home: Pose2 | None, work: Work, number: int) -> tuple[Tour, Route]:
    """Swaths, then the closed passes, then the open ones and those that were not reached; the last tour."""
    connector, passes = region.connector, region.connector.headland_passes
    lines = [line for line in _lines(connector, region.swaths, []) if not isinstance(line.source, HeadlandPass)]
    tour, onto = _drive_to(connector, start, lines, passes, home, work)
    tour, found = _filled_route(connector, onto, tour, work, passes, number)
    return _passes_after(connector, tour, found, passes, home, work)


def _passes_after(
    connector: PathConnector, tour: Tour, found: Route, passes: Sequence[HeadlandPass], home: Pose2 | None, work: Work
) -> tuple[Tour, Route]:
    """Closed passes after a tour, then the open ones and those that were not reached; the last tour."""
    rings, others = [p for p in passes if p.is_closed], [p for p in passes if not p.is_closed]
    headland = drive_passes(connector, tour.place(len(tour.stops))[0], None if home is None else [home], rings)
    left = lines_of((), [*others, *(opened(ring, connector, [headland.end]) for ring in headland.missed)], 0.0)
    after = drive_lines(connector, headland.end, home, left, work)
    bare = [*others, *headland.missed]
    worked = [p for p in found.headland_passes if not any(p is b for b in bare)]
    late = [s.line.source for s in after.stops if isinstance(s.line.source, HeadlandPass)]
    pieces = [*found.pieces, *headland.pieces, *after.pieces]
    return after, Route(pieces, found.swaths, [*worked, *late], found.moved)


def _drive_to(
    connector: PathConnector, start: Pose2, lines: Sequence[WorkLine], passes: Sequence[HeadlandPass],
    home: Pose2 | None, work: Work,
) -> tuple[Tour, Pose2 | None]:  # fmt: skip
    """A tour over lines from whose end a pass is reached, and where.

    It is the one that ends anywhere, up to the last line from which a pass is reached, or one to that pass if that has
    more lines.
    """
    free = drive_lines(connector, start, None, lines, work)
    places = ((count, free.place(count)[0]) for count in range(len(free.stops), -1, -1))
    found = ((count, onto) for count, end in places if (onto := _reached_pass(connector, passes, end)) is not None)
    count, onto = next(found, (0, home))
    if count == len(free.stops):
        return free, onto
    tours = replace(free, stops=free.stops[:count]), drive_lines(connector, start, onto, lines, work)
    return max(tours, key=lambda tour: len(tour.stops)), onto


def _reached_pass(connector: PathConnector, passes: Sequence[HeadlandPass], end: Pose2) -> Pose2 | None:
    """Where a pass begins to which a turn leads from a pose, else a way along the passes to one of the nearest."""
    requests = [connector.request(end, pose) for pose in _beginnings(connector, passes, end)]
    near = sorted(requests, key=lambda r: round(math.hypot(r.goal.x_m - end.x_m, r.goal.y_m - end.y_m), 3))
    reached = next((r for r in requests if connector.turn(r) is not None), None)
    reached = reached or next((r for r in near[:PLACES] if connector.along(r) is not None), None)
    return None if reached is None else reached.goal


def _beginnings(connector: PathConnector, passes: Sequence[HeadlandPass], near: Pose2) -> list[Pose2]:
    """Poses where drives over passes may begin, those of the innermost first, of each the nearest to a place first."""
    found = list[Pose2]()
    for one in reversed(passes):
        if one.is_closed:
            found += places_on(one, connector.rig.radius_m, near)[:PLACES]
        else:
            (line,) = lines_of((), [one], 0.0)
            found += [ends[0] for is_reversed in (False, True) if (ends := line.ends(is_reversed)) is not None]
    return found


def _filled_route(
    connector: PathConnector, home: Pose2 | None, tour: Tour, work: Work, closed: Sequence[HeadlandPass], number: int
) -> tuple[Tour, Route]:
    """A tour, with reversing with swaths over what it and the closed passes leave bare, and its route."""
    if connector.rig.has_reverse:
        rig, around = connector.rig, united([pass_coverage(p, connector.rig) for p in closed])
        for _ in range(FILLINGS):
            legs = [stop.leg for stop in tour.stops]
            filled = _Filled(connector, home, tour, number)
            fill_bare(connector.drivable, rig, work, connector.space, around, legs, filled.insert)
            if len(filled.tour.stops) == len(tour.stops):
                break
            tour, number = filled.tour, filled.number
    return tour, _route_of(tour, tour.pieces, closed)


def _route_of(tour: Tour, pieces: list[RoutePiece], closed: Sequence[HeadlandPass] = ()) -> Route:
    """Route with the pieces of a tour and closed passes."""
    sources = [stop.line.source for stop in tour.stops]
    passes = [*closed, *(s for s in sources if isinstance(s, HeadlandPass))]
    return Route(pieces, [s for s in sources if isinstance(s, AnySwath)], passes, tour.moved)


@dataclass
class _Filled:
    """A tour into which swaths are put; they are numbered from `number`."""

    connector: PathConnector
    home: Pose2 | None
    tour: Tour
    number: int

    def insert(self, swaths: Sequence[AnySwath], most_s: float) -> bool:
        """Puts swaths into the tour to which turns are found that take at most some time; returns whether any."""
        numbered = [replace(s, number=self.number + k) for k, s in enumerate(swaths)]
        lines = lines_of(numbered, (), -self.connector.rig.working_x_m)
        tour = inserted(self.connector, self.tour, self.home, lines)
        if len(tour.stops) == len(self.tour.stops) or tour.turns_s > self.tour.turns_s + most_s:
            return False
        self.tour, self.number = tour, self.number + len(swaths)
        return True


def _visit(region: Region, ways: TransportWays, work: Work, number: int) -> Route:
    """Folded to a pose of a region, its work from there to there, and folded back; empty where it is not reached."""
    connector, pose = region.connector, _room(region.connector)
    there, back = (None, None) if pose is None else (ways.to(pose), ways.back(pose))
    if pose is None or there is None or back is None:
        return Route([], [], [])
    tour, found = _worked(region, pose, pose, work, number)
    last, behind_m = tour.place(len(tour.stops))
    end = connector.find(connector.home_request(last, pose, behind_m))
    if end is None:
        return Route([], [], [])
    pieces = [*_transport_pieces(there), *found.pieces, *turn_pieces(end, -1), *_transport_pieces(back)]
    return replace(found, pieces=pieces)


def _visits_to_lines(
    regions: Sequence[Region], ways: TransportWays, work: Work, routes: Sequence[Route]
) -> list[Route]:
    """Folded to lines that `routes` do not work, longest first, and back from where each leads.

    With reversing also to swaths over the wide parts that then are bare.
    """
    driven = {id(line) for one in routes for line in (*one.swaths, *one.headland_passes)}
    visits = _Visits(regions[0].connector, ways, _free_number(regions, routes))
    for region in regions:
        lines = _lines(region.connector, region.swaths, [])
        visits.add([line for line in lines if id(line.source) not in driven])
    rig, space, drivable = visits.connector.rig, visits.connector.space, visits.connector.drivable
    if rig.has_reverse:
        whole = replace(drivable, free=united([r.connector.drivable.free for r in regions]))
        covered = united([one.area(rig) for one in (*routes, *visits.routes)])
        if parts(wide_bare(whole, rig, covered), worth_of(rig, False).least_m2):
            fill_bare(whole, rig, work, space, covered, (), visits.insert)
    return visits.routes


@dataclass
class _Visits:
    """Routes to lines of a region and back, driven folded from line to line; swaths are numbered from `number`."""

    connector: PathConnector
    ways: TransportWays
    number: int
    routes: list[Route] = field(default_factory=list)

    def insert(self, swaths: Sequence[AnySwath], most_s: float) -> bool:
        """Adds visits to swaths that are each reached in at most some time; returns whether to any."""
        numbered, before = [replace(s, number=self.number + k) for k, s in enumerate(swaths)], len(self.routes)
        self.add(lines_of(numbered, (), -self.connector.rig.working_x_m), most_s)
        self.number += len(swaths)
        return len(self.routes) > before

    def add(self, lines: Sequence[WorkLine], most_s: float = math.inf) -> None:
        """Adds visits to those of the lines that are each reached in at most some time, longest first."""
        left = sorted((line for line in lines if line.length_m > MIN_VISITED_M), key=lambda line: -line.length_m)
        while left:
            line, *others = left
            visit = _visit_to_line(self.connector, self.ways, line, others, most_s)
            worked = () if visit is None else (*visit.swaths, *visit.headland_passes)
            left = [other for other in others if not any(other.source is w for w in worked)]
            self.routes += [] if visit is None else [visit]


def _visit_to_line(
    connector: PathConnector, ways: TransportWays, line: WorkLine, others: Sequence[WorkLine], most_s: float
) -> Route | None:
    """Folded to the start of a line, over it and those of the others to which it leads, and folded back.

    None where it is not reached, or where the folded ways take more than some time, or than the line is worth.
    """
    rig = connector.rig
    most_s = min(most_s, worth_of(rig, False).most_s_per_m2 * rig.working_width_m * line.length_m)
    for is_reversed in (False, True):
        ends = line.ends(is_reversed)
        there = None if ends is None else ways.to(ends[0])
        if ends is None or there is None:
            continue
        tour = inserted(connector, Tour(ends[0], [Stop(line, is_reversed, Connection((), 0.0))]), None, others)
        back = ways.back(tour.place(len(tour.stops))[0])
        if back is not None and ways.time_s((*there, *back)) < most_s:
            return _route_of(tour, [*_transport_pieces(there), *tour.pieces, *_transport_pieces(back)])
    return None


def _joined(visits: Sequence[Route], ways: TransportWays) -> list[RoutePiece]:
    """Pieces of visits; from one to the next by a turn of the folded rig where that is faster than by the hub."""
    pieces = list[RoutePiece]()
    for visit in (v for v in visits if v.pieces):
        first = next(k for k, piece in enumerate(visit.pieces) if not piece.is_transport)
        end = max((k + 1 for k, piece in enumerate(pieces) if not piece.is_transport), default=0)
        turn = ways.turn(pieces[end - 1].leg.pose(-1), visit.pieces[first].leg.pose(0)) if pieces else None
        by_hub = [piece.leg for piece in (*pieces[end:], *visit.pieces[:first])]
        if turn is not None and turn.time_s < ways.time_s(by_hub):
            pieces = [*pieces[:end], *_transport_pieces(turn.legs), *visit.pieces[first:]]
        else:
            pieces += visit.pieces
    return pieces


def _transport_pieces(way: Sequence[Leg]) -> list[RoutePiece]:
    return [RoutePiece(PathSectionType.TURN, -1, leg, False, True) for leg in way]


def _room(connector: PathConnector) -> Pose2 | None:
    """Pose furthest from the edges of a region, along one of its longest edges, where the rig is free."""
    part = max(parts(connector.drivable.free), key=lambda p: p.area)
    x, y = map(float, shapely.maximum_inscribed_circle(part, CENTRE_ERROR_M).coords[0])
    poses = (Pose2(x, y, angle + turn) for angle in directions_of(part) for turn in (0.0, math.pi))
    return next((p for p in poses if connector.space.is_free(np.array([p[:2]]), np.array([p.yaw_rad]))), None)


def _lines(connector: PathConnector, swaths: Sequence[AnySwath], missed: Sequence[HeadlandPass]) -> list[WorkLine]:
    """Swaths, open passes, and those of the closed passes that were not reached before."""
    passes, lead_m = [p for p in connector.headland_passes if not p.is_closed], -connector.rig.working_x_m
    lines = lines_of(swaths, passes, lead_m)
    ends = [e[1] for line in lines for r in (False, True) if (e := line.ends(r)) is not None]
    lines = [*lines, *lines_of((), [opened(ring, connector, ends) for ring in missed], lead_m)]
    for leg in (leg for line in lines for leg in line.legs if leg is not None):
        connector.follow(leg)
    return lines


def _entry(connector: PathConnector, lane: Leg | None) -> tuple[list[RoutePiece], Pose2]:
    """From the start along the lane into the field; without a lane the machine starts in the field."""
    start = connector.drivable.site.start.pose
    if lane is None:
        if not connector.drivable.field.contains(Point(start.x_m, start.y_m)):
            where = describe(connector.drivable.site, start.x_m, start.y_m)
            raise FieldError(f"the site has no lane, and its start at {where} is not within the field: draw a lane")
        return [], start
    _check_lane(connector, lane)
    first, last = (lane.pose(k) for k in (0, -1))
    connection = connector.require(connector.start_request(start, first), "out of the yard")
    connector.follow(lane)
    pieces = [RoutePiece(PathSectionType.LANE, -1, leg, False) for leg in connection.legs]
    return [*pieces, RoutePiece(PathSectionType.LANE, -1, lane, False)], last


def _return(connector: PathConnector, tour: Tour, lane: Leg) -> list[RoutePiece]:
    """Back to the lane, along it, and straight on to where the rig stands in the yard."""
    home = _reversed_end(lane)
    end, behind_m = tour.place(len(tour.stops))
    pieces = turn_pieces(connector.require(connector.home_request(end, home, behind_m), "back to the lane"), -1)
    last = lane.back.pose(-1)
    parking = straight(last, _parking(connector, last))
    return [*pieces, *(RoutePiece(PathSectionType.LANE, -1, leg, False) for leg in (lane.back, parking))]


def _check_lane(connector: PathConnector, lane: Leg) -> None:
    """Raises FieldError for a lane on which the rig does not fit, or which turns more sharply than it can."""
    k, radius_m = int(np.argmax(np.abs(lane.curvature_radpm))), connector.rig.radius_m
    sharpest_m = 1.0 / max(abs(float(lane.curvature_radpm[k])), 1e-9)
    if sharpest_m < LEAST_RADIUS_SHARE * radius_m:
        where = describe(connector.drivable.site, *map(float, lane.p_map_m[k]))
        raise FieldError(
            f"the lane turns with a radius of {sharpest_m:.1f} m at {where}, the rig needs {radius_m:.1f} m: "
            "draw its corners further apart or less sharp"
        )
    drivable, (x, y) = connector.drivable, map(float, lane.p_map_m[-1])
    if drivable.whole.contains(Point(x, y)) and not drivable.free.contains(Point(x, y)):
        raise FieldError(
            f"the lane ends at {describe(drivable.site, x, y)}, within a margin along the outline: draw it further "
            "into the field, or set a smaller margin there"
        )
    for leg in (lane, lane.back):
        outside = connector.space.touching(leg.p_map_m, leg.heading_rad)
        if outside.any():
            where = describe(connector.drivable.site, *map(float, leg.p_map_m[int(np.argmax(outside))]))
            more = "" if connector.rig.trailer is None else ", or draw wider bends: the trailed implement cuts them"
            raise FieldError(
                f"a rig {connector.rig.width_m:g} m wide does not fit on the lane at {where}: widen gate or lane{more}"
            )


def lane_leg(connector: PathConnector) -> Leg:
    """Centre line of all lanes in order, with corners rounded."""
    points = fillet(
        polyline([p for lane in connector.drivable.site.lanes for p in lane.center_m]), connector.rig.radius_m
    )
    p = resample(smooth(points, connector.rig.config.smoothing_m), STEP_M)
    heading = headings(p)
    return Leg(1, p, heading, curvatures(heading, arc_length(p)))


def fillet(points_m: Float64, radius_m: float) -> Float64:
    """The polyline with its corners replaced by arcs of `radius_m` (smaller where an edge is too short)."""
    out = [points_m[:1]]
    for a, b, c in zip(points_m[:-2], points_m[1:-1], points_m[2:], strict=True):
        u, v = (b - a) / np.hypot(*(b - a)), (c - b) / np.hypot(*(c - b))
        turn = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))
        tangent = min(
            radius_m * abs(np.tan(turn / 2.0)), 0.5 * float(np.hypot(*(b - a))), 0.5 * float(np.hypot(*(c - b)))
        )
        share = np.linspace(0.0, 1.0, max(2, int(abs(turn) * radius_m / STEP_M)))[:, None]
        p0, p2 = b - tangent * u, b + tangent * v
        normal = np.array([-u[1], u[0]]) * np.sign(turn)
        r = tangent / max(abs(np.tan(turn / 2.0)), 1e-9)
        angle = share[:, 0] * abs(turn)
        arc = p0 + r * (np.sin(angle)[:, None] * u + (1.0 - np.cos(angle))[:, None] * normal)
        out.append(arc if abs(turn) > 1e-6 else np.vstack([p0, p2]))
    out.append(points_m[-1:])
    return resample(np.vstack(out), STEP_M)


def _parking(connector: PathConnector, lane_end: Pose2) -> Pose2:
    """First pose straight on from the lane where the rig is within the yard; raises FieldError."""
    yard = Polygon(connector.drivable.site.yard.outline_m)
    for ahead in np.arange(0.5, 40.0, 0.5):
        pose = lane_end.ahead(float(ahead))
        p, h = np.array([[pose.x_m, pose.y_m]]), np.array([pose.yaw_rad])
        if is_inside(connector.rig.straight_bodies, p, h, yard)[0] and connector.space.is_free(p, h):
            return pose
    where = describe(connector.drivable.site, lane_end.x_m, lane_end.y_m)
    raise FieldError(
        f"the rig cannot stand in the yard straight on from the lane's end at {where}: make the yard deeper"
    )


def _reversed_end(lane: Leg) -> Pose2:
    """Pose at the field end of the lane, heading back."""
    last = lane.pose(-1)
    return Pose2(last.x_m, last.y_m, last.yaw_rad + np.pi)

"""Ways to a refill place and back, put into a route where the worked area is used up."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, islice

import numpy as np
from shapely.geometry import LinearRing, Point, Polygon

from configs.mission import Refill
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.coverage.pass_route import turn_pieces
from planning.field.drivable_area import describe
from planning.turns.connector import PathConnector, RoutePiece
from planning.turns.search import Connection, Leg, straight

NEAR_M = 30.0  # from the point that the mission names to the outline and to the place
STRAIGHT_M = 4.0  # before and behind the place, forwards
STRIDE, STEP_M = 20, 2.0  # between two poses: points of a pass, and along the edge without one
OFF_EDGE_M = (0.1, 1.0, 2.5)  # beside an edge without headland passes, beyond the margin
SPOTS = 3  # nearest ones of each headland pass to which ways are searched


@dataclass(frozen=True)
class RefillCut:
    """Pieces of a route up to a refill place, the pose there, and the area worked since the last one."""

    pieces: int
    place: Pose2
    worked_m2: float


@dataclass(frozen=True)
class _Work:
    """Pieces `first` to `last` of a route over one line, and what they work."""

    first: int
    last: int
    area_m2: float


def with_refills(
    pieces: Sequence[RoutePiece], connectors: Sequence[PathConnector], refill: Refill, spots: Sequence[Sequence[Pose2]]
) -> tuple[list[RoutePiece], list[RefillCut]]:
    """The route with a way to the refill place between two lines before more than `every_m2` has been worked.

    `spots` are those of `refill_spots`. Raises FieldError for a place that is not reached, and an area that one line
    exceeds.
    """
    works = _works(pieces, connectors[0].rig.working_width_m)
    for work in works:
        if work.area_m2 > refill.every_m2:
            piece = pieces[work.first]
            name = "headland pass" if piece.section_type is PathSectionType.HEADLAND else "swath"
            raise FieldError(
                f"refill: {name} {piece.line} alone works {work.area_m2:.0f} m², more than every_m2 "
                f"{refill.every_m2:g}: set a larger area"
            )
    out, cuts = list[RoutePiece](), list[RefillCut]()
    since, first, copied = 0.0, 0, 0  # area and line since the last refill, pieces taken over
    for n, work in enumerate(works):
        while since + work.area_m2 > refill.every_m2:
            at, (there, back, k, m) = _cut(pieces, works, first, n, connectors, refill, spots)
            gap = works[at - 1].last + 1
            out += [*pieces[copied : gap + k], *there]
            worked_m2 = sum(w.area_m2 for w in works[first:at])
            cuts.append(RefillCut(len(out), there[-1].leg.pose(-1), worked_m2))
            out += back
            copied, first, since = gap + m, at, sum(w.area_m2 for w in works[at:n])
        since += work.area_m2
    return [*out, *pieces[copied:]], cuts


def _works(pieces: Sequence[RoutePiece], width_m: float) -> list[_Work]:
    found = list[_Work]()
    for k, piece in enumerate(pieces):
        if piece.is_working:
            area_m2 = width_m * float(np.hypot(*np.diff(piece.leg.p_map_m, axis=0).T).sum())
            is_same = piece.continues and bool(found)
            before = found.pop() if is_same else _Work(k, k, 0.0)
            found.append(_Work(before.first, k, before.area_m2 + area_m2))
    return found


_Ways = tuple[list[RoutePiece], list[RoutePiece], int, int]


def _cut(
    pieces: Sequence[RoutePiece], works: Sequence[_Work], first: int, last: int, connectors: Sequence[PathConnector],
    refill: Refill, spots: Sequence[Sequence[Pose2]],
) -> tuple[int, _Ways]:  # fmt: skip
    """The latest line, of those after `first` up to `last`, before which the place is reached, and the ways."""
    for at in range(last, first, -1):
        gap = pieces[works[at - 1].last : works[at].first + 1]
        found = next((ways for spot in spots if (ways := _ways(gap, connectors, spot)) is not None), None)
        if found is not None:
            return at, found
    site, end = connectors[0].drivable.site, pieces[works[last - 1].last].leg.pose(-1)
    raise FieldError(
        f"refill: no way from {describe(site, end.x_m, end.y_m)} to the place next to {_named(connectors[0], refill)} "
        "and back: name another place or a larger area"
    )


def _ways(gap: Sequence[RoutePiece], connectors: Sequence[PathConnector], spot: Sequence[Pose2]) -> _Ways | None:
    """Fastest ways from what is driven between two lines to a pose of a spot and back to it; None without any.

    `gap` begins and ends with work. The way begins after the first `k` pieces between and leads to before piece `m`;
    the rig leaves it as early and comes back as late as it can.
    """
    count = len(gap) - 2
    ends = [piece.leg.pose(-1) for piece in gap[:-1]]
    starts = [piece.leg.pose(0) for piece in gap[1:]]
    best: tuple[float, _Ways] | None = None
    for place in spot:
        before, behind = place.ahead(-STRAIGHT_M), place.ahead(STRAIGHT_M)
        for k in range(count + 1):
            there = _way(connectors, ends[k], before, _straight_m(gap[k].leg), 0.0)
            if there is None:
                continue
            ms = range(count, k - 1, -1)
            back = ((m, _way(connectors, behind, starts[m], 0.0, _straight_m(gap[m + 1].leg))) for m in ms)
            m, way = next(((m, w) for m, w in back if w is not None), (0, None))
            if way is None:
                continue
            time_s = there.time_s + way.time_s
            if best is None or time_s < best[0] - 1e-6:
                arrival = [*turn_pieces(there, -1), *_pieces(before, place)]
                best = time_s, (arrival, [*_pieces(place, behind), *turn_pieces(way, -1)], k, m)
            break
    return None if best is None else best[1]


def _way(
    connectors: Sequence[PathConnector], start: Pose2, goal: Pose2, behind_m: float, ahead_m: float
) -> Connection | None:
    """Along a headland pass, else a turn."""
    for connector in connectors:
        request = connector.request(start, goal, behind_m, ahead_m)
        found = connector.along(request) or connector.turn(request)
        if found is not None:
            return found
    return None


def _pieces(start: Pose2, goal: Pose2) -> list[RoutePiece]:
    return [RoutePiece(PathSectionType.TURN, -1, straight(start, goal), False)]


def _straight_m(leg: Leg) -> float:
    """Length of a straight leg, 0 of others."""
    return 0.0 if leg.curvature_radpm.any() else math.dist(leg.p_map_m[0], leg.p_map_m[-1])


def refill_spots(connector: PathConnector, refill: Refill) -> list[list[Pose2]]:
    """Free poses along the edge next to the point, nearest first, in both directions where they are free.

    Those on the pass along the edge come before those on passes further inside, which are left more easily. Raises
    FieldError where there is none.
    """
    site, point = connector.drivable.site, Point(refill.at_m)
    for area in site.no_go:
        if Polygon(area.outline_m).contains(point):
            raise FieldError(f"refill: {_named(connector, refill)} is in {area.name}: name a place at the edge")
    found = list[list[Pose2]]()
    is_near = point.distance(connector.drivable.field.exterior) <= NEAR_M
    for line in _beside_edge(connector) if is_near else ():
        near = sorted(line, key=lambda pose: round(point.distance(Point(pose[:2])), 3))
        near = [pose for pose in near if point.distance(Point(pose[:2])) <= NEAR_M]
        both = ([pose, Pose2(pose.x_m, pose.y_m, pose.yaw_rad + math.pi)] for pose in near)
        free = ([pose for pose in spot if _is_free(connector, pose)] for spot in both)
        found += islice((spot for spot in free if spot), SPOTS)
    if not found:
        raise FieldError(
            f"refill: no free place for a rig {connector.rig.width_m:g} m wide at an edge within {NEAR_M:g} m of "
            f"{_named(connector, refill)}: name a place at the edge"
        )
    return found


def _beside_edge(connector: PathConnector) -> Iterator[list[Pose2]]:
    """Poses on each headland pass that is not around an obstacle, else on lines beside the outline, outermost first."""
    passes = [p for p in connector.headland_passes if not p.is_around_obstacle]
    for _, same in groupby(passes, key=lambda p: p.number):
        yield [p.pose(k) for p in same for k in range(0, len(p.points_m), STRIDE)]
    if passes:
        return
    ring = connector.drivable.field.exterior
    ring = ring if ring.is_ccw else ring.reverse()
    places = [[ring.interpolate(float(d) % ring.length) for d in (s, s - STEP_M, s + STEP_M)] for s in _steps(ring)]
    edge = [(at, math.atan2(b.y - a.y, b.x - a.x)) for at, a, b in places]
    for off_m in OFF_EDGE_M:
        by_m = 0.5 * connector.rig.width_m + connector.drivable.margin_m + off_m
        yield [Pose2(at.x - by_m * math.sin(yaw), at.y + by_m * math.cos(yaw), yaw) for at, yaw in edge]


def _steps(ring: LinearRing) -> Float64:
    return np.arange(0.0, ring.length, STEP_M)


def _is_free(connector: PathConnector, place: Pose2) -> bool:
    leg = straight(place.ahead(-STRAIGHT_M), place.ahead(STRAIGHT_M))
    return connector.space.is_free(leg.p_map_m, leg.heading_rad)


def _named(connector: PathConnector, refill: Refill) -> str:
    return describe(connector.drivable.site, *refill.at_m)

"""Driving the headland passes one after the other: entry point of each, its legs with corner fills, and its exit."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
from shapely.geometry import LineString

from geometry.pose2 import Pose2
from messages.plan import PathSectionType
from planning.coverage.headland import APART, CornerFill, CornerTurn, HeadlandPass
from planning.turns.connector import PathConnector, RoutePiece
from planning.turns.departure import along, arrival_along, departure_of, straightened
from planning.turns.search import AT_ONCE_M, Connection, Leg, bounds_s, straight

STRIDE = 25  # points of a pass between two candidates, 2.5 m
SWINGS = (1.0, 0.2)  # of the slack beside an edge, which a bent edge takes itself
CLOSING = 3  # points by which a pass overlaps its own beginning
AROUND = 20  # points before and after an entry that are straight
STRAIGHT_RADPM = 0.02
MAX_ENTRIES, MAX_LINKS, MAX_GOALS, THOROUGH, THOROUGH_NEAR = 16, 6, 12, 8, 2
NO_LINK_S = 100.0
NEAR_WIDTHS = 1.5  # distance of neighbouring passes, in working widths


@dataclass(frozen=True)
class PassDrive:
    """Pieces over the closed passes that are reached, the pose at their end, and the passes that are not reached."""

    pieces: list[RoutePiece]
    end: Pose2
    missed: list[HeadlandPass]


@dataclass(frozen=True)
class _Entry:
    """Where the drive over a closed pass begins and ends: at one of its points, or in a corner without its turn.

    Along an edge it ends with a departure, and where the edge is bent begins with an arrival.
    """

    index: int
    start: Pose2
    end: Pose2
    turn: CornerTurn | None = None
    departure: Leg | None = None
    arrival: Leg | None = None

    @property
    def saved_s(self) -> float:
        """Time of the turn that is not driven."""
        return 0.0 if self.turn is None else self.turn.way.time_s


def drive_passes(
    connector: PathConnector, start: Pose2, goals: Sequence[Pose2] | None, rings: Sequence[HeadlandPass]
) -> PassDrive:
    """Drives closed passes, from each to the one inside it first; `goals` are poses to which the rig drives later.

    A pass along the edge is left before a corner, in one, or by a departure: elsewhere the tail would swing over the
    edge. One that cannot be left for another pass or a goal is not driven, except without goals (None) the last one.
    """
    left = [(ring, _entries(ring, connector.rig.radius_m)) for ring in rings]
    for ring, entries in left:
        if connector.rig.trailer is not None:
            _follow(connector, ring, entries)
        elif ring.number == 0:
            entries[:] = _beside_edge(connector, ring, entries)
    pieces: list[RoutePiece] = []
    last, number, is_last = _Entry(0, start, start), 0, False
    while number < len(left) or (goals is None and left and not is_last):
        if number == len(left):
            number, is_last = 0, True
        ring, entries = left[number]
        following = left[number + 1] if number + 1 < len(left) else None
        entered = [e.start for other, them in left if other is not ring for e in them]
        others = None if goals is None and (is_last or not entered) else [*(goals or ()), *entered]
        best = _best(connector, last, ring, entries, following, others)
        if best is None:
            number += 1
            continue
        connection, last = best
        first, *others_of_loop = _loop(ring, last)
        more = [replace(piece, continues=True) for piece in others_of_loop]
        arrival = () if last.arrival is None else (RoutePiece(PathSectionType.TURN, ring.number, last.arrival, False),)
        pieces += [*turn_pieces(connection, ring.number), *arrival, first, *more]
        del left[number]
        left.sort(key=lambda other: not _is_inside(other[0], ring, connector.rig.working_width_m))
        number, is_last = 0, False  # those that were not reached before may be now
    return PassDrive(pieces, last.end, [ring for ring, _ in left])


def _is_inside(ring: HeadlandPass, outer: HeadlandPass, width_m: float) -> bool:
    """Whether a pass is the next one inwards from another."""
    if ring.number != outer.number + 1 or ring.is_around_obstacle != outer.is_around_obstacle:
        return False
    return LineString(ring.points_m[::STRIDE]).distance(LineString(outer.points_m[::STRIDE])) < NEAR_WIDTHS * width_m


def opened(ring: HeadlandPass, connector: PathConnector, ends: list[Pose2]) -> HeadlandPass:
    """A closed pass cut open without its fills, where a turn leads from one of the `ends` of lines to it."""
    rig, ring = connector.rig, replace(ring, fills=(), turns=())
    entries = _entries(ring, rig.radius_m)
    poses, first = [e.start for e in entries], entries[0].index
    if ends:
        bound = bounds_s(ends, poses, rig.config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
        ranked = np.argsort(bound, axis=None, kind="stable")[:MAX_ENTRIES]
        near = [(int(k) // len(poses), int(k) % len(poses)) for k in ranked]
        found = (n for e, n in near if connector.turn(connector.request(ends[e], poses[n])) is not None)
        first = entries[next(found, near[0][1])].index
    index = (first + np.arange(len(ring.points_m) + CLOSING)) % (len(ring.points_m) - 1)
    heading = np.unwrap(ring.heading_rad[index])
    return replace(ring, points_m=ring.points_m[index], heading_rad=heading, is_closed=False)


def _best(
    connector: PathConnector, last: _Entry, ring: HeadlandPass, entries: list[_Entry],
    following: tuple[HeadlandPass, list[_Entry]] | None, others: Sequence[Pose2] | None,
) -> tuple[Connection, _Entry] | None:  # fmt: skip
    """Connection to the entry of least time together with the connection from there to the next pass.

    An entry from which no turn leads to the next pass has to be left for another place.
    """
    links = ((n, _link(connector, last, entries[n])) for n in _by_time(connector, last, entries))
    reached = ((n, connection) for n, connection in links if connection is not None)
    stuck: list[tuple[Connection, _Entry]] = []
    while tried := list(islice(reached, MAX_ENTRIES)):
        ranked = list[tuple[float, int, bool, Connection]]()
        for n, connection in tried:
            onwards_s = _onwards_s(connector, entries[n], following[1] if following is not None else [])
            cost_s = connection.time_s - entries[n].saved_s + (onwards_s if following is not None else 0.0)
            ranked.append((round(cost_s, 6), n, onwards_s < NO_LINK_S, connection))
        for _, n, is_linked, connection in sorted(ranked, key=lambda r: r[:2]):
            if is_linked or _is_left(connector, entries[n], others):
                return connection, entries[n]
            stuck.append((connection, entries[n]))
    for connection, entry in chain(stuck[:THOROUGH_NEAR], _along(connector, last, ring, entries)):
        if _is_left(connector, entry, others) or (following and any(_along(connector, entry, *following))):
            return connection, entry
    return None


def _follow(connector: PathConnector, ring: HeadlandPass, entries: list[_Entry]) -> None:
    """Keeps the drives over a pass with a trailed implement, and its hitch angles at their ends."""
    angles = connector.rig.hitch_angles(ring.points_m, ring.heading_rad, is_closed=True)
    leg = Leg(1, ring.points_m[:-1], ring.heading_rad[:-1], ring.curvature_radpm[:-1])
    for entry in entries:
        connector.hitch_rad[entry.end] = float(angles[(entry.index + CLOSING) % (len(angles) - 1)])
        connector.beginnings[entry.start] = leg, entry.index


def _along(
    connector: PathConnector, last: _Entry, ring: HeadlandPass, entries: list[_Entry]
) -> Iterator[tuple[Connection, _Entry]]:
    """Connections along the passes to some entries of a pass: the nearest, and those near another pass."""
    near = _by_time(connector, last, entries)[:THOROUGH_NEAR]
    for n in dict.fromkeys([*near, *_nearest_to_others(connector, ring, entries)[:THOROUGH]]):
        connection = connector.find(connector.request(last.end, entries[n].start))
        if connection is not None:
            yield connection, entries[n]


def _onwards_s(connector: PathConnector, entry: _Entry, following: list[_Entry]) -> float:
    """Least time of a turn from the end of a drive over a pass to the next pass, `NO_LINK_S` without any."""
    if not following:
        return NO_LINK_S
    near = _by_time(connector, entry, following)[:MAX_LINKS]
    links = ((_link(connector, entry, following[k]), following[k].saved_s) for k in near)
    return min((link.time_s - saved_s for link, saved_s in links if link is not None), default=NO_LINK_S)


def _is_left(connector: PathConnector, entry: _Entry, goals: Sequence[Pose2] | None) -> bool:
    """Whether the end of a drive over a pass is left for one of the goals, of which fewer are tried farther away."""
    if not goals:
        return goals is None
    rig, config = connector.rig, connector.rig.config
    bound = bounds_s([entry.end], goals, config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)[0]
    ranks = np.unique(np.geomspace(1, len(goals), MAX_GOALS).astype(int)) - 1
    near = [connector.request(entry.end, goals[k]) for k in np.argsort(bound, kind="stable")[ranks]]
    return any(connector.turn(r) for r in near) or any(connector.find(r) for r in near[:THOROUGH_NEAR])


def _link(connector: PathConnector, last: _Entry, following: _Entry) -> Connection | None:
    """Turn from where the drive over one pass ends to where that over another begins."""
    request = connector.request(last.end, following.start)
    return connector.turn(request if last.turn is None else replace(request, run_out_m=AT_ONCE_M))


def _nearest_to_others(connector: PathConnector, ring: HeadlandPass, entries: list[_Entry]) -> list[int]:
    """Entries of a pass, nearest to another pass first."""
    others = [p.points_m[::STRIDE] for p in connector.headland_passes if p is not ring]
    if not others:
        return []
    gaps = np.array([e.start[:2] for e in entries])[:, None] - np.vstack(others)
    return [int(k) for k in np.argsort(np.hypot(*gaps.T).min(axis=0), kind="stable")]


def _by_time(connector: PathConnector, last: _Entry, entries: list[_Entry]) -> list[int]:
    """Indices of the entries, nearest in time first."""
    rig, goals = connector.rig, [e.start for e in entries]
    bound = bounds_s([last.end], goals, rig.config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)[0]
    saved_s = np.array([e.saved_s for e in entries])
    return [int(k) for k in np.argsort(bound - saved_s, kind="stable")]


def turn_pieces(connection: Connection, line: int) -> list[RoutePiece]:
    """A connection as pieces."""
    return [RoutePiece(PathSectionType.TURN, line, leg, False) for leg in connection.legs]


def places_on(ring: HeadlandPass, radius_m: float, near: Pose2) -> list[Pose2]:
    """Poses where the drive over a closed pass may begin, a quarter of them apart, the first nearest to a place."""
    poses = [entry.start for entry in _entries(ring, radius_m)]
    first = min(range(len(poses)), key=lambda k: math.hypot(poses[k].x_m - near.x_m, poses[k].y_m - near.y_m))
    return [poses[(first + round(share * len(poses))) % len(poses)] for share in (0.0, 0.25, 0.5, 0.75)]


def _entries(ring: HeadlandPass, radius_m: float) -> list[_Entry]:
    """The turns of a pass, and where it is straight for some metres and before corners, apart from fills and turns.

    Without any, where it is straightest.
    """
    n = len(ring.points_m) - 1
    curvature = ring.curvature_radpm[:-1]
    around = np.max([np.roll(np.abs(curvature), k) for k in range(-AROUND, AROUND + 1, 2)], axis=0)
    candidates = np.arange(0, n, STRIDE)
    flat = [int(k) for k in candidates[around[candidates] < STRAIGHT_RADPM]]
    bends = curvature > 0.5 / radius_m
    for start in np.flatnonzero(~bends & np.roll(bends, -1)):
        before = (start - np.arange(40)) % n
        level = np.abs(curvature[before]) < STRAIGHT_RADPM
        if level.any():
            flat.append(int(before[int(np.argmax(level))]))
    spans = [(t.before.index, (t.behind.index - t.before.index) % n) for t in ring.turns]

    def driven(points: Iterable[int]) -> list[int]:
        return [k for k in points if all((k - first) % n > length for first, length in spans)]

    apart = [k for k in driven(flat) if all(APART < (f.index - k) % n < n - APART for f in ring.fills)]
    straightest = (int(k) for k in candidates[np.argsort(around[candidates], kind="stable")])
    points = apart or driven(flat) or driven(straightest)[:3]
    corners = [_Entry(t.behind.index, _end(ring, t.behind), _end(ring, t.before), t) for t in ring.turns]
    return [*(_Entry(k, ring.pose(k), ring.pose(k + CLOSING)) for k in points), *corners]


def _beside_edge(connector: PathConnector, ring: HeadlandPass, entries: Sequence[_Entry]) -> list[_Entry]:
    """Entries of a pass along an edge, with arrivals, and also with departures, where the rig is free on them."""
    rig = connector.rig
    if rig.config.edge_slack_m == 0.0:
        return list(entries)
    coming = departure_of(rig.front_m, rig.config.edge_slack_m)
    leaving = [departure_of(-rig.rear_m, share * rig.config.edge_slack_m) for share in SWINGS]
    if rig.has_reverse:
        leaving = [straightened(curve, rig.config.smoothing_m) for curve in leaving]
    kept, departing = list[_Entry](), list[_Entry]()
    for entry in entries:
        if entry.turn is not None:
            kept.append(entry)
            continue
        if not _is_free(connector, straight(entry.start.ahead(-rig.line_up_m), entry.start)):
            arrival = arrival_along(coming, _part(ring, entry.index - len(coming.p_map_m), entry.index))
            if _is_free(connector, arrival):
                entry = replace(entry, start=arrival.pose(0), arrival=arrival)
        first = entry.index + CLOSING
        legs = (along(curve, _part(ring, first, first + len(curve.p_map_m))) for curve in leaving)
        leg = next((leg for leg in legs if _is_free(connector, leg)), None)
        if leg is not None:
            departing.append(replace(entry, end=leg.pose(-1), departure=leg))
        kept.append(entry)
    if not rig.has_reverse:
        connector.departed.update(entry.end for entry in departing)
    return [*kept, *departing]


def _is_free(connector: PathConnector, leg: Leg) -> bool:
    """Whether the rig is free on a leg and can steer it."""
    bend = float(np.abs(leg.curvature_radpm).max())
    return bend < 1.0 / connector.rig.radius_m and connector.space.is_free(leg.p_map_m, leg.heading_rad)


def _part(ring: HeadlandPass, first: int, last: int) -> Leg:
    """Part of a closed pass from one index to another, around its end."""
    index = np.arange(first, last + 1) % (len(ring.points_m) - 1)
    return Leg(1, ring.points_m[index], np.unwrap(ring.heading_rad[index]), ring.curvature_radpm[index])


def _end(ring: HeadlandPass, fill: CornerFill) -> Pose2:
    """Pose at the end of a fill, away from the pass."""
    return ring.pose(fill.index).ahead(fill.by_m)


def _loop(ring: HeadlandPass, entry: _Entry) -> list[RoutePiece]:
    """Once around a pass, from where its drive begins to where it ends."""
    n, first = len(ring.points_m) - 1, entry.index
    length = n + CLOSING if entry.turn is None else (entry.turn.before.index - first) % n
    index = (first + np.arange(n + CLOSING + 1)) % n
    heading, curvature = np.unwrap(ring.heading_rad[index]), ring.curvature_radpm[index]

    def piece(a: int, b: int) -> RoutePiece:
        leg = Leg(1, ring.points_m[index[a : b + 1]], heading[a : b + 1], curvature[a : b + 1])
        return RoutePiece(PathSectionType.HEADLAND, ring.number, leg, True)

    stops: list[tuple[int, float, CornerFill | CornerTurn]]
    stops = [((f.index - first) % n, f.by_m, f) for f in ring.fills]
    stops += [((t.before.index - first) % n, t.before.by_m, t) for t in ring.turns if t is not entry.turn]
    pieces, done = [], 0
    for offset, _, stop in sorted(stops, key=lambda s: s[:2]):
        if offset > done:
            pieces.append(piece(done, offset))
        pieces += _fill_pieces(ring, stop) if isinstance(stop, CornerFill) else _turn_pieces(ring, stop)
        done = offset if isinstance(stop, CornerFill) else (stop.behind.index - first) % n
    pieces.append(piece(done, length))
    if entry.departure is not None:
        pieces.append(RoutePiece(PathSectionType.TURN, ring.number, entry.departure, False))
    if entry.turn is None:
        return pieces
    out = _straight_piece(ring, entry.start, ring.pose(first))
    return [out, *pieces, _straight_piece(ring, ring.pose(first + length), entry.end)]


def _fill_pieces(ring: HeadlandPass, fill: CornerFill) -> list[RoutePiece]:
    corner, away = ring.pose(fill.index), _end(ring, fill)
    return [_straight_piece(ring, corner, away), _straight_piece(ring, away, corner)]


def _turn_pieces(ring: HeadlandPass, turn: CornerTurn) -> list[RoutePiece]:
    into = _straight_piece(ring, ring.pose(turn.before.index), _end(ring, turn.before))
    out = _straight_piece(ring, _end(ring, turn.behind), ring.pose(turn.behind.index))
    return [into, *turn_pieces(turn.way, ring.number), out]


def _straight_piece(ring: HeadlandPass, start: Pose2, goal: Pose2) -> RoutePiece:
    """Straight on with work, or back without."""
    leg = straight(start, goal)
    is_working = leg.direction > 0
    section = PathSectionType.HEADLAND if is_working else PathSectionType.TURN
    return RoutePiece(section, ring.number, leg, is_working)

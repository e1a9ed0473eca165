"""Lines that a tour left out, put into it where a turn leads to them.

A line goes between two lines of the tour where it costs least. With reversing, one that cannot be left forwards is an
excursion: the rig works it and reverses over it and over the turn that led to it, or reverses into it and works out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.pose2 import Pose2
from planning.coverage.pass_route import turn_pieces
from planning.coverage.work_line import WorkLine
from planning.turns.connector import PathConnector, RoutePiece
from planning.turns.search import Connection, ConnectionRequest, Leg, bounds_s

TRIED = 10  # places of a tour to which turns are searched
TRIED_ALONG, MIN_ALONG_M = 3, 10.0  # to which a way along the headland passes is searched, and length of such a line


@dataclass(frozen=True)
class Stop:
    """A line of a tour in one direction with the way to it; after an excursion the rig is where that way began.

    Of an excursion `is_inwards` the way leads from the line to where the rig was before.
    """

    line: WorkLine
    is_reversed: bool
    way: Connection
    is_excursion: bool = False
    is_inwards: bool = False

    @property
    def leg(self) -> Leg:
        """Path over the line."""
        leg = self.line.legs[self.is_reversed]
        assert leg is not None
        return leg

    @property
    def pieces(self) -> list[RoutePiece]:
        """Way and line, and the way back of an excursion."""
        line, way = self.line, self.way.legs
        work = RoutePiece(line.section_type, line.number, self.leg, True)
        back = [leg.backwards for leg in ((self.leg, *way) if self.is_inwards else (*way, self.leg))][::-1]
        before, after = (back, way) if self.is_inwards else (way, back if self.is_excursion else ())
        return [*self._turns(before), work, *self._turns(after)]

    def _turns(self, legs: Sequence[Leg]) -> list[RoutePiece]:
        return turn_pieces(Connection(tuple(legs), 0.0), self.line.number)


@dataclass(frozen=True)
class Tour:
    """Drive over lines from `start`; `moved` of them are not in the order of the mission."""

    start: Pose2
    stops: list[Stop]
    moved: int = 0

    def place(self, count: int) -> tuple[Pose2, float]:
        """Pose after the first `count` stops, and the straight length behind it."""
        for stop in reversed(self.stops[:count]):
            if not stop.is_excursion:
                return stop.leg.pose(-1), stop.line.straight_m(stop.is_reversed)
        return self.start, 0.0

    def has(self, line: WorkLine) -> bool:
        """Whether a line is driven."""
        return any(stop.line is line for stop in self.stops)

    @property
    def pieces(self) -> list[RoutePiece]:
        """The complete drive."""
        return [piece for stop in self.stops for piece in stop.pieces]

    @property
    def turns_s(self) -> float:
        """Time of the ways between lines; that of an excursion is driven twice."""
        return sum(stop.way.time_s * (1 + stop.is_excursion) for stop in self.stops)


def inserted(connector: PathConnector, tour: Tour, home: Pose2 | None, lines: Sequence[WorkLine]) -> Tour:
    """The tour with those of the lines, longest first, to which a turn is found."""
    left = sorted(lines, key=lambda line: -line.length_m)
    while left:
        for line in left:
            found = _between(connector, tour, home, line) or _excursion(connector, tour, line)
            if found is not None:
                tour, left = found, [other for other in left if other is not line]
                break
        else:
            break
    return tour


def _between(connector: PathConnector, tour: Tour, home: Pose2 | None, line: WorkLine) -> Tour | None:
    """The tour with a line between two of its lines, or at its end."""
    options = []
    for at in range(len(tour.stops) + 1):
        following = tour.stops[at] if at < len(tour.stops) else None
        if following is None or not following.is_excursion:
            options += [(at, is_reversed) for is_reversed in (False, True) if line.legs[is_reversed] is not None]
    for at, is_reversed in _cheapest(connector, tour, home, line, options):
        stop = _reached(connector, tour, line, at, is_reversed)
        if stop is None:
            continue
        first, end = [*tour.stops[:at], stop], stop.leg.pose(-1)
        behind_m = line.straight_m(is_reversed)
        if at == len(tour.stops):
            if home is None or connector.find(connector.home_request(end, home, behind_m)) is not None:
                return replace(tour, stops=first)
            continue
        following = tour.stops[at]
        way = connector.turn(_request(connector, end, following, behind_m))
        if way is not None:
            return replace(tour, stops=[*first, replace(following, way=way), *tour.stops[at + 1 :]])
    return None


def _excursion(connector: PathConnector, tour: Tour, line: WorkLine) -> Tour | None:
    """The tour with a line that is left the way it was reached, forwards out of it or into it."""
    if not connector.rig.has_reverse:
        return None
    places = [k for k in range(len(tour.stops) + 1) if k == len(tour.stops) or not tour.stops[k].is_excursion]
    options = [(at, r, i) for at in places for r in (False, True) if line.legs[r] is not None for i in (False, True)]
    near = _nearest(connector, tour, line, options)
    is_long = line.length_m > MIN_ALONG_M
    for is_thorough, tried in ((False, near[: 2 * TRIED]), (True, near[: 2 * TRIED_ALONG * is_long])):
        for at, is_reversed, is_inwards in tried:
            stop = _reached(connector, tour, line, at, is_reversed, is_inwards, is_thorough)
            if stop is not None:
                stops = [*tour.stops[:at], replace(stop, is_excursion=True), *tour.stops[at:]]
                return replace(tour, stops=stops)
    return None


def _reached(
    connector: PathConnector, tour: Tour, line: WorkLine, at: int, is_reversed: bool, is_inwards: bool = False,
    is_thorough: bool = False,
) -> Stop | None:  # fmt: skip
    pose, behind_m = tour.place(at)
    (first, last), length_m = _ends(line, is_reversed), line.straight_m(is_reversed)
    onto, off = connector.request(pose, first, behind_m, length_m), connector.request(last, pose, length_m)
    request = off if is_inwards else onto
    way = connector.find(request) if is_thorough else connector.turn(request)
    return None if way is None else Stop(line, is_reversed, way, is_inwards=is_inwards)


def _request(connector: PathConnector, start: Pose2, stop: Stop, behind_m: float) -> ConnectionRequest:
    return connector.request(start, stop.leg.pose(0), behind_m, stop.line.straight_m(stop.is_reversed))


def _nearest(
    connector: PathConnector, tour: Tour, line: WorkLine, options: list[tuple[int, bool, bool]]
) -> list[tuple[int, bool, bool]]:
    """Places of the tour, directions of a line and of the excursion, those of the shortest ways first."""
    rig, config = connector.rig, connector.rig.config
    places = [tour.place(at)[0] for at, _, _ in options]
    starts, ends = ([_ends(line, r)[k] for r in (False, True)] for k in (0, 1))
    onto = bounds_s(places, starts, config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
    off = bounds_s(ends, places, config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
    time = [off[int(r), k] if i else onto[k, int(r)] for k, (_, r, i) in enumerate(options)]
    return [options[k] for k in np.argsort(time, kind="stable")]


def _cheapest(
    connector: PathConnector, tour: Tour, home: Pose2 | None, line: WorkLine, options: list[tuple[int, bool]]
) -> list[tuple[int, bool]]:
    """Places of the tour and directions of a line, those first where it adds least time."""
    rig, config = connector.rig, connector.rig.config
    places = [tour.place(at)[0] for at, _ in options]
    starts, ends = ([_ends(line, r)[k] for r in (False, True)] for k in (0, 1))
    goals = [stop.leg.pose(0) for stop in tour.stops] + ([home] if home is not None else [])
    onto = bounds_s(places, starts, config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
    off = bounds_s(ends, goals, config.run_out_m, rig.line_up_m, rig.radius_m, rig.turn_times)
    time = []
    for k, (at, r) in enumerate(options):
        saved = tour.stops[at].way.time_s if at < len(tour.stops) else 0.0
        time.append(onto[k, int(r)] + (off[int(r), at] if at < len(goals) else 0.0) - saved)
    return [options[k] for k in np.argsort(time, kind="stable")[:TRIED]]


def _ends(line: WorkLine, is_reversed: bool) -> tuple[Pose2, Pose2]:
    """Ends of a line in one direction, or in the other where it has none in this one."""
    ends = line.ends(is_reversed) or line.ends(not is_reversed)
    assert ends is not None
    return ends

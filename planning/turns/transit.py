"""Connections along a headland pass: onto it, along it in either direction, and off again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import Pose2
from planning.turns.free_space import FreeSpace
from planning.turns.search import Connection, ConnectionRequest, Leg, TurnTimes, bounds_s, find_turn

STRIDE = 50  # points between two places where a pass is joined or left, 5 m
STRAIGHT_M = 1.0
MAX_NEAR, MAX_TRIED, MAX_FOUND = 32, 16, 4
STRAIGHT_RADPM = 0.05


@dataclass(frozen=True)
class Track:
    """A pass in one direction: points (N, 2), heading, curvature (N,); closed when it ends where it begins.

    Turns from and to a pose are searched once, for one free space.
    """

    leg: Leg
    is_closed: bool
    known: dict[tuple[bool, Pose2, float], list[tuple[int, Connection]]] = field(default_factory=dict, compare=False)

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Indices where it is joined or left: nearly straight points."""
        n = len(self.leg.p_map_m) - int(self.is_closed)
        return tuple(k for k in range(0, n, STRIDE) if abs(float(self.leg.curvature_radpm[k])) < STRAIGHT_RADPM)

    def part(self, first: int, last: int) -> Leg | None:
        """From one index to another, around the end of a closed one; None where an open one does not lead there."""
        n = len(self.leg.p_map_m) - int(self.is_closed)
        if last <= first and not self.is_closed:
            return None
        index = np.arange(first, last + 1 if last > first else last + n + 1) % n
        return Leg(1, self.leg.p_map_m[index], np.unwrap(self.leg.heading_rad[index]), self.leg.curvature_radpm[index])

    def joined(
        self, start: Pose2, run_out_m: float, hitch_rad: float, space: FreeSpace, times: TurnTimes
    ) -> list[tuple[int, Connection]]:
        """Places with the shortest free turns from a pose onto the pass."""

        def request(place: Pose2) -> ConnectionRequest:
            return ConnectionRequest(start, place, run_out_m, STRAIGHT_M, hitch_rad=hitch_rad)

        return self._searched((True, start, run_out_m), request, space, times)

    def left(
        self, goal: Pose2, line_up_m: float, most_hitch_rad: float, space: FreeSpace, times: TurnTimes
    ) -> list[tuple[int, Connection]]:
        """Places with the shortest free turns from the pass to a pose."""

        def request(place: Pose2) -> ConnectionRequest:
            return ConnectionRequest(place, goal, STRAIGHT_M, line_up_m, most_hitch_rad=most_hitch_rad)

        return self._searched((False, goal, line_up_m), request, space, times)

    def _searched(
        self, key: tuple[bool, Pose2, float], request: Callable[[Pose2], ConnectionRequest], space: FreeSpace,
        times: TurnTimes,
    ) -> list[tuple[int, Connection]]:  # fmt: skip
        if key not in self.known:
            poses = [self.leg.pose(k) for k in self.places]
            self.known[key] = _free({k: request(poses[k]) for k in _near(poses, key[1])}, space, times)
        return self.known[key]


def both_ways(points_m: Float64, heading_rad: Float64, curvature_radpm: Float64, is_closed: bool) -> list[Track]:
    """The tracks of a pass."""
    leg = Leg(1, points_m, heading_rad, curvature_radpm)
    return [Track(leg, is_closed), Track(leg.back, is_closed)]


def along_passes(
    request: ConnectionRequest, space: FreeSpace, times: TurnTimes, tracks: Sequence[Track]
) -> Connection | None:
    """Fastest free connection of those along one pass found by the shortest turns onto it and off it."""
    found: list[tuple[float, int, list[Leg]]] = []
    for track in tracks:
        ons = track.joined(request.start, request.run_out_m, request.hitch_rad, space, times)
        offs = track.left(request.goal, request.line_up_m, request.most_hitch_rad, space, times) if ons else []
        for (i, on), (j, off) in product(ons, offs):
            part = track.part(track.places[i], track.places[j])
            if part is not None:
                time = on.time_s + off.time_s + 0.1 * len(part.p_map_m) / times.forward_mps
                found.append((time, len(found), [*on.legs, part, *off.legs]))
    for time, _, legs in sorted(found, key=lambda f: f[:2]):
        if space.trailer is not None:
            trailed = _trailed(request, space, legs, time)
            if trailed is not None:
                return trailed
        elif all(space.is_free(leg.p_map_m, leg.heading_rad) for leg in legs):
            return Connection(tuple(legs), time)
    return None


def _trailed(request: ConnectionRequest, space: FreeSpace, legs: Sequence[Leg], time_s: float) -> Connection | None:
    """The connection over all legs with a trailed implement, which forgets no bend of one on the next; or None."""
    p, heading = np.vstack([leg.p_map_m for leg in legs]), np.concatenate([leg.heading_rad for leg in legs])
    hitch_rad = space.hitch_after(p, heading, request.hitch_rad)
    is_in_line = abs(hitch_rad) <= request.most_hitch_rad
    return (
        Connection(tuple(legs), time_s, hitch_rad)
        if is_in_line and space.is_free(p, heading, request.hitch_rad)
        else None
    )


def _near(poses: Sequence[Pose2], place: Pose2) -> list[int]:
    gaps = [(pose.x_m - place.x_m) ** 2 + (pose.y_m - place.y_m) ** 2 for pose in poses]
    return [int(k) for k in np.argsort(gaps, kind="stable")[:MAX_NEAR]]


def _free(requests: dict[int, ConnectionRequest], space: FreeSpace, times: TurnTimes) -> list[tuple[int, Connection]]:
    """The first free turns, in order of the time that they would take without obstacles."""
    found: list[tuple[int, Connection]] = []
    for k in sorted(requests, key=lambda k: _bound_s(requests[k], space, times))[:MAX_TRIED]:
        turn = find_turn(requests[k], space, times, is_first_only=True)
        if turn is not None:
            found.append((k, turn))
        if len(found) == MAX_FOUND:
            break
    return found


def _bound_s(request: ConnectionRequest, space: FreeSpace, times: TurnTimes) -> float:
    ends = [request.start], [request.goal]
    return float(bounds_s(*ends, request.run_out_m, request.line_up_m, space.radius_m, times)[0, 0])

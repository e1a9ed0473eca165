"""Connections along a headland pass: onto it, along it in either direction, and off again."""

from collections.abc import Sequence
from dataclasses import dataclass
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
    """A pass in one direction: points (N, 2), heading, curvature (N,); closed when it ends where it begins."""

    leg: Leg
    is_closed: bool

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
        if not track.places:
            continue
        poses = [track.leg.pose(k) for k in track.places]
        near = _near(poses, request.start)
        on_s = bounds_s(
            [request.start], [poses[k] for k in near], request.run_out_m, STRAIGHT_M, space.radius_m, times
        )[0]
        ons = _free(
            {k: ConnectionRequest(request.start, poses[k], request.run_out_m, STRAIGHT_M) for k in near},
            on_s,
            space,
            times,
        )
        if not ons:
            continue
        near = _near(poses, request.goal)
        off_s = bounds_s(
            [poses[k] for k in near], [request.goal], STRAIGHT_M, request.line_up_m, space.radius_m, times
        )[:, 0]
        offs = _free(
            {k: ConnectionRequest(poses[k], request.goal, STRAIGHT_M, request.line_up_m) for k in near},
            off_s,
            space,
            times,
        )
        for (i, on), (j, off) in product(ons, offs):
            part = track.part(track.places[i], track.places[j])
            if part is not None:
                time = on.time_s + off.time_s + 0.1 * len(part.p_map_m) / times.forward_mps
                found.append((time, len(found), [*on.legs, part, *off.legs]))
    for time, _, legs in sorted(found, key=lambda f: f[:2]):
        if all(space.is_free(leg.p_map_m, leg.heading_rad) for leg in legs):
            return Connection(tuple(legs), time)
    return None


def _near(poses: Sequence[Pose2], place: Pose2) -> list[int]:
    gaps = [(pose.x_m - place.x_m) ** 2 + (pose.y_m - place.y_m) ** 2 for pose in poses]
    return [int(k) for k in np.argsort(gaps, kind="stable")[:MAX_NEAR]]


def _free(
    requests: dict[int, ConnectionRequest], bound_s: Float64, space: FreeSpace, times: TurnTimes
) -> list[tuple[int, Connection]]:
    found: list[tuple[int, Connection]] = []
    numbers = list(requests)
    for n in np.argsort(bound_s, kind="stable")[:MAX_TRIED]:
        k = numbers[n]
        turn = find_turn(requests[k], space, times, is_first_only=True)
        if turn is not None:
            found.append((k, turn))
        if len(found) == MAX_FOUND:
            break
    return found

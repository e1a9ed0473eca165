"""Driving the rounds: where each begins, and where it is left for the next.

A round lies so near the edge that the tail would swing over it when the rig turned off a straight part. So it is left
where it bends inwards anyway, and the rig goes on along it up to there.
"""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import arc_length
from geometry.pose2 import Pose2
from messages.plan import PathSectionType
from planning.turns.connector import Piece, Ways
from planning.turns.turn import STEP_M, Wanted, curve_between, shortest_length_m

EVERY = 25  # points of a round between two places tried, 2.5 m
CLOSING = 3  # points by which a round works on over its own beginning
JOINT = 50  # points of a round checked together with the way to or from it
MOST_CHECKED = 100
MOST_ENTRIES = 14
MOST_ENTERED = 2
NEAR_M = 25.0
BEND_STRAIGHT_M = 1.0


@dataclass(frozen=True)
class Link:
    """A free way that leaves a round at its point `leave` and enters the next at its point `enter`."""

    leave: int
    enter: int
    points_m: Float64
    length_m: float


def drive_rounds(ways: Ways, start: Pose2) -> tuple[list[Piece], Float64]:
    """All rounds with the ways to them, and the last one's points (N, 2), begun `JOINT` before its end.

    Raises FieldError.
    """
    rings = [r.points_m[:-1] for r in ways.rounds]
    entries = _entries(ways, start, rings[0])
    pieces: list[Piece] = []
    for number, ring in enumerate(rings):
        line = ways.rounds[number].number
        links = _links(ways, ring, rings[number + 1]) if number + 1 < len(rings) else []
        best = _best(entries, links, len(ring), number + 1 == len(rings))
        entry, link = best if best is not None else _by_search(ways, start, rings, number, entries)
        pieces += [
            Piece(PathSectionType.TURN, line, entry.points_m, False),
            Piece(PathSectionType.HEADLAND, line, _loop(ring, entry.enter), True),
        ]
        if link is None:
            return pieces, np.roll(ring, JOINT - entry.enter - CLOSING, axis=0)
        pieces.append(Piece(PathSectionType.TURN, line, _part(ring, entry.enter + CLOSING, link.leave), False))
        entries = [link]
    raise AssertionError("the last round has no link")


def _best(entries: list[Link], links: list[Link], count: int, is_last: bool) -> tuple[Link, Link | None] | None:
    """The entry and the link onwards that are shortest together, with the way along the round between them."""
    if is_last:
        return (entries[0], None) if entries else None
    pairs = [
        (e.length_m + (k.leave - e.enter - CLOSING) % count * STEP_M + k.length_m, i, j)
        for i, e in enumerate(entries)
        for j, k in enumerate(links)
    ]
    if not pairs:
        return None
    _, i, j = min(pairs)
    return entries[i], links[j]


def _entries(ways: Ways, start: Pose2, ring: Float64) -> list[Link]:
    config, options = ways.rig.config, []
    for k in range(0, len(ring), EVERY):
        wanted = Wanted(start, pose_at(ring, k), config.run_out_m, config.line_up_m)
        options.append((shortest_length_m(wanted, ways.rig.radius_m), k, wanted))
    options.sort(key=lambda o: (round(o[0], 6), o[1]))
    found: list[Link] = []
    for _, k, wanted in options[:MOST_CHECKED]:
        way = curve_between(wanted, ways.space, 3, None, _part(ring, k, k + JOINT))
        if way is not None:
            found.append(Link(-1, k, way, float(arc_length(way)[-1])))
        if len(found) == MOST_ENTRIES:
            break
    return found


def _links(ways: Ways, ring: Float64, following: Float64) -> list[Link]:
    """From each place of the round the shortest free way to the next, where there is one."""
    found = []
    for j in range(0, len(ring), EVERY):
        pose, before = pose_at(ring, j), _part(ring, j - JOINT, j)
        gaps = np.hypot(*(following[::EVERY] - ring[j]).T)
        options = []
        for k in (np.flatnonzero(gaps < max(NEAR_M, 1.5 * gaps.min())) * EVERY).tolist():
            wanted = Wanted(pose, pose_at(following, k), BEND_STRAIGHT_M, ways.rig.config.line_up_m)
            options.append((round(shortest_length_m(wanted, ways.rig.radius_m), 6), k, wanted))
        for _, k, wanted in sorted(options, key=lambda o: o[:2])[:MOST_ENTERED]:
            way = curve_between(wanted, ways.space, 2, before, _part(following, k, k + JOINT))
            if way is not None:
                found.append(Link(j, k, way, float(arc_length(way)[-1])))
                break
    return found


def _by_search(
    ways: Ways, start: Pose2, rings: list[Float64], number: int, entries: list[Link]
) -> tuple[Link, Link | None]:
    """As `_best`, but by thorough search, where no simple curve was free."""
    config, ring = ways.rig.config, rings[number]
    if not entries:
        way = ways.demand(Wanted(start, pose_at(ring, 0), config.run_out_m, config.line_up_m), "to the first round")
        entries = [Link(-1, 0, way, float(arc_length(way)[-1]))]
    entry = entries[0]
    if number + 1 == len(rings):
        return entry, None
    leave, following = (entry.enter + CLOSING) % len(ring), rings[number + 1]
    order = np.argsort(np.hypot(*(following[::EVERY] - ring[leave]).T), kind="stable") * EVERY
    options = [
        Wanted(pose_at(ring, leave), pose_at(following, int(k)), config.run_out_m, config.line_up_m) for k in order[:8]
    ]
    for wanted, k in zip(options, order, strict=False):
        found = ways.find(wanted)
        if found is not None:
            return entry, Link(leave, int(k), found, float(arc_length(found)[-1]))
    ways.demand(options[0], f"to round {ways.rounds[number + 1].number + 1}")
    raise AssertionError


def pose_at(ring: Float64, k: int) -> Pose2:
    """The pose at a point of a round."""
    n = len(ring)
    d = ring[(k + 1) % n] - ring[(k - 1) % n]
    return Pose2(float(ring[k % n, 0]), float(ring[k % n, 1]), float(np.arctan2(d[1], d[0])))


def _loop(ring: Float64, k: int) -> Float64:
    return (
        np.vstack([ring[k:], ring[: k + CLOSING + 1]])
        if k + CLOSING < len(ring)
        else np.vstack([ring[k:], ring, ring[: k + CLOSING + 1 - len(ring)]])
    )


def _part(ring: Float64, first: int, last: int) -> Float64:
    n = len(ring)
    return ring[np.arange(first, first + (last - first) % n + 1) % n]

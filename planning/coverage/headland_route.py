"""Route along the headland passes: entry point of each and transition to the next.

A pass is so near the edge that the tail would swing over it if the rig turned off a straight part. It is therefore
left where it bends inwards, and the rig continues along it up to that point.
"""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import arc_length
from geometry.pose2 import Pose2
from messages.plan import PathSectionType
from planning.turns.connector import PathConnector, RoutePiece
from planning.turns.turn import STEP_M, ConnectionRequest, dubins_connection, shortest_length_m

STRIDE = 25  # points of a pass between two candidates, 2.5 m
CLOSING = 3  # points by which a pass overlaps its own beginning
JOINT = 50  # points of a pass checked together with the connection to or from it
MAX_CHECKED = 100
MAX_ENTRIES = 14
MAX_ENTERED = 2
NEAR_M = 25.0
BEND_STRAIGHT_M = 1.0


@dataclass(frozen=True)
class Link:
    """Free connection from point `leave` of a pass to point `enter` of the next."""

    leave: int
    enter: int
    points_m: Float64
    length_m: float


def route_headland(connector: PathConnector, start: Pose2) -> tuple[list[RoutePiece], Float64]:
    """All passes with their connections, and the points (N, 2) of the last pass, from `JOINT` before its end.

    Raises FieldError.
    """
    rings = [r.points_m[:-1] for r in connector.headland_passes]
    entries = _entries(connector, start, rings[0])
    pieces: list[RoutePiece] = []
    for number, ring in enumerate(rings):
        line = connector.headland_passes[number].number
        links = _links(connector, ring, rings[number + 1]) if number + 1 < len(rings) else []
        best = _best(entries, links, len(ring), number + 1 == len(rings))
        entry, link = best if best is not None else _by_search(connector, start, rings, number, entries)
        pieces += [
            RoutePiece(PathSectionType.TURN, line, entry.points_m, False),
            RoutePiece(PathSectionType.HEADLAND, line, _loop(ring, entry.enter), True),
        ]
        if link is None:
            return pieces, np.roll(ring, JOINT - entry.enter - CLOSING, axis=0)
        pieces.append(RoutePiece(PathSectionType.TURN, line, _part(ring, entry.enter + CLOSING, link.leave), False))
        entries = [link]
    raise AssertionError("the last pass has no link")


def _best(entries: list[Link], links: list[Link], count: int, is_last: bool) -> tuple[Link, Link | None] | None:
    """Entry and link onwards of the shortest sum, including the distance along the pass between them."""
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


def _entries(connector: PathConnector, start: Pose2, ring: Float64) -> list[Link]:
    config, options = connector.rig.config, []
    for k in range(0, len(ring), STRIDE):
        request = ConnectionRequest(start, pose_at(ring, k), config.run_out_m, config.line_up_m)
        options.append((shortest_length_m(request, connector.rig.radius_m), k, request))
    options.sort(key=lambda o: (round(o[0], 6), o[1]))
    found: list[Link] = []
    for _, k, request in options[:MAX_CHECKED]:
        connection = dubins_connection(request, connector.space, 3, None, _part(ring, k, k + JOINT))
        if connection is not None:
            found.append(Link(-1, k, connection, float(arc_length(connection)[-1])))
        if len(found) == MAX_ENTRIES:
            break
    return found


def _links(connector: PathConnector, ring: Float64, following: Float64) -> list[Link]:
    """Shortest free connection to the next pass from each candidate point that has one."""
    found = []
    for j in range(0, len(ring), STRIDE):
        pose, before = pose_at(ring, j), _part(ring, j - JOINT, j)
        gaps = np.hypot(*(following[::STRIDE] - ring[j]).T)
        options = []
        for k in (np.flatnonzero(gaps < max(NEAR_M, 1.5 * gaps.min())) * STRIDE).tolist():
            request = ConnectionRequest(pose, pose_at(following, k), BEND_STRAIGHT_M, connector.rig.config.line_up_m)
            options.append((round(shortest_length_m(request, connector.rig.radius_m), 6), k, request))
        for _, k, request in sorted(options, key=lambda o: o[:2])[:MAX_ENTERED]:
            connection = dubins_connection(request, connector.space, 2, before, _part(following, k, k + JOINT))
            if connection is not None:
                found.append(Link(j, k, connection, float(arc_length(connection)[-1])))
                break
    return found


def _by_search(
    connector: PathConnector, start: Pose2, rings: list[Float64], number: int, entries: list[Link]
) -> tuple[Link, Link | None]:
    """As `_best`, by thorough search where no Dubins path was free."""
    config, ring = connector.rig.config, rings[number]
    if not entries:
        connection = connector.require(
            ConnectionRequest(start, pose_at(ring, 0), config.run_out_m, config.line_up_m), "to the first headland pass"
        )
        entries = [Link(-1, 0, connection, float(arc_length(connection)[-1]))]
    entry = entries[0]
    if number + 1 == len(rings):
        return entry, None
    leave, following = (entry.enter + CLOSING) % len(ring), rings[number + 1]
    order = np.argsort(np.hypot(*(following[::STRIDE] - ring[leave]).T), kind="stable") * STRIDE
    options = [
        ConnectionRequest(pose_at(ring, leave), pose_at(following, int(k)), config.run_out_m, config.line_up_m)
        for k in order[:8]
    ]
    for request, k in zip(options, order, strict=False):
        found = connector.find(request)
        if found is not None:
            return entry, Link(leave, int(k), found, float(arc_length(found)[-1]))
    connector.require(options[0], f"to headland pass {connector.headland_passes[number + 1].number + 1}")
    raise AssertionError


def pose_at(ring: Float64, k: int) -> Pose2:
    """Pose at a point of a closed pass."""
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

"""Connections along a headland pass: onto it, along it, and off again."""

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import without_repeats
from geometry.pose2 import Pose2
from planning.turns.dubins import dubins_paths
from planning.turns.free_space import FreeSpace
from planning.turns.search import ConnectionRequest
from planning.turns.turn import dubins_connection, is_free

STRIDE = 30  # points of a pass, 3 m
MAX_TRIED = 14


def along_headland(request: ConnectionRequest, space: FreeSpace, rings_m: list[Float64]) -> Float64 | None:
    """Shortest free connection along any pass in either direction, (N, 2), or None."""
    found = [
        connection for ring in rings_m for r in (ring, ring[::-1]) for connection in _along(request, space, r[:-1])
    ]
    for _, connection in sorted(found, key=lambda f: round(f[0], 6)):
        if is_free(connection, space):
            return connection
    return None


def _along(request: ConnectionRequest, space: FreeSpace, ring: Float64) -> list[tuple[float, Float64]]:
    n = len(ring)
    poses = [(k, _pose(ring, k)) for k in range(0, n, STRIDE)]
    ons = [(k, ConnectionRequest(request.start, p, request.run_out_m, 1.0)) for k, p in poses]
    offs = [(k, ConnectionRequest(p, request.goal, 1.0, request.line_up_m)) for k, p in poses]
    on, off = _first_free(ons, space), _first_free(offs, space)
    if on is None or off is None:
        return []
    (i, entry_points), (j, exit_points) = on, off
    part = ring[i : j + 1] if j >= i else np.vstack([ring[i:], ring[: j + 1]])
    connection = without_repeats(np.vstack([entry_points, part, exit_points]))
    return [(float(len(part)) + len(entry_points) + len(exit_points), connection)]


def _first_free(options: list[tuple[int, ConnectionRequest]], space: FreeSpace) -> tuple[int, Float64] | None:
    def length(option: tuple[int, ConnectionRequest]) -> float:
        w = option[1]
        return round(
            dubins_paths(w.start.ahead(w.run_out_m), w.goal.ahead(-w.line_up_m), space.radius_m)[0].length_m, 6
        )

    for k, request in sorted(options, key=length)[:MAX_TRIED]:
        connection = dubins_connection(request, space, 6)
        if connection is not None:
            return k, connection
    return None


def _pose(ring: Float64, k: int) -> Pose2:
    d = ring[(k + 1) % len(ring)] - ring[k - 1]
    return Pose2(float(ring[k, 0]), float(ring[k, 1]), float(np.arctan2(d[1], d[0])))

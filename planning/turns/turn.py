"""Connections between poses by Dubins paths, checked by the swept footprint of machine and implement."""

from collections.abc import Iterator

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import headings, resample, smooth, without_repeats
from planning.turns.dubins import DubinsPath, dubins_paths, points_of
from planning.turns.free_space import FreeSpace
from planning.turns.search import ConnectionRequest

STEP_M = 0.1
RADII = (1.0, 1.25, 1.6, 2.2)
MORE_STRAIGHT_M = (0.0, 1.5, 3.5, 6.0)


def smoothed(points_m: Float64, smoothing_m: float) -> tuple[Float64, Float64]:
    """Points about 0.1 m apart with continuous curvature, and their headings."""
    points = smooth(resample(without_repeats(points_m), STEP_M), smoothing_m)
    return points, headings(points)


def is_free(points_m: Float64, space: FreeSpace) -> bool:
    """True if all bodies stay in the allowed area along the smoothed points (N, 2), checked every 0.1 m."""
    points, heading = smoothed(points_m, space.smoothing_m)
    return space.is_free(points, heading)


def candidates(request: ConnectionRequest, radius_m: float, limit: int) -> Iterator[Float64]:
    """Up to `limit` Dubins paths with straight ends, shortest first, including larger radii and longer straights."""
    found = [(run_out + c.length_m + line_up, k, c) for k, (run_out, line_up, c) in enumerate(_all(request, radius_m))]
    found.sort(key=lambda f: (round(f[0], 6), f[1]))
    return (_with_straights(request, curve) for _, _, curve in found[:limit])


def _all(request: ConnectionRequest, radius_m: float) -> Iterator[tuple[float, float, DubinsPath]]:
    for factor in RADII:
        for more_out in MORE_STRAIGHT_M:
            for more_up in MORE_STRAIGHT_M:
                run_out, line_up = request.run_out_m + more_out, request.line_up_m + more_up
                start, goal = request.start.ahead(run_out), request.goal.ahead(-line_up)
                for curve in dubins_paths(start, goal, radius_m * factor):
                    yield run_out, line_up, curve


def _with_straights(request: ConnectionRequest, curve: DubinsPath) -> Float64:
    start, goal = request.start, request.goal
    ends = np.array([[start.x_m, start.y_m]]), np.array([[goal.x_m, goal.y_m]])
    return without_repeats(np.vstack([ends[0], points_of(curve, STEP_M), ends[1]]))


def shortest_length_m(request: ConnectionRequest, radius_m: float) -> float:
    """Length of the shortest Dubins path with its straight ends, without collision check."""
    start, goal = request.start.ahead(request.run_out_m), request.goal.ahead(-request.line_up_m)
    return request.run_out_m + request.line_up_m + dubins_paths(start, goal, radius_m)[0].length_m


def dubins_connection(
    request: ConnectionRequest,
    space: FreeSpace,
    limit: int = 80,
    before: Float64 | None = None,
    after: Float64 | None = None,
) -> Float64 | None:
    """Shortest free one of the first `limit` Dubins paths, (N, 2), or None.

    `before` and `after` are the points driven on either side, so that the joints are checked as smoothed.
    """
    ends = [np.empty((0, 2)) if e is None else e for e in (before, after)]
    found = candidates(request, space.radius_m, limit)
    return next((c for c in found if is_free(np.vstack([ends[0], c, ends[1]]), space)), None)

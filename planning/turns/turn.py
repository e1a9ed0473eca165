"""Ways from pose to pose by Dubins curves, each proven free by the swept footprint of machine and implement."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float64
from geometry.footprint import Bodies, intrusion, is_inside
from geometry.polyline import headings, resample, smooth, without_repeats
from geometry.pose2 import Pose2
from planning.turns.dubins import Curve, dubins, points_of

STEP_M = 0.1
RADII = (1.0, 1.25, 1.6, 2.2)
MORE_STRAIGHT_M = (0.0, 1.5, 3.5, 6.0)


@dataclass(frozen=True)
class Space:
    """Where the bodies may be, and how they may turn."""

    allowed: BaseGeometry
    bodies: Bodies
    radius_m: float
    smoothing_m: float


@dataclass(frozen=True)
class Wanted:
    """A way wanted from `start` to `goal`, at least so far straight on after the one and before the other."""

    start: Pose2
    goal: Pose2
    run_out_m: float
    line_up_m: float


def smoothed(points_m: Float64, smoothing_m: float) -> tuple[Float64, Float64]:
    """Points about 0.1 m apart with continuous curvature, and their headings."""
    points = smooth(resample(without_repeats(points_m), STEP_M), smoothing_m)
    return points, headings(points)


def is_free(points_m: Float64, space: Space) -> bool:
    """Whether the bodies stay in the allowed area on the smoothed way, checked every 0.1 m."""
    points, heading = smoothed(points_m, space.smoothing_m)
    coarse = slice(None, None, 10)
    corners = np.vstack([b.corners_m for b in space.bodies])
    if intrusion(corners, points[coarse], heading[coarse], space.allowed).max() > 0.0:
        return False
    return bool(is_inside(space.bodies, points, heading, space.allowed).all())


def candidates(wanted: Wanted, radius_m: float, most: int) -> Iterator[Float64]:
    """Up to `most` Dubins ways with straight ends, shortest first, wider curves and longer straights among them."""
    found = [(run_out + c.length_m + line_up, k, c) for k, (run_out, line_up, c) in enumerate(_all(wanted, radius_m))]
    found.sort(key=lambda f: (round(f[0], 6), f[1]))
    return (_way(wanted, curve) for _, _, curve in found[:most])


def _all(wanted: Wanted, radius_m: float) -> Iterator[tuple[float, float, Curve]]:
    for factor in RADII:
        for more_out in MORE_STRAIGHT_M:
            for more_up in MORE_STRAIGHT_M:
                run_out, line_up = wanted.run_out_m + more_out, wanted.line_up_m + more_up
                start, goal = wanted.start.ahead(run_out), wanted.goal.ahead(-line_up)
                for curve in dubins(start, goal, radius_m * factor):
                    yield run_out, line_up, curve


def _way(wanted: Wanted, curve: Curve) -> Float64:
    start, goal = wanted.start, wanted.goal
    ends = np.array([[start.x_m, start.y_m]]), np.array([[goal.x_m, goal.y_m]])
    return without_repeats(np.vstack([ends[0], points_of(curve, STEP_M), ends[1]]))


def shortest_length_m(wanted: Wanted, radius_m: float) -> float:
    """Length of the shortest Dubins way with its straight ends, whatever lies between."""
    start, goal = wanted.start.ahead(wanted.run_out_m), wanted.goal.ahead(-wanted.line_up_m)
    return wanted.run_out_m + wanted.line_up_m + dubins(start, goal, radius_m)[0].length_m


def curve_between(
    wanted: Wanted, space: Space, most: int = 80, before: Float64 | None = None, after: Float64 | None = None
) -> Float64 | None:
    """The shortest free one of the first `most` Dubins ways, (N, 2), or None.

    `before` and `after` are what is driven on either side, so that the joints are checked as they will be smoothed.
    """
    ends = [np.empty((0, 2)) if e is None else e for e in (before, after)]
    ways = candidates(wanted, space.radius_m, most)
    return next((way for way in ways if is_free(np.vstack([ends[0], way, ends[1]]), space)), None)

"""A way round by the headland: on to a round, along it, and off again."""

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import without_repeats
from geometry.pose2 import Pose2
from planning.turns.dubins import dubins
from planning.turns.turn import Space, Wanted, curve_between, is_free

EVERY = 30  # points of a round, 3 m
NEAREST = 14


def along_rounds(wanted: Wanted, space: Space, rings_m: list[Float64]) -> Float64 | None:
    """The shortest free way found by any round in either direction, or None."""
    found = [way for ring in rings_m for r in (ring, ring[::-1]) for way in _along(wanted, space, r[:-1])]
    for _, way in sorted(found, key=lambda f: round(f[0], 6)):
        if is_free(way, space):
            return way
    return None


def _along(wanted: Wanted, space: Space, ring: Float64) -> list[tuple[float, Float64]]:
    n = len(ring)
    poses = [(k, _pose(ring, k)) for k in range(0, n, EVERY)]
    ons = [(k, Wanted(wanted.start, p, wanted.run_out_m, 1.0)) for k, p in poses]
    offs = [(k, Wanted(p, wanted.goal, 1.0, wanted.line_up_m)) for k, p in poses]
    on, off = _first_free(ons, space), _first_free(offs, space)
    if on is None or off is None:
        return []
    (i, to), (j, away) = on, off
    part = ring[i : j + 1] if j >= i else np.vstack([ring[i:], ring[: j + 1]])
    way = without_repeats(np.vstack([to, part, away]))
    return [(float(len(part)) + len(to) + len(away), way)]


def _first_free(options: list[tuple[int, Wanted]], space: Space) -> tuple[int, Float64] | None:
    def length(option: tuple[int, Wanted]) -> float:
        w = option[1]
        return round(dubins(w.start.ahead(w.run_out_m), w.goal.ahead(-w.line_up_m), space.radius_m)[0].length_m, 6)

    for k, want in sorted(options, key=length)[:NEAREST]:
        way = curve_between(want, space, 6)
        if way is not None:
            return k, way
    return None


def _pose(ring: Float64, k: int) -> Pose2:
    d = ring[(k + 1) % len(ring)] - ring[k - 1]
    return Pose2(float(ring[k, 0]), float(ring[k, 1]), float(np.arctan2(d[1], d[0])))

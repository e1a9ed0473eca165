"""Order and direction of swaths for short turns between them: greedy tours improved by local search (2-opt, or-opt)."""

import numpy as np

from geometry.arrays import Float64

Visit = tuple[int, bool]  # number of the swath, driven from b to a
MANY_SWATHS = 25


def order(cost_m: Float64) -> list[Visit]:
    """Visits in an order of low cost: the best greedy tours, improved to a local optimum.

    `cost_m` (2n + 1, 2n + 1): distance from the end of visit i to the start of visit j, where visit 2k drives swath k
    from a to b and 2k + 1 from b to a; the last index is the start and end of the tour.
    """
    count = len(cost_m) // 2
    if count == 0:
        return []
    firsts = np.argsort(cost_m[-1, :-1], kind="stable")[: 8 if count <= MANY_SWATHS else 2]
    tours = [_improved(_greedy(cost_m, int(first)), cost_m) for first in firsts]
    best = min(tours, key=lambda t: (round(float(_lengths([t], cost_m)[0]), 6), t))
    return [(v // 2, bool(v % 2)) for v in best]


def _greedy(cost_m: Float64, first: int) -> list[int]:
    tour, left = [first], [v for v in range(len(cost_m) - 1) if v // 2 != first // 2]
    while left:
        best = min(left, key=lambda v: (cost_m[tour[-1], v], v))
        tour.append(best)
        left = [v for v in left if v // 2 != best // 2]
    return tour


def _improved(tour: list[int], cost_m: Float64) -> list[int]:
    length = float(_lengths([tour], cost_m)[0])
    while True:
        tours = _neighbours(tour)
        lengths = _lengths(tours, cost_m)
        k = int(np.argmin(lengths))
        if lengths[k] > length - 1e-6:
            return tour
        tour, length = tours[k], float(lengths[k])


def _neighbours(tour: list[int]) -> list[list[int]]:
    """Tours with a part reversed, turned (order and direction), or moved."""
    n = len(tour)
    out = [tour]
    for i in range(n):
        for j in range(i + 1, n + 1):
            middle = tour[i:j]
            turned = [v ^ 1 for v in reversed(middle)]
            out += [tour[:i] + turned + tour[j:], tour[:i] + middle[::-1] + tour[j:]]
            if j - i <= 3:
                rest = tour[:i] + tour[j:]
                out += [rest[:at] + m + rest[at:] for at in range(len(rest) + 1) for m in (middle, turned)]
    return out


def _lengths(tours: list[list[int]], cost_m: Float64) -> Float64:
    ends = np.full((len(tours), 1), len(cost_m) - 1)
    stops = np.hstack([ends, np.array(tours), ends])
    return np.asarray(cost_m[stops[:, :-1], stops[:, 1:]].sum(axis=1), np.float64)

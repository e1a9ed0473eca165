"""Order and direction of lines for short turns between them: greedy tour, 2-opt, or-opt, and repeated perturbation."""

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.jit import kernel

Visit = tuple[int, bool]  # number of the line, driven from b to a
PERTURBATIONS = 400_000  # divided by the square of the number of lines
MAX_PERTURBATIONS, MIN_PERTURBATIONS = 400, 10
MAX_SWEEPS = 60


def order(cost: Float64, seed: int = 0) -> list[Visit]:
    """Visits in an order of low cost, the same for the same arguments.

    `cost` (2n + 1, 2n + 1): from the end of visit i to the start of visit j, where visit 2k drives line k from a to b,
    and 2k + 1 from b to a; the last index is the start and end of the tour. A tour and its reverse are taken to cost
    the same between lines: cost[i, j] = cost[j ^ 1, i ^ 1].
    """
    count = len(cost) // 2
    if count == 0:
        return []
    rounds = min(max(PERTURBATIONS // (count * count), MIN_PERTURBATIONS), MAX_PERTURBATIONS)
    draws = np.random.default_rng(seed).integers(0, count, (rounds, 3))
    return [(int(v) // 2, bool(v % 2)) for v in _solve(cost, draws)]


@kernel
def _solve(cost: Float64, draws: Int64) -> Int64:
    tour = _greedy(cost)
    _improve(tour, cost)
    best, best_cost = tour.copy(), _length(tour, cost)
    n = len(tour)
    for k in range(len(draws)):
        if n < 5:
            break
        tour[:] = best
        a, b, c = np.sort(draws[k])
        tour[a:c] = np.concatenate((best[b:c], best[a:b]))  # two neighbouring parts change places
        _improve(tour, cost)
        length = _length(tour, cost)
        if length < best_cost - 1e-9:
            best[:], best_cost = tour, length
    return best


@kernel
def _length(tour: Int64, cost: Float64) -> float:
    end = len(cost) - 1
    total = cost[end, tour[0]] + cost[tour[-1], end]
    for k in range(len(tour) - 1):
        total += cost[tour[k], tour[k + 1]]
    return float(total)


@kernel
def _greedy(cost: Float64) -> Int64:
    n = len(cost) // 2
    tour, is_left, last = np.empty(n, np.int64), np.ones(n, np.bool_), len(cost) - 1
    for k in range(n):
        best, least = -1, np.inf
        for v in range(2 * n):
            if is_left[v // 2] and (cost[last, v] < least or best < 0):
                best, least = v, cost[last, v]
        tour[k], is_left[best // 2], last = best, False, best
    return tour


@kernel
def _improve(tour: Int64, cost: Float64) -> None:
    """To a local optimum of turning a part around and of moving up to three lines."""
    for _ in range(MAX_SWEEPS):
        is_better = _turn_parts(tour, cost)
        if not (_move_parts(tour, cost) or is_better):
            return


@kernel
def _turn_parts(tour: Int64, cost: Float64) -> bool:
    n, end, is_better = len(tour), len(cost) - 1, False
    for i in range(n):
        for j in range(i, n):
            before = tour[i - 1] if i > 0 else end
            after = tour[j + 1] if j + 1 < n else end
            old = cost[before, tour[i]] + cost[tour[j], after]
            if cost[before, tour[j] ^ 1] + cost[tour[i] ^ 1, after] < old - 1e-6:
                tour[i : j + 1] = tour[i : j + 1][::-1].copy() ^ 1
                is_better = True
    return is_better


@kernel
def _move_parts(tour: Int64, cost: Float64) -> bool:
    n, end, is_better = len(tour), len(cost) - 1, False
    for size in range(1, min(4, n)):
        for i in range(n - size + 1):
            first, last = tour[i], tour[i + size - 1]
            before, after = (tour[i - 1] if i > 0 else end), (tour[i + size] if i + size < n else end)
            gain = cost[before, first] + cost[last, after] - cost[before, after]
            best, best_at, is_turned = gain - 1e-6, -1, False
            a = end
            for at in range(n - size + 1):  # between two lines of the others
                b = end if at == n - size else tour[at if at < i else at + size]
                base = -cost[a, b]
                if base + cost[a, first] + cost[last, b] < best:
                    best, best_at, is_turned = base + cost[a, first] + cost[last, b], at, False
                if base + cost[a, last ^ 1] + cost[first ^ 1, b] < best:
                    best, best_at, is_turned = base + cost[a, last ^ 1] + cost[first ^ 1, b], at, True
                a = b
            if best_at >= 0:
                part, rest = tour[i : i + size].copy(), np.concatenate((tour[:i], tour[i + size :]))
                moved = part[::-1].copy() ^ 1 if is_turned else part
                tour[:] = np.concatenate((rest[:best_at], moved, rest[best_at:]))
                is_better = True
    return is_better

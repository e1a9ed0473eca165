"""In which order and direction swaths are driven so that the way between them is short."""

from collections.abc import Callable

Visit = tuple[int, bool]
Cost = Callable[[Visit | None, Visit | None], float]  # None: where the tour comes from, or goes to


def order(count: int, cost: Cost) -> list[Visit]:
    """The visits (number, is reversed) in a good order: the best greedy tour, then improved until nothing helps."""
    if count == 0:
        return []
    starts: list[Visit] = [(k, r) for k in range(count) for r in (False, True)]
    starts.sort(key=lambda v: (cost(None, v), v))
    tours = [_improved(_greedy(count, first, cost), cost) for first in starts[:8]]
    return min(tours, key=lambda t: (round(_length(t, cost), 6), t))


def _greedy(count: int, first: Visit, cost: Cost) -> list[Visit]:
    tour, left = [first], [k for k in range(count) if k != first[0]]
    while left:
        last = tour[-1]
        best = min(((k, r) for k in left for r in (False, True)), key=lambda v: (cost(last, v), v))
        tour.append(best)
        left.remove(best[0])
    return tour


def _improved(tour: list[Visit], cost: Cost) -> list[Visit]:
    length = _length(tour, cost)
    while True:
        better = min(((_length(t, cost), t) for t in _neighbours(tour)), default=(length, tour))
        if better[0] > length - 1e-6:
            return tour
        length, tour = better


def _neighbours(tour: list[Visit]) -> list[list[Visit]]:
    """Tours with a stretch reversed, turned round, or moved elsewhere."""
    n, out = len(tour), []
    for i in range(n):
        for j in range(i + 1, n + 1):
            middle = tour[i:j]
            turned = [(k, not r) for k, r in reversed(middle)]
            out.append(tour[:i] + turned + tour[j:])
            out.append(tour[:i] + list(reversed(middle)) + tour[j:])
            if j - i <= 3:
                rest = tour[:i] + tour[j:]
                for at in range(len(rest) + 1):
                    out += [rest[:at] + m + rest[at:] for m in (middle, turned) if at != i]
    return out


def _length(tour: list[Visit], cost: Cost) -> float:
    ends = [None, *tour, None]
    return sum(cost(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True))

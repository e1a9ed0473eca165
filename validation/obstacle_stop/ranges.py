"""Detection ranges, and exact confidence bounds of shares and rates."""

from collections.abc import Iterable, Sequence

from scipy.special import betaincinv, gammaincinv

IN_A_ROW = 3
Flag = tuple[float, bool]


def range_without_failure(flags: Iterable[Flag]) -> float | None:
    """Largest range of (range, detected) below which all are detected; None when the nearest is not."""
    best = None
    for range_m, is_found in sorted(flags, key=lambda f: (f[0], f[1])):
        if not is_found:
            break
        best = range_m
    return best


def confirmed(flags: Sequence[Flag]) -> list[Flag]:
    """The same in order of time, detected when three in a row are; two fewer than given."""
    return [
        (flags[k][0], all(found for _, found in flags[k - IN_A_ROW + 1 : k + 1]))
        for k in range(IN_A_ROW - 1, len(flags))
    ]


def lost_from(flags: Iterable[Flag]) -> float | None:
    """Smallest range without detection; None when all are detected."""
    return min((range_m for range_m, is_found in flags if not is_found), default=None)


def share_bounds(count: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact bounds of a share (Clopper and Pearson 1934)."""
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if count == 0 else float(betaincinv(count, of - count + 1, tail))
    high = 1.0 if count >= of else float(betaincinv(count + 1, of - count, 1.0 - tail))
    return low, high


def rate_bounds(count: int, time: float, confidence: float = 0.95) -> tuple[float, float | None]:
    """Exact bounds of a rate of independent events (Garwood 1936); no upper bound without time."""
    if time <= 0.0:
        return 0.0, None
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if count == 0 else float(gammaincinv(count, tail)) / time
    return low, float(gammaincinv(count + 1, 1.0 - tail)) / time

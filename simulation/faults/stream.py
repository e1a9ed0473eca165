"""Faults of order, number and time of a device's messages; changes of content are passed in."""

from collections.abc import Callable
from typing import Generic, TypeVar

from simulation.faults.config import FaultKind

T = TypeVar("T")
DELAY_IN_AGES, SLOW_IN_AGES = 2.0, 3.0
STREAM_KINDS = tuple(FaultKind)[:6]


class FaultStream(Generic[T]):
    """One faulty device: `apply` takes a sent item and returns delivered items with their times.

    `renew` gives the content of its first argument the stamp or counter of its second; `corrupt` changes the content.
    """

    def __init__(
        self, kind: FaultKind, max_age_ns: int, renew: Callable[[T, T], T], corrupt: Callable[[FaultKind, T], T]
    ) -> None:
        self._kind, self._renew, self._corrupt = kind, renew, corrupt
        self._delay_ns, self._pause_ns = round(DELAY_IN_AGES * max_age_ns), round(SLOW_IN_AGES * max_age_ns)
        self._last: T | None = None
        self._held: T | None = None
        self._passed_ns: int | None = None

    def apply(self, now_ns: int, item: T) -> list[tuple[int, T]]:
        """Delivery times and items after one sent item."""
        kind = self._kind
        if kind not in STREAM_KINDS:
            return [(now_ns, self._corrupt(kind, item))]
        if kind is FaultKind.OFF:
            return []
        if kind is FaultKind.DELAYED:
            return [(now_ns + self._delay_ns, item)]
        if kind is FaultKind.OUT_OF_ORDER:
            return self._swap(now_ns, item)
        if kind is FaultKind.SLOW:
            return self._decimate(now_ns, item)
        self._last = item if self._last is None else self._last
        return [(now_ns, self._last if kind is FaultKind.REPEATED else self._renew(self._last, item))]

    def _swap(self, now_ns: int, item: T) -> list[tuple[int, T]]:
        before, self._held = self._held, item
        if before is None:
            return []
        self._held = None
        return [(now_ns, item), (now_ns, before)]

    def _decimate(self, now_ns: int, item: T) -> list[tuple[int, T]]:
        if self._passed_ns is not None and 0 <= now_ns - self._passed_ns < self._pause_ns:
            return []
        self._passed_ns = now_ns
        return [(now_ns, item)]

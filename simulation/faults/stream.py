"""Faults of order, number and time of a device's messages; changes of content are passed in."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from simulation.faults.config import STREAM_FAULTS, FaultKind

T = TypeVar("T")
DELAY_IN_AGES, SLOW_IN_AGES = 2.0, 3.0


class FaultStream(Generic[T]):
    """One faulty device: `apply` takes a sent item and returns delivered items with their times.

    `renew` gives the content of its first argument the stamp or counter of its second; `corrupt` changes the content,
    the given seconds after the fault began.
    """

    def __init__(
        self, kind: FaultKind, max_age_ns: int, replay_s: float, renew: Callable[[T, T], T],
        corrupt: Callable[[T, float], T],
    ) -> None:  # fmt: skip
        self._kind, self._renew, self._corrupt = kind, renew, corrupt
        self._delay_ns, self._pause_ns = round(DELAY_IN_AGES * max_age_ns), round(SLOW_IN_AGES * max_age_ns)
        self._replay_ns, self._replayed = round(1e9 * replay_s), deque[T]()
        self._began_ns: int | None = None
        self._last: T | None = None
        self._held: T | None = None
        self._passed_ns: int | None = None

    def apply(self, now_ns: int, item: T) -> list[tuple[int, T]]:
        """Delivery times and items after one sent item."""
        kind = self._kind
        self._began_ns = now_ns if self._began_ns is None else self._began_ns
        if kind not in STREAM_FAULTS:
            return [(now_ns, self._corrupt(item, (now_ns - self._began_ns) * 1e-9))]
        if kind is FaultKind.OFF:
            return []
        if kind is FaultKind.DELAYED:
            return [(now_ns + self._delay_ns, item)]
        if kind is FaultKind.OUT_OF_ORDER:
            return self._swap(now_ns, item)
        if kind is FaultKind.SLOW:
            return self._decimate(now_ns, item)
        if kind is FaultKind.REPLAY:
            return [(now_ns, self._replay(now_ns - self._began_ns, item))]
        self._last = item if self._last is None else self._last
        return [(now_ns, self._last if kind is FaultKind.REPEATED else self._renew(self._last, item))]

    def _replay(self, since_ns: int, item: T) -> T:
        if since_ns < self._replay_ns or not self._replayed:
            self._replayed.append(item)
            return item
        self._replayed.rotate(-1)
        return self._renew(self._replayed[-1], item)

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

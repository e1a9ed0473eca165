"""For how long something has held, and what was commanded lately: the memory that rules themselves do not have."""

from collections import deque


class DebounceTimer:
    """Seconds since a condition began to hold without a break."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    @property
    def is_held(self) -> bool:
        """Whether the condition held when last asked."""
        return self._since_ns is not None

    def update(self, now_ns: int, holds: bool) -> float:
        """Says whether it holds now; gives for how long it has."""
        if not holds:
            self._since_ns = None
            return 0.0
        if self._since_ns is None or self._since_ns > now_ns:
            self._since_ns = now_ns
        return (now_ns - self._since_ns) * 1e-9


class RecentRange:
    """The range of a value over the last moments."""

    def __init__(self, length_s: float) -> None:
        self._length_ns = round(length_s * 1e9)
        self._stamps: deque[int] = deque()
        self._values: deque[float] = deque()

    def add(self, now_ns: int, value: float) -> None:
        """Take the newest."""
        self._stamps.append(now_ns)
        self._values.append(value)
        while now_ns - self._stamps[0] > self._length_ns:
            self._stamps.popleft()
            self._values.popleft()

    def distance(self, value: float) -> float:
        """How far a value lies outside the range; 0 inside, or when nothing is known."""
        if not self._values:
            return 0.0
        return max(min(self._values) - value, value - max(self._values), 0.0)

"""Memory of conditions: how long they have held, the range of recent values, faults reported by other nodes."""

import math
from collections import deque
from collections.abc import Iterable

from messages.faults import Fault


class DebounceTimer:
    """Seconds for which a condition has held without interruption."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    @property
    def is_held(self) -> bool:
        """Whether the condition held at the last update."""
        return self._since_ns is not None

    def update(self, now_ns: int, holds: bool) -> float:
        """Takes the condition now; returns its duration."""
        if not holds:
            self._since_ns = None
            return 0.0
        if self._since_ns is None or self._since_ns > now_ns:
            self._since_ns = now_ns
        return (now_ns - self._since_ns) * 1e-9


class RecentDuration:
    """Seconds for which a condition has held in the last `length_s`, with interruptions; cleared while not watched."""

    def __init__(self, length_s: float) -> None:
        self._length_ns = round(length_s * 1e9)
        self._held: deque[tuple[int, int]] = deque()  # from, to
        self._since_ns: int | None = None

    def update(self, now_ns: int, is_watched: bool, holds: bool) -> float:
        """Takes the condition now, which holds until the next update; returns the sum of its durations."""
        if not is_watched:
            self._held.clear()
            self._since_ns = None
            return 0.0
        if self._since_ns is not None and now_ns > self._since_ns:
            self._held.append((self._since_ns, now_ns))
        self._since_ns = now_ns if holds else None
        while self._held and not 0 <= now_ns - self._held[0][1] < self._length_ns:
            self._held.popleft()
        return sum(end_ns - begin_ns for begin_ns, end_ns in self._held) * 1e-9


class RecentRange:
    """Range of a value over the last `length_s`."""

    def __init__(self, length_s: float) -> None:
        self._length_ns = round(length_s * 1e9)
        self._stamps: deque[int] = deque()
        self._values: deque[float] = deque()

    def add(self, now_ns: int, value: float) -> None:
        """Adds the newest value."""
        self._stamps.append(now_ns)
        self._values.append(value)
        while now_ns - self._stamps[0] > self._length_ns:
            self._stamps.popleft()
            self._values.popleft()

    @property
    def lowest(self) -> float:
        """The lowest value; infinite without values."""
        return min(self._values, default=math.inf)

    def distance(self, value: float) -> float:
        """Distance of a value from the range; 0 inside, and without values."""
        if not self._values:
            return 0.0
        return max(min(self._values) - value, value - max(self._values), 0.0)


class FaultMemory:
    """Active faults by source and code; a latched one stays after its end until a reset by the operator."""

    def __init__(self) -> None:
        self._active: dict[tuple[str, str], Fault] = {}
        self._ended: set[tuple[str, str]] = set()

    @property
    def active(self) -> tuple[Fault, ...]:
        """All active faults, earliest first."""
        return tuple(self._active.values())

    def update(self, faults: Iterable[Fault]) -> None:
        """Takes fault messages: begin and end."""
        for fault in faults:
            key = (fault.source, fault.code)
            if fault.is_active:
                self._active.setdefault(key, fault)
                self._ended.discard(key)
            elif key in self._active and self._active[key].is_latched:
                self._ended.add(key)
            else:
                self._active.pop(key, None)

    def reset(self) -> None:
        """Removes latched faults that have ended."""
        self._active = {key: fault for key, fault in self._active.items() if key not in self._ended}
        self._ended = set()

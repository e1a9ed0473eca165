"""Messages looked up by their stamps."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Generic, TypeVar

from messages.message import Message

M = TypeVar("M", bound=Message)


def nearest(stamps_ns: Sequence[int], stamp_ns: int, max_age_ns: int) -> int | None:
    """Index of the nearest of sorted stamps within an age, or None."""
    k = bisect_left(stamps_ns, stamp_ns)
    near = [j for j in (k - 1, k) if 0 <= j < len(stamps_ns)]
    best = min(near, key=lambda j: abs(stamps_ns[j] - stamp_ns), default=None)
    return best if best is not None and abs(stamps_ns[best] - stamp_ns) <= max_age_ns else None


class ByStamp(Generic[M]):
    """Messages in order of their stamps; `take_before` bounds their number."""

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.messages: list[M] = []

    def add(self, message: M) -> None:
        """Inserts a message; of equal stamps the first one stays."""
        k = bisect_left(self.stamps_ns, message.stamp_ns)
        if k == len(self.stamps_ns) or self.stamps_ns[k] != message.stamp_ns:
            self.stamps_ns.insert(k, message.stamp_ns)
            self.messages.insert(k, message)

    def nearest(self, stamp_ns: int, max_age_ns: int) -> M | None:
        """The nearest message within an age, or None."""
        k = nearest(self.stamps_ns, stamp_ns, max_age_ns)
        return None if k is None else self.messages[k]

    def take_before(self, stamp_ns: int) -> list[M]:
        """Removes and returns the messages with earlier stamps."""
        k = bisect_left(self.stamps_ns, stamp_ns)
        taken = self.messages[:k]
        del self.stamps_ns[:k], self.messages[:k]
        return taken

"""Attendance: whether the operator who has automatic operation started is still there."""

from interfaces.orders.config import OrderKey

TAKES_OVER = ("start", "resume", "reset")


class Attendance:
    """The key that gave the last start, resume or reset, and when an order of it was accepted last."""

    def __init__(self) -> None:
        self._key: OrderKey | None = None
        self._seen_ns = 0

    def take(self, now_ns: int, key: OrderKey, order: str) -> None:
        """An order was accepted."""
        if order in TAKES_OVER:
            self._key = key
        if key is self._key:
            self._seen_ns = now_ns

    def is_lost(self, now_ns: int) -> bool:
        """Whether nothing of that key was accepted within its `lost_operator_s`."""
        limit_s = None if self._key is None else self._key.lost_operator_s
        return limit_s is not None and abs(now_ns - self._seen_ns) * 1e-9 > limit_s

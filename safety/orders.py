"""Orders of people: with authority, in rising sequence, not expired; an emergency stop is taken from anyone, always."""

from collections.abc import Iterable

from messages.command import OperatorOrder, Order
from safety.modes import Event

EVENTS = {
    Order.START: Event.START,
    Order.RESUME: Event.START,
    Order.PAUSE: Event.PAUSE,
    Order.EMERGENCY_STOP: Event.EMERGENCY,
    Order.RESET: Event.RESET,
    Order.MANUAL: Event.MANUAL,
    Order.AUTOMATIC: Event.AUTOMATIC,
}


class Orders:
    """Judges orders; a start that cannot be followed yet waits until it expires or another order comes."""

    def __init__(self, authorities: tuple[str, ...]) -> None:
        self.refused = 0
        self._sequence = dict.fromkeys(authorities, -1)
        self._waiting: OperatorOrder | None = None

    def events(self, now_ns: int, orders: Iterable[OperatorOrder]) -> frozenset[Event]:
        """What people ask for at this moment."""
        asked = {EVENTS[order.order] for order in orders if self._accept(now_ns, order)}
        if self._waiting is not None and now_ns > self._waiting.expires_ns:
            self._waiting = None
        return frozenset(asked - {Event.START} if self._waiting is None else asked | {Event.START})

    def forget_start(self) -> None:
        """A start that was followed, or overtaken by a stop, asks no more."""
        self._waiting = None

    def _accept(self, now_ns: int, order: OperatorOrder) -> bool:
        if order.order is Order.EMERGENCY_STOP:
            self._waiting = None
            return True
        last = self._sequence.get(order.authority)
        if last is None or order.sequence <= last or now_ns > order.expires_ns:
            self.refused += 1
            return False
        self._sequence[order.authority] = order.sequence
        self._waiting = order if order.order in (Order.START, Order.RESUME) else None
        return True

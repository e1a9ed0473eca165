"""Orders of people: with authority, in rising sequence, not expired; an emergency stop is taken from anyone, always."""

from collections.abc import Iterable

from messages.command import OperatorCommand, OperatorCommandKind
from safety.modes import Event

EVENTS = {
    OperatorCommandKind.START: Event.START,
    OperatorCommandKind.RESUME: Event.START,
    OperatorCommandKind.PAUSE: Event.PAUSE,
    OperatorCommandKind.EMERGENCY_STOP: Event.EMERGENCY,
    OperatorCommandKind.RESET: Event.RESET,
    OperatorCommandKind.MANUAL: Event.MANUAL,
    OperatorCommandKind.AUTOMATIC: Event.AUTOMATIC,
}


class Orders:
    """Judges orders; a start that cannot be followed yet waits until it expires or another order comes."""

    def __init__(self, authorities: tuple[str, ...]) -> None:
        self.refused = 0
        self._sequence = dict.fromkeys(authorities, -1)
        self._waiting: OperatorCommand | None = None

    def events(self, now_ns: int, orders: Iterable[OperatorCommand]) -> frozenset[Event]:
        """What people ask for at this moment."""
        asked = {EVENTS[order.kind] for order in orders if self._accept(now_ns, order)}
        if self._waiting is not None and now_ns > self._waiting.expires_ns:
            self._waiting = None
        return frozenset(asked - {Event.START} if self._waiting is None else asked | {Event.START})

    def forget_start(self) -> None:
        """A start that was followed, or overtaken by a stop, asks no more."""
        self._waiting = None

    def _accept(self, now_ns: int, order: OperatorCommand) -> bool:
        if order.kind is OperatorCommandKind.EMERGENCY_STOP:
            self._waiting = None
            return True
        last = self._sequence.get(order.authority)
        if last is None or order.sequence <= last or now_ns > order.expires_ns:
            self.refused += 1
            return False
        self._sequence[order.authority] = order.sequence
        self._waiting = order if order.kind in (OperatorCommandKind.START, OperatorCommandKind.RESUME) else None
        return True

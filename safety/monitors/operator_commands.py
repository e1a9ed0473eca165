"""Operator commands: accepted with a known authority, a rising sequence number and before their expiry.

An emergency stop is always accepted.
"""

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


class OperatorCommands:
    """Accepts or refuses commands; a start stays pending until executed, expired or superseded by another command."""

    def __init__(self, authorities: tuple[str, ...]) -> None:
        self.refused_count = 0
        self._sequence = dict.fromkeys(authorities, -1)
        self._pending: OperatorCommand | None = None

    def events(self, now_ns: int, commands: Iterable[OperatorCommand]) -> frozenset[Event]:
        """Events of the accepted commands and of a pending start."""
        requested = {EVENTS[command.kind] for command in commands if self._accept(now_ns, command)}
        if self._pending is not None and now_ns > self._pending.expires_ns:
            self._pending = None
        return frozenset(requested - {Event.START} if self._pending is None else requested | {Event.START})

    def forget_start(self) -> None:
        """Clears the pending start: executed, or superseded by a stop."""
        self._pending = None

    def _accept(self, now_ns: int, command: OperatorCommand) -> bool:
        if command.kind is OperatorCommandKind.EMERGENCY_STOP:
            self._pending = None
            return True
        last = self._sequence.get(command.authority)
        if last is None or command.sequence <= last or now_ns > command.expires_ns:
            self.refused_count += 1
            return False
        self._sequence[command.authority] = command.sequence
        self._pending = command if command.kind in (OperatorCommandKind.START, OperatorCommandKind.RESUME) else None
        return True

"""Operator commands: accepted with a known authority, a rising sequence number and before their expiry.

An emergency stop is always accepted, a confirmation that nobody is near the machine only with a short validity.
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

    def __init__(self, authorities: tuple[str, ...], max_confirmation_s: float, max_pending_s: float) -> None:
        self.refused_count = 0
        self.is_just_confirmed = False
        self._max_confirmation_ns, self._max_pending_ns = (round(s * 1e9) for s in (max_confirmation_s, max_pending_s))
        self._confirmed_until_ns: int | None = None
        self._sequence = dict.fromkeys(authorities, -1)
        self._pending_until_ns: int | None = None  # of a start

    def events(self, now_ns: int, commands: Iterable[OperatorCommand]) -> frozenset[Event]:
        """Events of the accepted commands and of a pending start."""
        accepted = [command.kind for command in commands if self._accept(now_ns, command)]
        self.is_just_confirmed = OperatorCommandKind.CONFIRM_CLEAR in accepted
        requested = {EVENTS[kind] for kind in accepted if kind in EVENTS}
        if self._pending_until_ns is not None and now_ns > self._pending_until_ns:
            self._pending_until_ns = None
        return frozenset(requested | {Event.START} if self.is_start_pending else requested - {Event.START})

    def is_confirmed(self, now_ns: int) -> bool:
        """Whether an operator has confirmed that nobody is near the machine, and the confirmation has not expired."""
        return self._confirmed_until_ns is not None and now_ns <= self._confirmed_until_ns

    def forget_confirmation(self) -> None:
        """Clears the confirmation: used for a start, or no longer valid."""
        self._confirmed_until_ns = None

    @property
    def is_start_pending(self) -> bool:
        """Whether a start waits for its execution."""
        return self._pending_until_ns is not None

    def forget_start(self) -> None:
        """Clears the pending start: executed, or superseded by a stop."""
        self._pending_until_ns = None

    def _accept(self, now_ns: int, command: OperatorCommand) -> bool:
        if command.kind is OperatorCommandKind.EMERGENCY_STOP:
            self._pending_until_ns = None
            return True
        last = self._sequence.get(command.authority)
        if last is None or command.sequence <= last or now_ns > command.expires_ns:
            self.refused_count += 1
            return False
        is_confirmation = command.kind is OperatorCommandKind.CONFIRM_CLEAR
        if is_confirmation and command.expires_ns - now_ns > self._max_confirmation_ns:
            self.refused_count += 1
            return False
        self._sequence[command.authority] = command.sequence
        if is_confirmation:
            self._confirmed_until_ns = command.expires_ns
            return True
        is_start = EVENTS.get(command.kind) is Event.START
        self._pending_until_ns = min(command.expires_ns, now_ns + self._max_pending_ns) if is_start else None
        return True

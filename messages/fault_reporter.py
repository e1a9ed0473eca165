"""Fault messages of one source: each fault is reported once when it begins and once when it ends."""

from collections.abc import Iterable
from dataclasses import dataclass

from messages.faults import Fault, Response, Severity


@dataclass(frozen=True)
class FaultType:
    """The constant part of a fault message."""

    code: str
    severity: Severity
    response: Response
    text_en: str
    text_zh: str
    is_latched: bool = False


class FaultReporter:
    """Holds the active faults of `source` and turns changes of state into messages, in the order of the calls."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._active: dict[str, FaultType] = {}
        self._changes: list[tuple[FaultType, bool, str]] = []

    @property
    def active_codes(self) -> tuple[str, ...]:
        """Codes of the active faults, oldest first."""
        return tuple(self._active)

    def is_active(self, code: str) -> bool:
        """Whether a fault is active."""
        return code in self._active

    def set(self, fault: FaultType, is_active: bool = True, detail: str = "") -> None:
        """Sets the state of a fault; only a change becomes a message, with `detail` in brackets after its texts."""
        if is_active == self.is_active(fault.code):
            return
        if is_active:
            self._active[fault.code] = fault
        else:
            del self._active[fault.code]
        self._changes.append((fault, is_active, detail))

    def clear(self, code: str) -> None:
        """Ends a fault, with the texts that it began with."""
        if code in self._active:
            self.set(self._active[code], False)

    def report_event(self, fault: FaultType, detail: str = "") -> None:
        """Reports a fault that begins and ends at once."""
        self._changes += [(fault, True, detail), (fault, False, detail)]

    def take(self, now_ns: int) -> list[Fault]:
        """Messages of the changes since the last call."""
        changes, self._changes = self._changes, []
        return [self._message(now_ns, *change) for change in changes]

    def update(self, now_ns: int, states: Iterable[tuple[FaultType, bool]]) -> list[Fault]:
        """Sets the states of several faults; messages of the changes."""
        for fault, is_active in states:
            self.set(fault, is_active)
        return self.take(now_ns)

    def _message(self, now_ns: int, fault: FaultType, is_active: bool, detail: str) -> Fault:
        more = f" ({detail})" if detail else ""
        return Fault(
            now_ns, fault.code, self._source, fault.severity, fault.is_latched, fault.response, is_active,
            fault.text_en + more, fault.text_zh + more,
        )  # fmt: skip

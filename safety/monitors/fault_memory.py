"""Faults that others report: which hold now."""

from collections.abc import Iterable

from messages.faults import Fault


class FaultMemory:
    """Active faults by source and code; a latched one stays until a person resets it after it has ended."""

    def __init__(self) -> None:
        self._active: dict[tuple[str, str], Fault] = {}
        self._ended: set[tuple[str, str]] = set()

    @property
    def active(self) -> tuple[Fault, ...]:
        """All that hold, earliest first."""
        return tuple(self._active.values())

    def update(self, faults: Iterable[Fault]) -> None:
        """Begin and end what was reported."""
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
        """A person has seen what ended."""
        self._active = {key: fault for key, fault in self._active.items() if key not in self._ended}
        self._ended = set()

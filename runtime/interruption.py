"""SIGINT and SIGTERM: a drive ends with its log closed and its report written; a second signal ends it at once."""

import signal
from types import FrameType
from typing import Any, Self


class Interruption:
    """Context in which SIGINT and SIGTERM are noted instead of raised; the second one raises KeyboardInterrupt."""

    def __init__(self) -> None:
        self._signal = 0
        self._before: dict[int, Any] = {}

    @property
    def is_requested(self) -> bool:
        """Whether a signal has arrived."""
        return self._signal != 0

    @property
    def exit_code(self) -> int:
        """Exit code of a process ended by the signal, 0 without one."""
        return 128 + self._signal if self._signal else 0

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._signal:
            raise KeyboardInterrupt
        self._signal = number

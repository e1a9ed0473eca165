"""Common monotonic clock of all processes, independent of steps of the wall clock."""

import time


class Clock:
    """Clock that reads `start_ns` at `zero_ns` of CLOCK_MONOTONIC, which the processes of one computer share."""

    def __init__(self, start_ns: int, zero_ns: int) -> None:
        self._offset_ns = start_ns - zero_ns

    def __call__(self) -> int:
        """Current time in ns."""
        return time.monotonic_ns() + self._offset_ns

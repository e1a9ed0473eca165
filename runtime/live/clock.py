"""One clock for all processes: the machine's own running time, so a step of the wall clock changes nothing."""

import time


class Clock:
    """`start_ns` at the moment `zero_ns` of CLOCK_MONOTONIC, which all processes of one computer share."""

    def __init__(self, start_ns: int, zero_ns: int) -> None:
        self._offset_ns = start_ns - zero_ns

    def __call__(self) -> int:
        """Now, in ns."""
        return time.monotonic_ns() + self._offset_ns

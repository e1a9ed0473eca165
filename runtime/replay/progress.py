"""Progress of a pass over a long log, on standard error."""

import sys
import time

EVERY_S = 10.0  # of work between two lines; a short log prints none


class PassProgress:
    """Call `at` with times of the log; prints lines like `drive.mcap: replayed 432 of 3600 s, about 23 min left`.

    `verb` is what is done with the log; `span_ns` its first and last time, where they are known.
    """

    def __init__(self, name: str, verb: str, span_ns: tuple[int, int] | None = None) -> None:
        self._head, self._span_ns = f"{name}: {verb}", span_ns
        self._began_s = self._shown_s = time.monotonic()
        self._first_ns: int | None = None if span_ns is None else span_ns[0]

    def at(self, log_ns: int) -> None:
        """The pass has come to a time of the log."""
        self._first_ns = log_ns if self._first_ns is None else self._first_ns
        now_s = time.monotonic()
        if now_s - self._shown_s >= EVERY_S:
            self._shown_s = now_s
            sys.stderr.write(f"{self._head} {self._text((log_ns - self._first_ns) * 1e-9, now_s - self._began_s)}\n")
            sys.stderr.flush()

    def _text(self, done_s: float, worked_s: float) -> str:
        if self._span_ns is None:
            return f"{done_s:.0f} s of the log"
        total_s = (self._span_ns[1] - self._span_ns[0]) * 1e-9
        left_min = worked_s * max(0.0, total_s / max(done_s, 1e-3) - 1.0) / 60.0
        return f"{done_s:.0f} of {total_s:.0f} s, about {left_min:.0f} min left"

"""Heartbeat: counter that shows that a control function is alive (ISO 11783-7, PGN 61668)."""

GROUP = 0xF0E4
START = 251
COUNTS = 251
ERROR = 254
SHUT_DOWN = 255
GAP_NS = 300_000_000
MAX_JUMP = 3
GOOD_TO_RECOVER = 8


class Heartbeat:
    """Sender: 251 first and after an error, then 0 to 250 repeatedly."""

    def __init__(self) -> None:
        self._sent: int | None = None

    def encode(self) -> bytes:
        """The next byte."""
        self._sent = START if self._sent is None else after(self._sent)
        return bytes([self._sent])

    def encode_error(self) -> bytes:
        """The byte that sends every receiver to its safe state."""
        self._sent = None
        return bytes([ERROR])


class HeartbeatCheck:
    """Receiver check: in error after a repeat, a jump over 3, a gap over 300 ms or an error reported by the sender.

    Recovers after 8 consecutive valid values; a start (251) is valid and begins a new count.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._last_ns = 0
        self._good = 0
        self._is_failed = False

    def is_good(self, now_ns: int) -> bool:
        """Whether the sender is alive now."""
        return self._last is not None and not self._is_failed and now_ns - self._last_ns <= GAP_NS

    def receive(self, now_ns: int, sequence: int) -> bool:
        """Processes one byte; true when it is valid."""
        is_next = self._follows(sequence) and (self._last is None or now_ns - self._last_ns <= GAP_NS)
        self._last, self._last_ns = sequence, now_ns
        self._good = self._good + 1 if is_next else 0
        self._is_failed = not is_next or (self._is_failed and self._good < GOOD_TO_RECOVER)
        return is_next

    def _follows(self, sequence: int) -> bool:
        if sequence > START:
            return False
        if sequence == START:
            return self._last != START
        if self._last is None:
            return True
        return (sequence - after(self._last)) % COUNTS < MAX_JUMP


def after(sequence: int) -> int:
    """The byte that follows."""
    return 0 if sequence >= COUNTS - 1 else sequence + 1

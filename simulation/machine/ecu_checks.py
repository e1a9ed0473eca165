"""Checks of the tractor ECU on received frames: checksum, counter, heartbeat, time-outs, stop-all."""

HEARTBEAT_START, HEARTBEAT_LAST = 251, 250
RECOVERY_COUNT = 8


def xbr_checksum(identifier: int, data: bytes) -> int:
    """Checksum of a frame with counter and checksum in byte 8 (J1939-71, external brake request)."""
    total = sum(data[:7]) + (data[7] & 0x0F) + sum(identifier.to_bytes(4, "big"))
    return ((total >> 4) + total) & 0x0F


def is_checksum_good(identifier: int, data: bytes) -> bool:
    """True if the upper half of byte 8 is the frame's checksum."""
    return len(data) == 8 and data[7] >> 4 == xbr_checksum(identifier, data)


class Counter:
    """Detects a repeated counter: a frame sent twice or a frozen sender."""

    def __init__(self) -> None:
        self._last: int | None = None

    def accept(self, value: int) -> bool:
        """True if the counter changed."""
        is_new = value != self._last
        self._last = value
        return is_new


class Deadline:
    """Time-out since the last valid frame."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_ns = round(timeout_s * 1e9)
        self._last_ns: int | None = None

    def renew(self, now_ns: int) -> None:
        """Records a valid frame."""
        self._last_ns = now_ns

    def is_met(self, now_ns: int) -> bool:
        """False before the first frame and after the time-out."""
        return self._last_ns is not None and now_ns - self._last_ns <= self._timeout_ns


class Heartbeat:
    """The gateway's heartbeat: a repeat, a jump over 3 or a gap is an error; 8 valid ones in sequence recover."""

    def __init__(self, timeout_s: float) -> None:
        self._deadline = Deadline(timeout_s)
        self._last: int | None = None
        self._good_in_row = RECOVERY_COUNT

    def receive(self, now_ns: int, sequence: int) -> None:
        """Processes a sequence number."""
        is_in_time = self._last is None or self._deadline.is_met(now_ns)
        is_good = is_in_time and is_sequence_good(self._last, sequence)
        self._good_in_row = self._good_in_row + 1 if is_good else 0
        self._last = sequence if sequence <= HEARTBEAT_START else None
        self._deadline.renew(now_ns)

    def is_good(self, now_ns: int) -> bool:
        """True if the heartbeat is present and has been valid for `RECOVERY_COUNT` messages."""
        return self._last is not None and self._good_in_row >= RECOVERY_COUNT and self._deadline.is_met(now_ns)


def is_sequence_good(last: int | None, sequence: int) -> bool:
    """True if a heartbeat may follow: 251 first, then 0 to 250 in turn, at most three steps ahead."""
    if sequence > HEARTBEAT_START:
        return False
    if last is None or sequence == HEARTBEAT_START:
        return sequence != last
    step = sequence + 1 if last == HEARTBEAT_START else (sequence - last) % (HEARTBEAT_LAST + 1)
    return 1 <= step <= 3


class StopAll:
    """Stop all implement operations: permitted after a received permit, never after a missed transition."""

    def __init__(self, timeout_s: float) -> None:
        self._deadline = Deadline(timeout_s)
        self._last: tuple[int, int] | None = None
        self._is_permitted = False

    def receive(self, now_ns: int, permit: int, count: int) -> None:
        """Processes state and transition count."""
        before = self._last
        self._last = (permit, count)
        self._deadline.renew(now_ns)
        has_missed = before is not None and permit == before[0] == 1 and count != before[1]
        if permit != 1 or has_missed:
            self._is_permitted = False
        elif before is None or before[0] != 1:
            self._is_permitted = True

    def is_permitted(self, now_ns: int) -> bool:
        """True if the implement may work."""
        return self._is_permitted and self._deadline.is_met(now_ns)

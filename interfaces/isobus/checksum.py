"""Counter and checksum in byte 8, against repetition, misrouting and corruption (J1939-71, XBR)."""

from interfaces.isobus.values import BadFrame, require_length

COUNTS = 16


def checksum(identifier: int, data: bytes) -> int:
    """Four bits over bytes 1–7, the counter and the identifier; `data` holds bytes 1–8 with the counter in byte 8."""
    total = sum(data[:7]) + (data[7] & 15) + sum(identifier.to_bytes(4, "big"))
    return ((total >> 4) + total) & 15


def protect(identifier: int, body: bytes, counter: int) -> bytes:
    """Eight bytes: the seven of `body`, then checksum and counter."""
    count = counter % COUNTS
    return body + bytes([checksum(identifier, body + bytes([count])) << 4 | count])


class ProtectionCheck:
    """Receiver check of one protected message: rejects a wrong checksum, a repeated count and a jump over 3."""

    def __init__(self) -> None:
        self._counter: int | None = None

    def check(self, identifier: int, data: bytes) -> None:
        """Raises BadFrame unless checksum and counter are valid; the counter is stored in any case."""
        require_length(data)
        if checksum(identifier, data) != data[7] >> 4:
            raise BadFrame("checksum")
        counter, last = data[7] & 15, self._counter
        self._counter = counter
        if last is not None and not 1 <= (counter - last) % COUNTS <= 3:
            raise BadFrame(f"counter {counter} after {last}")

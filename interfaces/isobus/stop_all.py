"""Stop all implement operations (ISO 11783-7, PGN 64770)."""

GROUP = 0xFD02
COUNTS = 251


class StopAll:
    """Sender: counts each transition to stop, so that a receiver detects one that it missed."""

    def __init__(self) -> None:
        self._transitions = 0
        self._is_permitted = False

    def encode(self, is_permitted: bool | None) -> bytes:
        """Frame of this state; None is "not available" (a person drives)."""
        if self._is_permitted and is_permitted is False:
            self._transitions = (self._transitions + 1) % COUNTS
        if is_permitted is not None:
            self._is_permitted = is_permitted
        state = 3 if is_permitted is None else int(is_permitted)
        return b"\xff" * 6 + bytes([self._transitions, 0xFC | state])

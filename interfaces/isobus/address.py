"""Address claim (ISO 11783-5, PGN 60928): nobody may send before an address is his."""

from interfaces.isobus.frame import BROADCAST, NULL_ADDRESS, Frame, encode_identifier
from interfaces.isobus.name import Name

CLAIM_GROUP = 0xEE00
REQUEST_GROUP = 0xEA00
WAIT_NS = 250_000_000
SELF_CONFIGURED = range(128, 248)
_PRIORITY = 6


def encode_claim(name: int, address: int) -> Frame:
    """The claim of an address, or with 254 the word that none could be had."""
    return Frame(encode_identifier(_PRIORITY, CLAIM_GROUP, address, BROADCAST), name.to_bytes(8, "little"))


class AddressClaim:
    """One control function's way to an address: claim, wait 250 ms, defend it, give way to a lower NAME."""

    def __init__(self, name: Name, preferred: int) -> None:
        self._name = name.encode()
        self._is_free_to_move = name.self_configurable == 1
        self._address = preferred
        self._claimed_ns: int | None = None
        self._taken: dict[int, int] = {}

    def address(self, now_ns: int) -> int | None:
        """The address once it is ours, None while waiting or when there is none to be had."""
        is_waiting = self._claimed_ns is None or now_ns - self._claimed_ns < WAIT_NS
        return None if is_waiting or self.is_refused else self._address

    @property
    def is_refused(self) -> bool:
        """Whether no address could be had."""
        return self._address == NULL_ADDRESS

    def start(self, now_ns: int) -> Frame:
        """Claim the address and begin to wait."""
        self._claimed_ns = now_ns
        return encode_claim(self._name, self._address)

    def answer_request(self) -> Frame:
        """The answer to a request for claimed addresses."""
        return encode_claim(self._name, self._address)

    def hear(self, now_ns: int, source: int, name: int) -> Frame | None:
        """Take another's claim; what is to be sent then, if anything. Our own NAME from elsewhere is a conflict."""
        self._taken = {a: n for a, n in self._taken.items() if n != name}
        if source != NULL_ADDRESS:
            self._taken[source] = name
        if source != self._address or self.is_refused:
            return None
        if name > self._name:  # ours wins: say so again
            del self._taken[source]
            return encode_claim(self._name, self._address)
        self._address = self._next_free()
        return self.start(now_ns)

    def _next_free(self) -> int:
        free = [a for a in SELF_CONFIGURED if a not in self._taken] if self._is_free_to_move else []
        return free[0] if free else NULL_ADDRESS

"""Address claim (ISO 11783-5, PGN 60928): required before sending any other message."""

from interfaces.isobus.frame import BROADCAST, NULL_ADDRESS, Frame, encode_identifier
from interfaces.isobus.name import Name

CLAIM_GROUP = 0xEE00
REQUEST_GROUP = 0xEA00
WAIT_NS = 250_000_000
SELF_CONFIGURED = range(128, 248)
_PRIORITY = 6


def encode_claim(name: int, address: int) -> Frame:
    """Claim of an address, or "cannot claim" with 254."""
    return Frame(encode_identifier(_PRIORITY, CLAIM_GROUP, address, BROADCAST), name.to_bytes(8, "little"))


class AddressClaim:
    """Address claim of one control function: claim, wait 250 ms, defend it, yield to a lower NAME."""

    def __init__(self, name: Name, preferred: int) -> None:
        self._name = name.encode()
        self._is_self_configurable = name.self_configurable == 1
        self._address = preferred
        self._claimed_ns: int | None = None
        self._claimed: dict[int, int] = {}

    def address(self, now_ns: int) -> int | None:
        """The claimed address; None while waiting or without one."""
        is_waiting = self._claimed_ns is None or now_ns - self._claimed_ns < WAIT_NS
        return None if is_waiting or self.is_refused else self._address

    @property
    def is_refused(self) -> bool:
        """Whether no address could be claimed."""
        return self._address == NULL_ADDRESS

    def start(self, now_ns: int) -> Frame:
        """Claims the address and starts the waiting time."""
        self._claimed_ns = now_ns
        return encode_claim(self._name, self._address)

    def answer_request(self) -> Frame:
        """The answer to a request for claimed addresses."""
        return encode_claim(self._name, self._address)

    def receive_claim(self, now_ns: int, source: int, name: int) -> Frame | None:
        """Processes a claim of another node; returns the reply if any. The own NAME from another node is a conflict."""
        self._claimed = {a: n for a, n in self._claimed.items() if n != name}
        if source != NULL_ADDRESS:
            self._claimed[source] = name
        if source != self._address or self.is_refused:
            return None
        if name > self._name:  # own NAME has priority: repeat the claim
            del self._claimed[source]
            return encode_claim(self._name, self._address)
        self._address = self._next_free()
        return self.start(now_ns)

    def _next_free(self) -> int:
        free = [a for a in SELF_CONFIGURED if a not in self._claimed] if self._is_self_configurable else []
        return free[0] if free else NULL_ADDRESS

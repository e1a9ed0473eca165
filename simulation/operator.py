"""Simulated operator: signs the orders of a scenario with a key of its own, drawn from the seed."""

import json

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from messages.command import OperatorCommandKind, SignedOrder
from simulation.randomness import generator

AUTHORITY = "remote"


class SimulatedOperator:
    """Operator of one machine; `session` is the nonce that the machine published at this start."""

    def __init__(self, seed: int, machine: str, session: str) -> None:
        self._machine, self._session = machine, session
        self._key, self._sequence = operator_key(seed), -1

    def order(self, now_ns: int, kind: OperatorCommandKind, valid_s: float, left_m: float | None = None) -> SignedOrder:
        """The signed order; its number is the time, which rises over restarts too, or the next one."""
        self._sequence = max(now_ns, self._sequence + 1)
        content = {
            "machine": self._machine, "session": self._session, "authority": AUTHORITY, "sequence": self._sequence,
            "order": kind.name.lower(), "signed_ns": now_ns, "expires_ns": now_ns + round(valid_s * 1e9),
        } | ({} if left_m is None else {"left_m": left_m})  # fmt: skip
        payload = json.dumps(content).encode()
        return SignedOrder(now_ns, public_bytes(self._key), self._key.sign(payload), payload)


def operator_key(seed: int) -> Ed25519PrivateKey:
    """Private key of the simulated operator; it is neither logged nor configured."""
    return Ed25519PrivateKey.from_private_bytes(generator(seed, "operator_key").bytes(32))


def public_bytes(key: Ed25519PrivateKey) -> bytes:
    """Public key, 32 bytes."""
    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)

"""Orders of the page: signed with its key and sent to the order port of the machine (docs/orders.md)."""

import json
import os
import socket
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from hmi.page_state import PageState
from messages.command import OperatorCommand, OrderStatus
from messages.errors import HeadlandError

ANSWER_NS = 1_000_000_000


@dataclass(frozen=True)
class SentOrder:
    """An order that was sent: its number, the time of the machine, and the refusals until then by reason.

    `is_check`: the machine verifies it and does nothing.
    """

    order: str
    sequence: int
    sent_ns: int
    refused: dict[str, int]
    is_check: bool = False


class OrderSender:
    """Signs orders with a key of this authority, and sends them to `port` on the loopback interface."""

    def __init__(self, key: Ed25519PrivateKey, authority: str, port: int) -> None:
        self._key, self._authority, self._port = key, authority, port
        self._sequence = -1
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(
        self, order: str, status: OrderStatus, now_ns: int, valid_s: float, left_m: float | None = None,
        is_check: bool = False,
    ) -> SentOrder:  # fmt: skip
        """Sends an order to the machine of this status, void `valid_s` after now (`left_m`: nudge); raises OSError."""
        self._sequence = max(now_ns, self._sequence + 1)
        content = {
            "machine": status.machine, "session": status.session, "authority": self._authority,
            "sequence": self._sequence, "order": order, "signed_ns": now_ns,
            "expires_ns": now_ns + round(valid_s * 1e9),
        }  # fmt: skip
        more = ({} if left_m is None else {"left_m": left_m}) | ({"is_check": True} if is_check else {})
        payload = json.dumps(content | more).encode()
        self._socket.sendto(self._key.sign(payload) + public_key_of(self._key) + payload, ("127.0.0.1", self._port))
        refused = {one.reason: one.count for one in status.refused}
        return SentOrder(order, self._sequence, now_ns, refused, is_check)


def outcome(sent: SentOrder, state: PageState) -> str | None:
    """`accepted`, `unanswered` after a second, or the reason of a refusal; None while the answer is awaited."""
    command, status = state.newest("operator_command", OperatorCommand), state.newest("order_status", OrderStatus)
    if sent.is_check:
        done = -1 if status is None else status.checked
    else:
        done = -1 if command is None else command.sequence
    if done >= sent.sequence:
        return "accepted"
    for one in status.refused if status is not None else ():
        if one.count > sent.refused.get(one.reason, 0):
            return one.reason
    return "unanswered" if state.now_ns - sent.sent_ns > ANSWER_NS else None


def public_key_of(key: Ed25519PrivateKey) -> bytes:
    """Public key, 32 bytes."""
    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


def read_key(path: Path) -> Ed25519PrivateKey:
    """Private key of a PEM file; raises HeadlandError."""
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise HeadlandError(f"{path}: no private key can be read ({error})") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise HeadlandError(f"{path}: not an Ed25519 key; `openssl genpkey -algorithm ed25519` makes one")
    return key


def own_key(path: Path) -> Ed25519PrivateKey:
    """Private key of a file that only this user can read, made on first use; raises HeadlandError."""
    if path.exists():
        return read_key(path)
    key = Ed25519PrivateKey.generate()
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(pem)
    except OSError as error:
        raise HeadlandError(f"{path}: the key of the page cannot be written ({error.strerror})") from error
    return key

"""Verification of one order: signature, machine, session, authority, permission, expiry, sequence and frequency."""

import json
from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from pydantic import Field, ValidationError, model_validator

from configs.strict import Config
from interfaces.orders.attendance import Attendance
from interfaces.orders.config import FORBID, ORDERS, PERMIT, PRESENT, OrderKey, OrdersConfig
from interfaces.orders.sequence import SequenceStore
from messages.command import OperatorCommand, OperatorCommandKind, SignedOrder
from messages.errors import HeadlandError

SECOND_NS = 1_000_000_000
REMEMBERED = 64  # accepted numbers that are recognized as repeated
ANYONE = "anyone"
MAX_BYTES = 1024
STOP, NUDGE = "emergency_stop", "nudge"
MAX_STEP_M = 0.05  # of one nudge
STOPS = (STOP, "pause", FORBID)  # taken however late they come
STARTS = (OperatorCommandKind.START, OperatorCommandKind.RESUME)


class Reason(StrEnum):
    """Why an order is refused."""

    MALFORMED = "malformed"
    UNKNOWN_KEY = "unknown_key"
    FORGED = "forged"
    WRONG_MACHINE = "wrong_machine"
    WRONG_SESSION = "wrong_session"
    NOT_PERMITTED = "not_permitted"
    STALE = "stale"
    REPLAYED = "replayed"
    REORDERED = "reordered"
    TOO_FREQUENT = "too_frequent"
    NOT_STORED = "not_stored"
    FORBIDDEN = "forbidden"
    NOT_ON_SWATH = "not_on_swath"
    OUT_OF_RANGE = "out_of_range"


class Refusal(Exception):
    """An order that is not accepted; the text has the details."""

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


class Payload(Config):
    """What is signed; `left_m` is the parameter of a nudge, `is_check` asks for the verification of an order alone."""

    machine: str = Field(max_length=80)
    session: str = Field(max_length=80)
    authority: str = Field(max_length=40)
    sequence: int = Field(ge=0, lt=1 << 63, strict=True)
    order: str = Field(max_length=40)
    signed_ns: int = Field(ge=0, lt=1 << 63, strict=True)
    expires_ns: int = Field(ge=0, lt=1 << 63, strict=True)
    left_m: float | None = Field(default=None, ge=-MAX_STEP_M, le=MAX_STEP_M, allow_inf_nan=False)
    is_check: bool = Field(default=False, strict=True)

    @model_validator(mode="after")
    def _has_its_parameter(self) -> Self:
        if (self.left_m is not None) != (self.order == NUDGE):
            raise ValueError("left_m belongs to a nudge, and to no other order")
        return self


@dataclass
class _Sender:
    """A configured key, the numbers accepted of it lately and when."""

    key: OrderKey
    public_key: Ed25519PublicKey
    accepted: deque[tuple[int, int]]


class OrderVerifier:
    """Verifies the orders for one machine and one session (a nonce of this start)."""

    def __init__(self, machine: str, session: str, config: OrdersConfig, store: SequenceStore) -> None:
        self._machine, self._session, self._config, self._store = machine, session, config, store
        self.attendance = Attendance()
        self.checked = -1  # number of the last order that was only checked
        self._senders = {
            bytes.fromhex(key.public_key): _Sender(
                key, Ed25519PublicKey.from_public_bytes(bytes.fromhex(key.public_key)), deque(maxlen=REMEMBERED)
            )
            for key in config.keys.values()
        }

    def command(self, now_ns: int, order: SignedOrder) -> OperatorCommand | None:
        """The command of an order, None for `present` and for a check; raises Refusal."""
        sender = self._senders.get(order.public_key)
        if sender is None:
            raise Refusal(Reason.UNKNOWN_KEY, order.public_key.hex()[:16])
        payload = self._signed_payload(sender, order)
        self._check_address(sender, payload)
        self._check_time(now_ns, payload)
        self._check_sequence(now_ns, sender, payload)
        try:
            if payload.order == FORBID and not payload.is_check:
                self._store.set_forbidden(True)
            self._store.advance(sender.key.public_key, payload.sequence)
            if payload.order == PERMIT and not payload.is_check:
                self._store.set_forbidden(False)
        except HeadlandError as error:
            raise Refusal(Reason.NOT_STORED, str(error)) from error
        sender.accepted.append((payload.sequence, now_ns))
        if payload.is_check:
            self.checked = payload.sequence
            return None
        kind = ORDERS.get(payload.order)
        if kind in STARTS and self.is_forbidden:  # its number is used up: it cannot be repeated after the permission
            raise Refusal(Reason.FORBIDDEN, payload.order)
        self.attendance.take(now_ns, sender.key, payload.order)
        if kind is None:
            return None
        return OperatorCommand(
            now_ns, kind, payload.authority, payload.sequence, payload.expires_ns, payload.left_m or 0.0
        )

    @property
    def is_forbidden(self) -> bool:
        """Whether a person has forbidden automatic operation, also before the last restart."""
        return self._store.is_forbidden

    def _signed_payload(self, sender: _Sender, order: SignedOrder) -> Payload:
        """The payload of a valid signature; nothing is parsed before."""
        try:
            sender.public_key.verify(order.signature, order.payload)
        except InvalidSignature as error:
            raise Refusal(Reason.FORGED, f"key of {sender.key.authority}") from error
        try:
            return Payload.model_validate_json(order.payload)
        except ValidationError as error:
            raise Refusal(Reason.MALFORMED, f"{error.error_count()} errors in the payload") from error

    def _check_address(self, sender: _Sender, payload: Payload) -> None:
        if payload.machine != self._machine:
            raise Refusal(Reason.WRONG_MACHINE, payload.machine)
        if payload.session != self._session:
            raise Refusal(Reason.WRONG_SESSION, payload.session)
        is_permitted = payload.order in sender.key.orders or payload.order == PRESENT
        if payload.authority != sender.key.authority or not is_permitted:
            raise Refusal(Reason.NOT_PERMITTED, f"{payload.order} by {payload.authority}")

    def _check_time(self, now_ns: int, payload: Payload) -> None:
        age_s = (now_ns - payload.signed_ns) * 1e-9
        if abs(age_s) > self._config.max_delay_s and payload.order not in STOPS:
            raise Refusal(Reason.STALE, f"{payload.order} was signed {age_s:.1f} s ago")
        left_s = (payload.expires_ns - now_ns) * 1e-9
        if not 0.0 <= left_s <= self._config.max_validity_s:
            raise Refusal(Reason.STALE, f"{payload.order} expires in {left_s:.1f} s")

    def _check_sequence(self, now_ns: int, sender: _Sender, payload: Payload) -> None:
        try:
            last = self._store.last(sender.key.public_key)
        except HeadlandError as error:
            raise Refusal(Reason.NOT_STORED, str(error)) from error
        if payload.sequence <= last:
            is_known = payload.sequence == last or any(number == payload.sequence for number, _ in sender.accepted)
            raise Refusal(Reason.REPLAYED if is_known else Reason.REORDERED, f"{payload.sequence} after {last}")
        recent = sum(abs(now_ns - at_ns) < SECOND_NS for _, at_ns in sender.accepted)
        if recent >= self._config.max_per_s:
            raise Refusal(Reason.TOO_FREQUENT, f"{recent} within a second")


def unsigned_stop(now_ns: int, order: SignedOrder) -> OperatorCommand | None:
    """The command of an emergency stop, which needs no key, or None for another order."""
    try:
        content: Any = json.loads(order.payload[:MAX_BYTES])
    except (ValueError, RecursionError):
        return None
    is_stop = isinstance(content, dict) and content.get("order") == STOP
    return OperatorCommand(now_ns, OperatorCommandKind.EMERGENCY_STOP, ANYONE, 0, now_ns) if is_stop else None

"""Configuration of the orders: public keys, their authorities and what they may order."""

from typing import Annotated

from pydantic import AfterValidator, Field

from configs.strict import Config
from messages.command import OperatorCommandKind

FORBID, PERMIT = "forbid", "permit"  # both pause; between them no start and no resume is accepted
ORDERS = {kind.name.lower(): kind for kind in OperatorCommandKind} | dict.fromkeys(
    (FORBID, PERMIT), OperatorCommandKind.PAUSE
)
PRESENT = "present"  # no command: the operator is there; permitted to every key
KEY_BYTES = 32


def _known_order(name: str) -> str:
    if name not in ORDERS:
        raise ValueError(f"no such order (known: {', '.join(ORDERS)})")
    return name


class OrderKey(Config):
    """A public key; its private key stays on the operator's device."""

    public_key: str = Field(pattern="^[0-9a-f]{64}$", description="Ed25519, 32 bytes in hexadecimal")
    authority: str = Field(min_length=1, max_length=40, description="one of modes.authorities of the supervisor")
    orders: tuple[Annotated[str, AfterValidator(_known_order)], ...] = Field(min_length=1)
    lost_operator_s: float | None = Field(
        default=10.0,
        ge=1.0,
        le=3600.0,
        description="the machine stops after so long without an order; null: it drives on",
    )


class OrdersConfig(Config):
    """Keys by name, and limits."""

    keys: dict[str, OrderKey]
    max_per_s: int = Field(ge=1, le=100, description="accepted orders of one key within a second")
    max_validity_s: float = Field(gt=0.0, le=3600.0, description="longest time to expiry")
    max_delay_s: float = Field(gt=0.0, le=60.0, description="longest time from its signature, but of a stop")
    report_s: float = Field(ge=0.1, le=10.0, description="a refusal is reported for this long")

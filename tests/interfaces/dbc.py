"""Reference implementation: cantools with the DBC file, as in the simulated machine."""

from functools import cache
from pathlib import Path

import cantools
from cantools.database import Database

DBC = Path(__file__).parents[2] / "configs" / "can" / "headland.dbc"


@cache
def database() -> Database:
    return cantools.database.load_file(DBC)


def identifier(name: str) -> int:
    return database().get_message_by_name(name).frame_id


def encode(name: str, **values: float) -> bytes:
    """Bytes with all reserved bits 1; omitted signals are all ones."""
    message = database().get_message_by_name(name)
    raw = {} if message.is_multiplexed() else {s.name: (1 << s.length) - 1 for s in message.signals}
    raw |= {k: round((v - _signal(message, k).offset) / _signal(message, k).scale) for k, v in values.items()}
    return message.encode(raw, scaling=False, padding=True, strict=False)


def decode(name: str, data: bytes) -> dict[str, float]:
    return database().get_message_by_name(name).decode(data, decode_choices=False)


def reserved_mask(name: str) -> int:
    """Bits of the frame that no signal uses."""
    message = database().get_message_by_name(name)
    used = 0
    for signal in message.signals:
        used |= ((1 << signal.length) - 1) << signal.start
    return (1 << 8 * message.length) - 1 & ~used


def _signal(message, name):
    return next(s for s in message.signals if s.name == name)

"""Identifiers of extended frames: priority, parameter group and addresses (ISO 11783-3).

bits 28–26   25–16 and 15–8                            7–0
priority     PDU1: group, destination                  source
             PDU2 (format byte ≥ 240): group           source
"""

from typing import NamedTuple

BROADCAST = 255
NULL_ADDRESS = 254
FIRST_PDU2 = 0xF000
EXTENDED_MAX = (1 << 29) - 1


class Frame(NamedTuple):
    """One extended frame."""

    identifier: int
    data: bytes


class Address(NamedTuple):
    """Fields of an identifier; `destination` is 255 for a group without one."""

    priority: int
    group: int
    source: int
    destination: int


def encode_identifier(priority: int, group: int, source: int, destination: int = BROADCAST) -> int:
    """29-bit identifier; the destination applies to PDU1 groups only."""
    target = 0 if _is_broadcast(group) else destination << 8
    return priority << 26 | group << 8 | target | source


def decode_identifier(identifier: int) -> Address:
    """The parts of a 29-bit identifier."""
    group = identifier >> 8 & 0x3FFFF
    priority, source = identifier >> 26 & 7, identifier & 0xFF
    if _is_broadcast(group):
        return Address(priority, group, source, BROADCAST)
    return Address(priority, group & 0x3FF00, source, group & 0xFF)


def _is_broadcast(group: int) -> bool:
    return group & 0xFF00 >= FIRST_PDU2

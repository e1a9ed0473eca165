"""Guidance System Command and Guidance Machine Status (ISO 11783-7, PGN 44288 and 44032).

On the bus curvature is positive to the right; elsewhere in Headland it is positive to the left.
"""

from dataclasses import dataclass

from interfaces.isobus.values import BadFrame, Scale, decode_bits, require_length

COMMAND_GROUP = 0xAD00
STATUS_GROUP = 0xAC00
NOT_LIMITED = 0
LIMITED_BY_OPERATOR = 1
NON_RECOVERABLE = 6
EXIT_CLEAR = 0
EXIT_NOT_AVAILABLE = 63

_RIGHT_RADPM = Scale(0.25e-3, -8.032, 2)


@dataclass(frozen=True)
class GuidanceStatus:
    """Status of the steering; `curvature_radpm` left positive, codes as in the standard."""

    curvature_radpm: float
    is_locked_out: bool
    is_steering_ready: bool
    limit: int
    exit_code: int


def encode_command(curvature_radpm: float, is_intending: bool) -> bytes:
    """Command of `curvature_radpm` (left positive), with or without intent to steer; raises ValueError."""
    return _RIGHT_RADPM.encode(-curvature_radpm) + bytes([0xFC | is_intending]) + b"\xff" * 5


def encode_idle() -> bytes:
    """Command without intent to steer and without curvature."""
    return b"\xff\xff\xfc" + b"\xff" * 5


def decode_status(data: bytes) -> GuidanceStatus:
    """Raises BadFrame when the curvature is missing or a code is reserved."""
    require_length(data)
    limit = decode_bits(data, 4, 6, 3)
    if limit in (4, 5):
        raise BadFrame(f"limit status {limit} is reserved")
    return GuidanceStatus(
        curvature_radpm=-_RIGHT_RADPM.decode(data, 1),
        is_locked_out=decode_bits(data, 3, 1, 2) != 0,
        is_steering_ready=decode_bits(data, 3, 3, 2) == 1,
        limit=limit,
        exit_code=decode_bits(data, 5, 1, 6),
    )

"""Status and commands of hitch and power take-off (ISO 11783-7, PGN 65090 to 65094)."""

from dataclasses import dataclass

from interfaces.isobus.values import BadFrame, Scale, decode_bits, decode_flag, require_length

REAR_HITCH_GROUP = 0xFE45
FRONT_HITCH_GROUP = 0xFE46
REAR_PTO_GROUP = 0xFE43
FRONT_PTO_GROUP = 0xFE44
COMMAND_GROUP = 0xFE42

_POSITION = Scale(0.004, 0.0, 1)
_ROTATION_RPM = Scale(0.125, 0.0, 2)


@dataclass(frozen=True)
class HitchStatus:
    """A hitch: `position` 0 lowest to 1 highest, `limit` as in the standard."""

    position: float
    is_in_work: bool
    limit: int


@dataclass(frozen=True)
class PtoStatus:
    """A power take-off."""

    speed_rpm: float
    is_engaged: bool
    limit: int


def encode_commands(rear_position: float | None, rear_pto_rpm: float | None, is_rear_engaged: bool | None) -> bytes:
    """Rear hitch (0 lowest to 1 highest) and rear power take-off; None and the front stay as is.

    Raises ValueError for a value that does not fit.
    """
    position = b"\xff" if rear_position is None else _encode_position(rear_position)
    speed = b"\xff\xff" if rear_pto_rpm is None else _ROTATION_RPM.encode(rear_pto_rpm)
    engage = 3 if is_rear_engaged is None else int(is_rear_engaged)
    return b"\xff" + position + b"\xff\xff" + speed + bytes([0xCF | engage << 4, 0xFF])


def decode_hitch(data: bytes) -> HitchStatus:
    """Raises BadFrame when position or work state is missing."""
    require_length(data)
    return HitchStatus(_POSITION.decode(data, 1), decode_flag(data, 2, 7), _limit(decode_bits(data, 2, 4, 3)))


def decode_pto(data: bytes) -> PtoStatus:
    """Raises BadFrame when speed or engagement is missing."""
    require_length(data)
    return PtoStatus(_ROTATION_RPM.decode(data, 1), decode_flag(data, 5, 7), _limit(decode_bits(data, 6, 2, 3)))


def _encode_position(position: float) -> bytes:
    if not 0.0 <= position <= 1.0:
        raise ValueError(f"hitch position {position!r} is not within 0 to 1")
    return _POSITION.encode(position)


def _limit(limit: int) -> int:
    if limit in (4, 5):
        raise BadFrame(f"limit status {limit} is reserved")
    return limit

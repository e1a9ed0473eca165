"""Wheel-based, ground-based and machine selected speed, and the speed command (ISO 11783-7)."""

from dataclasses import dataclass

from interfaces.isobus.values import BadFrame, Scale, decode_bits, decode_flag, require_length

WHEEL_GROUP = 0xFE48
GROUND_GROUP = 0xFE49
SELECTED_GROUP = 0xF022
COMMAND_GROUP = 0xFD43

_SPEED_MPS = Scale(0.001, 0.0, 2)


@dataclass(frozen=True)
class SelectedSpeed:
    """Machine selected speed; `speed_mps` signed, codes as in the standard."""

    speed_mps: float
    source: int
    limit: int
    exit_code: int


def encode_command(speed_mps: float) -> bytes:
    """Set point with its direction, the limit left as it is; raises ValueError."""
    return _SPEED_MPS.encode(abs(speed_mps)) + b"\xff" * 5 + bytes([0xFC | (speed_mps >= 0.0)])


def decode_speed(data: bytes) -> float:
    """Signed speed of a wheel-based or ground-based frame; raises BadFrame without speed or direction."""
    require_length(data)
    speed_mps = _SPEED_MPS.decode(data, 1)
    if speed_mps == 0.0:
        return 0.0  # at rest without direction; some machines then send 11
    return speed_mps if decode_flag(data, 8, 1) else -speed_mps


def decode_selected(data: bytes) -> SelectedSpeed:
    """Raises BadFrame when speed or direction is missing or a code is reserved."""
    speed_mps = decode_speed(data)
    source, limit = decode_bits(data, 8, 3, 3), decode_bits(data, 8, 6, 3)
    if source in (5, 6) or limit in (4, 5):
        raise BadFrame(f"source {source}, limit status {limit}: reserved")
    return SelectedSpeed(speed_mps, source, limit, decode_bits(data, 7, 1, 6))

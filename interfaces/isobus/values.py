"""Values within a frame: scaled numbers, bit fields and "not available".

Bytes and bits count from 1 as in the standard, bit 1 is the least significant; numbers are little-endian.
"""

import math
from dataclasses import dataclass

NOT_AVAILABLE = b"\xff" * 8


class BadFrame(ValueError):
    """A frame that must not be used; the text is the reason."""


@dataclass(frozen=True)
class Scale:
    """A number of `size` bytes: value = raw · factor + offset; above 0xFA, 0xFAFF … no number."""

    factor: float
    offset: float
    size: int

    @property
    def raw_max(self) -> int:
        """The highest raw value that is a number."""
        return (0xFB << 8 * (self.size - 1)) - 1

    def encode(self, value: float) -> bytes:
        """The nearest raw value; raises ValueError for NaN, infinity and what does not fit."""
        raw = round((value - self.offset) / self.factor) if math.isfinite(value) else -1
        if not 0 <= raw <= self.raw_max:
            raise ValueError(f"{value!r} does not fit: offset {self.offset}, factor {self.factor}, {self.size} bytes")
        return raw.to_bytes(self.size, "little")

    def decode(self, data: bytes, byte: int) -> float:
        """The value that starts at `byte`; raises BadFrame when it is an error or not available."""
        raw = int.from_bytes(data[byte - 1 : byte - 1 + self.size], "little")
        if raw > self.raw_max:
            raise BadFrame(f"byte {byte}: raw value {raw:#x} is an error or not available")
        return raw * self.factor + self.offset


def decode_bits(data: bytes, byte: int, bit: int, count: int) -> int:
    """The field of `count` bits whose lowest is `bit` of `byte`."""
    return data[byte - 1] >> (bit - 1) & (1 << count) - 1


def decode_flag(data: bytes, byte: int, bit: int) -> bool:
    """A two-bit state; raises BadFrame for error (10) and not available (11)."""
    state = decode_bits(data, byte, bit, 2)
    if state > 1:
        raise BadFrame(f"byte {byte} bit {bit}: state {state:02b} is an error or not available")
    return state == 1


def require_length(data: bytes, length: int = 8) -> None:
    """Raises BadFrame for a frame of another length."""
    if len(data) != length:
        raise BadFrame(f"{len(data)} bytes instead of {length}")

"""Frames of a receiver's byte stream: NMEA 0183, UBX and RTCM 3, in any mixture, also damaged."""

import mmap
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from pyubx2 import UBX_MSGIDS

from messages.errors import LogError

NMEA, UBX, RTCM, END = "NMEA 0183", "UBX", "RTCM 3", "end"
_SYNC = re.compile(rb"[$!]|\xb5\x62|\xd3[\x00-\x03]")
# Fields hold printable characters except the reserved $ * ! (a new sentence may follow a damaged one on its line).
_SENTENCE = re.compile(
    rb"([$!]([A-Z][A-Z0-9]{2,15})(?:,[\x20\x22\x23\x25-\x29\x2b-\x7e]{0,500})?(?:\*[0-9A-Fa-f]{2})?)[\r\n]*"
)
_UBX_EXTRA, _UBX_MAX = 8, 1 << 14  # bytes around the payload, and of the longest message
_LINE = 200  # greatest length of a prefix of a sentence on its line
_CRC24Q = 0x1864CFB


@dataclass(frozen=True)
class Frame:
    """One message: `data` with frame, the bytes from `at` to `end` of the stream.

    `prefix` is the text before a sentence on its line. `fault` is empty, or the reason why the frame is no message.
    """

    protocol: str
    kind: str
    data: bytes
    at: int
    end: int
    prefix: bytes = b""
    fault: str = ""


Bytes = bytes | mmap.mmap


def frames_of(path: Path) -> Iterator[Frame]:
    """All frames of a file, which is mapped, not loaded, and one of protocol END; raises LogError."""
    try:
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:  # ValueError: an empty file cannot be mapped
        raise LogError(f"{path}: cannot be read ({error})") from error
    with mapped as data:
        yield from frames(data)
        yield Frame(END, "", b"", len(data), len(data))


def frames(data: Bytes) -> Iterator[Frame]:
    """All frames; after bytes that are none the search continues with the next byte, so no later frame is lost."""
    at, end = 0, 0
    while (found := _SYNC.search(data, at)) is not None:
        frame = _READERS[found[0][0]](data, found.start(), end)
        if frame is not None:
            yield frame
        is_whole = frame is not None and not frame.fault
        at = frame.end if frame is not None and (is_whole or frame.protocol == NMEA) else found.start() + 1
        end = at if is_whole else end


def _sentence(data: Bytes, at: int, end: int) -> Frame | None:
    found = _SENTENCE.match(data, at)
    if found is None:
        return None
    line = max(data.rfind(b"\n", max(0, at - _LINE), at) + 1, end, at - _LINE)
    return Frame(NMEA, found[2].decode(), found[1], at, found.end(), bytes(data[line:at]))


def _ubx(data: Bytes, at: int, _: int) -> Frame | None:
    header = bytes(data[at : at + 6])
    kind = UBX_MSGIDS.get(header[2:4], header[2:4].hex(" "))
    size = int.from_bytes(header[4:6], "little") + _UBX_EXTRA
    if len(header) < 6 or size > _UBX_MAX or at + size > len(data):
        return Frame(UBX, kind, header, at, at + 2, fault="cut off or wrong length")
    body = np.frombuffer(data[at + 2 : at + size - 2], np.uint8).astype(np.int64)
    expected = bytes((int(body.sum()) & 0xFF, int(np.cumsum(body).sum()) & 0xFF))  # Fletcher, 8 bits
    if bytes(data[at + size - 2 : at + size]) != expected:
        return Frame(UBX, kind, header, at, at + 2, fault="wrong checksum")
    return Frame(UBX, kind, bytes(data[at : at + size]), at, at + size)


def _rtcm(data: Bytes, at: int, _: int) -> Frame | None:
    """A frame with a right checksum; two bytes of sync are too few to call others damaged."""
    end = at + 6 + (int.from_bytes(data[at + 1 : at + 3], "big") & 0x3FF)
    message = bytes(data[at:end])
    is_followed = end >= len(data) or _SYNC.match(data, end) or data[end] in b"\r\n"
    if at + 8 > end or end > len(data) or not is_followed or _crc24q(message):
        return None
    return Frame(RTCM, str(int.from_bytes(message[3:5], "big") >> 4), message, at, end)


@cache
def _crc24q_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        crc = value << 16
        for _ in range(8):
            crc = crc << 1 ^ (_CRC24Q if crc & 0x800000 else 0)
        table.append(crc)
    return tuple(table)


def _crc24q(message: bytes) -> int:
    """Zero for a message with its checksum (CRC-24Q)."""
    table, crc = _crc24q_table(), 0
    for byte in message:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


_READERS: dict[int, Callable[[Bytes, int, int], Frame | None]] = {
    ord("$"): _sentence,
    ord("!"): _sentence,
    0xB5: _ubx,
    0xD3: _rtcm,
}

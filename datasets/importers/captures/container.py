"""Frames of pcap and pcapng files, with one frame in memory at a time.

Several interfaces and sections of a pcapng file, both byte orders and all time resolutions are read. A damaged record
is skipped: reading continues at the next plausible record within 1 MiB, and each loss is noted with its position.
Sources: IETF drafts opsawg-pcap and opsawg-pcapng.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from messages.errors import LogError

# magic → byte order, nanoseconds per unit of the fraction
PCAP = {
    b"\xd4\xc3\xb2\xa1": ("<", 1_000),
    b"\xa1\xb2\xc3\xd4": (">", 1_000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
PCAPNG = b"\x0a\x0d\x0d\x0a"
ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, PACKET = 0x0A0D0D0A, 1, 2, 3, 6
TIME_RESOLUTION, TIME_OFFSET = 9, 14
MAX_RECORD = 1 << 20
SEARCH_BYTES = 1 << 20
DAY_S = 86_400


@dataclass(frozen=True, slots=True)
class Frame:
    """One captured frame of link type `link` (LINKTYPE of tcpdump)."""

    receive_ns: int
    link: int
    data: bytes


@dataclass(frozen=True, slots=True)
class _Interface:
    """Link type and time scale: a stamp is `offset_s` + ticks / (`base` ** `exponent`)."""

    link: int
    base: int = 10
    exponent: int = 6
    offset_s: int = 0

    def stamp_ns(self, ticks: int) -> int:
        return self.offset_s * 1_000_000_000 + ticks * 1_000_000_000 // int(self.base**self.exponent)


def is_capture(head: bytes) -> bool:
    """Whether a file with these first bytes is a pcap or pcapng file."""
    return head[:4] in PCAP or (head[:4] == PCAPNG and head[8:12] in ORDERS)


def frames(path: Path, damages: list[str]) -> Iterator[Frame]:
    """All readable frames of a file; losses are added to `damages`. Raises LogError if the file cannot be opened."""
    try:
        with path.open("rb") as file:
            head = file.read(24)
            if head[:4] in PCAP and len(head) == 24:
                yield from _pcap(file, head, damages)
            elif head[:4] == PCAPNG:
                file.seek(0)
                yield from _Pcapng(file, damages).frames()
            else:
                damages.append(f"byte 0: no complete file header ({len(head)} bytes)")
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def _pcap(file: BinaryIO, head: bytes, damages: list[str]) -> Iterator[Frame]:
    order, unit_ns = PCAP[head[:4]]
    record = struct.Struct(f"{order}IIII")
    link = struct.unpack_from(f"{order}I", head, 20)[0] & 0xFFFF
    last_s: int | None = None

    def is_plausible(fraction: int, size: int, original: int) -> bool:
        return 0 < size <= min(MAX_RECORD, original) and fraction * unit_ns < 1_000_000_000

    def is_record(data: bytes, at: int) -> bool:
        """Whether a record lies at a position: it and the next one are plausible and less than a day from the last."""
        seconds, *rest = record.unpack_from(data, at)
        after = at + record.size + rest[1]
        if not is_plausible(*rest) or (last_s is not None and abs(seconds - last_s) >= DAY_S):
            return False
        if after + record.size > len(data):
            return last_s is not None
        next_s, *rest = record.unpack_from(data, after)
        return is_plausible(*rest) and abs(next_s - seconds) < DAY_S

    while head := file.read(record.size):
        start = file.tell() - len(head)
        if len(head) < record.size:
            damages.append(f"byte {start}: the last record is cut off")
            return
        seconds, fraction, size, original = record.unpack(head)
        if not is_plausible(fraction, size, original):
            if not _skip_damage(file, start, record.size, is_record, damages):
                return
            continue
        data = file.read(size)
        if len(data) < size:
            damages.append(f"byte {start}: the last record has {len(data)} of {size} bytes")
            return
        last_s = seconds
        yield Frame(seconds * 1_000_000_000 + fraction * unit_ns, link, data)


def _skip_damage(
    file: BinaryIO, start: int, size: int, is_record: Callable[[bytes, int], bool], damages: list[str]
) -> bool:
    """Moves to the next plausible record after `start`; False, and the end of reading, if there is none."""
    file.seek(start + 1)
    window = file.read(SEARCH_BYTES)
    found = next((at for at in range(len(window) - size + 1) if is_record(window, at)), None)
    if found is None:
        damages.append(f"byte {start}: no record, and none within {SEARCH_BYTES} bytes; the rest is not read")
        return False
    damages.append(f"byte {start}: no record; {found + 1} bytes lost")
    file.seek(start + 1 + found)
    return True


class _Pcapng:
    """Blocks of a pcapng file; byte order and interfaces are those of the current section."""

    def __init__(self, file: BinaryIO, damages: list[str]) -> None:
        self._file = file
        self._damages = damages
        self._order = "<"
        self._interfaces: list[_Interface] = []
        self._last_ns = 0

    def frames(self) -> Iterator[Frame]:
        while head := self._file.read(12):
            start = self._file.tell() - len(head)
            if len(head) < 12:
                self._damages.append(f"byte {start}: the last block is cut off")
                return
            if head[:4] == PCAPNG and head[8:12] in ORDERS:
                self._order, self._interfaces = ORDERS[head[8:12]], []
            kind, size = struct.unpack_from(f"{self._order}II", head)
            body = b"" if not 12 <= size <= MAX_RECORD or size % 4 else head[8:] + self._file.read(size - 12)
            if len(body) == size - 8 and body[-4:] == head[4:8]:
                yield from self._frame(kind, body[:-4], start)
            elif not _skip_damage(self._file, start, 12, self._is_block, self._damages):
                return

    def _is_block(self, data: bytes, at: int) -> bool:
        """Whether a complete block lies at a position: its length is repeated at its end."""
        kind, size = struct.unpack_from(f"{self._order}II", data, at)
        is_kind = kind in (SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, PACKET)
        end = at + size
        return is_kind and size >= 12 and size % 4 == 0 and data[end - 4 : end] == data[at + 4 : at + 8]

    def _frame(self, kind: int, body: bytes, start: int) -> Iterator[Frame]:
        try:
            if kind == INTERFACE:
                self._interfaces.append(_interface(body, self._order))
            elif kind == SIMPLE_PACKET:
                size = struct.unpack_from(f"{self._order}I", body)[0]
                yield Frame(self._last_ns, self._interfaces[0].link, body[4 : 4 + size])
            elif kind in (PACKET, OLD_PACKET):
                head = struct.Struct(self._order + ("IIIII" if kind == PACKET else "HxxIIII"))
                number, high, low, size, _ = head.unpack_from(body)
                if size > len(body) - head.size:
                    raise ValueError(f"packet of {size} bytes in a block of {len(body)}")
                interface = self._interfaces[number]
                self._last_ns = interface.stamp_ns(high << 32 | low)
                yield Frame(self._last_ns, interface.link, body[head.size : head.size + size])
        except (struct.error, IndexError, ValueError) as error:
            self._damages.append(f"byte {start}: block of type {kind} is not readable ({error})")


def _interface(body: bytes, order: str) -> _Interface:
    """An interface description with the options that set its time scale."""
    link = struct.unpack_from(f"{order}H", body)[0]
    base, exponent, offset_s, at = 10, 6, 0, 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == TIME_RESOLUTION:
            base, exponent = (2 if value[0] & 0x80 else 10), value[0] & 0x7F
        elif code == TIME_OFFSET:
            offset_s = struct.unpack(f"{order}q", value)[0]
        at += 4 + size + -size % 4
    return _Interface(link, base, exponent, offset_s)

"""Records of an MCAP file, also truncated or damaged (the readers of `mcap` stop at the first bad byte).

A file is `magic, records..., magic`; a record is opcode, length and body; most records are in compressed chunks with a
CRC. An unreadable section yields a `Damage`, and reading continues at the next valid chunk.
"""

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics

from messages.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 1 << 30
RELEASE_BYTES = 1 << 24
_HEAD = struct.Struct("<BQ")
# start, end, uncompressed size and CRC, length of the compression's name
_CHUNK = struct.Struct("<QQQII")
_CHUNK_NAME = re.compile(rb"\x03\0\0\0lz4|\x04\0\0\0zstd")
_MESSAGE = struct.Struct("<HIQQ")
_PARSED: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_BAD = (McapError, struct.error, UnicodeDecodeError, RuntimeError, ValueError, zstandard.ZstdError)


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message of the file; `receive_ns` is the log time of MCAP, `stamp_ns` its publish time."""

    channel_id: int
    sequence: int
    receive_ns: int
    stamp_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Damage:
    """Unreadable bytes; `is_end` when nothing readable follows."""

    offset: int
    length: int
    reason: str
    is_end: bool


@dataclass(frozen=True, slots=True)
class End:
    """End record: the file is complete."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Place of a chunk in the file, and the log times of its messages, which follow."""

    offset: int
    start_ns: int
    end_ns: int


WalkRecord = RawMessage | Schema | Channel | Metadata | Statistics | Damage | Chunk | End


def walk(path: Path, has_chunks: bool = True) -> Iterator[WalkRecord]:
    """All readable records in file order, or those outside the chunks; raises LogError for a file that is not MCAP."""
    try:
        with path.open("rb") as file:
            start = file.read(len(MAGIC))
            if not start:
                raise LogError(f"{path}: is empty, nothing was recorded")
            if not MAGIC.startswith(start):
                raise LogError(f"{path}: is not an MCAP log (it begins with {start!r})")
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield from _walk(data, has_chunks)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def messages_of(path: Path, chunk: Chunk) -> list[RawMessage]:
    """Messages of a chunk that a walk has found; raises LogError if the file has changed since."""
    try:
        with path.open("rb") as file:
            file.seek(chunk.offset)
            opcode, length = _HEAD.unpack(file.read(_HEAD.size))
            records = list(_read(opcode, file.read(length)))
    except (OSError, *_BAD) as error:
        raise LogError(f"{path}: has changed since it was opened ({error})") from error
    return [record for record in records if isinstance(record, RawMessage)]


def _walk(data: mmap.mmap, has_chunks: bool) -> Iterator[WalkRecord]:
    at, size, released = len(MAGIC), len(data), 0
    while True:
        if at - released > RELEASE_BYTES:
            # pages that were read count as memory of the process until it releases them
            data.madvise(mmap.MADV_DONTNEED, released, (at - released) // mmap.PAGESIZE * mmap.PAGESIZE)
            released += (at - released) // mmap.PAGESIZE * mmap.PAGESIZE
        reason, end = _bounds(data, at)
        if not reason:
            opcode = data[at]
            if opcode == Opcode.CHUNK and not has_chunks:
                at = end
                continue
            try:
                records = list(_read(opcode, data[at + _HEAD.size : end]))
            except _BAD as error:
                yield Damage(at, end - at, f"{_name(opcode)}: {error or type(error).__name__}", False)
            else:
                if opcode == Opcode.CHUNK:
                    yield Chunk(at, *_CHUNK.unpack_from(data, at + _HEAD.size)[:2])
                yield from records
            if opcode == Opcode.FOOTER:
                yield from _close(data, end)
                return
            at = end
            continue
        found = _next_chunk(data, at + 1)
        yield Damage(at, (size if found is None else found) - at, reason, found is None)
        if found is None:
            return
        at = found


def _bounds(data: mmap.mmap, at: int) -> tuple[str, int]:
    """Defect of the record at `at` ("" = none), and its end."""
    left = len(data) - at
    if left < _HEAD.size:
        return "ends before its end record" if left <= 0 else f"ends inside a record, {left} bytes into it", at
    opcode, length = _HEAD.unpack_from(data, at)
    if not 0x01 <= opcode <= Opcode.DATA_END and opcode < 0x80:
        return f"no record of MCAP has the opcode {opcode:#04x}", at
    if length > left - _HEAD.size:
        return f"ends inside a record ({_name(opcode)} of {length} bytes)", at
    return "", at + _HEAD.size + length


def _close(data: mmap.mmap, at: int) -> Iterator[WalkRecord]:
    tail = data[at : at + len(MAGIC) + 1]
    if tail == MAGIC:
        yield End()
    else:
        yield Damage(at, len(data) - at, "the end mark is missing or followed by something", True)


def _next_chunk(data: mmap.mmap, start: int) -> int | None:
    """Start of the next chunk with valid length and CRC, or None."""
    lead = _HEAD.size + _CHUNK.size - 4
    at = start + lead
    while (match := _CHUNK_NAME.search(data, at)) is not None:
        begin, at = match.start() - lead, match.start() + 1
        if data[begin] != Opcode.CHUNK or _bounds(data, begin)[0]:
            continue
        try:
            _inflate(data[begin + _HEAD.size : _bounds(data, begin)[1]])
        except _BAD:
            continue
        return begin
    return None


def _read(opcode: int, body: bytes) -> Iterator[WalkRecord]:
    if opcode == Opcode.CHUNK:
        chunk = _inflate(body)
        at = 0
        while at < len(chunk):
            inner, length = _HEAD.unpack_from(chunk, at)
            at += _HEAD.size + length
            if at > len(chunk):
                raise ValueError(f"a record of {length} bytes reaches beyond its chunk")
            yield from _read_one(inner, chunk[at - length : at])
    else:
        yield from _read_one(opcode, body)


def _read_one(opcode: int, body: bytes) -> Iterator[WalkRecord]:
    if opcode == Opcode.MESSAGE:
        channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
        yield RawMessage(channel, sequence, log_ns, publish_ns, body[_MESSAGE.size :])
    elif opcode in _PARSED:
        yield _PARSED[opcode].read(ReadDataStream(BytesIO(body)))


def _inflate(body: bytes) -> bytes:
    """Content of a chunk; raises ValueError when length or CRC do not match its header."""
    _, _, size, crc, name_length = _CHUNK.unpack_from(body)
    at = _CHUNK.size + name_length
    name, packed = body[_CHUNK.size : at], body[at + 8 :]
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"claims to hold {size} bytes")
    if struct.unpack_from("<Q", body, at)[0] != len(packed):
        raise ValueError("its lengths differ")
    content = _decompress(name, packed, size)
    if len(content) != size:
        raise ValueError(f"holds {len(content)} bytes instead of {size}")
    if crc not in (0, zlib.crc32(content)):
        raise ValueError("its checksum is wrong")
    return content


def _decompress(name: bytes, packed: bytes, size: int) -> bytes:
    if name == b"lz4":
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        return content
    if name == b"zstd":
        if zstandard.frame_content_size(packed) not in (-1, size):
            raise ValueError("its lengths differ")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if name:
        raise ValueError(f"compression {name!r} is not known")
    return packed


def _name(opcode: int) -> str:
    try:
        return Opcode(opcode).name.lower()
    except ValueError:
        return f"opcode {opcode:#04x}"

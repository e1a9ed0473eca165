"""ROS 1 bags (format 2.0): read by rosbags, and without their index where it is lost or wrong.

A bag is `#ROSBAG V2.0`, then records of header (`name=value` fields) and data; messages and connections are in chunks.
"""

import bz2
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
from rosbags.rosbag1 import Reader, ReaderError

from datasets.importers.recording import Open, Recording, Skipped
from datasets.importers.ros_types import ROS1, decoder_of, type_name
from datasets.importers.streams import Item, recording_of
from messages.errors import LogError

NAME = "ROS 1 bag"
MAGIC = b"#ROSBAG V"
VERSION = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 2, 5, 7
CHUNK_MARK = b"op=\x05"
# Longest header of a chunk record.
MAX_HEADER = 256
MAX_CHUNK_BYTES = 1 << 30
PIECE = 1 << 16
BAD_RECORD = (ValueError, KeyError, IndexError, struct.error)
BAD_BAG = (ReaderError, OSError, ValueError, KeyError, IndexError, AssertionError, RuntimeError, EOFError, struct.error)


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a ROS 1 bag."""
    return open_ros1_bag if head.startswith(MAGIC) else None


def open_ros1_bag(path: Path, _: Path | None = None) -> Recording:
    """A ROS 1 bag, in order of reception; without a usable index in file order, as far as it is readable."""
    try:
        return recording_of(path, NAME, lambda: _indexed(path))
    except BAD_BAG as error:
        note = f"the index of the bag cannot be used ({str(error) or type(error).__name__}): read in file order"
    return recording_of(path, NAME, lambda: _in_file_order(path), (note,))


def _indexed(path: Path) -> Iterator[Item]:
    with Reader(path) as reader:
        for connection, receive_ns, raw in reader.messages():
            yield _item(connection.topic, connection.msgtype, str(connection.msgdef.data), receive_ns, bytes(raw))


def _item(topic: str, kind: str, definition: str, receive_ns: int, data: bytes) -> Item:
    kind = type_name(kind)
    return Item(topic, kind, receive_ns, lambda: decoder_of(ROS1, kind, definition)(data))


@dataclass(frozen=True)
class _Record:
    """A record: its fields, its data (cut short at the end of the file), and the position after it."""

    fields: dict[bytes, bytes]
    data: bytes
    end: int
    is_cut: bool

    @property
    def op(self) -> int:
        return self.fields[b"op"][0]

    def number(self, name: bytes) -> int:
        return int(struct.unpack("<I", self.fields[name])[0])


def _in_file_order(path: Path) -> Iterator[Item | Skipped]:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if not data[: len(VERSION)] == VERSION:
            raise LogError(f"{path}: a bag of format {data[8:12]!r} is not read, only 2.0 (`rosbag fix` converts it)")
        yield from _Walk(path.name).items(data)


class _Walk:
    """One pass over the records of a bag; `receive_ns` is that of the last message."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._connections: dict[int, tuple[str, str, str]] = {}
        self._receive_ns = 0

    def items(self, data: mmap.mmap) -> Iterator[Item | Skipped]:
        """Messages in file order, and lost parts."""
        at = len(VERSION)
        while at < len(data):
            try:
                record = _read(data, at)
                if record.op == CHUNK:
                    yield from self._chunk(record, at)
                if record.is_cut:
                    raise ValueError("the record is longer than the rest of the file")
                if record.op == CONNECTION:
                    self._connect(record)
                at = record.end
            except BAD_RECORD as error:
                end = _next_chunk(data, at + 1) or len(data)
                yield self._lost(at, end - at, str(error))
                at = end

    def _chunk(self, record: _Record, at: int) -> Iterator[Item | Skipped]:
        content, reason = _inflate(record)
        inner = 0
        try:
            while inner < len(content):
                one = _read(content, inner)
                if one.is_cut or one.op not in (CONNECTION, MESSAGE):
                    raise ValueError("no complete record of a message")
                if one.op == CONNECTION:
                    self._connect(one)
                else:
                    yield self._message(one)
                inner = one.end
        except BAD_RECORD as error:
            reason = reason or str(error)
        if reason and not record.is_cut:
            yield self._lost(at, record.end - at, f"rest of a chunk after byte {inner}: {reason}")

    def _message(self, record: _Record) -> Item | Skipped:
        seconds, nanoseconds = struct.unpack("<II", record.fields[b"time"])
        self._receive_ns = seconds * 1_000_000_000 + nanoseconds
        known = self._connections.get(record.number(b"conn"))
        if known is None:
            return Skipped(self._receive_ns, self._name, NAME, "message of a connection in a lost part")
        return _item(*known, self._receive_ns, record.data)

    def _connect(self, record: _Record) -> None:
        about = _fields(record.data)
        topic, kind, text = (
            about.get(k, b"").decode("utf-8", "replace") for k in (b"topic", b"type", b"message_definition")
        )
        self._connections[record.number(b"conn")] = (record.fields[b"topic"].decode() or topic, kind, text)

    def _lost(self, at: int, length: int, reason: str) -> Skipped:
        return Skipped(self._receive_ns, self._name, NAME, f"byte {at}: {length} bytes lost: {reason}")


def _read(data: mmap.mmap | bytes, at: int) -> _Record:
    """The record at `at`; raises ValueError, KeyError or struct.error if there is none."""
    (size,) = struct.unpack_from("<I", data, at)
    start = at + 4 + size
    fields = _fields(data[at + 4 : start])
    if start + 4 > len(data) or len(fields.get(b"op", b"")) != 1:
        raise ValueError("no record of a bag")
    (length,) = struct.unpack_from("<I", data, start)
    end = start + 4 + length
    return _Record(fields, data[start + 4 : end], min(end, len(data)), end > len(data))


def _fields(header: bytes) -> dict[bytes, bytes]:
    out, at = {}, 0
    while at < len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, mark, value = header[at + 4 : at + 4 + size].partition(b"=")
        if not mark or at + 4 + size > len(header):
            raise ValueError("no header of a record")
        out[name] = value
        at += 4 + size
    return out


def _next_chunk(data: mmap.mmap, start: int) -> int | None:
    """Start of the next record of a chunk, or None."""
    mark = data.find(CHUNK_MARK, start)
    while mark >= 0:
        for at in range(max(start, mark - MAX_HEADER), mark - 7):
            (size,) = struct.unpack_from("<I", data, at)
            if mark - at < size + 4 <= MAX_HEADER and _is_chunk(data, at):
                return at
        mark = data.find(CHUNK_MARK, mark + 1)
    return None


def _is_chunk(data: mmap.mmap, at: int) -> bool:
    try:
        return {b"compression", b"size"} <= _read(data, at).fields.keys()
    except BAD_RECORD:
        return False


def _inflate(record: _Record) -> tuple[bytes, str]:
    """Content of a chunk as far as it is readable, and the defect ("" = none)."""
    name = record.fields.get(b"compression", b"")
    if name == b"none":
        return record.data, ""
    decompressors = {b"bz2": bz2.BZ2Decompressor, b"lz4": lz4.frame.LZ4FrameDecompressor}
    if name not in decompressors:
        return b"", f"compression {name!r} is not one of none, bz2, lz4"
    decompressor, out = decompressors[name](), bytearray()
    try:
        limit = min(record.number(b"size"), MAX_CHUNK_BYTES)
        for at in range(0, len(record.data), PIECE):
            out += decompressor.decompress(record.data[at : at + PIECE], max_length=limit - len(out) + 1)
            if len(out) > limit:
                return bytes(out), "it holds more than stated"
    except (OSError, EOFError, ValueError, RuntimeError, KeyError, struct.error) as error:
        return bytes(out), f"{name.decode()}: {error}"
    return bytes(out), ""

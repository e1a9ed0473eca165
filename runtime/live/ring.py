"""A ring in shared memory: one process writes, any number read, and nobody waits for anybody.

A reader that falls behind, was stopped or meets a half-written record loses what was overwritten, and counts that.

    0        8          16..64   64                                        64 + size
    | written | heartbeat | free | ...| length crc record |...| length crc record |
"""

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

HEAD_BYTES = 64
_RECORD = struct.Struct("<II")
_WRAP = 0xFFFFFFFF
_WRITTEN, _BEAT = 0, 1


class _Ring:
    """The mapped file, of `size` bytes and a head."""

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDWR)
        try:
            self._map = mmap.mmap(descriptor, 0)
        finally:
            os.close(descriptor)
        self._head = np.frombuffer(self._map, np.uint64, HEAD_BYTES // 8)  # stores of one word are whole
        self._size = len(self._map) - HEAD_BYTES

    def close(self) -> None:
        """Let go of the memory."""
        del self._head
        self._map.close()


def make_ring(path: Path, size: int) -> None:
    """A new ring of `size` bytes, a multiple of 8, empty."""
    with path.open("xb") as file:
        file.truncate(HEAD_BYTES + size)


class RingWriter(_Ring):
    """The one writer."""

    def write(self, record: bytes) -> None:
        """Append a record; raises ValueError for one that is larger than a quarter of the ring."""
        if 4 * len(record) > self._size:
            raise ValueError(f"a record of {len(record)} bytes in a ring of {self._size}")
        written = int(self._head[_WRITTEN])
        needed = _padded(len(record))
        left = self._size - written % self._size
        if left < needed:
            self._put(written, _RECORD.pack(_WRAP, 0))
            written += left
        self._put(written, _RECORD.pack(len(record), zlib.crc32(record)) + record)
        self._head[_WRITTEN] = written + needed

    def beat(self, now_ns: int) -> None:
        """Show that the process lives."""
        self._head[_BEAT] = now_ns

    def _put(self, at: int, data: bytes) -> None:
        start = HEAD_BYTES + at % self._size
        self._map[start : start + len(data)] = data


class RingReader(_Ring):
    """One of the readers; begins with what is written from now on."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._read = int(self._head[_WRITTEN])
        self.lost = 0  # times that records were overwritten before they were read

    @property
    def beat_ns(self) -> int:
        """The last sign of life of the writer, 0 before the first."""
        return int(self._head[_BEAT])

    def records(self) -> Iterator[bytes]:
        """What has been written since the last call, up to now."""
        end = int(self._head[_WRITTEN])
        while self._read < end:
            record = self._next()
            if record is None:
                self.lost += 1
                self._read = int(self._head[_WRITTEN])
                return
            if record:
                yield record

    def _next(self) -> bytes | None:
        """The next record, b"" at the end of the round, or None when it has been overwritten."""
        offset = self._read % self._size
        start = HEAD_BYTES + offset
        length, crc = _RECORD.unpack_from(self._map, start)
        if length == _WRAP:
            self._read += self._size - offset
            return b""
        if offset + _padded(length) > self._size:
            return None
        record = self._map[start + _RECORD.size : start + _RECORD.size + length]
        if zlib.crc32(record) != crc or int(self._head[_WRITTEN]) - self._read > self._size:
            return None
        self._read += _padded(length)
        return record


def _padded(length: int) -> int:
    """Bytes that a record takes, so that the next begins at a word."""
    return (_RECORD.size + length + 7) // 8 * 8

"""Ring buffer in shared memory with one writer and any number of readers, all non-blocking.

A reader that is too slow, was halted or meets a half-written record skips the overwritten records and counts the loss.
The writer goes back to the start at the end of the memory, or earlier: after `LAP_BYTES` and four times what it wrote
in the last `PERIOD_S`. Pages are allocated when first written, and a large ring with few messages would take new ones
for hours.

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
LAP_BYTES, PERIOD_S = 1 << 20, 10.0
_RECORD = struct.Struct("<II")
_WRAP = 0xFFFFFFFF
_WRITTEN, _BEAT = 0, 1


class _Ring:
    """Memory-mapped file: header and `size` bytes of records."""

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDWR)
        try:
            self._map = mmap.mmap(descriptor, 0)
        finally:
            os.close(descriptor)
        self._head = np.frombuffer(self._map, np.uint64, HEAD_BYTES // 8)  # stores of one word are atomic
        self._size = len(self._map) - HEAD_BYTES

    def close(self) -> None:
        """Unmaps the memory."""
        del self._head
        self._map.close()


def make_ring(path: Path, size: int) -> None:
    """Creates an empty ring of `size` bytes, a multiple of 8."""
    with path.open("xb") as file:
        file.truncate(HEAD_BYTES + size)


class RingWriter(_Ring):
    """Writer of a ring."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._period_ns, self._period_began, self._recent_began = 0, 0, 0

    def write(self, record: bytes) -> None:
        """Appends a record; raises ValueError for one larger than a quarter of the ring."""
        if 4 * len(record) > self._size:
            raise ValueError(f"a record of {len(record)} bytes in a ring of {self._size}")
        written = int(self._head[_WRITTEN])
        needed = _padded(len(record))
        offset = written % self._size
        left = self._size - offset
        if self._head[_BEAT] - self._period_ns > PERIOD_S * 1e9:
            self._recent_began, self._period_began = self._period_began, written
            self._period_ns = int(self._head[_BEAT])
        recent = written + needed - self._recent_began  # of this period and the one before
        if left < needed or offset >= max(LAP_BYTES, 4 * recent):
            self._put(written, _RECORD.pack(_WRAP, 0))
            written += left
            self._period_began, self._recent_began = self._period_began + left, self._recent_began + left
        self._put(written, _RECORD.pack(len(record), zlib.crc32(record)) + record)
        self._head[_WRITTEN] = written + needed

    def beat(self, now_ns: int) -> None:
        """Writes the heartbeat."""
        self._head[_BEAT] = now_ns

    def _put(self, at: int, data: bytes) -> None:
        start = HEAD_BYTES + at % self._size
        self._map[start : start + len(data)] = data


class RingReader(_Ring):
    """Reader of a ring; starts with the next record that is written."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._read = int(self._head[_WRITTEN])
        self.lost = 0  # number of times that records were overwritten before reading

    @property
    def beat_ns(self) -> int:
        """Last heartbeat of the writer in ns, 0 before the first."""
        return int(self._head[_BEAT])

    def records(self) -> Iterator[bytes]:
        """Records written since the last call."""
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
        """Next record, b"" at the wrap-around, or None for an overwritten record."""
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
    """Bytes of a record including header, rounded up to a word of 8 bytes."""
    return (_RECORD.size + length + 7) // 8 * 8

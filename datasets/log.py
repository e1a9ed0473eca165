"""Log writer: MCAP, zstd, one channel per topic; readable up to the last second after a crash."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any, Self

import mcap.writer
import numpy as np
import zstandard
from google.protobuf.message import Message as Proto
from mcap.records import ChunkIndex
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer
from pydantic import Field

from configs.strict import Config
from datasets.codec import codec_of
from datasets.digest import Digest
from datasets.disk import MB, LogFile
from datasets.parts import CONTINUED, PART, PartName
from datasets.reader import END
from datasets.schema import descriptor_set
from datasets.viewer import Viewer
from datasets.writer_thread import WriterThread
from messages.message import Envelope, Message
from messages.perception import Obstacles
from messages.topics import spec_of

# The writer of `mcap` has no option for the level. Against level 3, level 1 takes two thirds of the time for 4 to
# 6 % more bytes of scans; lz4 takes half of it, for 50 to 66 % more bytes (its window is 64 kB).
_LEVEL_1: Any = SimpleNamespace(compress=partial(zstandard.compress, level=1))
mcap.writer.zstandard = _LEVEL_1  # type: ignore[attr-defined]


class _Offsets:
    """Channel and offset of the message indexes of a chunk, which the writer keeps until the end of the part.

    As the dictionary that `mcap` uses, but in 10 bytes each: a chunk a second of 60 channels held 17 MB per hour.
    """

    def __init__(self) -> None:
        self._packed = bytearray()

    def __setitem__(self, channel: int, offset: int) -> None:
        self._packed += _OFFSET.pack(channel, offset)

    def __len__(self) -> int:
        return len(self._packed) // _OFFSET.size

    def items(self) -> Iterator[tuple[int, int]]:
        """All channels and offsets, in the order of writing."""
        return _OFFSET.iter_unpack(self._packed)


_OFFSET = struct.Struct("<HQ")


def _chunk_index(**values: Any) -> ChunkIndex:
    return ChunkIndex(**values | {"message_index_offsets": _Offsets()})


mcap.writer.ChunkIndex = _chunk_index  # type: ignore[attr-defined, assignment]

PROFILE = "headland"
RECORDED = "/recorded/"
NO_POINTS = np.empty((0, 3), np.float32)


class LogConfig(Config):
    """Intervals of chunks, disk synchronization and parts (log time), size of parts, and free space on the disk.

    A chunk ends after `flush_s` or `chunk_kib`, and then survives a crash of the process; after `sync_s` it also
    survives a power failure. A rotated log begins a new part after `part_s` or `part_mb`. A drive needs about
    `drive_mb_per_s` of space.
    """

    chunk_kib: int = Field(ge=16, le=65536)
    flush_s: float = Field(gt=0.0, le=60.0)
    sync_s: float = Field(gt=0.0, le=600.0)
    min_free_mb: float = Field(ge=0.0, le=1e6)
    drive_mb_per_s: float = Field(default=0.6, gt=0.0, le=1000.0)
    part_s: float = Field(default=3600.0, gt=0.0, le=86400.0)
    part_mb: float = Field(default=1000.0, ge=0.1, le=1e6)


class LogWriter:
    """Writes one log; raises LogError with path and free space for errors of the disk.

    `metadata` (name → key → text: configuration, versions, calibration, conditions) precedes the first message, also in
    a truncated log. `viewer` adds `/view/...` topics. A log that was not closed has no index and no end record and is
    read as incomplete. Chunks are compressed and written by a thread, so its errors are raised by a later call. With
    `rotates` the log has parts (datasets/parts.py).
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, Mapping[str, str]],
        config: LogConfig,
        viewer: Viewer | None = None,
        rotates: bool = False,
    ) -> None:
        self.path = path
        self._config, self._rotates, self._part = config, rotates, PartName(path, 1)
        self._metadata = {name: dict(values) for name, values in metadata.items()}
        self._part_began_ns: int | None = None
        self.messages = 0
        self._viewer = viewer
        self._digest = Digest()
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._opened: dict[str, tuple[str, bytes]] = {}
        self._logged: dict[str, bool] = {}
        self._flush_ns, self._sync_ns = round(config.flush_s * 1e9), round(config.sync_s * 1e9)
        self._flushed_at_ns: int | None = None
        self._held_bytes, self._chunk_bytes = 0, config.chunk_kib * 1024
        self._synced_at_ns = 0
        self._is_open = False
        self._open_part({})
        self._thread = WriterThread()

    def write(self, envelope: Envelope) -> None:
        """Appends a message, if its topic is logged, and its viewer topics."""
        topic, message = envelope.topic, without_points(envelope.message)
        self._flush_when_due(envelope.receive_ns)
        if self._is_logged(topic):
            codec = codec_of(type(message))
            data = codec.encode(message)
            channel = self._channels.get(topic) or self._open(topic, codec.name, codec.schema)
            self._add(channel, envelope.receive_ns, data, message.stamp_ns, envelope.sequence)
            self._thread.call_later(self._digest.add, topic, message.stamp_ns, data)
            self.messages += 1
        self._show(envelope)

    def show(self, envelope: Envelope) -> None:
        """Appends the viewer topics of a message, without the message."""
        self._flush_when_due(envelope.receive_ns)
        self._show(envelope)

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata so far, for another log of the same drive."""
        return dict(self._metadata)

    @property
    def size_bytes(self) -> int:
        """Bytes written to the present part."""
        return self._file.tell()

    def _show(self, envelope: Envelope) -> None:
        for name, shown in self._viewer.show(envelope) if self._viewer is not None else ():
            self.write_view(envelope.receive_ns, envelope.message.stamp_ns, name, shown)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Appends metadata known at the end only; replaces earlier ones of this name for readers."""
        self._thread.drain()
        self._metadata[name] = dict(values)
        self._writer.add_metadata(name, dict(values))

    def digest(self) -> str:
        """Digest over all messages so far, without viewer topics."""
        self._thread.drain()
        return self._digest.text()

    def close(self) -> None:
        """Writes end record and index, which complete the log."""
        try:
            self._thread.drain()  # a new part may be due
            if self._is_open:
                self._finish_part(END, {"messages": str(self.messages), "digest": self.digest()})
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Closes the file without end record: readable up to the last chunk, incomplete."""
        self._thread.stop()
        self._file.close()

    def _open_part(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        self._file = LogFile(self._part.path, round(self._config.min_free_mb * MB))
        untyped: Any = Writer
        self._writer = untyped(self._file, chunk_size=self._chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="headland")
        for name, values in {**metadata, **self._metadata}.items():
            self._writer.add_metadata(name, dict(values))
        self._is_open = True

    def _finish_part(self, name: str, values: Mapping[str, str]) -> None:
        """Writes the last metadata of a part, then index and end record."""
        self._is_open = False
        self._writer.add_metadata(name, dict(values))
        self._writer.finish()
        self._file.sync()

    def _rotate_when_due(self, now_ns: int) -> None:
        """Begins a new part after `part_s` or `part_mb`."""
        if self._part_began_ns is None:
            self._part_began_ns = now_ns
        is_old = abs(now_ns - self._part_began_ns) >= self._config.part_s * 1e9
        is_due = is_old or self._file.tell() >= self._config.part_mb * MB
        if is_due and not self._thread.has_long_batch:
            self._part_began_ns = now_ns
            self._thread.call_later(self._rotate)
            self._thread.submit(is_long=True)

    def _rotate(self) -> None:
        """Ends a part and begins the next one with the same channels; raises LogError without the space for one.

        In the thread: the index of an hour takes longer than the heartbeat of a process may.
        """
        digest = self._digest.text()
        self._finish_part(CONTINUED, {"digest": digest})
        self._file.close()
        self._part = self._part.next
        self._open_part({PART: {"number": str(self._part.number), "digest": digest}})
        self._schemas = {}
        for topic in self._opened:
            self._register(topic)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _is_logged(self, topic: str) -> bool:
        known = self._logged.get(topic)
        if known is None:
            known = self._logged[topic] = spec_of(topic.removeprefix(RECORDED)).is_logged
        return known

    def write_view(self, receive_ns: int, stamp_ns: int, topic: str, shown: Proto) -> None:
        """Appends a message of a viewer topic."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._open(topic, shown.DESCRIPTOR.full_name, descriptor_set(shown.DESCRIPTOR.file))
        self._add(channel, receive_ns, shown.SerializeToString(), stamp_ns, 0)

    def _add(self, channel: int, receive_ns: int, data: bytes, stamp_ns: int, sequence: int) -> None:
        self._thread.call_later(self._write, channel, receive_ns, data, stamp_ns, sequence)
        self._held_bytes += len(data)
        if self._held_bytes > self._chunk_bytes:
            self._submit()

    def _write(self, channel: int, receive_ns: int, data: bytes, stamp_ns: int, sequence: int) -> None:
        self._writer.add_message(channel, receive_ns, data, stamp_ns, sequence)

    def _flush(self, is_synchronized: bool) -> None:
        self._writer.flush()
        if is_synchronized:
            self._file.sync()

    def _submit(self) -> None:
        self._held_bytes = 0
        self._thread.submit()

    def _open(self, topic: str, name: str, schema: bytes) -> int:
        self._thread.drain()  # channel numbers are assigned by queued calls
        self._opened[topic] = name, schema
        self._channels[topic] = self._register(topic)
        return self._channels[topic]

    def _register(self, topic: str) -> int:
        """Channel of a topic in this part; the same in each, since the order is."""
        name, schema = self._opened[topic]
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, SchemaEncoding.Protobuf, schema)
        channel: int = self._writer.register_channel(topic, MessageEncoding.Protobuf, self._schemas[name])
        return channel

    def _flush_when_due(self, now_ns: int) -> None:
        """Ends the chunk after `flush_s`, and after a clock jump backwards."""
        if self._flushed_at_ns is None:
            self._flushed_at_ns = self._synced_at_ns = now_ns
        if 0 <= now_ns - self._flushed_at_ns < self._flush_ns:
            return
        self._flushed_at_ns = now_ns
        self._file.check_space()
        is_synchronized = not 0 <= now_ns - self._synced_at_ns < self._sync_ns
        if is_synchronized:
            self._synced_at_ns = now_ns
        self._thread.call_later(self._flush, is_synchronized)
        self._submit()
        if self._rotates:
            self._rotate_when_due(now_ns)


def without_points(message: Message) -> Message:
    """Message as logged: obstacles without points, which the scan contains (a quarter of all bytes)."""
    return replace(message, points_base_m=NO_POINTS) if isinstance(message, Obstacles) else message

"""Reading of complete and truncated MCAP logs, of Headland and others, in file order."""

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError
from mcap.records import Channel, Metadata, Schema, Statistics

from datasets.codec import codec_for, proto_from
from datasets.parts import CONTINUED, PART, part_name
from datasets.records import Chunk, Damage, End, RawMessage, messages_of, walk
from datasets.schema import PACKAGE
from messages.errors import LogError
from messages.message import Envelope

VIEW = "/view/"
END = "end"


@dataclass(frozen=True, slots=True)
class Entry:
    """One undecoded message of a log, with encoding and schema of `data`."""

    topic: str
    encoding: str
    schema: Schema | None
    sequence: int
    receive_ns: int
    stamp_ns: int
    data: bytes


@dataclass
class LogScan:
    """A pass over all parts of a log (all topics or `topics`): the attributes hold the result after iteration.

    Damaged sections are skipped and listed; messages of a lost channel are counted in `orphans`.
    """

    path: Path
    topics: Container[str] | None = None
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damages: list[Damage] = field(default_factory=list)
    declared_messages: int | None = None
    size_bytes: int = 0
    orphans: int = 0
    is_ended: bool = False
    _chunks: list[tuple[Path, Chunk]] = field(default_factory=list)
    _known: dict[Path, tuple[dict[int, Schema], dict[int, Channel]]] = field(default_factory=dict)

    @property
    def is_complete(self) -> bool:
        """Whether the log was closed and every byte was readable."""
        return self.is_ended and not self.damages

    @property
    def losses(self) -> tuple[str, ...]:
        """Damaged and missing parts as text."""
        lost = tuple(f"byte {d.offset}: {d.reason}; {d.length} bytes lost" for d in self.damages)
        return lost if lost or self.is_ended else (f"byte {self.path.stat().st_size}: the log was not closed",)

    def __iter__(self) -> Iterator[Entry]:
        path: Path | None = self.path
        while path is not None:
            damages, self.is_ended = len(self.damages), False
            yield from self._entries_of(path)
            path = self._part_after(path, len(self.damages) > damages)

    def _part_after(self, path: Path, is_damaged: bool) -> Path | None:
        """The part that continues a part just read, or None; a missing or foreign one is a damage."""
        continued, part = self.metadata.pop(CONTINUED, None), self.metadata.pop(PART, {})
        number = part.get("number", "1")
        found = part_name(path, int(number) if number.isdecimal() else 1).next.path
        if continued is None and not (is_damaged and found.is_file() and END not in self.metadata):
            return None
        head = first_metadata(found, PART) if found.is_file() else None
        if head is not None and (continued is None or continued.get("digest") == head.get("digest")):
            return found
        if continued is not None:
            reason = f"{found.name} is missing" if head is None else f"{found.name} does not continue {path.name}"
            self.damages.append(Damage(path.stat().st_size, 0, reason, True))
            self.is_ended = False
        return None

    def newest(self, topics: Container[str], at_ns: int, within_ns: int) -> dict[str, Entry]:
        """Newest entry of each of some topics received up to `at_ns` and at most `within_ns` before.

        After iteration: the chunks of that time are read again. Raises LogError for a file that has changed since.
        """
        found: dict[str, Entry] = {}
        wanted = {one.topic for _, channels in self._known.values() for one in channels.values() if one.topic in topics}
        for path, chunk in reversed(self._chunks):
            if chunk.end_ns < at_ns - within_ns or found.keys() == wanted:
                break
            if chunk.start_ns > at_ns:
                continue
            newest: dict[str, Entry] = {}
            schemas, channels = self._known[path]
            of_topic = {number: channel for number, channel in channels.items() if channel.topic in wanted}
            for one in messages_of(path, chunk):
                channel = of_topic.get(one.channel_id)
                if channel is not None and 0 <= at_ns - one.receive_ns <= within_ns:
                    newest[channel.topic] = entry_of(one, channel, schemas)
            found = newest | found
        return found

    def _entries_of(self, path: Path) -> Iterator[Entry]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        self._known[path] = schemas, channels
        self.size_bytes += path.stat().st_size if path.is_file() else 0
        for record in walk(path):
            if isinstance(record, RawMessage):
                channel = channels.get(record.channel_id)
                if channel is None:
                    self.orphans += 1
                    continue
                if self.topics is not None and channel.topic not in self.topics:
                    continue
                yield entry_of(record, channel, schemas)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Chunk):
                self._chunks.append((path, record))
            else:
                self._note(record)

    def _note(self, record: Metadata | Statistics | Damage | End) -> None:
        if isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata
        elif isinstance(record, Damage):
            self.damages.append(record)
        elif isinstance(record, Statistics):
            self.declared_messages = (self.declared_messages or 0) + record.message_count
        else:
            self.is_ended = True


def entry_of(record: RawMessage, channel: Channel, schemas: Mapping[int, Schema]) -> Entry:
    """Entry of a record with its channel."""
    return Entry(
        channel.topic, channel.message_encoding, schemas.get(channel.schema_id), record.sequence,
        record.receive_ns, record.stamp_ns, record.data,
    )  # fmt: skip


def is_ours(entry: Entry) -> bool:
    """Whether the entry is a Headland message, not one for viewers."""
    return _is_own(entry.topic, entry.schema)


def _is_own(topic: str, schema: Schema | None) -> bool:
    return schema is not None and schema.name.startswith(f"{PACKAGE}.") and not topic.startswith(VIEW)


def has_own_messages(path: Path) -> bool | None:
    """Whether the index of a log counts Headland messages; None for a log without a complete index.

    The chunks, nearly all of the file, are not read: damage inside them is found by a pass over the log.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: dict[int, int] | None = None
    for record in walk(path, has_chunks=False):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Statistics):
            counts = record.channel_message_counts
        elif isinstance(record, Damage):
            return None
    if counts is None or not channels.keys() >= counts.keys():
        return None
    return any(n and _is_own(channels[i].topic, schemas.get(channels[i].schema_id)) for i, n in counts.items())


def decode(entry: Entry) -> Envelope:
    """Message of a Headland entry; raises LogError."""
    if entry.schema is None:
        raise LogError(f"topic {entry.topic!r}: its messages have no schema")
    message = codec_for(entry.schema.name, entry.schema.data).decode(entry.data)
    return Envelope(entry.topic, entry.sequence, entry.receive_ns, message)


def read_log(path: Path, topics: Container[str] | None = None) -> Iterator[Envelope]:
    """Headland messages of a log (all topics or `topics`), in log order; raises LogError."""
    for entry in LogScan(path, topics):
        if is_ours(entry):
            yield decode(entry)


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Metadata of a log or of its first part: configuration, versions, calibration, conditions, end record if any."""
    found = (record for record in walk(path, has_chunks=False) if isinstance(record, Metadata))
    return {record.name: record.metadata for record in found if record.name not in (PART, CONTINUED)}


def first_metadata(path: Path, name: str) -> dict[str, str] | None:
    """Metadata of this name before the first message of a file, or None."""
    try:
        for record in walk(path, has_chunks=False):
            if isinstance(record, Metadata) and record.name == name:
                return record.metadata
    except LogError:
        return None
    return None


class ProtobufDecoders:
    """Decodes entries of any log by its embedded schemas."""

    def __init__(self) -> None:
        self._parsers: dict[tuple[str, bytes], Callable[[bytes], Any]] = {}

    def decode(self, entry: Entry) -> Any:
        """The protobuf message; raises LogError when schema or bytes are wrong."""
        schema = entry.schema
        if schema is None or schema.encoding != "protobuf":
            raise LogError(f"topic {entry.topic!r}: has no protobuf schema")
        key = (schema.name, schema.data)
        if key not in self._parsers:
            self._parsers[key] = proto_from(schema.name, schema.data).FromString
        try:
            return self._parsers[key](entry.data)
        except DecodeError as error:
            raise LogError(f"topic {entry.topic!r}: a message is not a {schema.name} ({error})") from error

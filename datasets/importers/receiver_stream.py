"""Byte streams of GNSS receivers: NMEA 0183 and UBX, also mixed with RTCM 3 and others, stamped, or damaged.

Each protocol is a topic. A fix is received when a recorder stamped its last line; without stamps at its own time.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from datasets.importers.gnss.clock import S
from datasets.importers.gnss.framing import END, NMEA, RTCM, UBX, Frame, frames, frames_of
from datasets.importers.gnss.protocols import FIXES, STREAM, TOPICS, Fixes, Timing
from datasets.importers.gnss.sentence import BadSentence, parse
from datasets.importers.recording import Description, Ignored, Open, Received, Recording, Sensor, Skipped
from messages.errors import LogError

NAME = "NMEA 0183 / UBX"
# Recordings that may hold sentences in their messages; they have importers of their own.
CONTAINERS = (
    b"#ROSBAG", b"\x89MCAP", b"SQLite format 3",
    b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d", b"\x0a\x0d\x0d\x0a",  # pcap
)  # fmt: skip
SNIFF_BYTES = 1 << 18
ORDER_NS = 10 * S  # fixes of two protocols of one receiver are complete within this time of each other
NO_DATE = {
    NMEA: "NMEA 0183 without a date: times count from 1970-01-01 UTC",
    UBX: "UBX without a week number: times count from the first GPS week, 1980-01-06",
}


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a file with an NMEA sentence or a UBX message in its first bytes, or anywhere if it begins with RTCM 3."""
    if path.is_dir() or head.startswith(CONTAINERS):
        return None
    with path.open("rb") as file:
        data = file.read(SNIFF_BYTES)
    if any(map(_is_ours, frames(data))):
        return open_stream
    is_receiver = len(data) == SNIFF_BYTES and any(frame.protocol == RTCM for frame in frames(data))
    return open_stream if is_receiver and any(map(_is_ours, frames_of(path))) else None


def open_stream(path: Path, _: Path | None = None) -> Recording:
    """A stream; raises LogError when nothing in it is a fix."""
    found, streams = _Contents(), {protocol: cls(Timing()) for protocol, cls in FIXES.items()}
    fixes = Counter(item[1] for item in _read(path, streams, found) if not isinstance(item, Skipped))
    timings = {protocol: streams[protocol].timing() for protocol, topic in TOPICS.items() if fixes[topic]}
    if not timings:
        raise LogError(f"{path}: no GNSS fix with a time in it; it holds {found.text()}")
    sensors = tuple(Sensor(TOPICS[protocol], "", protocol, STREAM) for protocol in timings)
    notes = tuple(note for protocol, timing in timings.items() for note in _notes(protocol, timing))
    ignored = tuple(found.ignored())
    description = Description(" + ".join(timings), sensors, ignored=ignored, notes=notes + found.notes())
    return Recording(path, description, partial(_messages, path, timings))


@dataclass
class _Contents:
    """What a stream holds beside fixes: messages of kinds that are not read, bad ones, bytes of no message."""

    unread: Counter[tuple[str, str]] = field(default_factory=Counter)
    bad: Counter[tuple[str, str]] = field(default_factory=Counter)
    other_bytes: int = 0

    def ignored(self) -> Iterator[Ignored]:
        """The kinds that are not read."""
        for (protocol, kind), count in sorted(self.unread.items()):
            yield Ignored(f"{protocol} {kind}", STREAM, "messages of this kind are not read", count)

    def notes(self) -> tuple[str, ...]:
        """The bytes of no message."""
        return (f"{self.other_bytes} bytes of no message of {', '.join((*FIXES, RTCM))}",) if self.other_bytes else ()

    def text(self) -> str:
        """All of it, for an error."""
        parts = [f"{count} {protocol} {kind} (not read)" for (protocol, kind), count in self.unread.most_common(5)]
        parts += [f"{count} {protocol} ({reason})" for (protocol, reason), count in self.bad.most_common(3)]
        return ", ".join([*parts, *self.notes()])


def _messages(path: Path, timings: dict[str, Timing]) -> Iterator[Received | Skipped]:
    """Fixes in the order in which they are complete."""
    streams, last_ns = {protocol: FIXES[protocol](timing) for protocol, timing in timings.items()}, 0
    for item in _read(path, streams, _Contents()):
        last_ns = max(item[0], last_ns) if item[0] > last_ns - ORDER_NS else item[0]
        yield item._replace(receive_ns=last_ns) if isinstance(item, Skipped) else (last_ns, *item[1:])


def _read(path: Path, streams: Mapping[str, Fixes], contents: _Contents) -> Iterator[Received | Skipped]:
    end = 0
    for frame in frames_of(path):
        contents.other_bytes += max(0, frame.at - len(frame.prefix) - end)
        end = frame.end
        stream = streams.get(frame.protocol)
        if stream is not None and (frame.fault or stream.reads(frame.kind)):
            for item in stream.add(frame):
                if isinstance(item, Skipped):
                    contents.bad[item.source, item.reason] += 1
                yield item
        elif not frame.fault and frame.protocol != END:
            contents.unread[frame.protocol, frame.kind] += 1
    for stream in streams.values():
        yield from stream.finish()


def _is_ours(frame: Frame) -> bool:
    """Whether a frame is certainly a message: a checksum of 8 bits alone would also fit other text."""
    if frame.protocol == NMEA:
        return FIXES[NMEA](Timing()).reads(frame.kind) or _is_valid(frame.data)
    return frame.protocol == UBX and not frame.fault


def _is_valid(line: bytes) -> bool:
    try:
        parse(line)
    except BadSentence:
        return False
    return True


def _notes(protocol: str, timing: Timing) -> Iterator[str]:
    if timing.has_stamps:
        yield f"{protocol}: received at the time stamps of the lines"
        if timing.zone_ns:
            yield f"the time stamps are {timing.zone_ns / 3600 / S:+g} h from UTC, by comparison with the GNSS time"
    if not timing.has_date:
        yield f"{NO_DATE[protocol]}, or from the day of the line stamps" if timing.has_stamps else NO_DATE[protocol]

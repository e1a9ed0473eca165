"""Packet captures (pcap, pcapng) of lidars and radars: one pass to find the sensors, one to read them.

A stream is what one address sends to one port, by the content of its datagrams; each has its own decoder and topic.
Scans are lists of points: beams that fire together differ in azimuth, which a range image cannot hold, nor 16 bits the
ranges beyond 65.5 m. They may be incomplete, at the ends of the capture and where packets were lost, which is counted.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from datasets.importers.captures import ars548, hesai, ouster, velodyne
from datasets.importers.captures.container import frames, is_capture
from datasets.importers.captures.devices import Decoder, Lost, Maker, Stream
from datasets.importers.captures.network import Datagram, Network, name_of_content
from datasets.importers.recording import (
    Description,
    Extrinsic,
    Ignored,
    Open,
    Received,
    Recording,
    Sensor,
    Skipped,
    numbered,
)
from datasets.importers.streams import BAD_MESSAGE
from messages.errors import LogError
from messages.message import Message

NAME = "packet capture"
MAKERS: tuple[Maker, ...] = (ars548, hesai, ouster, velodyne)
# Datagrams of a stream before each one that it may repeat
COMPARED = 16
# Reasons listed in an error, and kinds of other content counted apart.
MAX_REASONS, MAX_OTHER = 8, 100
OTHER = "other UDP ports", "unknown content is not read"
CLOCKS = "stamps of a sensor that differ by more than 0.5 s from the time of capture are moved by a constant offset"


@dataclass
class _Findings:
    """Results of the first pass; `decoders` holds what each readable stream is, not its messages."""

    decoders: dict[Stream, Decoder] = field(default_factory=dict)
    refused: dict[Stream, str] = field(default_factory=dict)
    counts: Counter[Stream] = field(default_factory=Counter)
    other: Counter[tuple[str, str]] = field(default_factory=Counter)
    damages: list[str] = field(default_factory=list)


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens a pcap or pcapng file."""
    return open_capture if is_capture(head) else None


def open_capture(path: Path, _: Path | None = None) -> Recording:
    """A packet capture; raises LogError with the reasons when no stream can be read."""
    found = _find(path)
    labels = _labels([*found.decoders, *found.refused])
    ignored = tuple(_ignored(path, found, labels))
    if not found.decoders or (found.refused and all(d.kind == "imu" for d in found.decoders.values())):
        reasons = [f"{i.source}: {i.reason}" for i in ignored]
        raise LogError(f"{path}: no readable sensor data; {'; '.join(reasons[:MAX_REASONS]) or 'no packets'}")
    topics = numbered((labels[s], d.kind) for s, d in found.decoders.items())
    names = _frame_names(found.decoders)
    sensors = tuple(Sensor(topics[labels[s]], names[s], labels[s], s.model) for s in found.decoders)
    notes = tuple(f"{labels[s]}: {note}" for s, d in found.decoders.items() for note in d.notes)
    extrinsics = tuple(_extrinsics(found.decoders, names))
    about = Description(NAME, sensors, extrinsics, ignored, None, (*notes, CLOCKS))
    return Recording(path, about, lambda: _read(path, labels, topics))


def _find(path: Path) -> _Findings:
    found, network = _Findings(), Network()
    for datagram in network.datagrams(frames(path, found.damages)):
        recognized = _recognize(datagram)
        if recognized is None:
            source = f"{datagram.source}:{datagram.port}"
            name = name_of_content(datagram.payload)
            what = source, f"{name} in UDP datagrams of {len(datagram.payload)} bytes is not read"
            found.other[what if what in found.other or len(found.other) < MAX_OTHER else OTHER] += 1
            continue
        maker, stream = recognized
        found.counts[stream] += 1
        if stream not in found.decoders and stream not in found.refused:
            try:
                found.decoders[stream] = maker.open_decoder(stream, datagram.payload, path)
            except LogError as error:
                found.refused[stream] = str(error)
    found.other.update(network.skipped)
    return found


def _recognize(datagram: Datagram) -> tuple[Maker, Stream] | None:
    for maker in MAKERS:
        model = maker.recognize(datagram.payload)
        if model is not None:
            return maker, Stream(datagram.source, datagram.port, model)
    return None


def _ignored(path: Path, found: _Findings, labels: dict[Stream, str]) -> Iterator[Ignored]:
    for stream, reason in found.refused.items():
        yield Ignored(labels[stream], stream.model, reason, found.counts[stream])
    for (source, reason), count in found.other.items():
        yield Ignored(source, "packets", reason, count)
    for damage in found.damages:
        yield Ignored(path.name, "file", damage)


def _labels(streams: list[Stream]) -> dict[Stream, str]:
    """Name of each stream: address and port, numbered where one port has several models."""
    labels: dict[Stream, str] = {}
    for stream in streams:
        at = [s for s in labels if (s.source, s.port) == (stream.source, stream.port)]
        labels[stream] = f"{stream.source}:{stream.port}" + (f" ({len(at) + 1})" if at else "")
    return labels


def _frame_names(decoders: dict[Stream, Decoder]) -> dict[Stream, str]:
    """Frame of each stream: that of the maker, numbered from the second sensor on."""
    names: dict[Stream, str] = {}
    for stream, decoder in decoders.items():
        number = 1 + sum(decoders[s].frame == decoder.frame for s in names)
        names[stream] = decoder.frame + (f"_{number}" if number > 1 else "")
    return names


def _extrinsics(decoders: dict[Stream, Decoder], names: dict[Stream, str]) -> Iterator[Extrinsic]:
    """Poses between streams of one address, where it is that of one sensor."""
    for stream, decoder in decoders.items():
        at = [s for s in decoders if s.source == stream.source]
        for extrinsic in decoder.extrinsics:
            children = [s for s in at if decoders[s].frame == extrinsic.child]
            if len(children) == 1 and sum(decoders[s].frame == decoder.frame for s in at) == 1:
                yield Extrinsic(names[stream], names[children[0]], extrinsic.T_parent_child)


def _read(path: Path, labels: dict[Stream, str], topics: dict[str, str]) -> Iterator[Received | Skipped]:
    decoders: dict[Stream, Decoder] = {}
    last: dict[Stream, deque[bytes]] = {}
    end_ns = 0
    for datagram in Network().datagrams(frames(path, [])):
        recognized = _recognize(datagram)
        if recognized is None or labels.get(recognized[1]) not in topics:
            continue
        maker, stream = recognized
        label = labels[stream]
        end_ns = max(end_ns, datagram.receive_ns)
        before = last.setdefault(stream, deque(maxlen=COMPARED))
        if datagram.payload in before:
            yield Skipped(datagram.receive_ns, label, stream.model, "repeated datagram")
            continue
        before.append(datagram.payload)
        try:
            if stream not in decoders:
                decoders[stream] = maker.open_decoder(stream, datagram.payload, path)
            for found in decoders[stream].receive(datagram.payload, datagram.receive_ns):
                yield _item(datagram.receive_ns, found, topics[label], label, stream)
        except BAD_MESSAGE as error:
            yield Skipped(datagram.receive_ns, label, stream.model, str(error))
    for stream, decoder in decoders.items():
        try:
            for found in decoder.finish():
                yield _item(end_ns, found, topics[labels[stream]], labels[stream], stream)
        except BAD_MESSAGE as error:
            yield Skipped(end_ns, labels[stream], stream.model, str(error))


def _item(receive_ns: int, found: Message | Lost, topic: str, label: str, stream: Stream) -> Received | Skipped:
    if isinstance(found, Lost):
        return Skipped(receive_ns, label, stream.model, found.reason)
    return receive_ns, topic, found

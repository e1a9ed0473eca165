"""MCAP files: Headland logs, and logs with Foxglove or ROS messages."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from datasets.importers import foxglove_messages
from datasets.importers.recording import (
    SOURCE,
    Description,
    Ignored,
    Open,
    Received,
    Recording,
    Sensor,
    Skipped,
    description_from,
    read_head,
)
from datasets.importers.ros_types import ROS1, ROS2, decoder_of, type_name
from datasets.importers.streams import Item, recording_of
from datasets.parts import parts_after
from datasets.reader import (
    Entry,
    LogScan,
    ProtobufDecoders,
    decode,
    has_own_messages,
    is_ours,
    read_metadata,
)
from datasets.records import MAGIC
from messages.errors import LogError

NAME = "MCAP"
OWN = "headland"  # format of a Headland log that was not imported
BAG_METADATA = "metadata.yaml"  # in the folder of a ROS 2 bag


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens an MCAP file, also a truncated one, or a folder with one MCAP file that is no ROS 2 bag."""
    if not path.is_dir():
        return open_mcap if head.startswith(MAGIC) or MAGIC.startswith(head) else None
    found = [p for p in path.glob("*.mcap") if read_head(p).startswith(MAGIC)]
    later = {part for log in found for part in parts_after(log)}
    logs = [p for p in found if p not in later]
    is_bag = (path / BAG_METADATA).is_file()
    return (lambda _, __: open_mcap(logs[0])) if len(logs) == 1 and not is_bag else None


def open_mcap(path: Path, _: Path | None = None) -> Recording:
    """An MCAP file, complete or truncated; raises LogError."""
    has_ours = has_own_messages(path)
    if has_ours:
        return _own_log(path, read_metadata(path), ())
    scan = LogScan(path)
    if has_ours is None and sum(map(is_ours, scan)) > 0:  # to the end, for all losses
        return _own_log(path, scan.metadata, scan.losses)
    return recording_of(path, "mcap", lambda: entries_of(path))


def _own_log(path: Path, metadata: dict[str, dict[str, str]], notes: tuple[str, ...]) -> Recording:
    """A Headland log: its messages; description of an imported log from its metadata, else from the viewer frames.

    `notes` are the losses of a log without index; those of another one are skipped messages of each pass.
    """
    source = metadata.get(SOURCE)
    try:
        about = description_from(json.loads(source["description"])) if source is not None else _own_description(path)
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"{path}: its record {SOURCE!r} is no description ({error})") from error
    return Recording(path, replace(about, notes=about.notes + notes), lambda: _own_messages(path, not notes))


def _own_description(path: Path) -> Description:
    views = recording_of(path, OWN, lambda: entries_of(path)).description
    types = {e.topic: e.schema.name for e in LogScan(path) if is_ours(e) and e.schema is not None}
    sensors = tuple(Sensor(topic, topic, topic, name) for topic, name in types.items())
    ignored = tuple(Ignored(s.source, s.source_type, "for viewers") for s in views.sensors)
    truth_frame = "map" if "truth_objects" in types else None
    return Description(OWN, sensors, views.extrinsics, ignored, truth_frame)


def _own_messages(path: Path, are_losses_skipped: bool) -> Iterator[Received | Skipped]:
    scan, receive_ns = LogScan(path), 0
    for entry in scan:
        receive_ns = entry.receive_ns
        if not is_ours(entry):
            continue
        try:
            yield entry.receive_ns, entry.topic, decode(entry).message
        except LogError as error:
            yield Skipped(entry.receive_ns, entry.topic, _type_of(entry), str(error))
    if are_losses_skipped:
        yield from _lost(scan, receive_ns)


def entries_of(path: Path) -> Iterator[Item | Skipped]:
    """Messages of a log that are not Headland's, and lost parts."""
    decoders, scan, receive_ns = ProtobufDecoders(), LogScan(path), 0
    for entry in scan:
        receive_ns = entry.receive_ns
        if not is_ours(entry):
            yield Item(entry.topic, _type_of(entry), receive_ns, _decoder(entry, decoders))
    yield from _lost(scan, receive_ns)


def _lost(scan: LogScan, receive_ns: int) -> Iterator[Skipped]:
    """Lost parts after a pass."""
    for damage in scan.damages:
        reason = f"byte {damage.offset}: {damage.length} bytes lost: {damage.reason}"
        yield Skipped(receive_ns, scan.path.name, "mcap", reason)
    for _ in range(scan.orphans):
        yield Skipped(receive_ns, scan.path.name, "mcap", "message of a channel in a lost part")


def _type_of(entry: Entry) -> str:
    name = entry.schema.name if entry.schema is not None else ""
    return type_name(name) if entry.encoding in ("cdr", "ros1") else name


def _decoder(entry: Entry, decoders: ProtobufDecoders) -> Callable[[], Any]:
    if entry.encoding == "protobuf":
        return lambda: decoders.decode(entry)
    if entry.encoding == "json":
        return lambda: foxglove_messages.from_json(entry.data)
    if entry.encoding in ("cdr", "ros1"):
        ros = ROS2 if entry.encoding == "cdr" else ROS1
        return lambda: decoder_of(ros, _type_of(entry), _definition(entry))(entry.data)
    return lambda: _refuse(entry)


def _definition(entry: Entry) -> str:
    """Definition of a ROS type in the log, "" in another notation."""
    schema = entry.schema
    is_text = schema is not None and schema.encoding in ("ros1msg", "ros2msg")
    return schema.data.decode("utf-8", "replace") if schema is not None and is_text else ""


def _refuse(entry: Entry) -> Any:
    raise LogError(f"message encoding {entry.encoding!r} is not one of protobuf, json, cdr, ros1")

"""MCAP files: Headland logs, and logs with Foxglove or ROS messages."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from datasets.importers import foxglove_messages
from datasets.importers.recording import (
    SOURCE,
    Description,
    Ignored,
    Open,
    Received,
    Recording,
    Sensor,
    description_from,
    read_head,
)
from datasets.importers.ros_messages import TRANSFORMS
from datasets.importers.streams import Item, recording_of
from datasets.reader import Entry, LogScan, ProtobufDecoders, is_ours, read_log
from datasets.records import MAGIC
from messages.errors import LogError

NAME = "MCAP"
OWN = "headland"  # format of a Headland log that was not imported
BAG_METADATA = "metadata.yaml"  # in the folder of a ROS 2 bag


@cache
def ros_types(name: str) -> Any:
    """rosbags type store of a ROS distribution, with the transforms of tf2 added for ROS 1."""
    store = get_typestore(Stores[name])
    if TRANSFORMS not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
    return store


def sniff(path: Path, head: bytes) -> Open | None:
    """Opens an MCAP file, also a truncated one, or a folder with one MCAP file that is no ROS 2 bag."""
    if not path.is_dir():
        return open_mcap if head.startswith(MAGIC) or MAGIC.startswith(head) else None
    logs = [p for p in path.glob("*.mcap") if read_head(p).startswith(MAGIC)]
    is_bag = (path / BAG_METADATA).is_file()
    return (lambda _, __: open_mcap(logs[0])) if len(logs) == 1 and not is_bag else None


def open_mcap(path: Path, _: Path | None = None) -> Recording:
    """An MCAP file, complete or truncated; raises LogError."""
    scan = LogScan(path)
    has_ours = any(is_ours(entry) for entry in scan)
    notes = tuple(f"byte {d.offset}: {d.reason}; {d.length} bytes lost" for d in scan.damages)
    if has_ours:
        return _own_log(path, scan.metadata, notes)
    return recording_of(path, "mcap", lambda: _items(path), notes)


def _own_log(path: Path, metadata: dict[str, dict[str, str]], notes: tuple[str, ...]) -> Recording:
    """A Headland log: its messages; description of an imported log from its metadata, else from the viewer frames."""
    source = metadata.get(SOURCE)
    try:
        about = description_from(json.loads(source["description"])) if source is not None else _own_description(path)
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"{path}: its record {SOURCE!r} is no description ({error})") from error
    return Recording(path, replace(about, notes=about.notes + notes), lambda: _own_messages(path))


def _own_description(path: Path) -> Description:
    views = recording_of(path, OWN, lambda: _items(path)).description
    types = {e.topic: e.schema.name for e in LogScan(path) if is_ours(e) and e.schema is not None}
    sensors = tuple(Sensor(topic, topic, topic, name) for topic, name in types.items())
    ignored = tuple(Ignored(s.source, s.source_type, "for viewers") for s in views.sensors)
    truth_frame = "map" if "truth_objects" in types else None
    return Description(OWN, sensors, views.extrinsics, ignored, truth_frame)


def _own_messages(path: Path) -> Iterator[Received]:
    for envelope in read_log(path):
        yield envelope.receive_ns, envelope.topic, envelope.message


def _items(path: Path) -> Iterator[Item]:
    decoders = ProtobufDecoders()
    for entry in LogScan(path):
        if not is_ours(entry):
            name = entry.schema.name if entry.schema is not None else ""
            yield Item(entry.topic, _type_name(entry.encoding, name), entry.receive_ns, _decoder(entry, decoders))


def _type_name(encoding: str, name: str) -> str:
    """ROS types as `package/msg/Type`, also for schemas without `msg`."""
    if encoding in ("cdr", "ros1") and name.count("/") == 1:
        return name.replace("/", "/msg/")
    return {"tf/msg/tfMessage": TRANSFORMS}.get(name, name)


def _decoder(entry: Entry, decoders: ProtobufDecoders) -> Callable[[], Any]:
    if entry.encoding == "protobuf":
        return lambda: decoders.decode(entry)
    if entry.encoding == "json":
        return lambda: foxglove_messages.from_json(entry.data)
    name = _type_name(entry.encoding, entry.schema.name if entry.schema is not None else "")
    if entry.encoding == "cdr":
        return lambda: ros_types("ROS2_HUMBLE").deserialize_cdr(entry.data, name)
    if entry.encoding == "ros1":
        return lambda: ros_types("ROS1_NOETIC").deserialize_ros1(entry.data, name)
    return lambda: _refuse(entry)


def _refuse(entry: Entry) -> Any:
    raise LogError(f"message encoding {entry.encoding!r} is not one of protobuf, json, cdr, ros1")

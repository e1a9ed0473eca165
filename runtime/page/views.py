"""Viewer topics of a running drive and of a log, for the Foxglove server of the page."""

from bisect import bisect_right
from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from datasets.reader import VIEW, LogScan
from datasets.schema import descriptor_set, once
from datasets.viewer import Viewer
from hmi.feed import ViewMessage, is_event
from hmi.scene import Scene
from messages.message import Envelope
from runtime.stack import load_stack

SCHEMAS: dict[str, Any] = {  # of the kinds of topics that the page does not read: decoded for a subscription alone
    "lidar": PointCloud, "radar": PointCloud, "camera": CompressedImage, "ultrasonic": SceneUpdate,
    "truth_objects": SceneUpdate,
}  # fmt: skip
EACH = ("/view/events", "/view/log")  # every message counts, of the other topics the newest one


class MachineViews:
    """Converts the messages of a running drive.

    While a client is connected those that the page reads are converted, scans and images only for a subscription;
    without a client paths and faults alone, which come once.
    """

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._known: set[str] = set()
        self._envelopes: list[Envelope] = []
        self.read: frozenset[str] | None = None

    def needs(self, topic: str) -> bool:
        """Whether messages of a topic are needed that the page does not read."""
        return self.read is not None and topic.partition("/")[0] in SCHEMAS and f"/view/{topic}" in self.read

    def take(self, envelopes: Iterable[Envelope]) -> None:
        """Keeps messages until they are asked for."""
        self._envelopes = [one for one in envelopes if self.read is not None or is_event(one.topic)]

    def messages(self, topics: Iterable[str]) -> Iterator[ViewMessage]:
        """Viewer messages of what was taken, and those of `topics` that are there to be subscribed to."""
        envelopes, self._envelopes = self._envelopes, []
        for topic in topics:
            schema = SCHEMAS.get(topic.partition("/")[0])
            if schema is not None and topic not in self._known:
                self._known.add(topic)
                yield _message(f"/view/{topic}", schema.DESCRIPTOR, 0, None)
        for envelope in envelopes:
            if envelope.topic.partition("/")[0] in SCHEMAS and not self.needs(envelope.topic):
                continue
            stamp_ns = envelope.message.stamp_ns
            for topic, shown in self._viewer.show(envelope):
                yield _message(topic, shown.DESCRIPTOR, stamp_ns, shown.SerializeToString())


class LogViews:
    """The viewer messages of a log, in memory."""

    def __init__(self, path: Path) -> None:
        schemas: dict[bytes, bytes] = {}
        self._messages = []
        for entry in LogScan(path, _Views()):
            if entry.schema is not None and entry.encoding == "protobuf":
                schema = schemas.setdefault(entry.schema.data, entry.schema.data)
                self._messages.append(ViewMessage(entry.topic, entry.schema.name, schema, entry.receive_ns, entry.data))
        self._times_ns = [message.stamp_ns for message in self._messages]
        self._next = 0

    def rewind(self) -> None:
        """Begins at the start of the log again."""
        self._next = 0

    def messages(self, now_ns: int) -> list[ViewMessage]:
        """Messages up to a time that were not there at the last call: the newest of each topic, every event."""
        first, self._next = self._next, bisect_right(self._times_ns, now_ns)
        found = self._messages[first : self._next]
        newest = {message.topic: message for message in found}
        return [one for one in found if one.topic in EACH or newest[one.topic] is one]


class _Views(Container[str]):
    """The viewer topics, for a scan."""

    def __contains__(self, topic: object) -> bool:
        return str(topic).startswith(VIEW)


def machine_views(scene: Scene) -> MachineViews:
    """Views of the machine, implement and site of a scene, as configured for logs."""
    return MachineViews(Viewer(load_stack().datasets.viewer, scene.vehicle, scene.implement, scene.site))


def _message(topic: str, descriptor: Any, stamp_ns: int, data: bytes | None) -> ViewMessage:
    return ViewMessage(topic, descriptor.full_name, _schema_of(descriptor), stamp_ns, data)


@once
def _schema_of(descriptor: Any) -> bytes:
    return descriptor_set(descriptor.file)

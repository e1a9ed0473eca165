"""A recording: its description, and its messages in order of reception."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from geometry.arrays import Float64
from messages.errors import LogError
from messages.message import Message

# Metadata record of an imported log with its description.
SOURCE = "source"
# receive_ns, topic, message
Received = tuple[int, str, Message]
HEAD_BYTES = 4096
# Reasons of skipped messages listed for one stream.
MAX_REASONS = 5
OTHER_REASONS = "other reasons"
# Times that a log holds: from 1970 to 2262.
END_NS = 1 << 63


class Skipped(NamedTuple):
    """A message that cannot be read, in place of its `Received`, with the reason."""

    receive_ns: int
    source: str
    source_type: str
    reason: str


@dataclass(frozen=True)
class Sensor:
    """One stream of the recording: topic, frame of its data ("" = unknown), and its origin."""

    topic: str
    frame: str
    source: str
    source_type: str


@dataclass(frozen=True, eq=False)
class Extrinsic:
    """A constant pose `T_parent_child` (4, 4)."""

    parent: str
    child: str
    T_parent_child: Float64


@dataclass(frozen=True)
class CameraCalibration:
    """Intrinsics of the images of a topic: pinhole with Brown's distortion (k1, k2, p1, p2, k3; OpenCV's order).

    `frame` is the optical frame (x right, y down, z forward); the distortion of rectified images is zero.
    """

    topic: str
    frame: str
    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Ignored:
    """Messages of a stream that are not read, with the reason; `count` None = not counted."""

    source: str
    source_type: str
    reason: str
    count: int | None = None


@dataclass
class TopicCount:
    """Row of the table of a recording: messages of a stream, read to `topic` ("" = none is read) and skipped.

    `skipped` is None where the messages of an ignored stream were not counted; `reasons` has the number by reason.
    """

    source: str
    source_type: str
    topic: str
    read: int = 0
    skipped: int | None = 0
    reasons: Counter[str] = field(default_factory=Counter)

    def skip(self, reason: str, count: int | None) -> None:
        """Adds skipped messages."""
        self.skipped = None if count is None or self.skipped is None else self.skipped + count
        is_listed = reason in self.reasons or len(self.reasons) < MAX_REASONS
        self.reasons[reason if is_listed else OTHER_REASONS] += count or 0


@dataclass(frozen=True)
class Description:
    """Content of a recording, without assumptions other than those in `notes`.

    `truth_frame` is the frame of the true objects: `map`, or without poses that of the lidar named in their topic (at
    the stamp of each message); None without truth. `truth_view_deg` is the labelled half angle about the x axis of that
    lidar. `vehicle` names the file in `configs/vehicles/` of the recording vehicle where the format determines it.
    """

    format: str
    sensors: tuple[Sensor, ...]
    extrinsics: tuple[Extrinsic, ...] = ()
    ignored: tuple[Ignored, ...] = ()
    truth_frame: str | None = None
    notes: tuple[str, ...] = ()
    truth_view_deg: float = 180.0
    vehicle: str | None = None
    cameras: tuple[CameraCalibration, ...] = ()


@dataclass(frozen=True)
class Recording:
    """A recording on disk; each call of `messages` starts a new pass over it, which never ends at a bad message.

    `read` also skips messages with a time that no log holds.
    """

    path: Path
    description: Description
    messages: Callable[[], Iterator[Received | Skipped]]
    _pass: Counter[str | Skipped] = field(init=False, default_factory=Counter, repr=False, compare=False)

    def read(self) -> Iterator[Received]:
        """Messages of a new pass, bad ones skipped and counted; raises LogError at its end if none was readable."""
        counts: Counter[str | Skipped] = Counter()
        is_empty = True
        sensors = {sensor.topic: sensor for sensor in self.description.sensors}
        for item in self.messages():
            if not isinstance(item, Skipped) and (reason := _bad_time(item)):
                sensor = sensors.get(item[1], Sensor(item[1], "", item[1], ""))
                item = Skipped(0, sensor.source, sensor.source_type, reason)
            if isinstance(item, Skipped):
                counts[item._replace(receive_ns=0)] += 1
                continue
            counts[item[1]] += 1
            is_empty = False
            yield item
        self._pass.clear()
        self._pass.update(counts)
        if is_empty:
            raise LogError(f"{self.path}: contains no readable message; {_unread(self.table())}")

    def table(self) -> tuple[TopicCount, ...]:
        """All streams, with the numbers of the last complete pass; of an imported log also what the import skipped."""
        read = {item: count for item, count in self._pass.items() if not isinstance(item, Skipped)}
        skipped = [Ignored(*item[1:], count) for item, count in self._pass.items() if isinstance(item, Skipped)]
        return table_of(self.description, read, skipped)


def _bad_time(item: Received) -> str:
    """Why a log cannot hold the times of a message, empty if it can."""
    times_ns = item[0], item[2].stamp_ns
    return "a time before 1970" if min(times_ns) < 0 else "a time after 2262" if max(times_ns) >= END_NS else ""


def table_of(about: Description, read: Mapping[str, int], skipped: Iterable[Ignored] = ()) -> tuple[TopicCount, ...]:
    """Rows of all streams, from the messages read by topic and those skipped beyond `about.ignored`."""
    rows = [TopicCount(s.source, s.source_type, s.topic, read.get(s.topic, 0)) for s in about.sensors]
    by_source = {row.source: row for row in reversed(rows)}
    for ignored in (*about.ignored, *skipped):
        if ignored.source not in by_source:
            by_source[ignored.source] = TopicCount(ignored.source, ignored.source_type, "")
            rows.append(by_source[ignored.source])
        by_source[ignored.source].skip(ignored.reason, ignored.count)
    return tuple(rows)


def _unread(table: tuple[TopicCount, ...]) -> str:
    rows = [f"{row.source} ({row.source_type}): {', '.join(row.reasons) or 'without messages'}" for row in table]
    return f"streams: {'; '.join(rows) or 'none'}"


# Opens a path, with label files as truth; raises LogError.
Open = Callable[[Path, Path | None], Recording]


def read_head(path: Path) -> bytes:
    """The first bytes of a file; raises LogError."""
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def instance_of(source: str) -> str:
    """Instance name of a source in a topic: `sensing_lidar_points` for `/sensing/lidar/points`."""
    return re.sub(r"[^A-Za-z0-9]+", "_", source).strip("_") or "unnamed"


def describe(description: Description) -> dict[str, Any]:
    """The description as plain values, for the metadata of an imported log."""
    return {
        "format": description.format,
        "sensors": [vars(s) for s in description.sensors],
        "extrinsics": [
            {"parent": e.parent, "child": e.child, "T_parent_child": e.T_parent_child.tolist()}
            for e in description.extrinsics
        ],
        "ignored": [vars(i) for i in description.ignored],
        "truth_frame": description.truth_frame,
        "notes": list(description.notes),
        "truth_view_deg": description.truth_view_deg,
        "vehicle": description.vehicle,
        "cameras": [vars(c) for c in description.cameras],
    }


def description_from(values: dict[str, Any]) -> Description:
    """Inverse of `describe`; raises KeyError, TypeError or ValueError."""
    return Description(
        format=values["format"],
        sensors=tuple(Sensor(**s) for s in values["sensors"]),
        extrinsics=tuple(
            Extrinsic(e["parent"], e["child"], np.array(e["T_parent_child"], np.float64)) for e in values["extrinsics"]
        ),
        ignored=tuple(Ignored(**i) for i in values["ignored"]),
        truth_frame=values["truth_frame"],
        notes=tuple(values["notes"]),
        truth_view_deg=float(values["truth_view_deg"]),
        vehicle=values["vehicle"],
        cameras=tuple(_camera_from(c) for c in values.get("cameras", ())),
    )


def _camera_from(values: dict[str, Any]) -> CameraCalibration:
    """A calibration from plain values, where tuples are lists."""
    fields: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return CameraCalibration(**fields)


def numbered(sources: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Unique topics for (source, kind) pairs: a number is appended to a name in use."""
    topics: dict[str, str] = {}
    for source, kind in sources:
        topic, number = f"{kind}/{instance_of(source)}", 2
        while topic in topics.values():
            topic, number = f"{kind}/{instance_of(source)}_{number}", number + 1
        topics[source] = topic
    return topics

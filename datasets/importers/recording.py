"""A recording: its description, and its messages in order of reception."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import Float64
from messages.errors import LogError
from messages.message import Message

# Metadata record of an imported log with its description.
SOURCE = "source"
# receive_ns, topic, message
Received = tuple[int, str, Message]
HEAD_BYTES = 4096


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
class Ignored:
    """A stream that is not read, with the reason."""

    source: str
    source_type: str
    reason: str


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


@dataclass(frozen=True)
class Recording:
    """A recording on disk; each call of `read` starts a new pass over its messages."""

    path: Path
    description: Description
    read: Callable[[], Iterator[Received]]


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
    )


def numbered(sources: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Unique topics for (source, kind) pairs: a number is appended to a name in use."""
    topics: dict[str, str] = {}
    for source, kind in sources:
        topic, number = f"{kind}/{instance_of(source)}", 2
        while topic in topics.values():
            topic, number = f"{kind}/{instance_of(source)}_{number}", number + 1
        topics[source] = topic
    return topics

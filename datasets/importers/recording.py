"""What any recording becomes: what it holds, and its messages in order of arrival."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import Float64
from messages.message import Message

# The metadata record of an imported log that holds its description.
SOURCE = "source"
# receive_ns, topic, message
Received = tuple[int, str, Message]


@dataclass(frozen=True)
class Sensor:
    """One stream of the recording: our topic, the frame its data is in ("" = unknown), and where it came from."""

    topic: str
    frame: str
    source: str
    source_type: str


@dataclass(frozen=True, eq=False)
class Extrinsic:
    """A pose that holds throughout the recording; `T_parent_child` (4, 4)."""

    parent: str
    child: str
    T_parent_child: Float64


@dataclass(frozen=True)
class Ignored:
    """A stream that was found and not read, with the reason."""

    source: str
    source_type: str
    reason: str


@dataclass(frozen=True)
class Description:
    """What a recording is: nothing in it is guessed; the vehicle is unknown unless the recording says it.

    `truth_frame` is the frame of the true objects: `map`; or, when the recording has no pose, that of the lidar whose
    name their topic has (each message in that frame at its stamp); None without truth. `notes` say what was assumed.
    """

    format: str
    sensors: tuple[Sensor, ...]
    extrinsics: tuple[Extrinsic, ...] = ()
    ignored: tuple[Ignored, ...] = ()
    truth_frame: str | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recording:
    """A recording on disk; `read` starts a new pass over its messages each time it is called."""

    path: Path
    description: Description
    read: Callable[[], Iterator[Received]]


def instance_of(source: str) -> str:
    """A source's name as the instance in a topic: `/sensing/lidar/points` is `sensing_lidar_points`."""
    return re.sub(r"[^A-Za-z0-9]+", "_", source).strip("_") or "unnamed"


def describe(description: Description) -> dict[str, Any]:
    """The description as plain values, for `--json` and for the metadata of an imported log."""
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
    }


def description_from(values: dict[str, Any]) -> Description:
    """What `describe` was given."""
    return Description(
        format=values["format"],
        sensors=tuple(Sensor(**s) for s in values["sensors"]),
        extrinsics=tuple(
            Extrinsic(e["parent"], e["child"], np.array(e["T_parent_child"], np.float64)) for e in values["extrinsics"]
        ),
        ignored=tuple(Ignored(**i) for i in values["ignored"]),
        truth_frame=values["truth_frame"],
        notes=tuple(values["notes"]),
    )


def numbered(sources: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Topics for (source, kind), each once: what would get the same name gets a number."""
    topics: dict[str, str] = {}
    for source, kind in sources:
        topic, number = f"{kind}/{instance_of(source)}", 2
        while topic in topics.values():
            topic, number = f"{kind}/{instance_of(source)}_{number}", number + 1
        topics[source] = topic
    return topics

"""Recordings as streams of typed messages (bags and MCAP): one pass to describe, one to read."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from datasets.importers import foxglove_messages as foxglove
from datasets.importers import ros_messages as ros
from datasets.importers.recording import Description, Extrinsic, Ignored, Received, Recording, Sensor, numbered
from geometry.arrays import Float64
from messages.errors import LogError
from messages.message import Message

TRANSLATIONS = ros.TRANSLATIONS | foxglove.TRANSLATIONS
# Tolerance (m, -) for equal poses of a mount.
SAME_POSE = 1e-6
V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Item:
    """One message of a stream; `decode` is called only for messages that are read."""

    source: str
    type: str
    receive_ns: int
    decode: Callable[[], Any]


@dataclass
class _Findings:
    """Results of the first pass; `mounts` has None for a moving frame."""

    types: dict[str, str]
    frames: dict[str, str]
    mounts: dict[tuple[str, str], Float64 | None]


def recording_of(path: Path, name: str, items: Callable[[], Iterator[Item]], notes: tuple[str, ...] = ()) -> Recording:
    """A recording from a stream; `items` starts a new pass. Raises LogError with file, topic and value."""
    found = _find(path, items)
    read = {source: kind for source, kind in found.types.items() if kind in TRANSLATIONS}
    topics = numbered((source, TRANSLATIONS[kind][0]) for source, kind in read.items())
    sensors = [Sensor(topics[s], found.frames.get(s, ""), s, kind) for s, kind in read.items()]
    ignored = [
        Ignored(s, kind, "its type is not read") for s, kind in found.types.items() if not (s in read or _is_tf(kind))
    ]
    mounts = [Extrinsic(*edge, T) for edge, T in found.mounts.items() if T is not None]
    description = Description(name, tuple(sensors), tuple(mounts), tuple(ignored), None, notes)
    return Recording(path, description, lambda: _read(path, items, topics))


def _read(path: Path, items: Callable[[], Iterator[Item]], topics: dict[str, str]) -> Iterator[Received]:
    for item in items():
        topic = topics.get(item.source)
        if topic is not None:
            yield item.receive_ns, topic, _guarded(path, item, _translate)


def _find(path: Path, items: Callable[[], Iterator[Item]]) -> _Findings:
    found = _Findings({}, {}, {})
    for item in items():
        found.types.setdefault(item.source, item.type)
        if _is_tf(item.type):
            for parent, child, T in _guarded(path, item, _edges):
                _note_mount(found.mounts, (parent, child), T)
        elif item.type in TRANSLATIONS and item.source not in found.frames:
            found.frames[item.source] = _guarded(path, item, _frame)
    return found


def _note_mount(mounts: dict[tuple[str, str], Float64 | None], edge: tuple[str, str], T: Float64) -> None:
    known = mounts.setdefault(edge, T)
    if known is not None and not np.allclose(known, T, rtol=0.0, atol=SAME_POSE):
        mounts[edge] = None


def _is_tf(kind: str) -> bool:
    return kind == ros.TRANSFORMS or kind in foxglove.TRANSFORMS


def _edges(item: Item) -> list[tuple[str, str, Float64]]:
    is_foxglove = item.type in foxglove.TRANSFORMS
    return foxglove.edges_of(item.decode()) if is_foxglove else ros.edges_of(item.decode())


def _frame(item: Item) -> str:
    is_foxglove = item.type in foxglove.TRANSLATIONS
    return foxglove.frame_of(item.decode()) if is_foxglove else ros.frame_of(item.decode())


def _translate(item: Item) -> Message:
    return TRANSLATIONS[item.type][1](item.decode(), item.receive_ns)


def _guarded(path: Path, item: Item, step: Callable[[Item], V]) -> V:
    """Result of `step`; errors become LogError with file, topic and time."""
    try:
        return step(item)
    except (LogError, ValueError, TypeError, AttributeError, KeyError, IndexError, AssertionError) as error:
        raise LogError(f"{path}: topic {item.source!r} at {item.receive_ns} ns ({item.type}): {error}") from error

"""Recordings as streams of typed messages (bags and MCAP): one pass to describe, one to read."""

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from datasets.importers import foxglove_messages as foxglove
from datasets.importers import ros_messages as ros
from datasets.importers.recording import Description, Extrinsic, Ignored, Received, Recording, Sensor, Skipped, numbered
from datasets.importers.ros_types import TRANSFORMS
from datasets.importers.translation import NotRead, Translation
from geometry.arrays import Float64
from messages.errors import LogError

TRANSLATIONS = ros.TRANSLATIONS | foxglove.TRANSLATIONS
# Tolerance (m, -) for equal poses of a mount.
SAME_POSE = 1e-6
# Errors of decoding a message of arbitrary bytes.
BAD_MESSAGE = (
    LogError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, AssertionError, MemoryError,
    struct.error, cv2.error, SerdeError, TypesysError,
)  # fmt: skip
TRANSFORMS_ONLY = "constant transforms are read as mounts, moving ones are not used"


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

    types: dict[str, str] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    frames: dict[str, str] = field(default_factory=dict)
    mounts: dict[tuple[str, str], Float64 | None] = field(default_factory=dict)
    bad_transforms: Counter[tuple[str, str]] = field(default_factory=Counter)
    translations: dict[str, Translation] = field(default_factory=dict)
    refusals: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


Items = Callable[[], Iterator[Item | Skipped]]


def recording_of(path: Path, name: str, items: Items, notes: tuple[str, ...] = ()) -> Recording:
    """A recording from a stream; `items` starts a new pass and has `Skipped` for lost parts of the file."""
    found = _find(items)
    topics = numbered((source, translation.kind) for source, translation in found.translations.items())
    sensors = [
        Sensor(topic, found.frames.get(source, ""), source, found.types[source]) for source, topic in topics.items()
    ]
    mounts = [Extrinsic(*edge, T) for edge, T in found.mounts.items() if T is not None]
    description = Description(
        name, tuple(sensors), tuple(mounts), tuple(_ignored(found)), notes=(*notes, *dict.fromkeys(found.notes))
    )
    return Recording(path, description, lambda: _read(items, topics, found.translations))


def _read(items: Items, topics: dict[str, str], translations: dict[str, Translation]) -> Iterator[Received | Skipped]:
    translate = {source: translation.start() for source, translation in translations.items()}
    for item in items():
        if isinstance(item, Skipped):
            yield item
        elif item.source in topics:
            try:
                message = translate[item.source](item.decode(), item.receive_ns)
            except BAD_MESSAGE as error:
                yield Skipped(item.receive_ns, item.source, item.type, _text(error))
            else:
                yield item.receive_ns, topics[item.source], message


def _find(items: Items) -> _Findings:
    found = _Findings()
    for item in items():
        if isinstance(item, Skipped):
            found.notes.append(f"{item.source}: {item.reason}")
            continue
        if found.types.setdefault(item.source, item.type) != item.type:
            continue  # its messages fail to decode and are counted then
        found.counts[item.source] += 1
        is_decided = item.source in found.frames or item.source in found.refusals
        if item.type in TRANSLATIONS and not is_decided:
            _decide(found, item)
        elif _is_tf(item.type):
            _note_transforms(found, item)
    return found


def _decide(found: _Findings, item: Item) -> None:
    """Translation and frame of a stream by its first readable message."""
    try:
        message = item.decode()
        is_foxglove = item.type in foxglove.TRANSLATIONS
        found.translations[item.source] = (
            foxglove.translation_of(item.type, message) if is_foxglove else ros.translation_of(item.type, message)
        )
        found.frames[item.source] = foxglove.frame_of(message) if is_foxglove else ros.frame_of(message)
    except NotRead as error:
        found.refusals[item.source] = str(error)
        found.translations.pop(item.source, None)
    except BAD_MESSAGE:
        found.translations.setdefault(item.source, TRANSLATIONS[item.type])


def _note_transforms(found: _Findings, item: Item) -> None:
    try:
        message = item.decode()
        edges = foxglove.edges_of(message) if item.type in foxglove.TRANSFORMS else ros.edges_of(message)
    except BAD_MESSAGE as error:
        found.bad_transforms[item.source, _text(error)] += 1
        return
    for parent, child, T in edges:
        _note_mount(found.mounts, (parent, child), T)


def _ignored(found: _Findings) -> Iterator[Ignored]:
    """Streams that are not read, and bad transforms."""
    for source, kind in found.types.items():
        if source in found.translations:
            continue
        bad = {reason: count for (of, reason), count in found.bad_transforms.items() if of == source}
        reason = found.refusals.get(source, TRANSFORMS_ONLY if _is_tf(kind) else f"the type {kind} is not read")
        yield Ignored(source, kind, reason, found.counts[source] - sum(bad.values()))
        yield from (Ignored(source, kind, reason, count) for reason, count in bad.items())


def _text(error: BaseException) -> str:
    """One line of an error of decoding."""
    return " ".join(str(error).split()) or type(error).__name__


def _note_mount(mounts: dict[tuple[str, str], Float64 | None], edge: tuple[str, str], T: Float64) -> None:
    known = mounts.setdefault(edge, T)
    if known is not None and not np.allclose(known, T, rtol=0.0, atol=SAME_POSE):
        mounts[edge] = None


def _is_tf(kind: str) -> bool:
    return kind == TRANSFORMS or kind in foxglove.TRANSFORMS

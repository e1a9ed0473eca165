"""Lines of a truth sidecar: one JSON object per line, read strictly (an unknown key is an error).

Three kinds of lines; `note` is free text in all of them:

    {"log": "a.mcap", "frame": "top", "first_ns": 0, "last_ns": 900, "period_s": 0.1, "ground_m": -1.7}     the file
    {"id": 4, "status": "accepted", "class": "person", "size_m": [0.6, 0.6, 1.8]}                           an object
    {"stamp_s": 12.3, "id": 4, "class": "person", "center_m": [8, 0, 0.9], "size_m": [0.6, 0.6, 1.8]}       a box

A file of boxes alone is complete truth, at the stamps of its lines; a stamp without `id` says that nothing is there.
With a line for the file, the truth covers `first_ns` to `last_ns`: an object is there from its first to its last box,
linear between them, and nothing else is there; `is_complete` states that a person has reviewed the log and all objects
in the path are listed. Only objects with the
status `accepted` are truth; within `UNDECIDED_NS` of a `proposed` one there is no truth at all. Status, class and size
of the line of an object hold for all its boxes, whose lowest point is kept.
"""

import json
import math
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from configs.strict import Config, parse
from messages.errors import ConfigError, LogError
from messages.perception import ObstacleClass
from messages.truth import Occlusion, TrueObject, TrueObjects

UNDECIDED_NS = 200_000_000
MAX_SPAN_S = 100_000.0
Metres = Annotated[float, Field(gt=0.0, le=100.0)]
Size = tuple[Metres, Metres, Metres]


class Status(StrEnum):
    """Decision of a person on a perceived object."""

    PROPOSED = "proposed"
    ACCEPTED = "accepted"
    REJECTED = "rejected"


class FileLine(Config):
    """The whole file; `ground_m` is the height of the ground in the lidar frame, for objects that a person adds."""

    log: str
    frame: str
    first_ns: int
    last_ns: int
    period_s: float = Field(gt=0.0, le=10.0)
    ground_m: float
    is_complete: bool = False
    note: str = ""

    @model_validator(mode="after")
    def _has_span(self) -> "FileLine":
        span_s = (self.last_ns - self.first_ns) * 1e-9
        if not 0.0 <= span_s <= MAX_SPAN_S:
            raise ValueError(f"first_ns to last_ns are {span_s:g} s")
        return self


class ObjectLine(Config):
    """One object; `range_m` are its ranges from the vehicle front, first and nearest; `picture` is a file."""

    id: int
    status: Status
    label: ObstacleClass = Field(alias="class")
    size_m: Size | None = None
    role: str = ""
    first_s: float | None = None
    last_s: float | None = None
    range_m: tuple[float, float] | None = None
    is_stop_requested: bool | None = None
    picture: str = ""
    note: str = ""


class TimeLine(Config):
    """A time at which no object is there."""

    stamp_s: float | None = None
    stamp_ns: int | None = None
    frame: str = ""
    note: str = ""

    @model_validator(mode="after")
    def _has_stamp(self) -> "TimeLine":
        if self.stamp_s is None and self.stamp_ns is None:
            raise ValueError("neither stamp_s nor stamp_ns")
        return self

    @property
    def time_ns(self) -> int:
        """Stamp in ns."""
        return self.stamp_ns if self.stamp_ns is not None else round((self.stamp_s or 0.0) * 1e9)


class BoxLine(TimeLine):
    """One box at one time; `t_s` in the log and `range_m` are for the reader."""

    id: int
    label: ObstacleClass = Field(alias="class")
    center_m: tuple[float, float, float]
    size_m: Size
    yaw_deg: float = 0.0
    role: str = ""
    occlusion: Literal["unknown", "none", "partly", "largely"] = "unknown"
    status: Status | None = None
    t_s: float | None = None
    range_m: float | None = None


Line = FileLine | ObjectLine | TimeLine


@dataclass(frozen=True)
class Labelled:
    """Decision on an object with the times of its first and last box."""

    id: int
    status: Status
    label: ObstacleClass
    first_ns: int
    last_ns: int


@dataclass(frozen=True)
class Sidecar:
    """Truth of a sidecar: accepted objects by stamp, frame ("" = first lidar), and the decisions."""

    messages: tuple[TrueObjects, ...]
    frame: str
    is_complete: bool
    objects: tuple[Labelled, ...]


def read_lines(file: Path) -> list[tuple[dict[str, Any], Line]]:
    """All lines as written and parsed; raises LogError with file, line number and value."""
    try:
        texts = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{file}: cannot be read ({error})") from error
    out = []
    for number, text in enumerate(texts, 1):
        if not text.strip():
            continue
        try:
            values = json.loads(text)
        except ValueError as error:
            raise LogError(f"{file}:{number}: not JSON ({error}): {text[:60]!r}") from error
        if not isinstance(values, dict):
            raise LogError(f"{file}:{number}: not a JSON object: {text[:60]!r}")
        try:
            out.append((values, parse(_kind(values), values, f"{file}:{number}")))
        except ConfigError as error:
            raise LogError(str(error)) from error
    _check(file, [line for _, line in out])
    return out


def _kind(values: dict[str, Any]) -> type[Line]:
    if "log" in values:
        return FileLine
    has_stamp = "stamp_ns" in values or "stamp_s" in values
    return (BoxLine if has_stamp else ObjectLine) if "id" in values else TimeLine


def _check(file: Path, lines: list[Line]) -> None:
    """Raises LogError for what is there twice, and for an object without a box."""
    boxes = [line for line in lines if isinstance(line, BoxLine)]
    objects = [line.id for line in lines if isinstance(line, ObjectLine)]
    names = [f"object {i}" for i in objects] + [f"object {b.id} at {b.time_ns} ns" for b in boxes]
    names += ["the key log" for line in lines if isinstance(line, FileLine)]
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise LogError(f"{file}: {twice} is there twice")
    empty = sorted({*objects} - {box.id for box in boxes})
    if empty:
        raise LogError(f"{file}: object {empty[0]} has no box")


def read_sidecar(file: Path) -> Sidecar:
    """Truth of a file; raises LogError."""
    lines = [line for _, line in read_lines(file)]
    about = next((line for line in lines if isinstance(line, FileLine)), None)
    headers = {line.id: line for line in lines if isinstance(line, ObjectLine)}
    times = [line for line in lines if isinstance(line, TimeLine)]
    boxes = [line for line in times if isinstance(line, BoxLine)]
    objects = _decisions(headers, boxes)
    undecided = [(o.first_ns - UNDECIDED_NS, o.last_ns + UNDECIDED_NS) for o in objects if o.status is Status.PROPOSED]
    by_stamp: dict[int, list[TrueObject]] = {t: [] for t in (*_grid(about, boxes), *(line.time_ns for line in times))}
    accepted = {o.id for o in objects if o.status is Status.ACCEPTED}
    mine = [box for box in boxes if box.id in accepted]
    for box in mine if about is None else [*mine, *_between(mine, sorted(by_stamp))]:
        by_stamp[box.time_ns].append(_true_object(box, headers.get(box.id)))
    known = {t: o for t, o in by_stamp.items() if not any(first <= t <= last for first, last in undecided)}
    frame = about.frame if about is not None else next((line.frame for line in times if line.frame), "")
    has_decisions = about is not None or bool(headers) or any(box.status is not None for box in boxes)
    return Sidecar(
        tuple(TrueObjects(t, tuple(o)) for t, o in sorted(known.items())), frame,
        about.is_complete if about is not None else not has_decisions, objects,
    )  # fmt: skip


def _decisions(headers: dict[int, ObjectLine], boxes: Iterable[BoxLine]) -> tuple[Labelled, ...]:
    """Decision on each object: that of its line, else of its boxes (`proposed` if one is), else accepted."""
    by_id: dict[int, list[BoxLine]] = {}
    for box in boxes:
        by_id.setdefault(box.id, []).append(box)
    out = []
    for i, mine in sorted(by_id.items()):
        own = {box.status or Status.ACCEPTED for box in mine}
        worst = next(s for s in (Status.PROPOSED, Status.REJECTED, Status.ACCEPTED) if s in own)
        header, stamps = headers.get(i), [box.time_ns for box in mine]
        label = header.label if header is not None else mine[0].label
        out.append(Labelled(i, worst if header is None else header.status, label, min(stamps), max(stamps)))
    return tuple(out)


def _grid(about: FileLine | None, boxes: Iterable[BoxLine]) -> list[int]:
    """Stamps at which nothing is there: those of the file's line that are no box's."""
    if about is None:
        return []
    period_ns = round(0.5e9 * about.period_s)  # scans may be anywhere between
    stamps = np.arange(about.first_ns, about.last_ns + period_ns, period_ns, dtype=np.int64)
    taken = np.array(sorted({box.time_ns for box in boxes} or {about.first_ns - period_ns}), np.int64)
    after = np.searchsorted(taken, stamps)
    before, behind = taken[np.maximum(after - 1, 0)], taken[np.minimum(after, len(taken) - 1)]
    away = np.minimum(np.abs(stamps - before), np.abs(stamps - behind))
    return [int(t) for t in stamps[away > period_ns // 2]]


def _between(boxes: list[BoxLine], stamps_ns: list[int]) -> Iterator[BoxLine]:
    """Boxes at the other stamps between the first and the last box of each object."""
    by_id: dict[int, list[BoxLine]] = {}
    for box in sorted(boxes, key=lambda b: b.time_ns):
        by_id.setdefault(box.id, []).append(box)
    for mine in by_id.values():
        for a, b in pairwise(mine):
            for stamp_ns in stamps_ns[bisect_right(stamps_ns, a.time_ns) : bisect_left(stamps_ns, b.time_ns)]:
                share = (stamp_ns - a.time_ns) / (b.time_ns - a.time_ns)
                center, size = (
                    tuple(u + share * (v - u) for u, v in zip(one, two, strict=True))
                    for one, two in ((a.center_m, b.center_m), (a.size_m, b.size_m))
                )
                turn = math.remainder(b.yaw_deg - a.yaw_deg, 360.0)
                yaw_deg = a.yaw_deg + share * turn
                yield a.model_copy(
                    update={"stamp_ns": stamp_ns, "center_m": center, "size_m": size, "yaw_deg": yaw_deg}
                )


def _true_object(box: BoxLine, header: ObjectLine | None) -> TrueObject:
    label = box.label if header is None else header.label
    size = np.array(box.size_m if header is None or header.size_m is None else header.size_m)
    center = np.array(box.center_m)
    center[2] += 0.5 * (size[2] - box.size_m[2])
    role = (header.role if header is not None else "") or box.role or f"{label.value} {box.id}"
    occlusion = Occlusion[box.occlusion.upper()]
    return TrueObject(
        box.id, label, role, center, size, math.radians(box.yaw_deg), np.full(2, np.nan), math.nan, occlusion
    )

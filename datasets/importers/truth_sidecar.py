"""Truth in a sidecar file beside a log of any format, one JSON object per line and true object:

    {"stamp_s": 12.3, "id": 4, "class": "person", "center_m": [8, 0, 0.9], "size_m": [0.6, 0.6, 1.8], "yaw_deg": 0}

Centres are in the lidar frame at that time; `frame` in a line selects another lidar of the log.
"""

import heapq
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.importers.formats import open_recording, takes_labels
from datasets.importers.recording import Received, Recording, Sensor
from messages.errors import LogError
from messages.perception import ObstacleClass
from messages.truth import TrueObject, TrueObjects

SUFFIX = ".truth.jsonl"


def open_with_truth(path: Path, truth: Path | None, source: str) -> Recording:
    """A recording with truth from label files, from a sidecar (named or beside it), or from its own topic."""
    beside = path.with_name(path.name + SUFFIX)
    if truth is None and beside.is_file() and source in ("any", "sidecar"):
        truth = beside
    if truth is not None and truth.is_file() and truth.suffix in (".jsonl", ".json"):
        return _with_sidecar(open_recording(path), truth)
    recording = open_recording(path, truth if truth is not None and takes_labels(path) else None)
    if source == "sidecar":
        raise LogError(f"{path}: the conditions require truth from a sidecar, and {beside.name} does not exist")
    return recording


def _with_sidecar(recording: Recording, file: Path) -> Recording:
    frames = {s.frame: s.topic for s in recording.description.sensors if s.topic.startswith("lidar/")}
    if not frames:
        raise LogError(f"{recording.path}: no lidar for the frame of the truth")
    messages, frame = read_sidecar(file)
    frame = frame or next(iter(frames))
    if frame not in frames:
        raise LogError(f"{file}: frame {frame!r} is none of the log's lidars ({', '.join(frames)})")
    topic = f"truth_objects/{frames[frame].partition('/')[2]}"
    about = recording.description
    sensors = (*about.sensors, Sensor(topic, frame, str(file), "sidecar"))

    def read() -> Iterator[Received]:
        truths = ((m.stamp_ns, topic, m) for m in messages)
        others = (r for r in recording.read() if not r[1].startswith("truth_objects"))
        yield from heapq.merge(truths, others, key=lambda r: r[2].stamp_ns if r[1] == topic else r[0])

    return Recording(recording.path, replace(about, sensors=sensors, truth_frame=frame), read)


def read_sidecar(file: Path) -> tuple[list[TrueObjects], str]:
    """All objects by stamp, and the frame ("" without one); raises LogError with the line."""
    by_stamp: dict[int, list[TrueObject]] = {}
    frame = ""
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{file}: cannot be read ({error})") from error
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            values = json.loads(line)
            frame = values.get("frame", frame)
            stamp_ns = int(values["stamp_ns"]) if "stamp_ns" in values else round(float(values["stamp_s"]) * 1e9)
            objects = by_stamp.setdefault(stamp_ns, [])
            if "id" in values:
                objects.append(_object(values))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise LogError(f"{file}:{number}: no true object ({error!r}): {line[:60]!r}") from error
    return [TrueObjects(stamp, tuple(objects)) for stamp, objects in sorted(by_stamp.items())], frame


def _object(values: dict[str, Any]) -> TrueObject:
    center, size = np.array(values["center_m"], np.float64), np.array(values["size_m"], np.float64)
    if center.shape != (3,) or size.shape != (3,) or not (np.isfinite(center).all() and (size > 0.0).all()):
        raise ValueError(f"center_m {center} and size_m {size}")
    label = ObstacleClass(values["class"])
    yaw = math.radians(float(values.get("yaw_deg", 0.0)))
    role = str(values.get("role", f"{label.value} {values['id']}"))
    return TrueObject(int(values["id"]), label, role, center, size, yaw, np.full(2, np.nan), math.nan)

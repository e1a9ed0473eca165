"""Truth of a simulated drive from its log."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml

from configs.strict import parse
from configs.vehicle import Vehicle
from datasets.reader import LogScan, decode, is_ours, read_metadata
from geometry.arrays import Float64
from geometry.prism import Prism, Solids
from geometry.transforms import yaw_of
from messages.errors import LogError
from messages.truth import TrueMachine, TrueObjects, TrueShapes
from validation.drive.detections import Detections, DetectionSample
from validation.drive.record import TOPICS, DriveRecord
from validation.hazards.tracks import Drive, MachineTrack, ObjectTrack, Shapes

STATIC_NAME = "site"


@dataclass(frozen=True, eq=False)
class HazardLog:
    """Truth of a drive, messages of the stack, detections of the objects, and the scenario as plain data."""

    drive: Drive
    record: DriveRecord
    samples: list[DetectionSample]
    scenario: dict[str, Any]


def read_hazard_log(path: Path) -> HazardLog:
    """Reads a log; raises LogError for one without the shapes of a scenario with objects."""
    metadata = read_metadata(path)
    if "shapes" not in metadata or "config" not in metadata:
        raise LogError(f"{path}: no true shapes in it; they are logged by `headland run` since 0.4")
    config = yaml.load(metadata["config"]["yaml"], yaml.CSafeLoader)
    detections, record = Detections(parse(Vehicle, config["machine"], str(path))), DriveRecord()
    shapes: list[TrueShapes] = []
    for entry in LogScan(path, {*detections.topics, *TOPICS, "truth_shapes"}):
        if not is_ours(entry) or not detections.needs(entry.topic):
            continue
        envelope = decode(entry)
        detections(envelope)
        record.first_ns = record.first_ns or envelope.receive_ns
        record.last_ns = envelope.receive_ns
        if isinstance(envelope.message, TrueShapes):
            shapes.append(envelope.message)
        elif envelope.topic in record.messages:
            record.messages[envelope.topic].append(envelope.message)
    if len(record.truth) < 2:
        raise LogError(f"{path}: no true states of the machine")
    values = json.loads(metadata["shapes"]["json"])
    tracks = object_tracks(record.objects, shapes, record.first_ns)
    drive = Drive(
        machine_track(record.truth, shapes, record.first_ns), shapes_of(values), (*tracks, *static_tracks(values))
    )
    return HazardLog(drive, record, detections.samples, config["scenario"])


def _solids(values: Iterable[dict[str, Any]]) -> Solids:
    return Solids.of([Prism(v["name"], np.array(v["outline_m"]), *v["z_m"]) for v in values])


def shapes_of(values: dict[str, Any]) -> Shapes:
    """Shapes of machine and implement from the metadata of a log."""
    return Shapes(
        _solids(values["machine"]), _solids(values["implement"]), values["machine_width_m"],
        values["implement_origin_m"], values["lift_m"], tuple(values["width_m"]),
    )  # fmt: skip


def static_tracks(values: dict[str, Any]) -> list[ObjectTrack]:
    """Solids of the site, one track for each kind."""
    still = np.zeros((1, 2))
    kinds = sorted({v["name"] for v in values["static"]})
    return [
        ObjectTrack(STATIC_NAME, kind, np.zeros(1), still, still,
                    (_solids(v for v in values["static"] if v["name"] == kind),), is_static=True)
        for kind in kinds
    ]  # fmt: skip


def machine_track(truth: list[TrueMachine], shapes: list[TrueShapes], first_ns: int) -> MachineTrack:
    """Motion of the machine; PTO and fold are those of the last shapes message (0 without one)."""
    t = _seconds([m.stamp_ns for m in truth], first_ns)
    T = np.array([m.T_map_base for m in truth])
    yaw = np.unwrap([yaw_of(m.T_map_base) for m in truth])
    tool = yaw + np.angle(np.exp(1j * (np.array([m.implement_yaw_rad for m in truth]) - yaw)))
    known = _seconds([m.stamp_ns for m in shapes], first_ns)
    row = np.searchsorted(known, t + 1e-9, side="right") - 1
    pto, fold = ([getattr(m, name) for m in shapes] for name in ("pto_radps", "fold"))
    return MachineTrack(
        t, np.column_stack([T[:, :3, 3], yaw]), np.array([m.speed_mps for m in truth]),
        T[:, 2, :2].copy(), tool, np.array([m.hitch for m in truth]), _column(fold, row), _column(pto, row),
    )  # fmt: skip


def _column(values: list[float], row: np.ndarray) -> Float64:
    return np.array([values[max(k, 0)] if values else 0.0 for k in row.tolist()], np.float64)


def _seconds(stamps_ns: list[int], first_ns: int) -> Float64:
    return np.asarray((np.array(stamps_ns, np.int64) - first_ns) * 1e-9, np.float64)


def object_tracks(objects: list[TrueObjects], shapes: list[TrueShapes], first_ns: int) -> list[ObjectTrack]:
    """Tracks of the scenario's objects, with the shapes of the same time."""
    at = {m.stamp_ns: _by_object(m) for m in shapes}
    rows: dict[int, list[tuple[int, Any, Solids]]] = {}
    cache: dict[int, tuple[bytes, Solids]] = {}
    for message in objects:
        for one in message.objects:
            prisms = at.get(message.stamp_ns, {}).get(one.id)
            if prisms is None:
                continue
            key = b"".join(p.outline_m.tobytes() for p in prisms)
            if one.id not in cache or cache[one.id][0] != key:  # an unchanged shape is one object
                cache[one.id] = (key, Solids.of(prisms))
            rows.setdefault(one.id, []).append((message.stamp_ns, one, cache[one.id][1]))
    return [_track(found, first_ns) for _, found in sorted(rows.items())]


def _track(rows: list[tuple[int, Any, Solids]], first_ns: int) -> ObjectTrack:
    first = rows[0][1]
    return ObjectTrack(
        first.role, first.kind, _seconds([r[0] for r in rows], first_ns),
        np.array([r[1].center_map_m[:2] for r in rows]), np.array([r[1].velocity_mps[:2] for r in rows]),
        tuple(r[2] for r in rows), first.must_avoid,
    )  # fmt: skip


def _by_object(message: TrueShapes) -> dict[int, list[Prism]]:
    found: dict[int, list[Prism]] = {}
    for k, id in enumerate(message.object_id.tolist()):
        outline = message.outline_map_m[message.offsets[k] : message.offsets[k + 1]]
        found.setdefault(id, []).append(Prism("", outline, *message.z_m[k].tolist()))
    return found


def ground_m(drive: Drive, one: ObjectTrack) -> float:
    """Height of the ground at an object: of the machine where it came nearest in plan."""
    pose = drive.machine.pose
    k = int(np.hypot(*(pose[:, :2] - one.place_m[0]).T).argmin())
    point = shapely.Point(one.place_m[0])
    c, s = np.cos(pose[k, 3]), np.sin(pose[k, 3])
    d = np.array([point.x, point.y]) - pose[k, :2]
    return float(pose[k, 2] + drive.machine.slope[k] @ [c * d[0] + s * d[1], c * d[1] - s * d[0]])

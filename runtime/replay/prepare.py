"""A log looked through before it is replayed: what it has, whose it is, and where its motion comes from."""

import math
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from pydantic import Field

from configs.site import DatumConfig, PoseConfig, Shed
from configs.strict import CONFIGS, Config, load, parse
from datasets.importers.recording import Recording
from datasets.reader import LogScan, read_metadata
from datasets.records import MAGIC
from geometry.geodesy import Datum
from localization.lidar.scan_odometry import ScanOdometryConfig
from messages.errors import ConfigError
from messages.motion import Odometry
from runtime.replay.log_inspection import CHILD_FRAMES, Machine, Survey, find_machine, pose_between, survey
from runtime.replay.log_inspection_table import rows_of
from runtime.replay.trajectory import (
    is_steady,
)
from runtime.stack import StackConfig, load_stack, with_detector
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.observation import Setting


class ReplayConfig(Config):
    """`configs/replay.yaml`."""

    scan_odometry: ScanOdometryConfig
    beyond_m: float = Field(ge=0.0, le=500.0)
    jump_m: float = Field(gt=0.0, le=10.0)
    standing_s: float = Field(ge=0.0, le=60.0)
    clock_s: float = Field(gt=0.0, le=100.0)
    vehicles: dict[str, str]


@dataclass(frozen=True)
class Configuration:
    """All configuration of a replay."""

    stack: StackConfig
    replay: ReplayConfig
    conditions: Conditions


def load_configuration(conditions: Conditions, model: FilePath | None = None) -> Configuration:
    """The stack's own files, with the cameras' detector from `model` where one is given; raises ConfigError."""
    stack = with_detector(load_stack(), model)
    return Configuration(stack, load(ReplayConfig, CONFIGS / "replay.yaml"), conditions)


@dataclass(frozen=True)
class Source:
    """Where odometry comes from: the `localizer`, the log's `record` (of our own), a `topic` of it, or `scans`."""

    kind: str
    topic: str
    note: str


@dataclass(frozen=True)
class Place:
    """Where a log of ours was recorded: `dock` is where the machine was left in the shed (None: outside)."""

    datum: Datum
    shed: Shed | None
    dock: PoseConfig | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Prepared:
    """A log looked through: what it is, whose, and how it will be replayed."""

    recording: Recording
    found: Survey
    machine: Machine
    source: Source
    is_planned: bool
    truth_topic: str | None
    clock_ns: int
    config: Configuration
    damages: tuple[str, ...]
    place: Place | None

    @property
    def half_width_m(self) -> float:
        """Of the driving corridor: the machine with its implement along a planned path, else as the conditions say."""
        body, implement = self.machine.vehicle.body, self.machine.implement
        widest = max(body.width_m, implement.width_m if implement is not None else 0.0)
        if self.is_planned:
            return 0.5 * widest
        corridor = self.config.conditions.corridor
        return max(corridor.half_width_m, 0.5 * widest + corridor.side_margin_m)

    def setting(self, name: str) -> Setting:
        """What the judge must know."""
        about, lidars = self.recording.description, self.machine.vehicle.sensors.lidar
        by_frame = {s.frame: n for n, t in self.machine.lidars.items() for s in about.sensors if s.topic == t}
        frame = None if self.truth_topic is None else about.truth_frame
        frame = by_frame.get(frame, frame) if frame is not None else None
        degrees = self.config.conditions.truth.view_deg.get(about.format, 180.0)
        body = self.machine.vehicle.body
        return Setting(
            name, {n: lidar.mount.T_base_sensor for n, lidar in lidars.items()}, body.front_m, body.width_m,
            self.half_width_m, frame, math.radians(degrees),
        )  # fmt: skip

    def preflight(self) -> dict[str, Any]:
        """The table before anything is judged."""
        needed = dict.fromkeys(self.machine.lidars.values(), "obstacles")
        needed |= {self.truth_topic: "truth"} if self.truth_topic else {"truth_objects": "truth"}
        needed |= dict.fromkeys(self.source.topic.split(), "speed and way") if self.source.topic else {}
        needed |= {"path": "planned way", "control_command": "place on it"} if self.is_planned else {}
        notes = [*self.recording.description.notes, *self.damages, *self.machine.notes, self.source.note]
        notes += [] if self.place is None else self.place.notes
        if self.clock_ns:
            notes.append(f"times of reception run {self.clock_ns * 1e-9:+.1f} s against the stamps: shifted by that")
        has_truth = self.truth_topic is not None
        judged = ["stops", "ranges", "margins"] + (["misses", "false stops", "recall"] if has_truth else [])
        about = self.recording.description
        return {
            "log": str(self.recording.path),
            "format": about.format,
            "span_s": round(self.found.span_s, 3),
            "topics": rows_of(self.found, needed),
            "extrinsics": [f"{e.parent} → {e.child}" for e in about.extrinsics],
            "ignored": [f"{i.source} ({i.source_type}): {i.reason}" for i in about.ignored],
            "notes": notes,
            "judged": judged,
            "not_shown": [] if has_truth else ["misses, false stops and recall: no truth"],
        }


def prepare(path: FilePath, truth: FilePath | None, vehicle: FilePath | None, config: Configuration) -> Prepared:
    """Look a log through; raises LogError or ConfigError that says what is missing."""
    from datasets.importers.truth_sidecar import open_with_truth

    recording = open_with_truth(path, truth, config.conditions.truth.source)
    found = survey(recording)
    machine = find_machine(recording, found, vehicle, config.replay.vehicles)
    is_own = recording.description.format == "headland" and {"path", "control_command"} <= found.streams.keys()
    place = place_of(path) if recording.description.format == "headland" else None
    truths = [t for t in found.streams if t.partition("/")[0] == "truth_objects"]
    return Prepared(
        recording, found, machine, find_source(recording, found, machine, place, config.replay), is_own,
        truths[0] if truths else None, found.clock_ns(config.replay.clock_s), config,
        damages_of(path), place,
    )  # fmt: skip


def damages_of(path: FilePath) -> tuple[str, ...]:
    """What of an MCAP file was lost; nothing for other formats, whose readers refuse what is cut."""
    if not path.is_file() or path.open("rb").read(len(MAGIC)) != MAGIC:
        return ()
    scan = LogScan(path)
    for _ in scan:
        pass
    lost = tuple(f"byte {d.offset}: {d.reason}; {d.length} bytes lost" for d in scan.damages)
    return lost if lost or scan.is_ended else (f"byte {path.stat().st_size}: the log was not closed",)


def find_source(
    recording: Recording, found: Survey, machine: Machine, place: Place | None, config: ReplayConfig
) -> Source:
    """The best odometry that the log allows."""
    streams, sensors = found.streams, machine.vehicle.sensors
    own = {"imu", "wheel", "gnss/main"} <= streams.keys()
    if own and sensors.imu is not None and sensors.wheels is not None and "main" in sensors.gnss:
        if found.stood_s >= config.standing_s and place is not None:
            return Source("localizer", "imu wheel gnss/main", "odometry: recomputed by the localizer")
        if {"odom", "map_pose"} <= streams.keys():
            note = "odometry: the log's own, since the machine does not stand at its start and the localizer needs that"
            return Source("record", "odom map_pose", note)
    for topic in sorted(t for t in streams if t.partition("/")[0] == "odom"):
        if child_pose(recording, machine, topic) is not None:
            messages = [m for _, t, m in recording.read() if t == topic and isinstance(m, Odometry)]
            if len(messages) > 2 and is_steady(messages, config.jump_m):
                return Source("topic", topic, f"odometry: {topic} of the log")
    lidar = next(iter(machine.lidars.values()))
    return Source("scans", "", f"no speed that can be used: replaced by lidar odometry from {lidar}, taken as level")


def child_pose(recording: Recording, machine: Machine, topic: str) -> np.ndarray | None:
    """Pose of base in the frame that an odometry follows, or None when it is not known."""
    about = recording.description
    if topic == "odom" and about.format == "headland":
        return np.eye(4)
    frame = next((s.frame for s in about.sensors if s.topic == topic), "")
    frames = {s.topic: s.frame for s in about.sensors}
    for name, lidar_topic in machine.lidars.items():
        T = pose_between(about, frame, frames.get(lidar_topic, "?")) if frame else None
        if T is not None:
            return np.asarray(T @ np.linalg.inv(machine.vehicle.sensors.lidar[name].mount.T_base_sensor))
    return np.eye(4) if frame in CHILD_FRAMES else None


def place_of(path: FilePath) -> Place | None:
    """The place that a log's own configuration names, or None; raises ConfigError for a datum that cannot be."""
    import yaml

    text = read_metadata(path).get("config", {}).get("yaml") if path.is_file() else None
    config = yaml.safe_load(text) if text is not None else None
    site = config.get("site") if isinstance(config, dict) else None
    if not isinstance(site, dict):
        return None
    datum = parse(DatumConfig, site.get("datum"), f"{path}: site.datum").datum
    mission = (config or {}).get("mission") or {}
    try:
        shed = None if site.get("shed") is None else parse(Shed, site["shed"], f"{path}: site.shed")
    except ConfigError as error:
        return Place(datum, None, None, (f"shed left out, since another version wrote it: {error}",))
    is_left_there = shed is not None and mission.get("bay") is not None and mission.get("start") is None
    return Place(datum, shed, shed.bay(mission["bay"]).dock if shed is not None and is_left_there else None)

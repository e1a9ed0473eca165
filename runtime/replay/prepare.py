"""Preparation of a replay: inspection of the log, recording machine, and source of its odometry."""

import math
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from pydantic import Field

from configs.site import DatumConfig, PoseConfig, Shed
from configs.strict import CONFIGS, Config, load, parse
from configs.vehicle import Body, MountedImplement, TrailedImplement, Vehicle, outlines
from datasets.importers.import_table import rows_of as streams_of
from datasets.importers.recording import Recording
from datasets.reader import LogScan, read_metadata
from datasets.records import MAGIC
from datasets.viewer import ViewerConfig
from geometry.drawbar import Drawbar, Trailer
from geometry.geodesy import Datum
from geometry.rectangle import Rectangle
from localization.lidar.scan_odometry import ScanOdometryConfig
from messages.errors import ConfigError, LogError
from runtime.replay.log_inspection import (
    CHILD_FRAMES,
    LogInspection,
    RecordingMachine,
    find_machine,
    inspect,
    pose_between,
    vehicle_values,
)
from runtime.replay.log_inspection_table import rows_of
from runtime.replay.recorded_localization import localization_note
from runtime.replay.topic_binding import ODOMETRY, bind_sensors
from runtime.replay.trajectory import is_steady
from runtime.stack import StackConfig, load_stack, with_detector
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.observation import Setting
from validation.obstacle_stop.swept_path import Outline
from validation.obstacle_stop.visibility import View

RADAR_ELEVATION_RAD = (math.radians(-15.0), math.radians(15.0))  # not in the vehicle file


class ReplayConfig(Config):
    """File `configs/replay.yaml`."""

    scan_odometry: ScanOdometryConfig
    extension_m: float = Field(ge=0.0, le=500.0)
    max_pose_jump_m: float = Field(gt=0.0, le=10.0)
    min_standstill_s: float = Field(ge=0.0, le=60.0)
    max_wheel_gap_s: float = Field(gt=0.0, le=1.0)
    max_latency_s: float = Field(gt=0.0, le=1000.0)
    viewer: ViewerConfig


@dataclass(frozen=True)
class Configuration:
    """Configuration of a replay: stack, replay and conditions."""

    stack: StackConfig
    replay: ReplayConfig
    conditions: Conditions


def load_configuration(conditions: Conditions, model: FilePath | None = None) -> Configuration:
    """Loads the configuration files, with the camera detector from `model` if given; raises ConfigError."""
    stack = with_detector(load_stack(), model)
    return Configuration(stack, load(ReplayConfig, CONFIGS / "replay.yaml"), conditions)


@dataclass(frozen=True)
class OdometrySource:
    """Source of the odometry; kind is `localizer`, `record` (of a Headland log), `topic` or `scans`."""

    kind: str
    topic: str
    note: str


@dataclass(frozen=True)
class RecordingSite:
    """Site of a Headland log; `dock` is the initial dock pose of the machine, None outside the shed."""

    datum: Datum
    shed: Shed | None
    dock: PoseConfig | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReplayInput:
    """Inspected log with all inputs of its replay."""

    recording: Recording
    inspection: LogInspection
    machine: RecordingMachine
    odometry: OdometrySource
    is_planned: bool
    truth_topic: str | None
    clock_offset_ns: int
    config: Configuration
    site: RecordingSite | None
    localization: str | None = None

    @property
    def half_width_m(self) -> float:
        """Half width of the driving corridor: of machine and implement on a planned path, else of the conditions."""
        body, implement = self.machine.vehicle.body, self.machine.implement
        widest = max(body.width_m, implement.width_m if implement is not None else 0.0)
        if self.is_planned:
            return 0.5 * widest
        corridor = self.config.conditions.corridor
        return max(corridor.half_width_m, 0.5 * widest + corridor.side_margin_m)

    @property
    def delivery_span_ns(self) -> tuple[int, int]:
        """First and last time of delivery in the replay."""
        return (self.inspection.first_ns or 0) - self.clock_offset_ns, self.inspection.last_ns - self.clock_offset_ns

    def setting(self, name: str) -> Setting:
        """Setting of the log for the observer."""
        about, lidars = self.recording.description, self.machine.vehicle.sensors.lidar
        by_frame = {s.frame: n for n, t in self.machine.lidars.items() for s in about.sensors if s.topic == t}
        frame = None if self.truth_topic is None else about.truth_frame
        frame = by_frame.get(frame, frame) if frame is not None else None
        if frame is not None and frame != "map" and frame not in lidars:
            known = ", ".join(["map", *by_frame])
            raise LogError(f"{self.recording.path}: the truth is in frame {frame!r}, which is none of {known}")
        body, implement = self.machine.vehicle.body, self.machine.implement
        return Setting(
            name, {n: lidar.mount.T_base_sensor for n, lidar in lidars.items()}, body.front_m, body.width_m,
            self.half_width_m, frame, math.radians(about.truth_view_deg), outline_of(body, implement),
            outline_of(body, None if implement is None else implement.folded), views_of(self.machine.vehicle),
            not self.is_planned,
        )  # fmt: skip

    def inspection_table(self) -> dict[str, Any]:
        """Table of required and present topics, as JSON."""
        needed = dict.fromkeys(self.machine.lidars.values(), "obstacles")
        needed |= {self.truth_topic: "truth"} if self.truth_topic else {"truth_objects": "truth"}
        needed |= dict.fromkeys(self.odometry.topic.split(), "speed and path") if self.odometry.topic else {}
        needed |= {"path": "planned path", "control_command": "position on path"} if self.is_planned else {}
        notes = [*self.recording.description.notes, *self.machine.notes, self.odometry.note]
        notes += [] if self.site is None else self.site.notes
        notes += [] if self.localization is None else [self.localization]
        if self.clock_offset_ns:
            notes.append(f"receive times differ from the stamps by {self.clock_offset_ns * 1e-9:+.1f} s: shifted")
        has_truth = self.truth_topic is not None
        evaluable = ["stops", "ranges", "margins"] + (["misses", "false stops", "recall"] if has_truth else [])
        about = self.recording.description
        return {
            "log": str(self.recording.path),
            "format": about.format,
            "span_s": round(self.inspection.span_s, 3),
            "topics": rows_of(self.inspection, needed),
            "extrinsics": [f"{e.parent} → {e.child}" for e in about.extrinsics],
            "streams": streams_of(self.recording.table()),
            "notes": notes,
            "evaluable": evaluable,
            "not_shown": [] if has_truth else ["misses, false stops and recall: no ground truth"],
        }


def outline_of(body: Body, implement: MountedImplement | TrailedImplement | None) -> Outline:
    """Rectangles of a machine and its implement, a trailed one on its drawbar."""
    if not isinstance(implement, TrailedImplement):
        return Outline(outlines(body, implement))
    trailed = Rectangle(-implement.total_length_m, 0.0, implement.width_m)
    return Outline(outlines(body, None), Trailer(trailed, Drawbar(implement.hitch_m, implement.axle_length_m)))


def views_of(vehicle: Vehicle) -> tuple[View, ...]:
    """Fields of view of the lidars and radars, which measure the distance of an obstacle."""
    lidars = [
        View(one.mount.T_base_sensor, math.radians(0.5 * one.field_of_view_deg),
             (math.radians(min(one.elevation_deg)), math.radians(max(one.elevation_deg))), one.range_m[1])
        for one in vehicle.sensors.lidar.values()
    ]  # fmt: skip
    radars = [
        View(one.mount.T_base_sensor, math.radians(0.5 * one.field_of_view_deg), RADAR_ELEVATION_RAD, one.range_m[1])
        for one in vehicle.sensors.radar.values()
    ]
    return (*lidars, *radars)


def prepare(path: FilePath, truth: FilePath | None, vehicle: FilePath | None, config: Configuration) -> ReplayInput:
    """Inspects a log; raises LogError or ConfigError that names the missing data."""
    from datasets.importers.truth_sidecar import open_with_truth

    recording = open_with_truth(path, truth, config.conditions.truth.source)
    recording = bind_sensors(recording, vehicle_values(vehicle, recording.description)[0])
    inspection = inspect(recording)
    is_imported = recording.description.format != "headland"
    has_lidar = any(topic.startswith("lidar/") for topic in inspection.streams)
    known = ", ".join(sorted(inspection.streams)) or "none"
    refusal = f"{recording.path}: no lidar topic, evaluation of stops is not possible (topics: {known})"
    if not has_lidar and vehicle is None:
        raise LogError(refusal)
    machine = find_machine(recording, inspection, vehicle)
    localization = _localization_note(recording, inspection, machine, config) if is_imported else None
    if not has_lidar:
        raise LogError(refusal if localization is None else f"{refusal}; {localization}")
    is_planned = not is_imported and {"path", "control_command"} <= inspection.streams.keys()
    site = None if is_imported else site_of(path)
    truths = [t for t in inspection.streams if t.partition("/")[0] == "truth_objects"]
    if len(truths) > 1:
        raise LogError(f"{recording.path}: several topics of true objects ({', '.join(sorted(truths))}); one is needed")
    odometry = find_odometry_source(recording, inspection, machine, site, config)
    offset_ns = inspection.clock_offset_ns(config.replay.max_latency_s)
    truth_topic = truths[0] if truths else None
    return ReplayInput(
        recording, inspection, machine, odometry, is_planned, truth_topic, offset_ns, config, site, localization
    )


def _localization_note(
    recording: Recording, inspection: LogInspection, machine: RecordingMachine, config: Configuration
) -> str | None:
    stack = config.stack
    wheels = stack.localization.odometry.wheels.model_copy(update={"max_gap_s": config.replay.max_wheel_gap_s})
    odometry = stack.localization.odometry.model_copy(update={"wheels": wheels})
    localization = stack.localization.model_copy(update={"odometry": odometry})
    return localization_note(recording, inspection, machine, localization, stack.executor.latency_ns("localizer"))


def damage_of(path: FilePath) -> tuple[str, ...]:
    """Lost parts of an MCAP file; empty for other formats."""
    if not path.is_file() or path.open("rb").read(len(MAGIC)) != MAGIC:
        return ()
    scan = LogScan(path)
    for _ in scan:
        pass
    return scan.losses


def find_odometry_source(
    recording: Recording,
    inspection: LogInspection,
    machine: RecordingMachine,
    site: RecordingSite | None,
    config: Configuration,
) -> OdometrySource:
    """Best odometry available for the log."""
    streams, sensors = inspection.streams, machine.vehicle.sensors
    gnss = config.stack.localization.map_alignment.gnss.sensor
    own = {"imu", "wheel", f"gnss/{gnss}"} <= streams.keys()
    if own and sensors.imu is not None and sensors.wheels is not None and gnss in sensors.gnss:
        if inspection.standstill_s >= config.replay.min_standstill_s and site is not None:
            return OdometrySource("localizer", f"imu wheel gnss/{gnss}", "odometry: recomputed by the localizer")
        if {"odom", "map_pose"} <= streams.keys():
            note = "odometry: from the log, because the localizer needs a standstill at the start"
            return OdometrySource("record", "odom map_pose", note)
    found = [ODOMETRY] if ODOMETRY in streams else sorted(t for t in streams if t.partition("/")[0] == "odom")
    unusable: list[str] = []
    for topic in found:
        samples = inspection.odometry[topic]
        if child_pose(recording, machine, topic) is None:
            unusable.append(f"{topic} (child frame {_frame_of(recording, topic)!r})")
        elif len(samples.stamps_ns) > 2 and is_steady(samples, config.replay.max_pose_jump_m):
            return OdometrySource("topic", topic, f"odometry: {topic} of the log")
    if ODOMETRY in streams:
        raise LogError(f"{recording.path}: sensors.wheels.topic: the odometry is too short or jumps")
    remedy = f"the frame of {', '.join(unusable)} is unknown; sensors.wheels.topic in the vehicle file selects one"
    if len(unusable) > 1:
        raise LogError(f"{recording.path}: no odometry is usable: {remedy}")
    lidar = next(iter(machine.lidars.values()))
    note = f"no usable speed: replaced by planar lidar odometry from {lidar}"
    return OdometrySource("scans", "", f"{note}; {remedy}" if unusable else note)


def _frame_of(recording: Recording, topic: str) -> str:
    return next((s.frame for s in recording.description.sensors if s.topic == topic), "")


def child_pose(recording: Recording, machine: RecordingMachine, topic: str) -> np.ndarray | None:
    """Pose (4, 4) of base in the child frame of an odometry topic, or None if unknown.

    The child frame of the odometry that the vehicle file names is base, unless the log has its transform.
    """
    about = recording.description
    if topic == "odom" and about.format == "headland":
        return np.eye(4)
    frame = _frame_of(recording, topic)
    frames = {s.topic: s.frame for s in about.sensors}
    for name, lidar_topic in machine.lidars.items():
        T = pose_between(about, frame, frames.get(lidar_topic, "?")) if frame else None
        if T is not None:
            return np.asarray(T @ np.linalg.inv(machine.vehicle.sensors.lidar[name].mount.T_base_sensor))
    return np.eye(4) if frame in CHILD_FRAMES or topic == ODOMETRY else None


def site_of(path: FilePath) -> RecordingSite | None:
    """Site from the configuration in the log, or None; raises ConfigError for an invalid datum."""
    import yaml

    text = read_metadata(path).get("config", {}).get("yaml") if path.is_file() else None
    config = yaml.load(text, yaml.CSafeLoader) if text is not None else None
    site = config.get("site") if isinstance(config, dict) else None
    if not isinstance(site, dict):
        return None
    datum = parse(DatumConfig, site.get("datum"), f"{path}: site.datum").datum
    mission = (config or {}).get("mission") or {}
    try:
        shed = None if site.get("shed") is None else parse(Shed, site["shed"], f"{path}: site.shed")
    except ConfigError as error:
        return RecordingSite(datum, None, None, (f"shed omitted, written by another version: {error}",))
    is_docked = shed is not None and mission.get("bay") is not None and mission.get("start") is None
    return RecordingSite(datum, shed, shed.bay(mission["bay"]).dock if shed is not None and is_docked else None)

"""Inspection of a recorded log: its streams, and the machine that recorded it."""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from configs.sensor_kinds import SENSOR_KINDS, sensors_of
from configs.strict import CONFIGS, parse, read_yaml
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from datasets.importers.recording import Description, Recording
from datasets.reader import read_metadata
from geometry.arrays import Float64
from geometry.transforms import invert, rpy_of
from messages.errors import ConfigError, LogError
from messages.message import Message
from messages.motion import Odometry
from messages.sensors import CameraImage, GnssFix, GnssSolution, LidarScan, WheelSample
from messages.truth import TrueMachine, TrueObjects
from runtime.replay.progress import PassProgress
from runtime.replay.trajectory import OdometrySamples

EXAMPLE = """\
name: a name
body: {front_m: 3.7, rear_m: 1.1, width_m: 1.8, height_m: 1.5}  # from the rear axle on the ground
sensors:
  lidar:
    LIDAR:
      mount: {xyz_m: [0.8, 0.0, 1.7], rpy_deg: [0, 0, 0]}  # from the rear axle on the ground, x forward, y left
      elevation_deg: [-15, -13, -11, -9, -7, -5, -3, -1, 1, 3, 5, 7, 9, 11, 13, 15]
      columns: 1800
      rate_hz: 10
      range_m: [0.5, 80.0]
      range_sigma_m: 0.03"""
# Required values of a vehicle that have no effect in a replay.
UNUSED: dict[str, Any] = {
    "drivetrain": {
        "kind": "ackermann", "wheelbase_m": 2.5, "track_m": 1.5, "wheel_radius_m": 0.4, "min_turning_radius_m": 5.0,
    },
    "steering": {
        "kind": "electric_wheel", "max_wheel_rpm": 60, "wheel_turns_per_steer_rad": 3.0, "dead_time_s": 0.1,
        "lag_s": 0.1, "backlash_deg": 0.0,
    },
    "brake": {"dead_time_s": 0.1, "build_up_s": 0.3, "deceleration_mps2": 4.0},
    "max_speed_kmh": 80.0,
    "acceleration_mps2": 1.0,
}  # fmt: skip
BODY_KEYS = ("front_m", "rear_m", "width_m", "height_m")
LIDAR_KEYS = ("mount.xyz_m", "elevation_deg", "columns", "rate_hz", "range_m", "range_sigma_m")
CLOCK_MESSAGES = 1000
CLOCK_TOLERANCE_S = 0.5  # clocks of sensors differ slightly
MAX_PAUSE_NS = 3600 * 10**9
BASE_FRAMES = ("base", "base_link", "base_footprint")
CHILD_FRAMES = (*BASE_FRAMES, "")


@dataclass
class Stream:
    """Statistics of one topic of a log by receive time; `clock_s`: receive times minus stamps of its first messages."""

    topic: str
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_s: float = 0.0
    clock_s: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, receive_ns: int, message: Message) -> None:
        """Adds one message."""
        if self.count:
            self.longest_gap_s = max(self.longest_gap_s, (receive_ns - self.last_ns) * 1e-9)
        else:
            self.first_ns = receive_ns
        self.count, self.last_ns = self.count + 1, receive_ns
        if len(self.clock_s) < CLOCK_MESSAGES:
            self.clock_s.append((receive_ns - message.stamp_ns) * 1e-9)

    @property
    def rate_hz(self) -> float | None:
        """Mean rate; None for a single message."""
        span_s = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / span_s if span_s > 0.0 else None


@dataclass
class LogInspection:
    """Result of one pass over a log: streams, duration, odometry, initial standstill.

    `truth_age_ns` is the largest receive time minus stamp of the ground truth, 0 without any; `sensor_bytes` is the
    size of scans and images.
    """

    streams: dict[str, Stream] = field(default_factory=dict)
    first_ns: int | None = None
    last_ns: int = 0
    moved_ns: int | None = None
    truth_age_ns: int = 0
    sensor_bytes: int = 0
    odometry: dict[str, OdometrySamples] = field(default_factory=dict)
    first_fixes: dict[str, GnssFix] = field(default_factory=dict)

    @property
    def span_s(self) -> float:
        """Duration from the first to the last message."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9

    @property
    def standstill_s(self) -> float:
        """Duration of the standstill at the start, by wheel speed."""
        if self.first_ns is None:
            return 0.0
        return ((self.moved_ns if self.moved_ns is not None else self.last_ns) - self.first_ns) * 1e-9

    def clock_offset_ns(self, max_latency_s: float) -> int:
        """Difference of the clocks of receive times and stamps in ns; 0 where a latency explains it.

        A difference of clocks is common to all streams, and larger than any latency or of the wrong sign. The smallest
        median of the streams is the difference; what the others have beyond it is their latency. Streams with their
        receive times as stamps say nothing.
        """
        medians = [float(np.median(stream.clock_s)) for stream in self.streams.values() if any(stream.clock_s)]
        least, greatest = min(medians, default=0.0), max(medians, default=0.0)
        is_early = greatest < -CLOCK_TOLERANCE_S and greatest - least <= max_latency_s
        return round(least * 1e9) if least > max_latency_s or is_early else 0


def inspect(recording: Recording) -> LogInspection:
    """Reads a log once; raises LogError for a log without messages."""
    out, progress = LogInspection(), PassProgress(recording.path.name, "read")
    for receive_ns, topic, message in recording.read():
        progress.at(receive_ns)
        if out.first_ns is not None and abs(receive_ns - out.last_ns) > MAX_PAUSE_NS:
            raise LogError(
                f"{recording.path}: topic {topic!r} was received at {receive_ns} ns, "
                f"{(receive_ns - out.last_ns) * 1e-9:+.0f} s after the previous message, which exceeds any clock error"
            )
        if isinstance(message, TrueMachine | TrueObjects):
            out.truth_age_ns = max(out.truth_age_ns, receive_ns - message.stamp_ns)
        elif isinstance(message, Odometry):
            out.odometry.setdefault(topic, OdometrySamples()).add(message)
        elif isinstance(message, GnssFix) and message.solution is not GnssSolution.NONE:
            out.first_fixes.setdefault(topic, message)
        elif isinstance(message, LidarScan):
            out.sensor_bytes += message.ranges_mm.nbytes + message.xyz_m.nbytes + message.intensity.nbytes
        elif isinstance(message, CameraImage):
            out.sensor_bytes += len(message.encoded) or message.bgr.nbytes
        out.first_ns = receive_ns if out.first_ns is None else min(out.first_ns, receive_ns)
        out.last_ns = max(out.last_ns, receive_ns)
        out.streams.setdefault(topic, Stream(topic)).add(receive_ns, message)
        if isinstance(message, WheelSample) and abs(message.speed_mps) > 0.02 and out.moved_ns is None:
            out.moved_ns = receive_ns
    return out


@dataclass(frozen=True)
class RecordingMachine:
    """Machine that recorded the log; `lidars` maps its lidars to topics, `notes` give the source of each value."""

    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement | None
    lidars: dict[str, str]
    notes: tuple[str, ...]


def find_machine(recording: Recording, inspection: LogInspection, file: Path | None) -> RecordingMachine:
    """Machine by `--vehicle`, the configuration in the log, or its format; raises ConfigError with the missing keys."""
    topics = sorted(topic for topic in inspection.streams if topic.startswith("lidar/"))
    if file is None and recording.description.format == "headland":
        own = _logged_machine(recording.path, sorted(inspection.streams))
        if own is not None:
            return own
    values, file = vehicle_values(file, recording.description)
    where = str(file or "--vehicle")
    return _machine_from(values, recording.description, inspection.streams, topics, where, file is not None)


def vehicle_values(file: Path | None, about: Description) -> tuple[dict[str, Any], Path | None]:
    """Content of a vehicle file, by default that of the recording's format, and the file; raises ConfigError."""
    if file is None and about.vehicle is not None:
        file = CONFIGS / "vehicles" / f"{about.vehicle}.yaml"
    return ({} if file is None else _values(file)), file


def _values(file: Path) -> dict[str, Any]:
    path = file if file.is_file() else CONFIGS / "vehicles" / f"{file}.yaml"
    path = path if path.is_file() or file.suffix else CONFIGS / "machines" / f"{file}.yaml"
    values = read_yaml(path if path.is_file() else file)
    if not isinstance(values, dict):
        raise ConfigError(f"{file}: not a vehicle file; example:\n{EXAMPLE}")
    return values


def _logged_machine(path: Path, topics: list[str]) -> RecordingMachine | None:
    """Machine and implement from the configuration in the log, or None."""
    text = read_metadata(path).get("config", {}).get("yaml")
    if text is None:
        return None
    config = yaml.load(text, yaml.CSafeLoader)
    if not isinstance(config, dict) or "machine" not in config:
        return None
    vehicle = parse(Vehicle, config["machine"], f"{path}: machine")
    implement = None
    if config.get("implement") is not None:
        implement = parse(ImplementFile, {"implement": config["implement"]}, f"{path}: implement").implement
    lidars = {name: f"lidar/{name}" for name in vehicle.sensors.lidar if f"lidar/{name}" in topics}
    if not lidars:
        raise LogError(f"{path}: none of the machine's lidars ({', '.join(vehicle.sensors.lidar)}) is in the log")
    notes = ("machine: from the configuration in the log",)
    return RecordingMachine(_with_logged_sensors(vehicle, lidars, topics), implement, lidars, notes)


def _machine_from(
    values: dict[str, Any], about: Description, found: Iterable[str], topics: list[str], where: str, is_given: bool
) -> RecordingMachine:
    lidars = dict((values.get("sensors") or {}).get("lidar") or {})
    names, notes = _match_lidars(lidars, topics)
    mounts = mounts_of(about)
    for name, topic in names.items():
        lidar = dict(lidars.get(name) or {})
        if "mount" not in lidar and topic in mounts:
            lidar["mount"] = mounts[topic]
            notes += (f"{topic}: mount from the transforms in the log, base_link taken as rear axle on the ground",)
        lidars[name] = lidar
    missing = missing_values(values, {name: lidars[name] for name in names})
    if missing:
        raise ConfigError(_missing_text(where, missing, next(iter(names), "name"), is_given))
    sensors = dict(values.get("sensors") or {}) | {"lidar": {name: lidars[name] for name in names}}
    body = {"mass_kg": 1000.0} | dict(values["body"])
    name = values.get("name") or "recorded vehicle"
    vehicle = parse(Vehicle, UNUSED | values | {"name": name, "body": body, "sensors": sensors}, where)
    vehicle = _with_logged_sensors(vehicle, names, sorted(found))
    return RecordingMachine(vehicle, None, names, (f"vehicle: {where}", *notes))


def _match_lidars(lidars: dict[str, Any], topics: list[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Lidar names to topics of the log: by equal name, or one to one; else all topics of the log. And notes."""
    by_name = {t.partition("/")[2]: t for t in topics}
    same = {name: by_name[name] for name in lidars if name in by_name}
    if same:
        left = [t for name, t in by_name.items() if name not in same]
        return same, (f"not used, not in the vehicle file: {', '.join(left)}",) if left else ()
    if len(lidars) == 1 and len(topics) == 1:
        name = next(iter(lidars))
        return {name: topics[0]}, (f"{topics[0]} is the vehicle's lidar {name!r}: one of each",)
    return by_name, ()


def missing_values(values: dict[str, Any], lidars: dict[str, Any]) -> list[str]:
    """Missing keys of a vehicle file, in full."""
    body = values.get("body") or {}
    missing = [f"body.{key}" for key in BODY_KEYS if key not in body]
    for name, lidar in lidars.items():
        for key in LIDAR_KEYS:
            first, _, second = key.partition(".")
            part = lidar.get(first) if isinstance(lidar, dict) else None
            if part is None or (second and second not in part):
                missing.append(f"sensors.lidar.{name}.{key}")
    return missing


def _missing_text(where: str, missing: list[str], lidar: str, is_given: bool) -> str:
    begin = f"{where}: missing" if is_given else "the recording vehicle must be given by --vehicle FILE; required"
    example = EXAMPLE.replace("LIDAR", lidar)
    return f"{begin} {', '.join(missing)}. There are no defaults. Example:\n{example}"


def _with_logged_sensors(vehicle: Vehicle, lidars: dict[str, str], topics: list[str]) -> Vehicle:
    """Vehicle with the obstacle sensors that are in the log; the others are removed."""
    sensors: dict[str, Any] = {"lidar": {name: vehicle.sensors.lidar[name] for name in lidars}}
    for kind in SENSOR_KINDS.keys() - {"lidar"}:
        own = sensors_of(vehicle.sensors, kind)
        sensors[kind] = {name: own[name] for name in own if f"{kind}/{name}" in topics}
    return vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update=sensors)})


def mounts_of(about: Description) -> dict[str, dict[str, Any]]:
    """Mounts of the sensors by topic, from the transforms in the log."""
    out = {}
    for sensor in about.sensors:
        for base in BASE_FRAMES:
            T = pose_between(about, base, sensor.frame)
            if T is not None:
                rpy = np.degrees(rpy_of(T)).tolist()
                out[sensor.topic] = {"xyz_m": T[:3, 3].tolist(), "rpy_deg": rpy}
                break
    return out


def pose_between(about: Description, parent: str, child: str) -> Float64 | None:
    """Pose (4, 4) of `child` in `parent` along the static transforms of the log, or None if they are not connected."""
    links: dict[str, list[tuple[str, Float64]]] = {}
    for edge in about.extrinsics:
        links.setdefault(edge.parent, []).append((edge.child, edge.T_parent_child))
        links.setdefault(edge.child, []).append((edge.parent, invert(edge.T_parent_child)))
    known: dict[str, Float64] = {parent: np.eye(4)}
    queue = [parent]
    for frame in queue:
        for other, T in links.get(frame, []):
            if other not in known:
                known[other] = known[frame] @ T
                queue.append(other)
    return known.get(child) if parent in links or parent == child else None

"""What a log has, what judging it needs, and whose it is: the table before anything is judged."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from configs.strict import CONFIGS, parse, read_yaml
from configs.vehicle import ImplementFile, MountedImplement, TrailedImplement, Vehicle
from datasets.importers.recording import Description, Recording
from datasets.reader import read_metadata
from geometry.transforms import Float64, invert, rpy_of
from messages.errors import ConfigError, LogError
from messages.message import Message
from messages.sensors import WheelSample
from messages.truth import TrueMachine, TrueObjects

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
# What a vehicle must be by its class, though nothing of it acts when a log is judged.
IDLE: dict[str, Any] = {
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
BODY = ("front_m", "rear_m", "width_m", "height_m")
LIDAR = ("mount.xyz_m", "elevation_deg", "columns", "rate_hz", "range_m", "range_sigma_m")
LONGEST_PAUSE_NS = 3600 * 10**9
BASE_FRAMES = ("base", "base_link", "base_footprint")
CHILD_FRAMES = (*BASE_FRAMES, "")


@dataclass
class Stream:
    """One topic of a log: how often it came, when, and its longest silence, by time of reception."""

    topic: str
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_s: float = 0.0
    clock_s: list[float] = field(default_factory=list)

    def add(self, receive_ns: int, message: Message) -> None:
        """Take in one message."""
        if self.count:
            self.longest_gap_s = max(self.longest_gap_s, (receive_ns - self.last_ns) * 1e-9)
        else:
            self.first_ns = receive_ns
        self.count, self.last_ns = self.count + 1, receive_ns
        self.clock_s.append((receive_ns - message.stamp_ns) * 1e-9)

    @property
    def rate_hz(self) -> float | None:
        """Mean rate; None for a single message."""
        span_s = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / span_s if span_s > 0.0 else None


@dataclass
class Survey:
    """One pass over a log: its streams, and whether its wheels stood at first."""

    streams: dict[str, Stream] = field(default_factory=dict)
    first_ns: int | None = None
    last_ns: int = 0
    moved_ns: int | None = None
    truth: list[tuple[str, Message]] = field(default_factory=list)

    @property
    def span_s(self) -> float:
        """Seconds from the first message to the last."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9

    @property
    def stood_s(self) -> float:
        """How long the wheels stood at the start."""
        if self.first_ns is None:
            return 0.0
        return ((self.moved_ns if self.moved_ns is not None else self.last_ns) - self.first_ns) * 1e-9

    def clock_ns(self, most_s: float) -> int:
        """What to take from times of reception so that they run with the stamps; 0 while they agree to `most_s`."""
        ages = [a for s in self.streams.values() if s.topic.startswith("lidar/") for a in s.clock_s]
        offset_s = float(np.median(ages)) if ages else 0.0
        return round(offset_s * 1e9) if abs(offset_s) > most_s else 0


def survey(recording: Recording) -> Survey:
    """Read a log once; raises LogError when it holds nothing or no lidar."""
    out = Survey()
    for receive_ns, topic, message in recording.read():
        if out.first_ns is not None and abs(receive_ns - out.last_ns) > LONGEST_PAUSE_NS:
            raise LogError(
                f"{recording.path}: topic {topic!r} was received at {receive_ns} ns, "
                f"{(receive_ns - out.last_ns) * 1e-9:+.0f} s against the message before; no clock does that"
            )
        if isinstance(message, TrueMachine | TrueObjects):
            out.truth.append((topic, message))
        out.first_ns = receive_ns if out.first_ns is None else min(out.first_ns, receive_ns)
        out.last_ns = max(out.last_ns, receive_ns)
        out.streams.setdefault(topic, Stream(topic)).add(receive_ns, message)
        if isinstance(message, WheelSample) and abs(message.speed_mps) > 0.02 and out.moved_ns is None:
            out.moved_ns = receive_ns
    if out.first_ns is None:
        unread = ", ".join(f"{i.source} ({i.source_type})" for i in recording.description.ignored) or "nothing"
        raise LogError(f"{recording.path}: holds no message that is read here, but {unread}")
    if not any(topic.startswith("lidar/") for topic in out.streams):
        known = ", ".join(sorted(out.streams)) or "none"
        raise LogError(f"{recording.path}: no lidar in it, nothing can be judged (topics: {known})")
    return out


@dataclass(frozen=True)
class Machine:
    """Who recorded the log; `lidars` maps the vehicle's lidars to its topics, `notes` say what was taken whence."""

    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement | None
    lidars: dict[str, str]
    notes: tuple[str, ...]


def find_machine(recording: Recording, found: Survey, file: Path | None, by_format: dict[str, str]) -> Machine:
    """From `--vehicle`, the log's own configuration or its format; raises ConfigError naming what is missing."""
    topics = sorted(topic for topic in found.streams if topic.startswith("lidar/"))
    if file is None and recording.description.format == "headland":
        own = _own_machine(recording.path, sorted(found.streams))
        if own is not None:
            return own
    known = by_format.get(recording.description.format)
    if file is None and known is not None:
        file = CONFIGS / "vehicles" / f"{known}.yaml"
    values = _values(file)
    where = str(file or "--vehicle")
    return _machine_from(values, recording.description, found.streams, topics, where, file is not None)


def _values(file: Path | None) -> dict[str, Any]:
    if file is None:
        return {}
    path = file if file.is_file() else CONFIGS / "vehicles" / f"{file}.yaml"
    path = path if path.is_file() or file.suffix else CONFIGS / "machines" / f"{file}.yaml"
    values = read_yaml(path if path.is_file() else file)
    if not isinstance(values, dict):
        raise ConfigError(f"{file}: is no vehicle; such a file looks like this:\n{EXAMPLE}")
    return values


def _own_machine(path: Path, topics: list[str]) -> Machine | None:
    """Machine and implement as the log's own configuration has them, or None."""
    text = read_metadata(path).get("config", {}).get("yaml")
    if text is None:
        return None
    config = yaml.safe_load(text)
    if not isinstance(config, dict) or "machine" not in config:
        return None
    vehicle = parse(Vehicle, config["machine"], f"{path}: machine")
    implement = None
    if config.get("implement") is not None:
        implement = parse(ImplementFile, {"implement": config["implement"]}, f"{path}: implement").implement
    lidars = {name: f"lidar/{name}" for name in vehicle.sensors.lidar if f"lidar/{name}" in topics}
    if not lidars:
        raise LogError(f"{path}: none of the machine's lidars ({', '.join(vehicle.sensors.lidar)}) is in the log")
    return Machine(_heard(vehicle, lidars, topics), implement, lidars, ("machine: the log's own configuration",))


def _machine_from(
    values: dict[str, Any], about: Description, found: Iterable[str], topics: list[str], where: str, is_given: bool
) -> Machine:
    lidars = dict((values.get("sensors") or {}).get("lidar") or {})
    names, notes = _matched(lidars, topics)
    mounts = mounts_of(about)
    for name, topic in names.items():
        lidar = dict(lidars.get(name) or {})
        if "mount" not in lidar and topic in mounts:
            lidar["mount"] = mounts[topic]
            notes += (f"{topic}: mount from the log's own transforms, base_link taken as rear axle on the ground",)
        lidars[name] = lidar
    missing = missing_values(values, {name: lidars[name] for name in names})
    if missing:
        raise ConfigError(_ask(where, missing, next(iter(names)), is_given))
    sensors = dict(values.get("sensors") or {}) | {"lidar": {name: lidars[name] for name in names}}
    body = {"mass_kg": 1000.0} | dict(values["body"])
    name = values.get("name") or "recorded vehicle"
    vehicle = parse(Vehicle, IDLE | values | {"name": name, "body": body, "sensors": sensors}, where)
    vehicle = _heard(vehicle, names, sorted(found))
    return Machine(vehicle, None, names, (f"vehicle: {where}", *notes))


def _matched(lidars: dict[str, Any], topics: list[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Lidars of the file by the log's topics: by name, or the only one to the only one; else all of the log's."""
    by_name = {t.partition("/")[2]: t for t in topics}
    same = {name: by_name[name] for name in lidars if name in by_name}
    if same:
        left = [t for name, t in by_name.items() if name not in same]
        return same, (f"not used, since the vehicle file does not have them: {', '.join(left)}",) if left else ()
    if len(lidars) == 1 and len(topics) == 1:
        name = next(iter(lidars))
        return {name: topics[0]}, (f"{topics[0]} is the vehicle's lidar {name!r}: there is one of each",)
    return by_name, ()


def missing_values(values: dict[str, Any], lidars: dict[str, Any]) -> list[str]:
    """Full keys of what a vehicle file must still say."""
    body = values.get("body") or {}
    missing = [f"body.{key}" for key in BODY if key not in body]
    for name, lidar in lidars.items():
        for key in LIDAR:
            first, _, second = key.partition(".")
            part = lidar.get(first) if isinstance(lidar, dict) else None
            if part is None or (second and second not in part):
                missing.append(f"sensors.lidar.{name}.{key}")
    return missing


def _ask(where: str, missing: list[str], lidar: str, is_given: bool) -> str:
    begin = f"{where}: lacks" if is_given else "whose log this is must be said by --vehicle FILE; it needs"
    example = EXAMPLE.replace("LIDAR", lidar)
    return f"{begin} {', '.join(missing)}. Nothing of this is guessed. Such a file looks like this:\n{example}"


def _heard(vehicle: Vehicle, lidars: dict[str, str], topics: list[str]) -> Vehicle:
    """The vehicle with those of its obstacle sensors that the log has: nobody waits for the others."""
    sensors: dict[str, Any] = {"lidar": {name: vehicle.sensors.lidar[name] for name in lidars}}
    for kind in ("camera", "radar", "ultrasonic"):
        own = getattr(vehicle.sensors, kind)
        sensors[kind] = {name: own[name] for name in own if f"{kind}/{name}" in topics}
    return vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update=sensors)})


def mounts_of(about: Description) -> dict[str, dict[str, Any]]:
    """Mounts of the log's sensors that its own transforms tell, by topic."""
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
    """Pose of a frame in another along the log's fixed transforms, or None when they are not connected."""
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

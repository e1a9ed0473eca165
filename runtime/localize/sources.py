"""What `localize` needs of a recording: streams of its sensors, vehicle with mounts, and datum of `map`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from configs.strict import parse
from configs.vehicle import Vehicle
from datasets.importers.recording import Recording
from datasets.importers.selection import bind
from datasets.reader import read_metadata
from geometry.geodesy import Datum
from localization.localizer import IMU, WHEEL
from messages.errors import ConfigError, LogError
from runtime.replay.log_inspection import UNUSED, vehicle_values
from runtime.replay.prepare import RecordingSite, site_of
from runtime.replay.topic_binding import ODOMETRY, bind_sensors

BODY = {"front_m": 1.0, "rear_m": 1.0, "width_m": 1.0, "height_m": 1.0, "mass_kg": 1000.0}  # has no effect here
MOUNTS = (
    "--vehicle FILE is needed: it has the mounts and noise of sensors.gnss.main and sensors.imu (configs/vehicles/)"
)


@dataclass(frozen=True)
class Sources:
    """Recording with the topics of the localizer; `wheels` is the topic of the wheel speeds, "" without any.

    `site` is that of a Headland log, None for others.
    """

    recording: Recording
    vehicle: Vehicle
    gnss: str
    wheels: str
    site: RecordingSite | None
    notes: tuple[str, ...]


def sources_of(recording: Recording, file: Path | None, receiver: str) -> Sources:
    """Sensors, vehicle and site; raises LogError or ConfigError that names what is missing."""
    if not any(s.topic.partition("/")[0] == IMU for s in recording.description.sensors):
        known = ", ".join(sorted(s.topic for s in recording.description.sensors)) or "nothing that is read"
        raise LogError(f"{recording.path}: no IMU, without which nothing is localized (streams: {known})")
    own = _own_vehicle(recording) if file is None else None
    values, where = (None, None) if own is not None else vehicle_values(file, recording.description)
    if own is None and not values:
        raise ConfigError(f"{recording.path}: {MOUNTS}")
    bound = recording if values is None else _bound(recording, values, receiver)
    topics = {s.topic for s in bound.description.sensors}
    vehicle = own if own is not None else _vehicle(values or {}, str(where))
    if IMU not in topics:
        raise LogError(f"{recording.path}: several IMUs; sensors.imu.topic in the vehicle file selects one")
    if vehicle.sensors.imu is None or receiver not in vehicle.sensors.gnss:
        raise ConfigError(f"{where or recording.path}: sensors.imu and sensors.gnss.{receiver} are needed")
    gnss = f"gnss/{receiver}"
    wheels = next((t for t in (ODOMETRY, WHEEL) if t in topics), "") if vehicle.sensors.wheels is not None else ""
    notes = [] if gnss in topics else ["no GNSS: dead reckoning only, no position in map"]
    notes += [] if wheels else ["no wheel speeds"]
    if not wheels:
        vehicle = vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"wheels": None})})
    site = site_of(recording.path) if recording.description.format == "headland" else None
    return Sources(bound, vehicle, gnss, wheels, site, tuple(notes))


def datum_of(sources: Sources, first: tuple[float, float, float] | None) -> Datum:
    """Datum of the site, else the first usable fix (latitude, longitude, height), else zero."""
    if sources.site is not None:
        return sources.site.datum
    return Datum(*(first or (0.0, 0.0, 0.0)))


def _own_vehicle(recording: Recording) -> Vehicle | None:
    """The machine in a Headland log."""
    if recording.description.format != "headland" or not recording.path.is_file():
        return None
    text = read_metadata(recording.path).get("config", {}).get("yaml")
    config = yaml.load(text, yaml.CSafeLoader) if text is not None else None
    if not isinstance(config, dict) or "machine" not in config:
        return None
    return parse(Vehicle, config["machine"], f"{recording.path}: machine")


def _vehicle(values: dict[str, Any], where: str) -> Vehicle:
    body = BODY | dict(values.get("body") or {})
    sensors = {k: v for k, v in dict(values.get("sensors") or {}).items() if k in ("gnss", "imu", "wheels")}
    whole = UNUSED | values | {"name": values.get("name") or "recorded vehicle", "body": body, "sensors": sensors}
    return parse(Vehicle, whole, where)


def _bound(recording: Recording, values: dict[str, Any], receiver: str) -> Recording:
    """Streams by the names in the vehicle file; without a name the only one of its kind."""
    sensors = {k: v for k, v in dict(values.get("sensors") or {}).items() if k in ("gnss", "imu", "wheels")}
    kinds = {kind: [s for s in recording.description.sensors if s.topic.partition("/")[0] == kind]
             for kind in ("gnss", "imu", "wheel")}  # fmt: skip
    present = {s.source for s in recording.description.sensors} | {s.topic for s in recording.description.sensors}
    gnss = dict((sensors.get("gnss") or {}).get(receiver) or {})
    if not kinds["gnss"] and gnss.get("topic") not in present:
        sensors.pop("gnss", None)  # a recording without GNSS is one without a position, not a wrong file
    out = bind_sensors(recording, {"sensors": sensors})
    missing = {}
    if gnss.get("topic") is None and len(kinds["gnss"]) == 1:
        missing[f"gnss/{receiver}"] = (kinds["gnss"][0].topic, f"sensors.gnss.{receiver}")
    if (sensors.get("imu") or {}).get("topic") is None and len(kinds["imu"]) == 1:
        missing[IMU] = (kinds["imu"][0].topic, "sensors.imu")
    if (sensors.get("wheels") or {}).get("topic") is None and len(kinds["wheel"]) == 1:
        missing[WHEEL] = (kinds["wheel"][0].topic, "sensors.wheels")
    missing = {topic: names for topic, names in missing.items() if topic != names[0]}
    return replace(bind(out, missing)) if missing else out

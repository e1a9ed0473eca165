"""Streams of a recording that a vehicle file names by `topic:`."""

from collections.abc import Mapping
from typing import Any

from datasets.importers.recording import Recording
from datasets.importers.selection import bind

# Topic of the odometry that `sensors.wheels.topic` names.
ODOMETRY = "odom/wheels"


def bind_sensors(recording: Recording, vehicle: Mapping[str, Any]) -> Recording:
    """The recording with the topics of the machine's sensors for the streams named in a vehicle file; raises LogError.

    `sensors.wheels.topic` is a stream of wheel speeds, or the odometry to be used.
    """
    bindings: dict[str, tuple[str, str]] = {}
    for kind, sensors in (vehicle.get("sensors") or {}).items():
        if not isinstance(sensors, dict):
            continue
        if kind in ("imu", "wheels"):
            if sensors.get("topic") is not None:
                name = str(sensors["topic"])
                bindings[_single(recording, kind, name)] = (name, f"sensors.{kind}.topic")
            continue
        for sensor, values in sensors.items():
            if isinstance(values, dict) and values.get("topic") is not None:
                bindings[f"{kind}/{sensor}"] = (str(values["topic"]), f"sensors.{kind}.{sensor}.topic")
    return bind(recording, bindings) if bindings else recording


def _single(recording: Recording, kind: str, name: str) -> str:
    if kind == "imu":
        return "imu"
    kinds = {s.topic.partition("/")[0] for s in recording.description.sensors if name in (s.source, s.topic)}
    return ODOMETRY if kinds == {"odom"} else "wheel"

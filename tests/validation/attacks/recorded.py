"""Generated drives as log files, and their verdict by the whole path of `headland validate`."""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from configs.strict import CONFIGS, read_yaml
from datasets.importers.recording import SOURCE, Description, Extrinsic, Sensor, describe
from datasets.log import LogWriter
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import ImuSample, WheelSample
from messages.truth import TrueMachine
from runtime.replay.evaluate import Task, evaluate_task
from runtime.replay.log_inspection import UNUSED
from runtime.stack import load_stack
from tests.validation.obstacle_stop.consistency.world import OUTLINE, START_NS, Actor, Drive
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.totals import aggregate

CONDITIONS = load_conditions(None)
LOG = load_stack().datasets.log
Change = Callable[[list[Envelope]], Iterable[Envelope]]


def standing(id: int, x_m: float, y_m: float = 0.0, **more: Any) -> Actor:
    """A person who stands at a place in map."""
    return Actor(id, lambda t: (x_m, y_m, 0.0), **more)


def walking(id: int, x_m: float, y_m: float, vx_mps: float, vy_mps: float, **more: Any) -> Actor:
    """A person who walks from a place in map."""
    yaw = math.atan2(vy_mps, vx_mps)
    return Actor(id, lambda t: (x_m + vx_mps * t, y_m + vy_mps * t, yaw), **more)


def drive(*actors: Actor, **values: Any) -> Drive:
    """A drive of 4 s at 4 m/s towards these actors, with two persons and a vehicle beside the path."""
    defaults: dict[str, Any] = {"seed": 3, "beams": 32, "columns": 300, "speed_mps": 4.0, "seconds": 4.0, "objects": 3}
    return Drive(actors=actors, **(defaults | values))


def vehicle_values(drive: Drive) -> dict[str, Any]:
    """Content of the vehicle file of a drive."""
    lidar, body = drive.lidar(), OUTLINE
    xyz, rpy = lidar.mount.xyz_m, lidar.mount.rpy_deg
    top = {
        "mount": {"xyz_m": list(xyz), "rpy_deg": list(rpy)}, "elevation_deg": list(lidar.elevation_deg),
        "columns": lidar.columns, "rate_hz": 10.0, "range_m": [0.5, 80.0], "range_sigma_m": 0.03,
    }  # fmt: skip
    size = {"front_m": body.front_m, "rear_m": -body.rear_m, "width_m": 2.0 * body.half_width_m, "height_m": 1.5}
    return {"name": "a test car", "body": size, "sensors": {"lidar": {"top": top}}}


def write_log(path: Path, drive: Drive, envelopes: Iterable[Envelope], about: dict[str, Any] | None = None) -> Path:
    """Log of a drive as an import writes it: with a description, truth in map or in the frame of the lidar.

    `about` has values of the description that are not those of the drive.
    """
    frame = None if not drive.has_truth else "map" if drive.truth_in_map else "top"
    topic = "truth_objects" if drive.truth_in_map else "truth_objects/top"
    frames = {"lidar/top": "top", "odom": "base", topic: "map" if drive.truth_in_map else "top"}
    sensors = tuple(Sensor(topic, frame, topic, "generated") for topic, frame in frames.items())
    path.unlink(missing_ok=True)
    mount = Extrinsic("base", "top", drive.lidar().mount.T_base_sensor)
    description = replace(Description("generated", sensors, (mount,), truth_frame=frame), **(about or {}))
    metadata = {SOURCE: {"path": "generated", "description": json.dumps(describe(description))}}
    with LogWriter(path, metadata, LOG) as log:
        for number, envelope in enumerate(envelopes):
            named = topic if envelope.topic == "truth_objects" else envelope.topic
            if drive.truth_in_map or not isinstance(envelope.message, TrueMachine):
                log.write(replace(envelope, topic=named, sequence=number))
    return path


@lru_cache(maxsize=4)
def envelopes_of(drive: Drive) -> tuple[Envelope, ...]:
    """The messages of a drive, odometry and wheel speed at 25 Hz, without IMU: half the time of a test."""
    kept = (e for e in drive.envelopes() if not isinstance(e.message, ImuSample))
    every = 40_000_000
    return tuple(
        e for e in kept
        if not isinstance(e.message, Odometry | WheelSample) or (e.message.stamp_ns - START_NS) % every == 0
    )  # fmt: skip


@dataclass(frozen=True)
class Bench:
    """Folder in which drives are written and judged."""

    folder: Path

    def judge(
        self, drive: Drive, change: Change = lambda es: es, vehicle: dict[str, Any] | None = None,
        about: dict[str, Any] | None = None, **conditions: Any,
    ) -> dict[str, Any]:  # fmt: skip
        """Result of `headland validate` for the log of a drive after a change of its messages."""
        log = write_log(self.folder / "drive.mcap", drive, change(list(envelopes_of(drive))), about)
        return self.judge_log(log, vehicle or vehicle_values(drive), **conditions)

    def judge_log(self, log: Path, vehicle: dict[str, Any] | None, **conditions: Any) -> dict[str, Any]:
        """Result of `headland validate` for a log and the content of a vehicle file (None: of the log)."""
        file, limits = self.folder / "car.yaml" if vehicle is not None else None, self.folder / "conditions.yaml"
        if file is not None:
            file.write_text(yaml.safe_dump(vehicle))
        changed = CONDITIONS.model_copy(update=conditions)
        limits.write_text(yaml.safe_dump(changed.model_dump(mode="json")))
        task = Task(log.name, log, None, file, limits, None, False, None, self.folder / "result", "")
        return aggregate([evaluate_task(task)], changed)


def write_own_log(path: Path, drive: Drive, implement: str) -> Path:
    """Log of a drive as the stack writes it, of a machine with an implement of configs/implements."""
    values = vehicle_values(drive)
    machine = UNUSED | values | {"body": values["body"] | {"mass_kg": 1000.0}}
    about = {"machine": machine, "implement": read_yaml(CONFIGS / "implements" / f"{implement}.yaml")["implement"]}
    with LogWriter(path, {"config": {"yaml": yaml.safe_dump(about)}}, LOG) as log:
        for number, envelope in enumerate(envelopes_of(drive)):
            log.write(replace(envelope, sequence=number))
    return path


def reasons(result: dict[str, Any]) -> str:
    """Why a result is not passed, a line each: outcome of every encounter, false stops, blocking findings, the rest."""
    lines = [f"encounter {e['id']}: {e['outcome']}" for e in result["encounters"]]
    lines += [f"false stop: {s['reason']}, {s['class']}" for s in result["stops"] if s["is_false"]]
    lines += [f"{f['code']}: {f['text']}" for f in result["findings"] if f["is_blocking"]]
    return "\n".join([*lines, *(row["reason"] for row in result["not_shown"])])

"""Evaluation of one log as a task for a worker process: replay, outcomes and figures as plain values."""

from __future__ import annotations

import base64
import errno
import os
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import HeadlandError
from runtime.workers import store_result

if TYPE_CHECKING:
    from runtime.bus import Sink
    from runtime.replay.prepare import ReplayInput
    from validation.obstacle_stop.consistency.observer import ConsistencyObserver
    from validation.obstacle_stop.observation import LogObservation, Setting
    from validation.obstacle_stop.perceived_objects import PerceivedObjects

NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


@dataclass(frozen=True)
class Task:
    """One log to evaluate; inputs of a worker as plain values."""

    name: str
    log: Path
    truth: Path | None
    vehicle: Path | None
    conditions: Path | None
    removed_object: str | None
    has_sensor_data: bool
    model: Path | None
    folder: Path
    key: str


class NotShown(HeadlandError):
    """A log that is readable and cannot show anything."""


def lost_task(task: Task, error: Exception) -> dict[str, Any]:
    """Result of a log whose worker died."""
    return {"log": task.name, "failed": f"{task.log}: the worker died ({error!r})"}


def evaluate_task(task: Task) -> dict[str, Any]:
    """Evaluates one log in this process; errors are part of the result, except those in writing it (HeadlandError)."""
    try:
        values = _evaluate(task)
    except HeadlandError as error:
        values = {"log": task.name, "failed": "; ".join([str(error), *_damage(task.log)])}
        values["is_not_shown"] = isinstance(error, NotShown)
    except Exception as error:  # an invalid log may raise any error; the other logs continue
        if isinstance(error, OSError) and error.errno in NO_SPACE:
            raise _cannot_write(task, error) from error
        where = traceback.format_exc().strip().splitlines()[-3:]
        values = {"log": task.name, "failed": f"{task.log}: {error!r} ({' '.join(where)})"}
    values["key"] = task.key
    if "failed" not in values:
        try:
            store_result(task.folder, values)
        except OSError as error:
            raise _cannot_write(task, error) from error
    return values


def _cannot_write(task: Task, error: OSError) -> HeadlandError:
    return HeadlandError(f"{task.folder}: cannot write the results ({error.strerror})")


def _damage(log: Path) -> tuple[str, ...]:
    """Damage of a log, a possible cause of the failure."""
    from runtime.replay.prepare import damage_of

    try:
        return damage_of(log)
    except HeadlandError:
        return ()


def _evaluate(task: Task) -> dict[str, Any]:
    """Replays and evaluates a log; heavy modules are imported only here."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from datasets.importers.sidecar_lines import read_sidecar
    from datasets.importers.truth_sidecar import sidecar_of
    from runtime.replay.log_inspection_table import render
    from runtime.replay.object_removal import remove_object
    from runtime.replay.prepare import load_configuration, prepare
    from runtime.replay.progress import PassProgress
    from runtime.replay.replay import replay
    from runtime.replay.replay_log import replay_log
    from validation.obstacle_stop.conditions import load_conditions
    from validation.obstacle_stop.evaluation import evaluate_log
    from validation.obstacle_stop.labels import open_questions
    from validation.obstacle_stop.observer import Observer
    from validation.obstacle_stop.perceived_objects import PerceivedObjects

    conditions = load_conditions(task.conditions)
    check_thinned(task.log)
    replay_input = prepare(task.log, task.truth, task.vehicle, load_configuration(conditions, task.model))
    if task.removed_object is not None:
        replay_input = remove_object(replay_input, task.removed_object)
    inspection = replay_input.inspection_table()
    sys.stderr.write(render(inspection))
    setting = replay_input.setting(task.name)
    observer = Observer(setting, conditions)
    has_truth = setting.truth_frame is not None
    sidecar = sidecar_of(task.log, task.truth, conditions.truth.source)
    perceived = None if has_truth or sidecar is not None else PerceivedObjects(setting, observer.tracks)
    consistency = consistency_observer(replay_input, setting)
    progress = PassProgress(task.name, "replayed", replay_input.delivery_span_ns)
    sinks: list[Sink] = [lambda envelope: progress.at(envelope.receive_ns), observer, consistency]
    sinks += [] if perceived is None else [perceived]
    task.folder.mkdir(parents=True, exist_ok=True)
    with replay_log(task.folder / "replay.mcap", replay_input, inspection, task.has_sensor_data) as log:
        replay(replay_input, [*sinks, log])
        observed = observer.finish()
        values = evaluate_log(task.name, observed, has_truth, conditions)
        log.write_encounters(values["encounters"], observed.first_ns)
    findings = [finding.as_dict for finding in consistency.finish()]
    values |= {"inspection": inspection, "digest": log.digest(), "findings": findings}
    values["first_ns"] = observed.first_ns
    if perceived is not None:
        return values | _proposal(values, perceived, replay_input, observed, setting)
    labels = {} if sidecar is None else open_questions(read_sidecar(sidecar), observed)
    labels["not_shown"] = [*values.get("not_shown", []), *labels.get("not_shown", [])]
    return values | labels | {"figures": _figures(values, observed, setting) if has_truth else {}}


def check_thinned(log: Path) -> None:
    """Raises NotShown for a log of `live`, which has the sensor data of events only, in logs of their own."""
    from datasets.importers.recording import read_head
    from datasets.reader import read_metadata
    from datasets.records import MAGIC

    if log.is_file() and read_head(log).startswith(MAGIC) and (thinned := read_metadata(log).get("thinned")):
        left_out = thinned.get("left_out")
        raise NotShown(f"{log}: thinned, without {left_out}; the logs in events/ have the seconds around events")


def consistency_observer(replay_input: ReplayInput, setting: Setting) -> ConsistencyObserver:
    """Sink that checks the inputs of the log against each other."""
    from configs.vehicle import outlines
    from validation.obstacle_stop.consistency.observer import ConsistencyObserver

    machine = replay_input.machine
    sensors = machine.vehicle.sensors
    lidars = {name: sensors.lidar[name] for name in machine.lidars}
    bodies = outlines(machine.vehicle.body, machine.implement)
    T_imu = None if sensors.imu is None else sensors.imu.mount.T_base_sensor
    is_from_scans = replay_input.odometry.kind == "scans"
    conditions, topic = replay_input.config.conditions, replay_input.odometry.topic
    return ConsistencyObserver(setting, lidars, bodies, is_from_scans, conditions, T_imu, topic)


def _proposal(
    values: dict[str, Any], perceived: PerceivedObjects, replay_input: ReplayInput, observed: LogObservation,
    setting: Setting,
) -> dict[str, Any]:  # fmt: skip
    """Lines of the proposed truth, and pictures (PNG in base64) by file name; encounters name theirs."""
    from validation.obstacle_stop.proposal import box_lines, file_line, object_line, proposal_figure

    scans = perceived.scans_ns
    if not scans:
        return {}
    topic = replay_input.machine.lidars[perceived.lidar]
    frame = next((s.frame for s in replay_input.recording.description.sensors if s.topic == topic), "") or topic
    T = setting.T_base_lidar[perceived.lidar]
    heads = [file_line(replay_input.recording.path.name, frame, scans, T, observed)]
    boxes: list[dict[str, Any]] = []
    figures: dict[str, str] = {}
    for one in perceived.objects(observed):
        picture = f"logs/{values['log']}/object-{one.id}.png"
        heads.append(object_line(one, picture, observed))
        boxes += box_lines(one, T, observed)
        figures[picture] = base64.b64encode(proposal_figure(one, setting, observed)).decode()
    for encounter in values["encounters"]:
        picture = f"logs/{values['log']}/object-{encounter['id']}.png"
        encounter["picture"] = picture if picture in figures else None
    return {"proposal": heads + boxes, "figures": figures}


def _figures(values: dict[str, Any], observed: LogObservation, setting: Setting) -> dict[str, str]:
    """Pictures (PNG in base64) of the encounters by file name, which each encounter then names."""
    from validation.obstacle_stop.figures import encounter_figure

    out = {}
    for number, encounter in enumerate(values["encounters"], 1):
        encounter["picture"] = f"logs/{values['log']}/encounter-{number}.png"
        png = encounter_figure(encounter, observed, setting.front_m, setting.width_m)
        out[encounter["picture"]] = base64.b64encode(png).decode()
    return out

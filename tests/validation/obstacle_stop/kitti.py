"""The first forty KITTI frames: their replay, computed once, and their result after changes before or after it."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from datasets.importers.recording import Received, Skipped
from messages.message import Envelope
from runtime.replay.evaluate import consistency_observer
from runtime.replay.prepare import ReplayInput, load_configuration, prepare
from runtime.replay.replay import replay
from tests.recordings import DATA, needs
from tests.validation.obstacle_stop.consistency.changes import Change, unchanged
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.evaluation import evaluate_log
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.totals import aggregate

LOG, TRUTH, LIDAR = DATA / "kitti-seq-pcd", DATA / "kitti-tracking-truth", "velodyne"
LABELS = TRUTH / "scripts" / "KITTI" / "label" / "0000.txt"
NEEDED = needs(LOG.name, TRUTH.name)
CONDITIONS = load_conditions(None)


@cache
def recorded() -> ReplayInput:
    """The log as recorded."""
    return prepare(LOG, TRUTH, None, load_configuration(CONDITIONS))


@cache
def messages() -> tuple[Received | Skipped, ...]:
    """All messages of the log: decompressed once."""
    return tuple(recorded().recording.messages())


@cache
def outputs() -> tuple[Envelope, ...]:
    """All messages of the replay of the log."""
    return run(recorded())


def run(prepared: ReplayInput) -> tuple[Envelope, ...]:
    """All messages of a replay."""
    envelopes: list[Envelope] = []
    replay(prepared, [envelopes.append])
    return tuple(envelopes)


def result_of(envelopes: tuple[Envelope, ...], prepared: ReplayInput, change: Change = unchanged) -> dict:
    """Result of a replay after a change of its messages, in order of delivery."""
    setting = prepared.setting("kitti")
    observer, consistency = Observer(setting, CONDITIONS), consistency_observer(prepared, setting)
    changed = [c for e in envelopes if (c := change(e)) is not None]
    for envelope in sorted(changed, key=lambda e: e.receive_ns):
        observer(envelope)
        consistency(envelope)
    log = evaluate_log("kitti", observer.finish(), True, CONDITIONS)
    log["findings"] = [finding.as_dict for finding in consistency.finish()]
    return aggregate([log], CONDITIONS) | {"confirmation": log["confirmation"]}


def judged(change: Change = unchanged) -> dict:
    """Result after a change of what perception does not see: truth, or its outputs."""
    return result_of(outputs(), recorded(), change)


def replayed(change: Change = unchanged, **mount: tuple[float, float, float]) -> dict:
    """Result of a new replay with changed sensor data, or another mount in the vehicle file."""
    prepared = recorded()
    vehicle, recording = prepared.machine.vehicle, prepared.recording
    lidar = vehicle.sensors.lidar[LIDAR]
    lidar = lidar.model_copy(update={"mount": lidar.mount.model_copy(update=mount)})
    sensors = vehicle.sensors.model_copy(update={"lidar": {LIDAR: lidar}})
    machine = replace(prepared.machine, vehicle=vehicle.model_copy(update={"sensors": sensors}))

    def read() -> Iterator[Received | Skipped]:
        for item in messages():
            if isinstance(item, Skipped):
                yield item
                continue
            receive_ns, topic, message = item
            changed = change(Envelope(topic, 0, receive_ns, message))
            if changed is not None:
                yield changed.receive_ns, topic, changed.message

    prepared = replace(prepared, machine=machine, recording=replace(recording, messages=read))
    return result_of(run(prepared), prepared)

"""Removal of one object from all sensor data of a log; the ground truth is kept."""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import cast

from configs.sensor_kinds import sensors_of
from configs.vehicle import Sensors
from datasets.importers.recording import Received, Skipped
from geometry.arrays import Float64
from geometry.transforms import invert
from messages.errors import LogError
from messages.message import Message
from messages.truth import TrueMachine, TrueObject, TrueObjects
from runtime.replay.prepare import ReplayInput
from validation.obstacle_stop.boxes import Box, box_of
from validation.sensor_registry import REMOVALS

MAX_AGE_NS = 150_000_000
BoxAt = Callable[[int], Box | None]


def remove_object(replay_input: ReplayInput, name: str) -> ReplayInput:
    """Log without the object of this role, class or id; raises LogError if the ground truth has none."""
    frame = replay_input.setting("").truth_frame
    objects: list[tuple[int, TrueObject]] = []
    machines: list[TrueMachine] = []
    known: set[str] = set()
    for _, topic, message in replay_input.recording.read():
        if isinstance(message, TrueObjects) and topic == replay_input.truth_topic:
            known |= {true_object.role or true_object.label.value for true_object in message.objects}
            objects += [(message.stamp_ns, t) for t in message.objects if name in (t.role, t.label.value, str(t.id))]
        elif isinstance(message, TrueMachine):
            machines.append(message)
    objects.sort(key=lambda o: o[0])
    machines.sort(key=lambda m: m.stamp_ns)
    if not objects:
        raise LogError(
            f"--remove-object {name}: not in the ground truth (objects: {', '.join(sorted(known)) or 'none'})"
        )
    lidars = {n: lidar.mount.T_base_sensor for n, lidar in replay_input.machine.vehicle.sensors.lidar.items()}
    boxes = [
        _box_by_time([o for o in objects if o[1].id == i], machines, lidars.get(frame or ""))
        for i in sorted({t.id for _, t in objects})
    ]
    names = {topic: f"lidar/{n}" for n, topic in replay_input.machine.lidars.items()}
    sensors = replay_input.machine.vehicle.sensors
    recording = replay_input.recording

    def read() -> Iterator[Received | Skipped]:
        for item in recording.messages():
            if isinstance(item, Skipped):
                yield item
                continue
            receive_ns, topic, message = item
            for box_at in boxes:
                box = box_at(message.stamp_ns)
                message = message if box is None else without_object(names.get(topic, topic), message, box, sensors)
            yield receive_ns, topic, message

    notes = (*recording.description.notes, f"{name} removed from all sensor data, replaced by its surroundings")
    about = replace(recording.description, notes=notes)
    return replace(replay_input, recording=replace(recording, description=about, messages=read))


def _box_by_time(
    objects: list[tuple[int, TrueObject]], machines: list[TrueMachine], T_base_lidar: Float64 | None
) -> BoxAt:
    """Box of the object in base as a function of time."""
    stamps, machine_stamps = [stamp for stamp, _ in objects], [m.stamp_ns for m in machines]

    def box_at(stamp_ns: int) -> Box | None:
        k = _nearest(stamps, stamp_ns)
        if k is None or T_base_lidar is not None:
            return None if k is None or T_base_lidar is None else box_of(objects[k][1], T_base_lidar)
        m = _nearest(machine_stamps, stamp_ns)
        return None if m is None else box_of(objects[k][1], invert(machines[m].T_map_base))

    return box_at


def _nearest(stamps_ns: list[int], stamp_ns: int) -> int | None:
    k = bisect_left(stamps_ns, stamp_ns)
    best = min(
        (j for j in (k - 1, k) if 0 <= j < len(stamps_ns)), key=lambda j: abs(stamps_ns[j] - stamp_ns), default=None
    )
    return best if best is not None and abs(stamps_ns[best] - stamp_ns) <= MAX_AGE_NS else None


def without_object(topic: str, message: Message, box: Box, sensors: Sensors) -> Message:
    """Sensor message without the object; other messages unchanged."""
    kind, _, name = topic.partition("/")
    sensor = sensors_of(sensors, kind).get(name) if kind in REMOVALS else None
    return message if sensor is None else cast(Message, REMOVALS[kind](message, box, sensor))

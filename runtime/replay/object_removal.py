"""A log as it would be had one object not been there: gone from every sensor's data, and still in the truth."""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import replace

from configs.vehicle import Sensors
from datasets.importers.recording import Received
from geometry.transforms import Float64, invert
from messages.errors import LogError
from messages.message import Message
from messages.sensors import CameraImage, LidarScan, RadarScan, UltrasonicRange
from messages.truth import TrueMachine, TrueObject, TrueObjects
from runtime.replay.prepare import Prepared
from validation.obstacle_stop.boxes import Box, box_of
from validation.obstacle_stop.object_removal import (
    remove_from_echo,
    remove_from_image,
    remove_from_radar,
    remove_from_scan,
)

OLDEST_NS = 150_000_000
Place = Callable[[int], Box | None]


def erase(prepared: Prepared, name: str) -> Prepared:
    """The log without what the truth calls `name` (its role, class or id); raises LogError when there is no such."""
    frame = prepared.setting("").truth_frame
    things: list[tuple[int, TrueObject]] = []
    machines: list[TrueMachine] = []
    known: set[str] = set()
    for topic, message in prepared.found.truth:
        if isinstance(message, TrueObjects) and topic == prepared.truth_topic:
            known |= {thing.role or thing.label.value for thing in message.objects}
            things += [(message.stamp_ns, t) for t in message.objects if name in (t.role, t.label.value, str(t.id))]
        elif isinstance(message, TrueMachine):
            machines.append(message)
    things.sort(key=lambda o: o[0])
    machines.sort(key=lambda m: m.stamp_ns)
    if not things:
        raise LogError(f"--without {name}: the truth has no such object (it has {', '.join(sorted(known)) or 'none'})")
    lidars = {n: lidar.mount.T_base_sensor for n, lidar in prepared.machine.vehicle.sensors.lidar.items()}
    places = [
        _place_of([o for o in things if o[1].id == i], machines, lidars.get(frame or ""))
        for i in sorted({t.id for _, t in things})
    ]
    names = {topic: f"lidar/{n}" for n, topic in prepared.machine.lidars.items()}
    sensors = prepared.machine.vehicle.sensors
    recording = prepared.recording

    def read() -> Iterator[Received]:
        for receive_ns, topic, message in recording.read():
            for place in places:
                box = place(message.stamp_ns)
                message = message if box is None else gone(names.get(topic, topic), message, box, sensors)
            yield receive_ns, topic, message

    notes = (*recording.description.notes, f"without {name}: replaced by what stands beside it in every sensor's data")
    return replace(
        prepared, recording=replace(recording, description=replace(recording.description, notes=notes), read=read)
    )


def _place_of(things: list[tuple[int, TrueObject]], machines: list[TrueMachine], T_base_lidar: Float64 | None) -> Place:
    """Where the object was in base, by time."""
    stamps, driven = [stamp for stamp, _ in things], [m.stamp_ns for m in machines]

    def place(stamp_ns: int) -> Box | None:
        k = _nearest(stamps, stamp_ns)
        if k is None or T_base_lidar is not None:
            return None if k is None or T_base_lidar is None else box_of(things[k][1], T_base_lidar)
        m = _nearest(driven, stamp_ns)
        return None if m is None else box_of(things[k][1], invert(machines[m].T_map_base))

    return place


def _nearest(stamps_ns: list[int], stamp_ns: int) -> int | None:
    k = bisect_left(stamps_ns, stamp_ns)
    best = min(
        (j for j in (k - 1, k) if 0 <= j < len(stamps_ns)), key=lambda j: abs(stamps_ns[j] - stamp_ns), default=None
    )
    return best if best is not None and abs(stamps_ns[best] - stamp_ns) <= OLDEST_NS else None


def gone(topic: str, message: Message, box: Box, sensors: Sensors) -> Message:
    """A sensor's message without the object; others as they are."""
    name = topic.partition("/")[2]
    if isinstance(message, LidarScan) and name in sensors.lidar:
        return remove_from_scan(message, box, sensors.lidar[name].mount.T_base_sensor)
    if isinstance(message, RadarScan) and name in sensors.radar:
        return remove_from_radar(message, box, sensors.radar[name])
    if isinstance(message, UltrasonicRange) and name in sensors.ultrasonic:
        return remove_from_echo(message, box, sensors.ultrasonic[name])
    if isinstance(message, CameraImage) and name in sensors.camera:
        return remove_from_image(message, box, sensors.camera[name])
    return message

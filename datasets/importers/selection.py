"""Streams of a recording chosen by name, and bound to the topics of a machine's sensors."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

from datasets.importers.recording import Received, Recording, Sensor, Skipped
from messages.errors import LogError

NOT_SELECTED = "not selected"


def select(recording: Recording, names: Collection[str]) -> Recording:
    """The streams with these names, the others are skipped; raises LogError for a name that the recording lacks."""
    chosen = {_find(recording, name, "--topics").topic for name in names}
    by_topic = {sensor.topic: sensor for sensor in recording.description.sensors}

    def messages() -> Iterator[Received | Skipped]:
        for item in recording.messages():
            if isinstance(item, Skipped) or item[1] in chosen:
                yield item
            else:
                sensor = by_topic[item[1]]
                yield Skipped(item[0], sensor.source, sensor.source_type, NOT_SELECTED)

    return replace(recording, messages=messages)


def bind(recording: Recording, bindings: Mapping[str, tuple[str, str]]) -> Recording:
    """A recording with streams renamed to the topics of a machine.

    `bindings` maps such a topic, as `lidar/front`, to the name of the stream and the key of the vehicle file that has
    it. Raises LogError for a stream that is missing, of another kind, or bound twice.
    """
    about = recording.description
    renamed: dict[str, str] = {}
    for topic, (name, key) in bindings.items():
        sensor = _find(recording, name, key)
        if _kind(sensor.topic) != _kind(topic):
            raise LogError(f"{key}: {name!r} has messages of kind {_kind(sensor.topic)!r}, not {_kind(topic)!r}")
        if sensor.topic in renamed:
            raise LogError(f"{key}: {name!r} is bound to {renamed[sensor.topic]!r} already")
        renamed[sensor.topic] = topic
    taken = {*renamed.values(), *(s.topic for s in about.sensors)}
    for sensor in about.sensors:
        if sensor.topic in bindings and sensor.topic not in renamed:
            renamed[sensor.topic] = _free(sensor.topic, taken)

    def messages() -> Iterator[Received | Skipped]:
        for item in recording.messages():
            yield item if isinstance(item, Skipped) else (item[0], renamed.get(item[1], item[1]), item[2])

    sensors = tuple(replace(s, topic=renamed.get(s.topic, s.topic)) for s in about.sensors)
    cameras = tuple(replace(c, topic=renamed.get(c.topic, c.topic)) for c in about.cameras)
    return replace(recording, description=replace(about, sensors=sensors, cameras=cameras), messages=messages)


def _find(recording: Recording, name: str, key: str) -> Sensor:
    """The stream with this source or topic."""
    sensors = recording.description.sensors
    for sensor in sensors:
        if name in (sensor.source, sensor.topic) or name.strip("/") == sensor.source.strip("/"):
            return sensor
    known = ", ".join(f"{s.source} ({_kind(s.topic)})" for s in sensors) or "nothing that is read"
    reason = next((f"; {name}: {i.reason}" for i in recording.description.ignored if i.source == name), "")
    raise LogError(f"{recording.path}: {key}: no topic {name!r}; the recording has {known}{reason}")


def _kind(topic: str) -> str:
    return topic.partition("/")[0]


def _free(topic: str, taken: set[str]) -> str:
    number = 2
    while f"{topic}_{number}" in taken:
        number += 1
    taken.add(f"{topic}_{number}")
    return f"{topic}_{number}"

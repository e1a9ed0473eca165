"""Message time-outs by the topic table; reports the most upstream topic that timed out."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

from messages.topics import spec_of

ROUNDING_S = 1e-9
LATE_SHARE = 0.6  # of the maximum age: a message this old is about to time out

UPSTREAM: dict[str, tuple[str, ...]] = {
    "odom": ("imu", "wheel", "machine"),
    "map_pose": ("imu", "wheel", "odom"),
    "tracks": ("lidar", "health", "odom"),
    "health": ("odom",),
    "control_command": ("imu", "wheel", "machine", "odom", "map_pose"),
}


@dataclass(frozen=True)
class TopicAge:
    """Age of the newest message of a topic in seconds; None before the first."""

    topic: str
    age_s: float | None
    max_age_s: float

    @property
    def is_stale(self) -> bool:
        """Whether it is too old, absent, or from the future."""
        return self.age_s is None or abs(self.age_s) > self.max_age_s + ROUNDING_S

    @property
    def is_late(self) -> bool:
        """Whether it is late but possibly not yet stale."""
        return self.age_s is None or abs(self.age_s) > LATE_SHARE * self.max_age_s + ROUNDING_S


def age_of(topic: str, stamp_ns: int | None, now_ns: int) -> TopicAge:
    """Age of a topic whose newest message has this stamp."""
    age_s = None if stamp_ns is None else (now_ns - stamp_ns) * 1e-9
    return TopicAge(topic, age_s, _max_age_s(topic))


@cache
def _max_age_s(topic: str) -> float:
    return spec_of(topic).max_age_s


def timed_out_topics(ages: Iterable[TopicAge]) -> tuple[str, ...]:
    """Topics that timed out, replaced by their root causes, each once."""
    known = {age.topic: age for age in ages}
    causes: list[str] = []
    for topic, age in known.items():
        if age.is_stale:
            cause = root_cause_of(topic, known)
            causes += [cause] if cause not in causes else []
    return tuple(causes)


def root_cause_of(topic: str, known: Mapping[str, TopicAge]) -> str:
    """Most upstream topic that is late too, or the topic itself."""
    kind, _, name = topic.partition("/")
    sensor = (name.replace("_", "/", 1),) if kind == "health" else ()  # health/lidar_front depends on lidar/front
    for above in (*sensor, *UPSTREAM.get(kind, ())):
        late = next((t for t, age in known.items() if above in (t, t.partition("/")[0]) and age.is_late), None)
        if late is not None:
            return root_cause_of(late, known)
    return topic

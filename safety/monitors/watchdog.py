"""What should come and does not, by the topic table alone; the cause is blamed, not what fell silent because of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

from messages.topics import spec_of

ROUNDING_S = 1e-9
LATE_SHARE = 0.6  # of the greatest age: a message this late is on its way to silence

UPSTREAM: dict[str, tuple[str, ...]] = {
    "odom": ("imu", "wheel", "machine"),
    "map_pose": ("imu", "wheel", "odom"),
    "tracks": ("lidar", "health", "odom"),
    "health": ("odom",),
    "control_command": ("imu", "wheel", "machine", "odom", "map_pose"),
}


@dataclass(frozen=True)
class TopicAge:
    """Age of the newest message of a topic in seconds; None when none ever came."""

    topic: str
    age_s: float | None
    max_age_s: float

    @property
    def is_stale(self) -> bool:
        """Too old, never come, or from a future that cannot be."""
        return self.age_s is None or abs(self.age_s) > self.max_age_s + ROUNDING_S

    @property
    def is_late(self) -> bool:
        """Older than it should be, if not yet too old."""
        return self.age_s is None or abs(self.age_s) > LATE_SHARE * self.max_age_s + ROUNDING_S


def age_of(topic: str, stamp_ns: int | None, now_ns: int) -> TopicAge:
    """The age of a topic whose newest message has this stamp."""
    age_s = None if stamp_ns is None else (now_ns - stamp_ns) * 1e-9
    return TopicAge(topic, age_s, _max_age_s(topic))


@cache
def _max_age_s(topic: str) -> float:
    return spec_of(topic).max_age_s


def timed_out_topics(ages: Iterable[TopicAge]) -> tuple[str, ...]:
    """The topics that are silent, causes first and without what only follows from them."""
    known = {age.topic: age for age in ages}
    blamed: list[str] = []
    for topic, age in known.items():
        if age.is_stale:
            cause = root_cause_of(topic, known)
            blamed += [cause] if cause not in blamed else []
    return tuple(blamed)


def root_cause_of(topic: str, known: Mapping[str, TopicAge]) -> str:
    """The farthest upstream topic that is late too, or the topic itself."""
    kind, _, name = topic.partition("/")
    sensor = (name.replace("_", "/", 1),) if kind == "health" else ()  # health/lidar_front tells of lidar/front
    for above in (*sensor, *UPSTREAM.get(kind, ())):
        late = next((t for t, age in known.items() if above in (t, t.partition("/")[0]) and age.is_late), None)
        if late is not None:
            return root_cause_of(late, known)
    return topic

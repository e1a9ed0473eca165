"""Sources of the messages that a page shows: a running machine, or a log that is played."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from calibration.recording import KINDS as RECORDED
from messages.message import Envelope

TOPICS = (
    "supervisor", "safe_command", "control_command", "operator_command", "order_status", "machine", "odom", "map_pose",
    "mission", "path", "tracks", "wheel",
)  # fmt: skip
KINDS = ("health", "gnss", "fault", "can", "node_timing")
EVENTS = ("path", "fault", "operator_command")  # every message of these counts, of the others the newest one
MIN_RATE, MAX_RATE = 1.0, 20.0


def is_shown(topic: str) -> bool:
    """Whether the page reads a topic."""
    return topic in TOPICS or topic.partition("/")[0] in KINDS


def is_event(topic: str) -> bool:
    """Whether every message of a topic counts, not only the newest."""
    return topic.partition("/")[0] in EVENTS


def is_recorded(topic: str) -> bool:
    """Whether a calibration needs the messages of a topic."""
    return topic.partition("/")[0] in RECORDED


@dataclass(frozen=True)
class ViewMessage:
    """Protobuf message of a viewer topic `/view/...`, with name and FileDescriptorSet of its schema.

    Without `data` it says that the topic is there.
    """

    topic: str
    schema_name: str
    schema: bytes
    stamp_ns: int
    data: bytes | None


class Feed(ABC):
    """Messages since the last call, in order; `now_ns` is the present time of the machine or of the log.

    With `is_recording` every message that a calibration needs is among them, of scans the newest; of the topics
    `watched`, scans and images that an open page shows, the newest.
    """

    now_ns: int = 0
    is_recording: bool = False
    watched: frozenset[str] = frozenset()

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()  # messages since the start by topic, also of topics that are not shown

    @abstractmethod
    def poll(self) -> Iterable[Envelope]:
        """New messages of shown topics."""

    def views(self, read: frozenset[str] | None) -> Iterable[ViewMessage]:
        """Viewer messages of the last call of `poll`; `read` are the topics that are needed next, None: no client."""
        return ()

    @property
    def playback(self) -> "Playback | None":
        """Position in a log; None for a machine."""
        return None

    def take_restart(self) -> bool:
        """Whether what was shown before is void, because the position was changed; True once per change."""
        return False


@dataclass
class Playback:
    """Position in a log of `length_s` seconds; `stops_s` are the times at which the machine began to stop."""

    length_s: float
    stops_s: Sequence[float]
    position_s: float = 0.0
    rate: float = 1.0
    is_paused: bool = False
    is_moved: bool = False

    def advance(self, elapsed_s: float) -> None:
        """Moves the position by the wall-clock time that has passed."""
        if not self.is_paused:
            self.position_s = min(self.length_s, self.position_s + max(0.0, elapsed_s) * self.rate)

    def seek(self, position_s: float) -> None:
        """Moves to a position within the log."""
        self.position_s = min(self.length_s, max(0.0, position_s))
        self.is_moved = True

    def seek_next_stop(self, lead_s: float = 2.0) -> bool:
        """Moves to shortly before the next stop after the position; False without one."""
        later = [stop_s for stop_s in self.stops_s if stop_s - lead_s > self.position_s + 0.5]
        if later:
            self.seek(later[0] - lead_s)
        return bool(later)

    def set_rate(self, rate: float) -> None:
        """Times real time, 1 to 20."""
        self.rate = min(MAX_RATE, max(MIN_RATE, rate))

"""Feed of a log that is played: messages of shown topics in memory, undecoded and thinned."""

import pathlib
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from time import monotonic

from datasets.reader import Entry, LogScan, decode, is_ours
from geometry.arrays import Float64
from hmi.feed import Feed, Playback, ViewMessage, is_event, is_shown
from messages.command import Mode, SupervisorState
from messages.errors import LogError
from messages.message import Envelope
from messages.plan import Path
from runtime.page.views import LogViews

THIN_NS = 200_000_000  # between two messages of a topic that are kept, and two times at which watched ones are read
WATCH_NS = 2_500_000_000  # oldest scan or image that is shown: the log of `live` has a scan each 2 s
HISTORY = ("odom", "map_pose", "machine", "supervisor")  # track, worked area and times need all of these
STOPPED = frozenset({Mode.OBSTACLE_STOP, Mode.FAULT_STOP, Mode.EMERGENCY_STOP})


class _Shown:
    """Container of the shown topics, for a scan."""

    def __contains__(self, topic: object) -> bool:
        return is_shown(str(topic))


class LogFeed(Feed):
    """Plays a log from its start; raises LogError for one without messages of the supervisor."""

    def __init__(self, path: pathlib.Path, has_views: bool = False) -> None:
        super().__init__()
        self._views = LogViews(path) if has_views else None
        self._log = shown_log(path)
        self._entries = list(kept_entries(self._log))
        self._times_ns = [entry.receive_ns for entry in self._entries]
        states = [entry for entry in self._entries if entry.topic == "supervisor"]
        if not states:
            raise LogError(f"{path}: has no messages of the supervisor; a log of `headland run` or `live` is needed")
        self._start_ns = self._times_ns[0]
        length_s = (self._times_ns[-1] - self._start_ns) * 1e-9
        self._playback = Playback(length_s, tuple(self._stops(states)))
        self._next, self._polled_s, self._is_restarted = 0, monotonic(), False
        self._read_ns, self._read, self._found = 0, frozenset[str](), dict[str, int]()
        self.now_ns = self._start_ns

    @property
    def playback(self) -> Playback:
        """Position in the log."""
        return self._playback

    def poll(self) -> Iterable[Envelope]:
        """Messages up to the present position; after a change of it all from the start of the log."""
        now_s = monotonic()
        self._playback.advance(now_s - self._polled_s)
        self._polled_s = now_s
        if self._playback.is_moved:
            self._playback.is_moved, self._is_restarted, self._next = False, True, 0
            if self._views is not None:
                self._views.rewind()
        self.now_ns = self._start_ns + round(self._playback.position_s * 1e9)
        first, self._next = self._next, bisect_right(self._times_ns, self.now_ns)
        entries = self._entries[first : self._next]
        newest = {entry.topic: index for index, entry in enumerate(entries)}
        kept = [
            entry for index, entry in enumerate(entries)
            if entry.topic in HISTORY or is_event(entry.topic) or newest[entry.topic] == index
        ]  # fmt: skip
        return (decode(entry) for entry in [*kept, *self._watched_entries()])

    def _watched_entries(self) -> Iterator[Entry]:
        """Those scans and images at the present position that were not there at the last call."""
        if self.watched == self._read and abs(self.now_ns - self._read_ns) < THIN_NS:
            return
        self._read_ns, self._read, before = self.now_ns, self.watched, self._found
        entries = self._log.newest(self.watched, self.now_ns, WATCH_NS) if self.watched else {}
        self._found = {topic: entry.receive_ns for topic, entry in entries.items()}
        for topic, entry in entries.items():
            if before.get(topic) != entry.receive_ns:
                yield entry

    def take_restart(self) -> bool:
        """Whether the position was changed since the last call."""
        is_restarted, self._is_restarted = self._is_restarted, False
        return is_restarted

    def views(self, read: frozenset[str] | None) -> Iterable[ViewMessage]:
        """Viewer messages of the log up to the present position."""
        return () if self._views is None else self._views.messages(self.now_ns)

    def planned_map_m(self) -> tuple[Float64, ...]:
        """Points (N, 2) of all paths of the log in `map`."""
        found = (decode(entry).message for entry in self._entries if entry.topic == "path")
        return tuple(path.p_map_m for path in found if isinstance(path, Path))

    def _stops(self, states: list[Entry]) -> Iterator[float]:
        """Times at which the mode became one of a stop (s after the start)."""
        was_stopped = True
        for entry in states:
            message = decode(entry).message
            is_stopped = isinstance(message, SupervisorState) and message.mode in STOPPED
            if is_stopped and not was_stopped:
                yield (entry.receive_ns - self._start_ns) * 1e-9
            was_stopped = is_stopped


def shown_log(path: pathlib.Path) -> LogScan:
    """Pass over the shown topics of a log."""
    return LogScan(path, _Shown())


def kept_entries(log: Iterable[Entry]) -> Iterator[Entry]:
    """Those entries of shown topics that are played: every event, of the others one in `THIN_NS`, by reception."""
    last_ns: dict[str, int] = {}
    for entry in log:
        if not is_ours(entry):
            continue
        if not is_event(entry.topic) and 0 <= entry.receive_ns - last_ns.get(entry.topic, 0) < THIN_NS:
            continue
        last_ns[entry.topic] = entry.receive_ns
        yield entry

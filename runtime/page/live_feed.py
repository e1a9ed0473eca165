"""Feed of a running drive: the rings of its processes."""

import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from hmi.feed import Feed, ViewMessage, is_event, is_recorded, is_shown
from messages.message import Envelope
from runtime.live.ring import RingReader
from runtime.live.serialization import topic_of, unpack
from runtime.page.views import MachineViews


class LiveFeed(Feed):
    """Newest message of each shown topic, and every event, from the rings by process.

    The time of the machine is the newest stamp and what has passed since it arrived, so that ages grow when nothing
    arrives, and a simulation that is slower than real time is not taken for silent. `logged` is what happened before.
    """

    def __init__(
        self, rings: Mapping[str, Path], logged: Iterable[Envelope] = (), views: MachineViews | None = None
    ) -> None:
        super().__init__()
        self._views = views
        self._logged: Iterable[Envelope] = logged
        self._readers = [RingReader(path) for path in rings.values()]
        self._newest_ns = self._arrived_ns = 0
        self._sequence = 0

    def poll(self) -> Iterable[Envelope]:
        """New messages, decoded only where shown."""
        now_ns = time.monotonic_ns()
        wanted: dict[tuple[str, int], bytes] = {}
        for reader in self._readers:
            for record in reader.records():
                topic = topic_of(record)
                self.counts[topic] += 1
                is_whole = len(record) > 1 + record[0]  # others have the topic alone, to be counted
                is_kept = self.is_recording and is_whole and is_recorded(topic)
                is_viewed = self._views is not None and is_whole and self._views.needs(topic)
                is_watched = is_whole and topic in self.watched
                if is_shown(topic) or is_kept or is_viewed or is_watched:
                    self._sequence += 1
                    is_each = (
                        is_event(topic) or topic.startswith("can/") or (is_kept and not topic.startswith("lidar/"))
                    )
                    key = (topic, self._sequence if is_each else 0)
                    wanted.pop(key, None)
                    wanted[key] = record
        found = [self._envelope(record) for record in wanted.values()]
        envelopes = [*self._logged, *(envelope for envelope in found if envelope is not None)]
        self._logged = ()
        if envelopes:
            self._newest_ns, self._arrived_ns = max(e.message.stamp_ns for e in envelopes), now_ns
        self.now_ns = self._newest_ns + now_ns - self._arrived_ns
        if self._views is not None:
            self._views.take(envelopes)
        return envelopes

    def views(self, read: frozenset[str] | None) -> Iterable[ViewMessage]:
        """Viewer messages of the last messages."""
        if self._views is None:
            return ()
        self._views.read = read
        return self._views.messages(self.counts)

    def _envelope(self, record: bytes) -> Envelope | None:
        output = unpack(record, None)
        return None if output is None else Envelope(output[0], self._sequence, self.now_ns, output[1])

"""Feed of a running drive: the rings of its processes."""

import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from hmi.feed import Feed, is_event, is_shown
from messages.message import Envelope
from runtime.live.ring import RingReader
from runtime.live.serialization import topic_of, unpack


class LiveFeed(Feed):
    """Newest message of each shown topic, and every event, from the rings by process.

    The time of the machine is estimated from the newest stamp and the monotonic clock, so that ages grow when nothing
    arrives.
    """

    def __init__(self, rings: Mapping[str, Path]) -> None:
        self._readers = [RingReader(path) for path in rings.values()]
        self._offset_ns: int | None = None
        self._sequence = 0

    def poll(self) -> Iterable[Envelope]:
        """New messages, decoded only where shown."""
        now_ns = time.monotonic_ns()
        wanted: dict[tuple[str, int], bytes] = {}
        for reader in self._readers:
            for record in reader.records():
                topic = topic_of(record)
                if is_shown(topic):
                    self._sequence += 1
                    key = (topic, self._sequence if is_event(topic) else 0)
                    wanted.pop(key, None)
                    wanted[key] = record
        found = [self._envelope(record) for record in wanted.values()]
        envelopes = [envelope for envelope in found if envelope is not None]
        newest_ns = max((e.message.stamp_ns for e in envelopes), default=None)
        if newest_ns is not None and (self._offset_ns is None or newest_ns - now_ns > self._offset_ns):
            self._offset_ns = newest_ns - now_ns
        self.now_ns = 0 if self._offset_ns is None else now_ns + self._offset_ns
        return envelopes

    def _envelope(self, record: bytes) -> Envelope | None:
        output = unpack(record, None)
        return None if output is None else Envelope(output[0], self._sequence, self.now_ns, output[1])

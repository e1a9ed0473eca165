"""Packets of a rotating lidar in order, and those that are missing, by azimuth."""

from bisect import insort
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from datasets.importers.captures.devices import Lost
from messages.errors import LogError

TURN = 36_000  # azimuth in 0.01°
SECTOR = 9_000
# A longer gap may be a sensor that turns the other way.
MAX_GAP = TURN * 3 // 4
# Packets held until those that were sent before have come
HELD = 3
LATE = f"packet that comes more than {HELD} packets late"


class Packet(NamedTuple):
    """A packet sent at `time_ns` of the sensor's clock."""

    time_ns: int
    payload: bytes
    receive_ns: int


class InOrder:
    """Packets in the order of their times."""

    def __init__(self) -> None:
        self._held: list[Packet] = []
        self._last_ns: int | None = None

    def add(self, packet: Packet) -> Iterator[Packet]:
        """The packets that no earlier one can precede now; raises LogError for one that comes too late."""
        if self._last_ns is not None and packet.time_ns < self._last_ns:
            raise LogError(LATE)
        insort(self._held, packet)
        if len(self._held) > HELD:
            self._last_ns = self._held[0].time_ns
            yield self._held.pop(0)

    def finish(self) -> Iterator[Packet]:
        """The packets held; the next one may have any time."""
        held, self._held, self._last_ns = self._held, [], None
        yield from held


class Continuity:
    """Compares each packet with the one before it. `sequence` numbers of 32 bits count where the sensor sends them."""

    def __init__(self) -> None:
        self._first, self._step, self._sequence = 0, 0.0, 0

    def restart(self) -> None:
        """Forgets the last packet, after a gap that is counted otherwise."""
        self._step = 0.0

    def lost(self, azimuths: Sequence[int], sequence: int | None = None) -> Iterator[Lost]:
        """Packets missing before this one, each with its sector."""
        if self._step > 0.0:
            gap = (azimuths[0] - self._first) % TURN
            count = round(gap / self._step) - 1 if gap <= MAX_GAP else 0
            if sequence is not None:
                count = min(max(0, sequence - self._sequence - 1), round(TURN / self._step))
            for k in range(count):
                begin = round(self._first + (k + 1) * self._step) % TURN // SECTOR * SECTOR // 100
                yield Lost(f"packet missing at azimuth {begin}° to {begin + SECTOR // 100}°")
        distinct = list(dict.fromkeys(azimuths))  # the returns of a firing have one azimuth
        turned = (distinct[-1] - distinct[0]) % TURN
        self._step = turned / (len(distinct) - 1) * len(distinct) if len(distinct) > 1 else 0.0
        self._first, self._sequence = azimuths[0], sequence or 0

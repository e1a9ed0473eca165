"""Faults of a run, applied to messages between writer and readers."""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from messages.errors import ConfigError, LogError
from messages.message import Envelope, Message
from messages.node import Output
from messages.topics import spec_of
from simulation import randomness
from simulation.faults.config import STREAM_FAULTS, SYSTEM_FAULTS, FaultKind, FaultsConfig, InjectedFault
from simulation.faults.measurement import Corruption, with_stamp_of
from simulation.faults.stream import FaultStream

HOUR_NS = 3_600_000_000_000
NOT_TOPICS = ("can/", "node/")
MAX_AGE_NS = 1_000_000_000  # of topics sent on event


class FaultInjection:
    """Changes the messages of faulty devices; `now_ns` is the time of the last message.

    `faulty_items` counts the messages and frames of each faulty device. As a sink it simulates a full disk.
    """

    def __init__(self, faults: Iterable[InjectedFault], config: FaultsConfig, start_ns: int, seed: int) -> None:
        self.now_ns = self._start_ns = start_ns
        self.config, self._seed = config, seed
        self._faults: list[InjectedFault] = []
        self._streams: dict[tuple[str, FaultKind], FaultStream[Message]] = {}
        self._later: list[tuple[int, int, Output]] = []
        self._held = 0
        self._topics: tuple[str, ...] = ()
        self.faulty_items = Counter[str]()
        for fault in faults:
            self.add_fault(fault)

    def add_fault(self, fault: InjectedFault) -> None:
        """Adds a fault; raises ConfigError for an unknown topic kind, or one without configured fields."""
        if fault.topic not in SYSTEM_FAULTS and not fault.topic.startswith(NOT_TOPICS):
            spec_of(fault.topic)
            has_values = fault.kind not in (*STREAM_FAULTS, FaultKind.SWAPPED)
            if has_values and fault.topic.partition("/")[0] not in self.config.messages:
                raise ConfigError(
                    f"fault {fault.kind.value!r} on {fault.topic!r}: faults.yaml describes no field of it"
                )
        self._faults.append(fault)

    def check_topics(self, topics: Iterable[str]) -> None:
        """Raises ConfigError when a fault is on a topic without writer."""
        self._topics = tuple(sorted(topics))
        known = {*self._topics, *SYSTEM_FAULTS}
        for fault in self._faults:
            if fault.topic not in known and not fault.topic.startswith(NOT_TOPICS):
                raise ConfigError(f"fault on {fault.topic!r}: there are {', '.join(sorted(known))}")

    def __call__(self, envelope: Envelope) -> None:
        """Raises LogError while the disk is full."""
        if self._faults and self.active_kinds("log"):
            raise LogError("the disk is full (injected fault)")

    def active_kinds(self, topic: str) -> list[FaultKind]:
        """Active faults of a topic."""
        elapsed_ns = self.now_ns - self._start_ns
        return [fault.kind for fault in self._faults if fault.topic == topic and fault.is_on(elapsed_ns)]

    def clock_error_ns(self, true_ns: int) -> int:
        """Error of the clock, positive when ahead."""
        elapsed_ns = true_ns - self._start_ns
        kinds = [f.kind for f in self._faults if f.topic == "clock" and f.is_on(elapsed_ns)]
        return HOUR_NS * (kinds.count(FaultKind.AHEAD) - kinds.count(FaultKind.BEHIND))

    def generator(self, name: str) -> np.random.Generator:
        """Random generator of one faulty device."""
        return randomness.generator(self._seed, f"fault/{name}")

    def next_ns(self) -> int | None:
        """Time of the next delayed message."""
        return min((due_ns for due_ns, _, _ in self._later), default=None)

    def due(self, now_ns: int) -> list[Output]:
        """Delayed messages that are due by `now_ns`."""
        self.now_ns = now_ns
        come = sorted(held for held in self._later if held[0] <= now_ns)
        self._later = [held for held in self._later if held[0] > now_ns]
        return [output for _, _, output in come]

    def apply(self, now_ns: int, outputs: list[Output]) -> list[Output]:
        """Messages delivered now of those sent now."""
        self.now_ns = now_ns
        if not self._faults:
            return outputs
        come: list[Output] = []
        for written, message in outputs:
            topic = self._swapped(written)
            kinds = [kind for kind in self.active_kinds(topic) if kind is not FaultKind.SWAPPED]
            self.faulty_items[topic] += bool(kinds)
            for due_ns, changed in (
                self._stream(topic, kinds[0]).apply(now_ns, message) if kinds else [(now_ns, message)]
            ):
                if due_ns <= now_ns:
                    come.append((topic, changed))
                else:
                    self._held += 1
                    self._later.append((due_ns, self._held, (topic, changed)))
        return come

    def partner_of(self, topic: str) -> str | None:
        """The sensor of the same kind with which a topic is exchanged: the next one by name; None without another."""
        kind = topic.partition("/")[0]
        same = [one for one in self._topics if one.partition("/")[0] == kind and "/" in one]
        return same[(same.index(topic) + 1) % len(same)] if topic in same and len(same) > 1 else None

    def _swapped(self, topic: str) -> str:
        """Topic as which a message is delivered."""
        for fault in self._faults:
            if fault.kind is FaultKind.SWAPPED and fault.is_on(self.now_ns - self._start_ns):
                pair = (fault.topic, self.partner_of(fault.topic))
                if topic in pair:
                    return pair[1 - pair.index(topic)] or topic
        return topic

    def _stream(self, topic: str, kind: FaultKind) -> FaultStream[Message]:
        if (topic, kind) not in self._streams:
            row, wrong = spec_of(topic), Corruption(kind, self.config.plausible, self.generator(topic))
            errors = self.config.messages.get(topic.partition("/")[0], {})
            max_age_ns = round(row.max_age_s * 1e9) if np.isfinite(row.max_age_s) else MAX_AGE_NS
            self._streams[topic, kind] = FaultStream(
                kind, max_age_ns, self.config.plausible.replay_s, with_stamp_of,
                lambda message, since_s: wrong.message(message, errors, since_s),
            )  # fmt: skip
        return self._streams[topic, kind]

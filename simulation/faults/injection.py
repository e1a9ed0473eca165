"""The faults of a run, and the tap through which every message passes on its way to its readers."""

from collections.abc import Iterable

import numpy as np

from messages.errors import ConfigError, LogError
from messages.message import Envelope, Message
from messages.node import Output
from messages.topics import spec_of
from simulation import randomness
from simulation.faults.config import OF_WHOLE, FaultKind, FaultsConfig, InjectedFault
from simulation.faults.measurement import distorted, renewed
from simulation.faults.stream import STREAM_KINDS, Stream

HOUR_NS = 3_600_000_000_000
OF_DEVICES = ("can/", "node/")
MAX_AGE_NS = 1_000_000_000  # of topics that are sent on event


class Injection:
    """Changes what broken devices send; `now_ns` is the time of the last message that passed.

    As a sink it is the disk that may be full.
    """

    def __init__(self, faults: Iterable[InjectedFault], config: FaultsConfig, start_ns: int, seed: int) -> None:
        self.now_ns = self._start_ns = start_ns
        self.config, self._seed = config, seed
        self._faults: list[InjectedFault] = []
        self._streams: dict[tuple[str, FaultKind], Stream[Message]] = {}
        self._later: list[tuple[int, int, Output]] = []
        self._held = 0
        for fault in faults:
            self.plant(fault)

    def plant(self, fault: InjectedFault) -> None:
        """Add a fault; raises ConfigError for a kind of topic that there is not, or whose fields nobody described."""
        if fault.topic not in OF_WHOLE and not fault.topic.startswith(OF_DEVICES):
            spec_of(fault.topic)
            if fault.topic.partition("/")[0] not in self.config.messages and fault.kind not in STREAM_KINDS:
                raise ConfigError(
                    f"fault {fault.kind.value!r} on {fault.topic!r}: faults.yaml describes no field of it"
                )
        self._faults.append(fault)

    def refuse_unknown(self, topics: Iterable[str]) -> None:
        """Raise ConfigError when a fault is on a topic that nobody writes."""
        known = {*topics, *OF_WHOLE}
        for fault in self._faults:
            if fault.topic not in known and not fault.topic.startswith(OF_DEVICES):
                raise ConfigError(f"fault on {fault.topic!r}: there are {', '.join(sorted(known))}")

    def __call__(self, envelope: Envelope) -> None:
        """Raise LogError while the disk is full."""
        if self._faults and self.kinds("log"):
            raise LogError("the disk is full (planted)")

    def kinds(self, topic: str) -> list[FaultKind]:
        """How a topic is broken now."""
        elapsed_ns = self.now_ns - self._start_ns
        return [fault.kind for fault in self._faults if fault.topic == topic and fault.is_on(elapsed_ns)]

    def clock_error_ns(self, true_ns: int) -> int:
        """By how much the clock is ahead."""
        elapsed_ns = true_ns - self._start_ns
        kinds = [f.kind for f in self._faults if f.topic == "clock" and f.is_on(elapsed_ns)]
        return HOUR_NS * (kinds.count(FaultKind.AHEAD) - kinds.count(FaultKind.BEHIND))

    def generator(self, name: str) -> np.random.Generator:
        """Random numbers of one faulty device."""
        return randomness.generator(self._seed, f"fault/{name}")

    def next_ns(self) -> int | None:
        """When a message that was held back comes next."""
        return min((due_ns for due_ns, _, _ in self._later), default=None)

    def due(self, now_ns: int) -> list[Output]:
        """What was held back until now."""
        self.now_ns = now_ns
        come = sorted(held for held in self._later if held[0] <= now_ns)
        self._later = [held for held in self._later if held[0] > now_ns]
        return [output for _, _, output in come]

    def pass_on(self, now_ns: int, outputs: list[Output]) -> list[Output]:
        """What comes now of what was sent now."""
        self.now_ns = now_ns
        if not self._faults:
            return outputs
        come: list[Output] = []
        for topic, message in outputs:
            kinds = self.kinds(topic)
            for due_ns, changed in (
                self._stream(topic, kinds[0]).pass_on(now_ns, message) if kinds else [(now_ns, message)]
            ):
                if due_ns <= now_ns:
                    come.append((topic, changed))
                else:
                    self._held += 1
                    self._later.append((due_ns, self._held, (topic, changed)))
        return come

    def _stream(self, topic: str, kind: FaultKind) -> Stream[Message]:
        if (topic, kind) not in self._streams:
            row, random = spec_of(topic), self.generator(topic)
            errors = self.config.messages.get(topic.partition("/")[0], {})
            max_age_ns = round(row.max_age_s * 1e9) if np.isfinite(row.max_age_s) else MAX_AGE_NS
            self._streams[topic, kind] = Stream(
                kind, max_age_ns, renewed, lambda k, message: distorted(k, message, errors, random)
            )
        return self._streams[topic, kind]

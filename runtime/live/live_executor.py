"""The executor against the clock: messages of other processes come through rings, and a step takes what it takes."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from messages.faults import Fault
from messages.node import Node, On, Output, World
from runtime.bus import Sink
from runtime.executor import FAULT_TOPIC, Executor, stopping_fault
from runtime.live.clock import Clock
from runtime.live.ring import RingReader, RingWriter
from runtime.live.serialization import pack, unpack

POLL_S = 0.001


class Nothing(World):
    """No world: all that a process hears comes from others."""

    writes = ()

    def next_ns(self) -> int | None:
        """Never."""
        return None

    def step(self, now_ns: int) -> Iterable[Output]:
        """Nothing."""
        return []


@dataclass(frozen=True)
class Line:
    """How a process is joined to the others: its own ring, theirs by name, and how long each of them may be silent."""

    ring: RingWriter
    others: Mapping[str, RingReader]
    silent_s: Mapping[str, float]


class LiveExecutor(Executor):
    """One process of the live stack; `hears_all` for the log, which wants every topic."""

    def __init__(
        self, world: World, nodes: Sequence[Node], sinks: Iterable[Sink], clock: Clock, line: Line,
        hears_all: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(world, [(node, 0) for node in nodes], sinks)
        self._clock, self._line = clock, line
        self._wanted = None if hears_all else frozenset(topic for node in nodes for topic in heard_by(node))
        self._silent: set[str] = set()
        self._started_ns = self.now_ns = clock()
        for seat in self._seats:
            seat.wake(self.now_ns)

    def run(self, is_done: Callable[[], bool]) -> None:
        """Go on until `is_done`; raises LogError at the end when a sink could not write."""
        while not is_done():
            self.now_ns = self._clock()
            self._line.ring.beat(self.now_ns)
            self._listen()
            self._go_on()
            self._watch_others()
            self._step_due()
            self._rest()
        if self._bus.lost:
            raise self._bus.lost[0]

    def _listen(self) -> None:
        """What others have said since."""
        for ring in self._line.others.values():
            for record in ring.records():
                output = unpack(record, self._wanted)
                if output is not None:
                    self._hand_out([output])

    def _go_on(self) -> None:
        """The world up to now, a step at a time."""
        while (world_ns := self.world.next_ns()) is not None and world_ns <= self.now_ns:
            self._deliver(list(self.world.step(world_ns)))
            self._line.ring.beat(self._clock())

    def _step_due(self) -> None:
        for seat in self._seats:
            due_ns = seat.due_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self._step(seat)
                while self._deliveries:
                    self._deliver(self._deliveries.pop(0)[2])
                self.now_ns = self._clock()
        while self._deliveries:
            self._deliver(self._deliveries.pop(0)[2])

    def _deliver(self, outputs: list[Output]) -> None:
        """What this process says, to its own nodes and to the others."""
        for output in outputs:
            self._line.ring.write(pack(output))
        super()._deliver(outputs)

    def _watch_others(self) -> None:
        """A process that shows no life is a fault that stops, whatever it did."""
        for name, limit_s in self._line.silent_s.items():
            silent_s = (self.now_ns - max(self._line.others[name].beat_ns, self._started_ns)) * 1e-9
            if silent_s > limit_s and name not in self._silent:
                self._silent.add(name)
                self._deliver([(FAULT_TOPIC, process_fault(self.now_ns, name, silent_s))])

    def _rest(self) -> None:
        """Sleep until something may be due."""
        due = [due_ns for seat in self._seats if (due_ns := seat.due_ns()) is not None]
        world_ns = self.world.next_ns()
        due += [] if world_ns is None else [world_ns]
        wait_s = min([POLL_S, *((due_ns - self._clock()) * 1e-9 for due_ns in due)])
        if wait_s > 0.0:
            time.sleep(wait_s)


def heard_by(node: Node) -> set[str]:
    """All topics that a node must be told of."""
    triggers = node.runs.topics if isinstance(node.runs, On) else ()
    return {*node.reads, *triggers}


def process_fault(now_ns: int, name: str, silent_s: float) -> Fault:
    """The fault that a silent process becomes."""
    words = (
        f"Process {name} has shown no life for {silent_s:.2f} s",
        f"Prozess {name} gibt seit {silent_s:.2f} s kein Lebenszeichen",
    )
    return stopping_fault(now_ns, "process.silent", name, *words)

"""Real-time executor: exchanges messages with other processes through rings; steps take their actual time."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from messages.faults import Fault
from messages.node import Node, On, Output, World
from messages.timing import NodeTiming
from runtime.bus import Sink
from runtime.executor import FAULT_TOPIC, Executor, stopping_fault
from runtime.live.clock import Clock
from runtime.live.ring import RingReader, RingWriter
from runtime.live.serialization import pack, unpack

POLL_S = 0.001
TIMING_NS = 1_000_000_000


class NoWorld(World):
    """World of a process that receives all its messages from other processes."""

    writes = ()

    def next_ns(self) -> int | None:
        """None."""
        return None

    def step(self, now_ns: int) -> Iterable[Output]:
        """No messages."""
        return []


@dataclass(frozen=True)
class ProcessLinks:
    """Rings that join a process to the others: its own, the others by name, and the timeouts of their heartbeats.

    `settle_s`: timeout of the first heartbeat, and of all within that time after the start: compiled code is read from
    the disk then, and nothing moves before it has been started.
    """

    ring: RingWriter
    others: Mapping[str, RingReader]
    timeout_s: Mapping[str, float]
    settle_s: float


class LiveExecutor(Executor):
    """Executor of one process of the live stack; `reads_all` is for the log, which records every topic.

    It writes the latency of its nodes once a second.
    """

    def __init__(
        self, world: World, nodes: Sequence[Node], sinks: Iterable[Sink], clock: Clock, links: ProcessLinks,
        reads_all: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(world, [(node, 0) for node in nodes], sinks)
        self._clock, self._links = clock, links
        self._topics = None if reads_all else frozenset(topic for node in nodes for topic in topics_read_by(node))
        self._timed_out: set[str] = set()
        self._latencies_ns: dict[str, list[int]] = {node.name: [] for node in nodes}
        self._started_ns = self.now_ns = self._timed_ns = clock()
        for scheduled in self._nodes:
            scheduled.reset(self.now_ns)

    def run(self, is_done: Callable[[], bool]) -> None:
        """Runs until `is_done`; raises LogError at the end if a sink has failed."""
        while not is_done():
            self.now_ns = self._clock()
            self._links.ring.beat(self.now_ns)
            self._receive()
            self._advance_world()
            self._check_heartbeats()
            self._step_due()
            self._write_timing()
            self._sleep()
        if self._bus.sink_errors:
            raise self._bus.sink_errors[0]

    def _receive(self) -> None:
        """Delivers the new messages of other processes."""
        for ring in self._links.others.values():
            for record in ring.records():
                output = unpack(record, self._topics)
                if output is not None:
                    self._distribute([output])
                    self._links.ring.beat(self._clock())

    def _advance_world(self) -> None:
        """Steps the world up to now."""
        while (world_ns := self.world.next_ns()) is not None and world_ns <= self.now_ns:
            self._deliver(list(self.world.step(world_ns)))
            self._links.ring.beat(self._clock())

    def _step_due(self) -> None:
        for scheduled in self._nodes:
            due_ns = scheduled.due_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self._step(scheduled)
                while self._deliveries:
                    self._deliver(self._next_delivery())
                self.now_ns = self._clock()
                self._latencies_ns[scheduled.node.name].append(self.now_ns - due_ns)
        while self._deliveries:
            self._deliver(self._next_delivery())

    def _write_timing(self) -> None:
        if self.now_ns - self._timed_ns < TIMING_NS:
            return
        self._timed_ns = self.now_ns
        for name, found in self._latencies_ns.items():
            if found:
                timing = NodeTiming(self.now_ns, len(found), 1e-9 * sum(found) / len(found), 1e-9 * max(found))
                self._deliver([(f"node_timing/{name}", timing)])
                found.clear()

    def _deliver(self, outputs: list[Output]) -> None:
        """Writes messages to the ring and delivers them to the nodes of this process."""
        for output in outputs:
            self._links.ring.write(pack(output))
        super()._deliver(outputs)

    def _check_heartbeats(self) -> None:
        """Reports a fault with a stop for each process whose heartbeat timed out, and its end."""
        for name, limit_s in self._links.timeout_s.items():
            beat_ns = self._links.others[name].beat_ns
            has_settled = beat_ns >= self._started_ns and self.now_ns - self._started_ns > self._links.settle_s * 1e9
            silent_s = (self.now_ns - max(beat_ns, self._started_ns)) * 1e-9
            is_silent = silent_s > (limit_s if has_settled else self._links.settle_s)
            if is_silent != (name in self._timed_out):
                self._timed_out ^= {name}
                fault = process_fault(self.now_ns, name, silent_s)
                self._deliver([(FAULT_TOPIC, replace(fault, is_active=is_silent))])

    def _sleep(self) -> None:
        """Sleeps until the next step may be due, at most POLL_S."""
        due = [due_ns for scheduled in self._nodes if (due_ns := scheduled.due_ns()) is not None]
        world_ns = self.world.next_ns()
        due += [] if world_ns is None else [world_ns]
        wait_s = min([POLL_S, *((due_ns - self._clock()) * 1e-9 for due_ns in due)])
        if wait_s > 0.0:
            time.sleep(wait_s)


def topics_read_by(node: Node) -> set[str]:
    """Topics that a node reads or is triggered by."""
    triggers = node.runs.topics if isinstance(node.runs, On) else ()
    return {*node.reads, *triggers}


def process_fault(now_ns: int, name: str, silent_s: float) -> Fault:
    """Fault of a process without a heartbeat."""
    words = (
        f"Process {name}: no heartbeat for {silent_s:.2f} s",
        f"进程 {name} 已 {silent_s:.2f} 秒无心跳",
    )
    return stopping_fault(now_ns, "process.silent", name, *words)

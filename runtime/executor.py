"""Executor for all worlds: delivers due messages, then steps due nodes; a node is busy for its latency."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Protocol

from messages.errors import WiringError
from messages.faults import Fault, Response, Severity
from messages.node import Every, Node, On, Output, World
from messages.topics import spec_of
from runtime.bus import Bus, Sink
from runtime.node_process import NodeProcess, Result
from runtime.node_step import StepResult, step_node

FAULT_TOPIC = "fault/executor"
MAX_TIME_JUMP_NS = 1_800_000_000_000  # a longer pause of the world is a clock step: no node steps in between

Delivery = list[Output] | Callable[[], list[Output]]  # outputs, or a call that waits for them


class Tap(Protocol):
    """Filter between writers and readers that may change, drop or delay messages."""

    def next_ns(self) -> int | None:
        """Time of the next delayed message, or None."""

    def due(self, now_ns: int) -> list[Output]:
        """Delayed messages due at `now_ns`."""

    def apply(self, now_ns: int, outputs: list[Output]) -> list[Output]:
        """Messages of `outputs` that are delivered at once."""


@dataclass
class ScheduledNode:
    """Node with its latency and the state of its schedule."""

    node: Node
    latency_ns: int
    free_ns: int = 0
    next_tick_ns: int = 0
    triggered_ns: int | None = None
    has_failed: bool = False
    topics: frozenset[str] = field(init=False)
    period_ns: int | None = field(init=False)  # None: triggered by topics

    def __post_init__(self) -> None:
        runs = self.node.runs
        self.topics = frozenset(runs.topics) if isinstance(runs, On) else frozenset()
        self.period_ns = runs.period_ns if isinstance(runs, Every) else None

    def due_ns(self) -> int | None:
        """Time of the next step as known now, or None."""
        if self.has_failed:
            return None
        requested_ns = self.triggered_ns if self.period_ns is None else self.next_tick_ns
        if requested_ns is None:
            return None
        return requested_ns if requested_ns > self.free_ns else self.free_ns

    def begin_step(self, now_ns: int) -> None:
        """Marks the node busy for its latency and clears the trigger."""
        self.free_ns = now_ns + self.latency_ns
        self.triggered_ns = None
        if self.period_ns is not None:
            self.next_tick_ns += ((now_ns - self.next_tick_ns) // self.period_ns + 1) * self.period_ns

    def reset(self, now_ns: int) -> None:
        """Restarts the schedule at a time, after a backward step of the clock."""
        self.free_ns = self.next_tick_ns = now_ns


class Executor:
    """Runs nodes in one world; `sinks` receive every message in the order of delivery.

    A node or sink that raises is not called again; either is a fault with a controlled stop. `process` steps some of
    the nodes; with a tap there is none.
    """

    def __init__(
        self,
        world: World,
        nodes: Sequence[tuple[Node, int]],
        sinks: Iterable[Sink],
        tap: Tap | None = None,
        process: NodeProcess | None = None,
    ) -> None:
        self.world = world
        self._tap = tap
        start_ns = world.next_ns() or 0
        self.now_ns = start_ns
        self._nodes = [ScheduledNode(node, latency_ns, next_tick_ns=start_ns) for node, latency_ns in nodes]
        self._triggered_by: dict[str, list[ScheduledNode]] = {}
        for scheduled in self._nodes:
            for topic in scheduled.topics:
                self._triggered_by.setdefault(topic, []).append(scheduled)
        self._process = process
        elsewhere = () if process is None else process.names
        self._bus = Bus([node for node, _ in nodes if node.name not in elsewhere], sinks)
        if process is not None:
            self._bus.add_reader(process.topics, process)
        self._deliveries: list[tuple[int, int, Delivery]] = []
        self._delivery_count = 0

    def run(self, is_done: Callable[[], bool]) -> None:
        """Runs until `is_done` or the end of the world; raises LogError at the end if a sink has failed."""
        while not is_done() and (now_ns := self._next_ns()) is not None:
            self._advance(now_ns)
        if self._bus.sink_errors:
            raise self._bus.sink_errors[0]

    def add_sink(self, sink: Sink) -> None:
        """Adds a sink for all messages from now on."""
        self._bus.sinks.append(sink)

    def _next_ns(self) -> int | None:
        world_ns = self.world.next_ns()
        if world_ns is None:
            return None
        if world_ns - self.now_ns > MAX_TIME_JUMP_NS:
            return world_ns
        times = [world_ns] + [due for scheduled in self._nodes if (due := scheduled.due_ns()) is not None]
        held_ns = None if self._tap is None else self._tap.next_ns()
        times += [] if held_ns is None else [held_ns]
        return min([*times, self._deliveries[0][0]]) if self._deliveries else min(times)

    def _advance(self, now_ns: int) -> None:
        if now_ns < self.now_ns:
            self._step_back(now_ns)
        self.now_ns = now_ns
        if self._tap is not None:
            self._distribute(self._tap.due(now_ns))
        if self.world.next_ns() == now_ns:
            self._deliver(list(self.world.step(now_ns)))
        while self._deliveries and self._deliveries[0][0] <= now_ns:
            self._deliver(self._next_delivery())
        due = [one for one in self._nodes if (due_ns := one.due_ns()) is not None and due_ns <= now_ns]
        pending = self._order([one.node.name for one in due])
        for scheduled in due:
            self._step(scheduled, pending.get(scheduled.node.name))

    def _order(self, names: list[str]) -> Mapping[str, Result]:
        """Orders the steps of those of these nodes that are in the other process."""
        if self._process is None:
            return {}
        ordered = [name for name in names if name in self._process.names]
        return self._process.order(self.now_ns, ordered) if ordered else {}

    def _step_back(self, now_ns: int) -> None:
        """Handles a backward clock step: schedules restart now, pending deliveries become due now."""
        for scheduled in self._nodes:
            scheduled.reset(now_ns)
        self._deliveries = [(now_ns, number, outputs) for _, number, outputs in sorted(self._deliveries)]

    def _deliver(self, outputs: list[Output]) -> None:
        self._distribute(outputs if self._tap is None else self._tap.apply(self.now_ns, outputs))

    def _distribute(self, outputs: list[Output]) -> None:
        failed = len(self._bus.sink_errors)
        topics = self._bus.deliver(self.now_ns, outputs)
        if len(self._bus.sink_errors) > failed:
            self._schedule(self.now_ns, [(FAULT_TOPIC, log_fault(self.now_ns, str(self._bus.sink_errors[-1])))])
        for topic in topics:
            for scheduled in self._triggered_by.get(topic, ()):
                if scheduled.triggered_ns is None:
                    scheduled.triggered_ns = self.now_ns

    def _step(self, scheduled: ScheduledNode, pending: Result | None = None) -> None:
        """Steps a node, or takes the `pending` result of its step when that is due."""
        now_ns, name = self.now_ns, scheduled.node.name
        scheduled.begin_step(now_ns)
        due_ns = now_ns + scheduled.latency_ns
        if pending is not None:
            self._schedule(due_ns, lambda: _outputs(scheduled, now_ns, pending()))
        elif outputs := _outputs(scheduled, now_ns, step_node(scheduled.node, now_ns, self._bus.inboxes[name])):
            self._schedule(due_ns, outputs)

    def _schedule(self, due_ns: int, delivery: Delivery) -> None:
        self._delivery_count += 1
        heappush(self._deliveries, (due_ns, self._delivery_count, delivery))

    def _next_delivery(self) -> list[Output]:
        delivery = heappop(self._deliveries)[2]
        return delivery() if callable(delivery) else delivery


def _outputs(scheduled: ScheduledNode, now_ns: int, result: StepResult) -> list[Output]:
    """Outputs of a step at `now_ns`: a fault if it failed, after which the node is not stepped again."""
    if not isinstance(result, str):
        return result
    scheduled.has_failed = True
    return [(FAULT_TOPIC, node_fault(now_ns, scheduled.node.name, result))]


def node_fault(now_ns: int, name: str, text: str) -> Fault:
    """Fault of a node that raised an exception; `text` is the traceback."""
    words = f"Program part {name} failed: {text}", f"程序模块 {name} 故障：{text}"
    return stopping_fault(now_ns, "node.exception", name, *words)


def log_fault(now_ns: int, text: str) -> Fault:
    """Fault of a log that cannot be written; the machine does not drive without a log."""
    return stopping_fault(now_ns, "log.failed", "log", f"Log cannot be written: {text}", f"日志无法写入：{text}")


def stopping_fault(now_ns: int, code: str, source: str, text_en: str, text_zh: str) -> Fault:
    """Latched fault of the runtime with a controlled stop, to be reset by a person."""
    return Fault(
        stamp_ns=now_ns,
        code=code,
        source=source,
        severity=Severity.ALARM,
        is_latched=True,
        response=Response.CONTROLLED_STOP,
        is_active=True,
        text_en=text_en,
        text_zh=text_zh,
    )


def check_wiring(world: World, nodes: Sequence[tuple[Node, int]], cores: int) -> None:
    """Checks the wiring: one writer per topic, a writer for each read, latencies above zero, load within the cores.

    Raises WiringError that names topic and nodes.
    """
    writers: dict[str, str] = dict.fromkeys(world.writes, "world") | {FAULT_TOPIC: "executor"}
    for node, latency_ns in nodes:
        if latency_ns <= 0:
            raise WiringError(f"node {node.name!r}: latency {latency_ns} ns must be above zero")
        for topic in node.writes:
            spec_of(topic)
            if topic in writers:
                raise WiringError(f"topic {topic!r} has two writers: {writers[topic]} and {node.name}")
            writers[topic] = node.name
    for node, _ in nodes:
        triggers = node.runs.topics if isinstance(node.runs, On) else ()
        if missing := [topic for topic in (*node.reads, *triggers) if topic not in writers]:
            raise WiringError(f"node {node.name!r} reads {', '.join(missing)}, which has no writer")
    load = sum(_rate_hz(node) * latency_ns * 1e-9 for node, latency_ns in nodes)
    if load > cores:
        raise WiringError(f"the nodes need {load:.2f} cores by rate × latency, but {cores} are given")


def _rate_hz(node: Node) -> float:
    if isinstance(node.runs, Every):
        return 1e9 / node.runs.period_ns
    periods = [spec_of(topic).period_s for topic in node.runs.topics]
    return sum(1.0 / period for period in periods if period > 0.0)

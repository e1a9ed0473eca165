"""One loop for all worlds: deliver what is due, then step whoever is due; a node is busy for its latency."""

import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Protocol

from messages.errors import WiringError
from messages.faults import Fault, Response, Severity
from messages.node import Every, Node, On, Output, World
from messages.topics import spec_of
from runtime.bus import Bus, Sink

FAULT_TOPIC = "fault/executor"
LEAP_NS = 1_800_000_000_000  # no world is silent for half an hour: its clock was set, and nobody steps in between


class Tap(Protocol):
    """What every message passes on its way to its readers; it may change, drop or hold back."""

    def next_ns(self) -> int | None:
        """When something that was held back comes next."""

    def due(self, now_ns: int) -> list[Output]:
        """What was held back until now."""

    def apply(self, now_ns: int, outputs: list[Output]) -> list[Output]:
        """What comes now of what was sent now."""


@dataclass
class _Seat:
    """A node with its latency and what it waits for."""

    node: Node
    latency_ns: int
    free_ns: int = 0
    next_tick_ns: int = 0
    triggered_ns: int | None = None
    is_dead: bool = False
    topics: frozenset[str] = field(default_factory=frozenset)
    period_ns: int | None = None  # None: it waits for topics

    def due_ns(self) -> int | None:
        """When the node steps next, as far as known now."""
        if self.is_dead:
            return None
        asked_ns = self.triggered_ns if self.period_ns is None else self.next_tick_ns
        if asked_ns is None:
            return None
        return asked_ns if asked_ns > self.free_ns else self.free_ns

    def take(self, now_ns: int) -> None:
        """Note that the node steps now."""
        self.free_ns = now_ns + self.latency_ns
        self.triggered_ns = None
        if self.period_ns is not None:
            self.next_tick_ns += ((now_ns - self.next_tick_ns) // self.period_ns + 1) * self.period_ns

    def wake(self, now_ns: int) -> None:
        """Begin anew at a time that lies before what the clock has shown."""
        self.free_ns = self.next_tick_ns = now_ns


class Executor:
    """Runs nodes in one world; `sinks` see every message in the order of delivery.

    A node that raises is not asked again, nor is a sink that cannot write (`lost`): either is a fault that stops.
    """

    def __init__(
        self, world: World, nodes: Sequence[tuple[Node, int]], sinks: Iterable[Sink], tap: Tap | None = None
    ) -> None:
        self.world = world
        self._tap = tap
        start_ns = world.next_ns() or 0
        self.now_ns = start_ns
        self._seats = [_Seat(node, latency_ns, next_tick_ns=start_ns) for node, latency_ns in nodes]
        for seat in self._seats:
            seat.topics = frozenset(seat.node.runs.topics) if isinstance(seat.node.runs, On) else frozenset()
            seat.period_ns = seat.node.runs.period_ns if isinstance(seat.node.runs, Every) else None
        self._bus = Bus([node for node, _ in nodes], sinks)
        self._deliveries: list[tuple[int, int, list[Output]]] = []
        self._scheduled = 0

    def run(self, is_done: Callable[[], bool]) -> None:
        """Go on until `is_done` or the world ends; raises LogError at the end when a sink could not write."""
        while not is_done() and (now_ns := self._next_ns()) is not None:
            self._advance(now_ns)
        if self._bus.lost:
            raise self._bus.lost[0]

    def watch(self, sink: Sink) -> None:
        """Show every message to one sink more, from now on."""
        self._bus.sinks.append(sink)

    def _next_ns(self) -> int | None:
        world_ns = self.world.next_ns()
        if world_ns is None:
            return None
        if world_ns - self.now_ns > LEAP_NS:
            return world_ns
        times = [world_ns] + [due for seat in self._seats if (due := seat.due_ns()) is not None]
        held_ns = None if self._tap is None else self._tap.next_ns()
        times += [] if held_ns is None else [held_ns]
        return min([*times, self._deliveries[0][0]]) if self._deliveries else min(times)

    def _advance(self, now_ns: int) -> None:
        if now_ns < self.now_ns:
            self._step_back(now_ns)
        self.now_ns = now_ns
        if self._tap is not None:
            self._hand_out(self._tap.due(now_ns))
        if self.world.next_ns() == now_ns:
            self._deliver(list(self.world.step(now_ns)))
        while self._deliveries and self._deliveries[0][0] <= now_ns:
            self._deliver(heappop(self._deliveries)[2])
        for seat in self._seats:
            due_ns = seat.due_ns()
            if due_ns is not None and due_ns <= now_ns:
                self._step(seat)

    def _step_back(self, now_ns: int) -> None:
        """The clock went back: nobody waits for the time it has shown, and what was to come then comes now."""
        for seat in self._seats:
            seat.wake(now_ns)
        self._deliveries = [(now_ns, number, outputs) for _, number, outputs in sorted(self._deliveries)]

    def _deliver(self, outputs: list[Output]) -> None:
        self._hand_out(outputs if self._tap is None else self._tap.apply(self.now_ns, outputs))

    def _hand_out(self, outputs: list[Output]) -> None:
        lost = len(self._bus.lost)
        topics = self._bus.deliver(self.now_ns, outputs)
        if len(self._bus.lost) > lost:
            self._schedule(self.now_ns, [(FAULT_TOPIC, log_fault(self.now_ns, str(self._bus.lost[-1])))])
        for seat in self._seats:
            if seat.triggered_ns is None and not seat.topics.isdisjoint(topics):
                seat.triggered_ns = self.now_ns

    def _step(self, seat: _Seat) -> None:
        inbox = self._bus.inboxes[seat.node.name]
        inbox.now_ns = self.now_ns
        seat.take(self.now_ns)
        try:
            outputs = list(seat.node.step(self.now_ns, inbox))
            self._check(seat.node, outputs)
        except Exception:  # any failure of a node ends in a stop, not in a crash
            seat.is_dead = True
            outputs = [(FAULT_TOPIC, node_fault(self.now_ns, seat.node.name, traceback.format_exc()))]
        inbox.clear()
        if outputs:
            self._schedule(self.now_ns + seat.latency_ns, outputs)

    def _schedule(self, due_ns: int, outputs: list[Output]) -> None:
        self._scheduled += 1
        heappush(self._deliveries, (due_ns, self._scheduled, outputs))

    @staticmethod
    def _check(node: Node, outputs: list[Output]) -> None:
        for topic, _ in outputs:
            if topic not in node.writes:
                raise WiringError(f"node {node.name!r} writes {topic!r}, which it does not declare")


def node_fault(now_ns: int, name: str, text: str) -> Fault:
    """The fault that a node's exception becomes."""
    words = f"Program part {name} failed: {text}", f"Programmteil {name} ausgefallen: {text}"
    return stopping_fault(now_ns, "node.exception", name, *words)


def log_fault(now_ns: int, text: str) -> Fault:
    """The fault that a log which cannot be written becomes: nobody drives unrecorded."""
    return stopping_fault(now_ns, "log.failed", "log", f"The log fails: {text}", f"Das Protokoll ist gestört: {text}")


def stopping_fault(now_ns: int, code: str, source: str, text_en: str, text_zh: str) -> Fault:
    """A fault of the runtime's own: nothing but a stop is safe, and a person must see it."""
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
    """Refuse what cannot work: two writers, a read without a writer, no latency, more load than cores.

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
            raise WiringError(f"node {node.name!r} reads {', '.join(missing)}, which nobody writes")
    load = sum(_rate_hz(node) * latency_ns * 1e-9 for node, latency_ns in nodes)
    if load > cores:
        raise WiringError(f"the nodes need {load:.2f} cores by rate × latency, but {cores} are given")


def _rate_hz(node: Node) -> float:
    if isinstance(node.runs, Every):
        return 1e9 / node.runs.period_ns
    periods = [spec_of(topic).period_s for topic in node.runs.topics]
    return sum(1.0 / period for period in periods if period > 0.0)

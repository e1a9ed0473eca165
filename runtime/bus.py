"""Message bus: topics, sequence numbers and the inbox of each node."""

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

from messages.errors import LogError, WiringError
from messages.message import Envelope, Message
from messages.node import All, At, Node, Output
from messages.topics import spec_of

M = TypeVar("M", bound=Message)
Sink = Callable[[Envelope], None]


class _Interpolable(Protocol):
    stamp_ns: int

    def interpolate(self, other: "_Interpolable", stamp_ns: int) -> Message: ...


class Reader(Protocol):
    """Takes delivered messages."""

    def put(self, envelope: Envelope) -> None:
        """Takes a delivered message."""


class NodeInbox:
    """Inbox of one node; reading an undeclared topic raises WiringError."""

    def __init__(self, node: Node) -> None:
        self.now_ns = 0
        self._node = node.name
        self._last: dict[str, Message | None] = dict.fromkeys(node.reads)
        self._queues = {topic: deque[Message](maxlen=r.most) for topic, r in node.reads.items() if isinstance(r, All)}
        self._histories = {topic: deque[Message]() for topic, r in node.reads.items() if isinstance(r, At)}
        self._keep_ns = {topic: round(r.keep_s * 1e9) for topic, r in node.reads.items() if isinstance(r, At)}
        ages = {topic: spec_of(topic).max_age_s for topic in node.reads}
        self._max_age_ns = {topic: math.inf if math.isinf(age) else round(age * 1e9) for topic, age in ages.items()}

    def put(self, envelope: Envelope) -> None:
        """Stores a delivered message."""
        topic, message = envelope.topic, envelope.message
        self._last[topic] = message
        if topic in self._queues:
            self._queues[topic].append(message)
        if topic in self._histories:
            history = self._histories[topic]
            if history and message.stamp_ns <= history[-1].stamp_ns:
                history.clear()  # backward clock step: earlier messages have no order against the new ones
            history.append(message)
            while history[-1].stamp_ns - history[0].stamp_ns > self._keep_ns[topic]:
                history.popleft()

    def clear(self) -> None:
        """Empties the queues of `all`."""
        for queue in self._queues.values():
            queue.clear()

    def last(self, topic: str, kind: type[M]) -> M | None:
        """Newest message of any age, or None."""
        if topic not in self._last:
            raise WiringError(f"node {self._node!r} reads {topic!r}, which it does not declare")
        message = self._last[topic]
        if message is not None and not isinstance(message, kind):
            raise WiringError(f"node {self._node!r}: {topic!r} carries {type(message).__name__}, not {kind.__name__}")
        return message

    def latest(self, topic: str, kind: type[M]) -> M | None:
        """Newest message, or None if there is none or it exceeds the maximum age of its topic."""
        message = self.last(topic, kind)
        if message is None or abs(self.now_ns - message.stamp_ns) > self._max_age_ns[topic]:
            return None
        return message

    def all(self, topic: str, kind: type[M]) -> tuple[M, ...]:
        """Messages since the last step, oldest first."""
        return tuple(m for m in self._queues[topic] if isinstance(m, kind))

    def at(self, topic: str, kind: type[M], stamp_ns: int) -> M | None:
        """Message interpolated to a time, or None outside the stored history."""
        after: _Interpolable | None = None
        for message in reversed(self._histories[topic]):
            if message.stamp_ns == stamp_ns:
                return message if isinstance(message, kind) else None
            if message.stamp_ns < stamp_ns:
                found = message.interpolate(after, stamp_ns) if after is not None else None  # type: ignore[attr-defined]
                return found if isinstance(found, kind) else None
            after = message  # type: ignore[assignment]
        return None


class Bus:
    """Delivers messages to inboxes and sinks in one order, numbering each topic from 0.

    A sink that raises LogError is removed; `sink_errors` holds the errors.
    """

    def __init__(self, nodes: Iterable[Node], sinks: Iterable[Sink]) -> None:
        self.inboxes = {node.name: NodeInbox(node) for node in nodes}
        self.sinks = list(sinks)
        self.sink_errors: list[LogError] = []
        self._sequence: dict[str, int] = {}
        self._readers: dict[str, list[Reader]] = {}
        for node in nodes:
            for topic in node.reads:
                self._readers.setdefault(topic, []).append(self.inboxes[node.name])

    def add_reader(self, topics: Iterable[str], reader: Reader) -> None:
        """Adds a reader of these topics beside the inboxes."""
        for topic in topics:
            self._readers.setdefault(topic, []).append(reader)

    def deliver(self, now_ns: int, outputs: Iterable[Output]) -> list[str]:
        """Delivers messages; returns their topics."""
        topics = []
        for topic, message in outputs:
            sequence = self._sequence.get(topic, 0)
            self._sequence[topic] = sequence + 1
            envelope = Envelope(topic, sequence, now_ns, message)
            for inbox in self._readers.get(topic, ()):
                inbox.put(envelope)
            self._pass_to_sinks(envelope)
            topics.append(topic)
        return topics

    def _pass_to_sinks(self, envelope: Envelope) -> None:
        for sink in self.sinks:
            try:
                sink(envelope)
            except LogError as error:
                self.sinks = [other for other in self.sinks if other is not sink]
                self.sink_errors.append(error)

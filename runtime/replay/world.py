"""World of a replay: a stream of recorded messages."""

from collections.abc import Iterable, Iterator

from datasets.importers.recording import Received
from messages.node import Output, World


class ReplayWorld(World):
    """World that delivers a stream of messages at their receive times."""

    def __init__(self, stream: Iterable[Received], writes: Iterable[str]) -> None:
        self.writes = tuple(writes)
        self._stream = iter(stream)
        self._next = next(self._stream, None)

    def next_ns(self) -> int | None:
        """Receive time of the next message, or None at the end."""
        return None if self._next is None else self._next[0]

    def step(self, now_ns: int) -> list[Output]:
        """Messages received by `now_ns`."""
        out: list[Output] = []
        while self._next is not None and self._next[0] <= now_ns:
            out.append((self._next[1], self._next[2]))
            self._next = next(self._stream, None)
        return out


def in_order(stream: Iterator[Received]) -> Iterator[Received]:
    """Stream with non-decreasing receive times."""
    last_ns: int | None = None
    for receive_ns, topic, message in stream:
        last_ns = receive_ns if last_ns is None else max(last_ns, receive_ns)
        yield last_ns, topic, message

"""Nodes that fail and a clock that steps."""

from collections.abc import Iterable
from dataclasses import replace

from messages.node import Inbox, Node, Output, World
from simulation.faults.config import FaultKind
from simulation.faults.injection import FaultInjection


class FaultyNode(Node):
    """A node that raises or hangs once that fault holds, and from then on for ever."""

    def __init__(self, node: Node, injection: FaultInjection) -> None:
        self.name, self.reads, self.writes, self.runs = node.name, node.reads, node.writes, node.runs
        self._node, self._injection = node, injection
        self._is_hanging = False

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The node's own step while it is whole."""
        active_kinds = self._injection.active_kinds(f"node/{self.name}")
        if FaultKind.RAISES in active_kinds:
            raise RuntimeError("planted")
        self._is_hanging = self._is_hanging or FaultKind.HANGS in active_kinds
        return [] if self._is_hanging else self._node.step(now_ns, inbox)


class SteppingClock(World):
    """A world whose clock, and with it every stamp, is ahead or behind while that fault holds."""

    def __init__(self, world: World, injection: FaultInjection) -> None:
        self.writes = world.writes
        self._world, self._injection = world, injection

    def next_ns(self) -> int | None:
        """When something happens next, by the wrong clock."""
        true_ns = self._world.next_ns()
        return None if true_ns is None else true_ns + self._injection.clock_error_ns(true_ns)

    def step(self, now_ns: int) -> Iterable[Output]:
        """Go on by the right clock, and tell the time by the wrong one."""
        true_ns = self._world.next_ns()
        assert true_ns is not None, "asked to go on beyond the end"
        error_ns, outputs = self._injection.clock_error_ns(true_ns), self._world.step(true_ns)
        if error_ns == 0:
            return outputs
        return [(topic, replace(m, stamp_ns=m.stamp_ns + error_ns)) for topic, m in outputs]

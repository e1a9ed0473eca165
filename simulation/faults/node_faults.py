"""Failing nodes and a stepping clock."""

from collections.abc import Iterable
from dataclasses import replace

from messages.node import Inbox, Node, Output, World
from simulation.faults.config import FaultKind
from simulation.faults.injection import FaultInjection


class FaultyNode(Node):
    """A node that raises while the fault is active, or hangs permanently once it was."""

    def __init__(self, node: Node, injection: FaultInjection) -> None:
        self.name, self.reads, self.writes, self.runs = node.name, node.reads, node.writes, node.runs
        self._node, self._injection = node, injection
        self._is_hanging = False

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The node's own step without fault."""
        active_kinds = self._injection.active_kinds(f"node/{self.name}")
        if FaultKind.RAISES in active_kinds:
            raise RuntimeError("injected fault")
        self._is_hanging = self._is_hanging or FaultKind.HANGS in active_kinds
        return [] if self._is_hanging else self._node.step(now_ns, inbox)


class SteppingClock(World):
    """A world whose clock, and with it every stamp, is ahead or behind while the fault is active."""

    def __init__(self, world: World, injection: FaultInjection) -> None:
        self.writes = world.writes
        self._world, self._injection = world, injection

    def next_ns(self) -> int | None:
        """Time of the next event by the faulty clock."""
        true_ns = self._world.next_ns()
        return None if true_ns is None else true_ns + self._injection.clock_error_ns(true_ns)

    def step(self, now_ns: int) -> Iterable[Output]:
        """Advances by the true clock; stamps by the faulty one."""
        true_ns = self._world.next_ns()
        assert true_ns is not None, "step after the end of the world"
        error_ns, outputs = self._injection.clock_error_ns(true_ns), self._world.step(true_ns)
        if error_ns == 0:
            return outputs
        return [(topic, replace(m, stamp_ns=m.stamp_ns + error_ns)) for topic, m in outputs]

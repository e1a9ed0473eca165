"""Process that steps some nodes of an executor while it goes on; their outputs are the same as in its own process."""

import fcntl
import multiprocessing
import os
import pickle
import signal
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection

from messages.errors import HeadlandError
from messages.message import Envelope
from messages.node import Node, Output
from runtime.bus import Bus
from runtime.node_step import StepResult, step_node
from runtime.processes import begin_worker

PIPE_BYTES = 1 << 20  # several scans, so that an order does not wait for the step before; the most of Linux

Item = Envelope | tuple[int, str]


class NodeProcess:
    """Forked process with the state and the inboxes of its nodes; ends with `close`, and with its parent.

    Orders and results go in order. Fork it before a thread runs that the nodes need.
    """

    def __init__(self, nodes: Sequence[Node]) -> None:
        self.names = tuple(node.name for node in nodes)
        self.topics = frozenset(topic for node in nodes for topic in node.reads)
        context = multiprocessing.get_context("fork")
        orders, self._orders = context.Pipe(duplex=False)
        self._results, results = context.Pipe(duplex=False)
        fcntl.fcntl(self._orders.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._process = context.Process(target=_serve, args=(nodes, orders, results, os.getpid()), name=self.names[0])
        self._process.start()
        orders.close()
        results.close()
        self._items: list[Item] = []
        self._ordered = self._received = 0
        self._waiting: dict[int, StepResult] = {}

    def put(self, envelope: Envelope) -> None:
        """Takes a delivered message for the inboxes; it is sent with the next order."""
        self._items.append(envelope)

    def order(self, now_ns: int, names: Sequence[str]) -> None:
        """Orders steps of these nodes; raises HeadlandError if the process has ended."""
        self._items += [(now_ns, name) for name in names]
        try:
            self._orders.send_bytes(pickle.dumps(self._items, protocol=5))
        except OSError as error:
            raise self._lost() from error
        self._items = []

    def next_number(self) -> int:
        self._ordered += 1
        return self._ordered

    def result(self, number: int) -> StepResult:
        """Waits for the result of a step; raises HeadlandError if the process has ended."""
        try:
            while self._received < number:
                self._received += 1
                self._waiting[self._received] = pickle.loads(self._results.recv_bytes())
        except (EOFError, OSError) as error:
            raise self._lost() from error
        return self._waiting.pop(number)

    def close(self) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.join()
        self._orders.close()
        self._results.close()

    def _lost(self) -> HeadlandError:
        self._process.join(1.0)
        return HeadlandError(f"the process of the nodes {', '.join(self.names)} has ended (exit code {self._process.exitcode})")


def _serve(nodes: Sequence[Node], orders: Connection, results: Connection, parent: int) -> None:
    begin_worker(parent)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    bus, by_name = Bus(nodes, ()), {node.name: node for node in nodes}
    sender = ThreadPoolExecutor(1, "results")  # so that orders are read while the parent does not read results
    while True:
        try:
            items = pickle.loads(orders.recv_bytes())
        except EOFError:
            return
        for item in items:
            if isinstance(item, Envelope):
                bus.deliver(item.receive_ns, [(item.topic, item.message)])
            else:
                now_ns, name = item
                result = step_node(by_name[name], now_ns, bus.inboxes[name])
                sender.submit(results.send_bytes, pickle.dumps(result, protocol=5))

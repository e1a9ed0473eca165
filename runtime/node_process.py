"""Process that steps some nodes of an executor while the executor goes on, on another core.

    executor ──messages that they read, step orders──► nodes and their inboxes
             ◄──────outputs, or a traceback──────────

A node is busy for its latency: the executor waits for the outputs when that is over, and they are the same to the bit.
"""

import fcntl
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import NoReturn

from messages.errors import HeadlandError
from messages.message import Envelope
from messages.node import Node
from runtime.bus import Bus
from runtime.node_step import StepResult, step_node
from runtime.processes import begin_worker

PIPE_BYTES = 1 << 20  # several scans, so that the executor does not wait until they are read; Linux allows no more
PREFIXES = ("lidar", "radar", "tracker", "localizer")  # nodes whose step takes longer than to send its input
PICKLE = 5  # protocol that keeps arrays read-only

Result = Callable[[], StepResult]


class NodeProcess:
    """Forked process with the state and the inboxes of its nodes; ends with `close`, and with its parent.

    Messages arrive in the order of delivery, and steps are made in the order of the orders.
    """

    def __init__(self, nodes: Sequence[Node]) -> None:
        self.names = tuple(node.name for node in nodes)
        self.topics = frozenset(topic for node in nodes for topic in node.reads)
        context = multiprocessing.get_context("fork")  # the nodes are made already
        orders, self._orders = context.Pipe(duplex=False)
        self._results, results = context.Pipe(duplex=False)
        with suppress(OSError):  # the user has many pipes: this one stays small
            fcntl.fcntl(self._orders.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._process = context.Process(target=_serve, args=(nodes, orders, results, os.getpid()), name="nodes")
        self._process.start()
        orders.close()
        results.close()
        self._delivered: list[Envelope] = []
        self._ordered = self._received = 0
        self._results_by_number: dict[int, StepResult] = {}

    def put(self, envelope: Envelope) -> None:
        """Takes a delivered message, which is sent with the next order."""
        self._delivered.append(envelope)

    def order(self, now_ns: int, names: Sequence[str]) -> dict[str, Result]:
        """Orders steps of these nodes now; each result is waited for when it is called.

        Order and result raise HeadlandError if the process has ended.
        """
        try:
            self._orders.send_bytes(pickle.dumps((self._delivered, now_ns, names), PICKLE))
        except OSError as error:
            raise self._lost() from error
        self._delivered = []
        first, self._ordered = self._ordered, self._ordered + len(names)
        return {name: partial(self._result, number) for number, name in enumerate(names, first)}

    def close(self) -> None:
        """Ends the process at once; it writes no file."""
        self._process.kill()
        self._process.join()
        self._orders.close()
        self._results.close()

    def _result(self, number: int) -> StepResult:
        try:
            while self._received <= number:
                self._results_by_number[self._received] = pickle.loads(self._results.recv_bytes())
                self._received += 1
        except (EOFError, OSError) as error:
            raise self._lost() from error
        return self._results_by_number.pop(number)

    def _lost(self) -> HeadlandError:
        self._process.join(5.0)
        code = self._process.exitcode or 0
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return HeadlandError(f"the process of the nodes {', '.join(self.names)} has ended ({how})")


@contextmanager
def node_process(nodes: Sequence[tuple[Node, int]], cores: int) -> Iterator[NodeProcess | None]:
    """Process for some nodes of a simulated drive, None on one core; forks, so no camera image may be rendered yet."""
    chosen = [node for node, _ in nodes if node.name.startswith(PREFIXES)]
    if cores < 2 or not chosen:
        yield None
        return
    process = NodeProcess(chosen)
    try:
        yield process
    finally:
        process.close()


def _serve(nodes: Sequence[Node], orders: Connection, results: Connection, parent: int) -> None:
    """Steps the nodes as ordered until the parent ends this process, or an error of these lines does."""
    begin_worker(parent)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # as SIGINT: the parent decides when the drive ends
    try:
        _step_as_ordered(nodes, orders, results)
    except Exception:
        sys.stderr.write(traceback.format_exc())
        os._exit(1)  # without waiting for a result that the parent does not read


def _step_as_ordered(nodes: Sequence[Node], orders: Connection, results: Connection) -> NoReturn:
    bus, by_name = Bus(nodes, ()), {node.name: node for node in nodes}
    sender = ThreadPoolExecutor(1, "results")  # a thread, so that this one reads on while the parent is sending
    while True:
        delivered, now_ns, names = pickle.loads(orders.recv_bytes())
        for envelope in delivered:
            bus.deliver(envelope.receive_ns, [(envelope.topic, envelope.message)])
        for name in names:
            result = step_node(by_name[name], now_ns, bus.inboxes[name])
            sender.submit(results.send_bytes, pickle.dumps(result, PICKLE))

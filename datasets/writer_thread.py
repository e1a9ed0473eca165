"""Thread that compresses and writes one batch of messages while the next is collected."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class WriterThread:
    """Executes calls in the given order, in batches; the file is the same as without the thread.

    An exception ends its batch and is raised by the next `submit` or `drain`.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "log")
        self._calls: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        self._batch: Future[None] | None = None

    def call_later(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Adds a call to the next batch."""
        self._calls.append((call, arguments))

    def submit(self) -> None:
        """Starts the batch after the previous one is done: at most two are held."""
        self._wait()
        calls, self._calls = self._calls, []
        self._batch = self._pool.submit(_make, calls)

    def drain(self) -> None:
        """Returns when all calls are executed."""
        if self._calls:
            self.submit()
        self._wait()

    def stop(self) -> None:
        """Ends after the running batch; calls not submitted are dropped."""
        self._calls.clear()
        self._pool.shutdown()

    def _wait(self) -> None:
        batch, self._batch = self._batch, None
        if batch is not None:
            batch.result()


def _make(calls: list[tuple[Callable[..., Any], tuple[Any, ...]]]) -> None:
    for call, arguments in calls:
        call(*arguments)

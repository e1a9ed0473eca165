"""A thread of a log's own: while one stretch of messages is compressed and written, the next one comes."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class LogThread:
    """Makes calls in the order in which they were given, a batch at a time; so the file is what it would be without.

    What a call raises ends its batch, and is raised by the next `hand_over` or `settle`.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "log")
        self._calls: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        self._batch: Future[None] | None = None

    def later(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Make this call with the next batch."""
        self._calls.append((call, arguments))

    def hand_over(self) -> None:
        """Begin the batch, once the one before is done: no more than two are ever held."""
        self._wait()
        calls, self._calls = self._calls, []
        self._batch = self._pool.submit(_make, calls)

    def settle(self) -> None:
        """Return when all calls are made."""
        if self._calls:
            self.hand_over()
        self._wait()

    def stop(self) -> None:
        """End after the batch at hand; what was not handed over is dropped."""
        self._calls.clear()
        self._pool.shutdown()

    def _wait(self) -> None:
        batch, self._batch = self._batch, None
        if batch is not None:
            batch.result()


def _make(calls: list[tuple[Callable[..., Any], tuple[Any, ...]]]) -> None:
    for call, arguments in calls:
        call(*arguments)

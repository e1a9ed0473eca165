"""Thread that compresses and writes batches of messages while the next one is collected."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

MAX_BATCHES = 8  # that wait while a long one is executed


class WriterThread:
    """Executes calls in the given order, in batches; the file is the same as without the thread.

    An exception ends its batch, drops the later ones, and is raised by a later `submit` or by `drain`.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "log")
        self._calls: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        self._batches: deque[Future[None]] = deque()
        self._long: Future[None] | None = None
        self._has_failed = False

    @property
    def has_long_batch(self) -> bool:
        """Whether a long batch waits or is executed."""
        return self._long is not None and not self._long.done()

    def call_later(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Adds a call to the next batch."""
        self._calls.append((call, arguments))

    def submit(self, is_long: bool = False) -> None:
        """Starts the batch after the one before it is done, so that at most two are held; if that is long, it waits."""
        most = MAX_BATCHES if self.has_long_batch else 1
        while self._batches and (self._batches[0].done() or len(self._batches) >= most):
            self._batches.popleft().result()
        calls, self._calls = self._calls, []
        self._batches.append(self._pool.submit(self._make, calls))
        self._long = self._batches[-1] if is_long else self._long

    def drain(self) -> None:
        """Returns when all calls are executed."""
        if self._calls:
            self.submit()
        while self._batches:
            self._batches.popleft().result()

    def stop(self) -> None:
        """Ends after the submitted batches; calls not submitted are dropped."""
        self._calls.clear()
        self._pool.shutdown()

    def _make(self, calls: list[tuple[Callable[..., Any], tuple[Any, ...]]]) -> None:
        if self._has_failed:
            return
        try:
            for call, arguments in calls:
                call(*arguments)
        except BaseException:
            self._has_failed = True
            raise

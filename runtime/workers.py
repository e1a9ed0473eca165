"""Independent tasks: one after another, on processes of this machine that are reused, or on a Dask cluster.

A task has a folder, and a key: the hash of all that determines its result, by which it is found again.
"""

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from messages.errors import HeadlandError
from runtime.processes import begin_worker, terminate_children

T = TypeVar("T")
Values = dict[str, Any]
RESULT = "result.json"


def stored_result(folder: Path, key: str) -> Values | None:
    """Result of the same task from an earlier run, or None."""
    try:
        values = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) and values.get("key") == key else None


def store_result(folder: Path, values: Values) -> None:
    """Writes the result of a task with its `key`, whole or not at all; raises OSError."""
    temporary = folder / f"{RESULT}.new"
    temporary.write_text(json.dumps(values), encoding="utf-8")
    temporary.replace(folder / RESULT)


@dataclass(frozen=True)
class Work(Generic[T]):
    """What a worker does with a task, and the result of a task whose worker died; both are importable functions."""

    run: Callable[[T], Values]
    lost: Callable[[T, Exception], Values]

    def result(self, get: Callable[[], Any], task: T) -> Values:
        """Result of a worker."""
        try:
            return dict(get())
        except HeadlandError:
            raise
        except Exception as error:  # a failed worker must not end the run
            return self.lost(task, error)


def run_all(work: Work[T], tasks: list[T], jobs: int | None, scheduler: str | None) -> Iterator[tuple[T, Values]]:
    """Results in the order of completion; `jobs` None uses all cores. Raises HeadlandError of the work."""
    count = min(jobs or len(os.sched_getaffinity(0)), len(tasks))
    if scheduler is not None:
        yield from _on_cluster(work, tasks, scheduler)
    elif count <= 1:
        for task in tasks:
            yield task, work.run(task)
    else:
        # threads of loaded libraries do not survive a fork
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(count, context, begin_worker, (os.getpid(),)) as pool:
            futures = {pool.submit(work.run, task): task for task in tasks}
            try:
                for future in as_completed(futures):
                    yield futures[future], work.result(future.result, futures[future])
            except KeyboardInterrupt:
                terminate_children()
                raise
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def _on_cluster(work: Work[T], tasks: list[T], address: str) -> Iterator[tuple[T, Values]]:
    """Runs the tasks on a Dask cluster; results are returned as values."""
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError as error:
        raise HeadlandError("--scheduler needs the package distributed, which is not installed") from error
    try:
        client = Client(address, timeout="10s")  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        raise HeadlandError(f"--scheduler {address}: no reply from the scheduler ({error})") from error
    with client:
        futures = {client.submit(work.run, task, pure=False): task for task in tasks}
        for future in completed(list(futures)):  # type: ignore[no-untyped-call]
            yield futures[future], work.result(future.result, futures[future])

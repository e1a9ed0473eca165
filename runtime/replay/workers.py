"""Evaluation of many logs: one after another, on processes of this machine, or on a Dask cluster."""

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

from messages.errors import HeadlandError
from runtime.replay.evaluate import Task, evaluate_task

Evaluated = tuple[Task, dict[str, Any]]


def evaluate_all(tasks: list[Task], jobs: int | None, scheduler: str | None) -> Iterator[Evaluated]:
    """Results in the order of completion; `jobs` None uses all cores. Raises HeadlandError if none can be written."""
    count = min(jobs or len(os.sched_getaffinity(0)), len(tasks))
    if scheduler is not None:
        yield from _on_cluster(tasks, scheduler)
    elif count <= 1:
        for task in tasks:
            yield task, evaluate_task(task)
    else:
        # threads of loaded libraries do not survive a fork
        with ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn")) as pool:
            futures = {pool.submit(evaluate_task, task): task for task in tasks}
            try:
                for future in as_completed(futures):
                    yield futures[future], _result_of(future.result, futures[future])
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def _on_cluster(tasks: list[Task], address: str) -> Iterator[Evaluated]:
    """Runs the tasks on a Dask cluster; results are returned as values, only the logs need a shared disk."""
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
        futures = {client.submit(evaluate_task, task, pure=False): task for task in tasks}
        for future in completed(list(futures)):  # type: ignore[no-untyped-call]
            yield futures[future], _result_of(future.result, futures[future])


def _result_of(get: Callable[[], Any], task: Task) -> dict[str, Any]:
    """Result of a worker; a worker that died gives a failed log."""
    try:
        return dict(get())
    except HeadlandError:
        raise
    except Exception as error:  # a failed worker must not end the run
        return {"log": task.name, "failed": f"{task.log}: the worker died ({error!r})"}

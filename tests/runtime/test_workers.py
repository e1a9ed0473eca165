"""Independent tasks: in this process, on reused processes, on a Dask cluster; a dead worker is a result."""

import os

import pytest

from messages.errors import HeadlandError
from runtime.workers import Work, run_all

TASKS = [(("a", 1),), (("a", 2),), (("a", 3),)]


def lost(task, error):
    return {"task": task, "lost": repr(error)}


def refuse(task):
    raise HeadlandError("disk full")


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_has_its_result(jobs):
    found = dict(run_all(Work(dict, lost), TASKS, jobs, None))
    assert found == {task: dict(task) for task in TASKS}


def test_a_dead_worker_is_a_result():
    found = dict(run_all(Work(os._exit, lost), [3, 4], 2, None))
    assert set(found) == {3, 4}
    assert all("BrokenProcessPool" in values["lost"] for values in found.values())


def test_an_error_of_the_work_ends_the_run():
    with pytest.raises(HeadlandError, match="disk full"):
        list(run_all(Work(refuse, lost), [1], 1, None))


def test_results_of_a_cluster():
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        found = dict(run_all(Work(dict, lost), TASKS, None, cluster.scheduler_address))
    assert found == {task: dict(task) for task in TASKS}


def test_a_scheduler_that_does_not_reply_is_named():
    with pytest.raises(HeadlandError, match="--scheduler nowhere"):
        list(run_all(Work(dict, lost), TASKS, None, "nowhere"))

"""`headland validate`: replays recorded logs and evaluates whether the stack would have stopped for the obstacles."""

import argparse
import base64
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from datasets.log import LogWriter
from messages.errors import HeadlandError
from messages.message import Envelope
from runtime.run_folder import RunFolder, resolved, versions
from validation.obstacle_stop.conditions import FILE, load_conditions
from validation.obstacle_stop.tables import print_table, summary_line, write_table

EXIT = {"passed": 0, "failed": 1, "not_shown": 2}
NOT_LOGGED = ("lidar", "camera", "obstacles", "ground", "recorded", "imu", "wheel", "gnss", "can")


@dataclass(frozen=True)
class Task:
    """One log to evaluate; inputs of a worker as plain values."""

    name: str
    log: Path
    truth: Path | None
    vehicle: Path | None
    conditions: Path | None
    removed_object: str | None
    model: Path | None
    folder: Path
    key: str


def main(arguments: argparse.Namespace) -> int:
    """Evaluates all logs; 0 passed, 1 failed, 2 not shown."""
    if arguments.jobs is not None and arguments.jobs < 1:
        raise HeadlandError(f"--jobs {arguments.jobs}: must be at least 1")
    conditions = load_conditions(arguments.conditions)
    folder = _folder(arguments.out)
    tasks = _tasks(arguments, folder.path)
    (folder.path / "config.yaml").write_text(resolved(conditions=conditions), encoding="utf-8")
    folder.record("conditions", versions() | {"conditions": conditions.model_dump(mode="json")}
                  | {"logs": [str(task.log) for task in tasks]})  # fmt: skip
    done = _evaluate_all(tasks, arguments)
    results = [done[task.name] for task in tasks]
    result = _finish(folder, results, conditions)
    if arguments.json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        print_table(result)
    if len(tasks) == 1 and result["failed_to_read"]:
        raise HeadlandError(result["failed_to_read"][0]["reason"])
    return EXIT[result["state"]]


class _ResumedFolder(RunFolder):
    """Run folder with results of earlier logs; tables and report are written again."""

    def __init__(self, out: Path) -> None:
        foreign = [p.name for p in out.iterdir() if p.name not in RESULTS and not p.name.endswith(".png")]
        if foreign:
            raise HeadlandError(f"--out {out}: contains {foreign[0]}, not of a validation; name another folder")
        for path in out.iterdir():
            if path.is_file():
                path.unlink()
        self.path = out.absolute()
        self._events = 0


RESULTS = {"logs", "result.jsonl", "report.html", "encounters.parquet", "stops.parquet", "recall.parquet",
           "config.yaml", "command", "console.log"}  # fmt: skip


def _folder(out: Path | None) -> RunFolder:
    if out is not None and out.is_dir() and any(out.iterdir()):
        return _ResumedFolder(out)
    return RunFolder("validate", out)


def _tasks(arguments: argparse.Namespace, folder: Path) -> list[Task]:
    """One task per log, with a unique name."""
    named: dict[str, Path] = {}
    for log in arguments.log:
        name, number = log.name or log.absolute().name, 2
        while name in named:
            name, number = f"{log.name}-{number}", number + 1
        named[name] = log
    tasks, commit = [], versions()["commit"]
    for name, log in named.items():
        key = _key(log, commit, arguments)
        tasks.append(
            Task(
                name, log.absolute(), _absolute(arguments.truth), arguments.vehicle, arguments.conditions,
                arguments.remove_object, _absolute(arguments.model), folder / "logs" / name, key,
            )
        )  # fmt: skip
    return tasks


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _key(log: Path, commit: str, arguments: argparse.Namespace) -> str:
    """Hash of all inputs of an evaluation: log files, conditions, vehicle, options and commit."""
    parts = [
        commit,
        str(arguments.truth),
        str(arguments.remove_object),
        str(arguments.model),
        _text(arguments.conditions or FILE),
    ]
    parts.append(_text(arguments.vehicle) if arguments.vehicle is not None else "")
    files = sorted(log.rglob("*")) if log.is_dir() else [log]
    parts += [f"{p}:{p.stat().st_size}:{p.stat().st_mtime_ns}" for p in files if p.is_file()]
    return sha256("\n".join(parts).encode()).hexdigest()


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else str(path)


def _evaluate_all(tasks: list[Task], arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Results by name, printed on standard error as they complete."""
    done: dict[str, dict[str, Any]] = {}
    waiting = []
    for task in tasks:
        stored = _stored_result(task)
        if stored is None:
            waiting.append(task)
        else:
            done[task.name] = stored
    if done:
        sys.stderr.write(f"{len(done)} of {len(tasks)} evaluated before\n")
    for task, values in _run(waiting, arguments):
        done[task.name] = values
        sys.stderr.write(f"[{len(done)}/{len(tasks)}] {task.name}: {summary_line(values)}\n")
    return done


def _stored_result(task: Task) -> dict[str, Any] | None:
    """Result of the same evaluation from an earlier run, or None."""
    try:
        values = json.loads((task.folder / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) and values.get("key") == task.key else None


def _run(tasks: list[Task], arguments: argparse.Namespace) -> Iterator[tuple[Task, dict[str, Any]]]:
    jobs = min(arguments.jobs or len(os.sched_getaffinity(0)), len(tasks))
    if arguments.scheduler is not None:
        yield from _on_cluster(tasks, arguments.scheduler)
    elif jobs <= 1:
        for task in tasks:
            yield task, evaluate_task(task)
    else:
        with ProcessPoolExecutor(jobs, mp_context=_spawn_context()) as pool:
            futures = {pool.submit(evaluate_task, task): task for task in tasks}
            for future in as_completed(futures):
                yield futures[future], _result_of(future.result, futures[future])


def _spawn_context() -> Any:
    """Context of new processes: threads of loaded libraries do not survive a fork."""
    import multiprocessing

    return multiprocessing.get_context("spawn")


def _on_cluster(tasks: list[Task], address: str) -> Iterator[tuple[Task, dict[str, Any]]]:
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
    except Exception as error:  # a failed worker must not end the run
        return {"log": task.name, "failed": f"{task.log}: the worker died ({error!r})"}


def evaluate_task(task: Task) -> dict[str, Any]:
    """Evaluates one log in this process; errors are part of the result."""
    try:
        values = _evaluate(task)
    except HeadlandError as error:
        values = {"log": task.name, "failed": "; ".join([str(error), *_damage(task.log)])}
    except Exception as error:  # an invalid log may raise any error; the other logs continue
        where = traceback.format_exc().strip().splitlines()[-3:]
        values = {"log": task.name, "failed": f"{task.log}: {error!r} ({' '.join(where)})"}
    values["key"] = task.key
    if "failed" not in values:
        task.folder.mkdir(parents=True, exist_ok=True)
        temporary = task.folder / "result.json.new"
        temporary.write_text(json.dumps(values), encoding="utf-8")
        temporary.replace(task.folder / "result.json")
    return values


def _damage(log: Path) -> tuple[str, ...]:
    """Damage of a log, a possible cause of the failure."""
    from runtime.replay.prepare import damage_of

    try:
        return damage_of(log)
    except HeadlandError:
        return ()


def _evaluate(task: Task) -> dict[str, Any]:
    """Replays and evaluates a log; heavy modules are imported only here."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from runtime.replay.log_inspection_table import render
    from runtime.replay.object_removal import remove_object
    from runtime.replay.prepare import load_configuration, prepare
    from runtime.replay.replay import replay
    from validation.obstacle_stop.evaluation import evaluate_log
    from validation.obstacle_stop.figures import encounter_figure
    from validation.obstacle_stop.observer import Observer

    conditions = load_conditions(task.conditions)
    replay_input = prepare(task.log, task.truth, task.vehicle, load_configuration(conditions, task.model))
    if task.removed_object is not None:
        replay_input = remove_object(replay_input, task.removed_object)
    inspection = replay_input.inspection_table()
    sys.stderr.write(render(inspection))
    setting = replay_input.setting(task.name)
    observer = Observer(setting, conditions)
    task.folder.mkdir(parents=True, exist_ok=True)
    path = task.folder / "replay.mcap"
    path.unlink(missing_ok=True)
    about = {"replay": {"log": str(task.log), "inspection": json.dumps(inspection)}}
    with LogWriter(path, about, replay_input.config.stack.datasets.log) as log:

        def write(envelope: Envelope) -> None:
            if envelope.topic.lstrip("/").partition("/")[0] not in NOT_LOGGED:
                log.write(envelope)

        replay(replay_input, [observer, write])
    observed = observer.finish()
    values = evaluate_log(task.name, observed, setting.truth_frame is not None, conditions)
    figures = {}
    for encounter in values["encounters"]:
        if setting.truth_frame is not None:
            png = encounter_figure(
                encounter, observed, setting.front_m, setting.width_m, conditions.corridor.min_returns
            )
            figures[f"{task.name}: {encounter['role']}, {encounter['outcome']}"] = base64.b64encode(png).decode()
    return values | {"inspection": inspection, "digest": log.digest(), "figures": figures}


def _finish(folder: RunFolder, results: list[dict[str, Any]], conditions: Any) -> dict[str, Any]:
    """Writes tables, report and records of all logs; returns the overall result."""
    from validation.obstacle_stop.report import render
    from validation.obstacle_stop.totals import aggregate

    result = aggregate(results, conditions) | {"run_dir": str(folder.path)}
    for name in ("encounters", "stops", "recall"):
        write_table(folder.path / f"{name}.parquet", name, result[name])
    figures = {t: base64.b64decode(png) for values in results for t, png in values.get("figures", {}).items()}
    inspections = [values["inspection"] for values in results if "inspection" in values]
    (folder.path / "report.html").write_text(render(result, inspections, figures), encoding="utf-8")
    for values in results:
        record = {k: v for k, v in values.items() if k not in ("figures", "key")}
        folder.record("log", record)
    folder.record("result", {"result": result})
    folder.finish()
    return result

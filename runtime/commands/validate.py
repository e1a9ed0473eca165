"""`headland validate`: replays recorded logs and evaluates whether the stack would have stopped for the obstacles."""

from __future__ import annotations

import argparse
import base64
import json
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datasets.parts import files_of
from messages.errors import HeadlandError
from runtime.commands.argument_types import why_missing

if TYPE_CHECKING:
    from runtime.replay.evaluate import Task
    from runtime.result_folder import ResultFolder
    from validation.obstacle_stop.conditions import Conditions

EXIT = {"passed": 0, "failed": 1, "not_shown": 3}
EXIT_BAD_INPUT = 2


def main(arguments: argparse.Namespace) -> int:
    """Evaluates all logs; 0 passed, 1 failed, 2 bad input, 3 not shown."""
    check(arguments)
    # only now: these imports take seconds, and a wrong argument is reported at once
    from runtime.result_folder import ResultFolder
    from validation.obstacle_stop.conditions import load_conditions
    from validation.obstacle_stop.tables import print_table

    conditions = load_conditions(arguments.conditions)
    with ResultFolder("validate", arguments.out) as folder:
        results = _evaluate_all(_tasks(arguments, folder), arguments, folder)
        unread = [values["failed"] for values in results if "failed" in values and not values.get("is_not_shown")]
        if len(unread) == len(results):
            folder.discard()
            raise HeadlandError("\nheadland: ".join(unread))
        result = _finish(folder, results, conditions, arguments)
    if arguments.json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        print_table(result)
    return EXIT_BAD_INPUT if unread and result["state"] != "failed" else EXIT[result["state"]]


def check(arguments: argparse.Namespace) -> None:
    """Raises HeadlandError for a log given twice, a missing vehicle file, or one file of truth for several logs."""
    seen: dict[Path, Path] = {}
    for log in arguments.log:
        if (first := seen.setdefault(log.resolve(), log)) is not log:
            raise HeadlandError(f"{log}: the same log as {first}; encounters of one log count once")
    vehicle, truth = arguments.vehicle, arguments.truth
    is_name = vehicle is not None and len(vehicle.parts) == 1 and not vehicle.suffix
    if vehicle is not None and not vehicle.is_file() and not is_name:
        raise HeadlandError(f"--vehicle {vehicle}: {'not a file' if vehicle.exists() else why_missing(vehicle)}")
    if truth is not None and truth.suffix in (".jsonl", ".json") and len(arguments.log) > 1:
        raise HeadlandError(f"--truth {truth}: a file belongs to one log; place it beside its log as LOG.truth.jsonl")


def _tasks(arguments: argparse.Namespace, folder: ResultFolder) -> list[Task]:
    """One task per log, with a unique name."""
    from runtime.replay.evaluate import Task

    named: dict[str, Path] = {}
    for log in (log.absolute() for log in arguments.log):
        name, number = log.name, 2
        while name in named:
            name, number = f"{log.name}-{number}", number + 1
        named[name] = log
    version = _version()
    return [
        Task(
            name, log, _absolute(arguments.truth), _vehicle(arguments.vehicle), _absolute(arguments.conditions),
            arguments.remove_object, not arguments.without_sensor_data, _absolute(arguments.model),
            folder.new / "logs" / name, _key(log, version, arguments),
        )
        for name, log in named.items()
    ]  # fmt: skip


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _vehicle(path: Path | None) -> Path | None:
    """A file, or the name of one in configs/."""
    return path.absolute() if path is not None and path.is_file() else path


def _version() -> str:
    """Commit and local changes."""
    from runtime.run_folder import ROOT, versions

    changes = subprocess.run(["git", "-C", str(ROOT), "diff", "HEAD"], capture_output=True, check=False).stdout
    return f"{versions()['commit']} {sha256(changes).hexdigest()}"


def _key(log: Path, version: str, arguments: argparse.Namespace) -> str:
    """Hash of all inputs of an evaluation: files of log and truth, conditions, vehicle, model, options and version."""
    from validation.obstacle_stop.conditions import FILE

    beside = log.with_name(f"{log.name}.truth.jsonl")
    inputs = (log, beside, arguments.truth, arguments.vehicle, arguments.conditions or FILE, arguments.model)
    parts = [version, *map(str, (arguments.remove_object, arguments.without_sensor_data, arguments.vehicle))]
    for path in inputs:
        files = [] if path is None else sorted(path.rglob("*")) if path.is_dir() else files_of(path)
        parts += [f"{p}:{p.stat().st_size}:{p.stat().st_mtime_ns}" for p in files if p.is_file()] + [""]
    return sha256("\n".join(parts).encode()).hexdigest()


def _evaluate_all(tasks: list[Task], arguments: argparse.Namespace, folder: ResultFolder) -> list[dict[str, Any]]:
    """Results in the order of the logs; a line on standard error for each as it completes."""
    from runtime.replay.evaluate import evaluate_task, lost_task
    from runtime.workers import Work, run_all, stored_result
    from validation.obstacle_stop.tables import summary_line

    done: dict[str, dict[str, Any]] = {}
    for task in tasks:
        places = (task.folder, folder.path / "logs" / task.name)
        stored = next((values for place in places if (values := stored_result(place, task.key)) is not None), None)
        if stored is not None:
            done[task.name] = stored
    if done:
        sys.stderr.write(f"{len(done)} of {len(tasks)} evaluated before\n")
    waiting = [task for task in tasks if task.name not in done]
    for task, values in run_all(Work(evaluate_task, lost_task), waiting, arguments.jobs, arguments.scheduler):
        done[task.name] = values
        sys.stderr.write(f"[{len(done)}/{len(tasks)}] {task.name}: {summary_line(values)}\n")
    return [done[task.name] for task in tasks]


def _finish(
    folder: ResultFolder, results: list[dict[str, Any]], conditions: Conditions, arguments: argparse.Namespace
) -> dict[str, Any]:
    """Writes tables, report and records of all logs; returns the overall result."""
    from runtime.run_folder import resolved, versions
    from validation.obstacle_stop.report import render
    from validation.obstacle_stop.tables import table
    from validation.obstacle_stop.totals import aggregate

    result = aggregate(results, conditions) | {"run_dir": str(folder.path)}
    for name in ("encounters", "stops", "recall"):
        folder.write(f"{name}.parquet", table(name, result[name]))
    figures = {name: base64.b64decode(png) for log in results for name, png in log.get("figures", {}).items()}
    for name, png in figures.items():
        folder.write(name, png)
    for log in (log for log in results if "proposal" in log):
        lines = [json.dumps(line, ensure_ascii=False) for line in log["proposal"]]
        folder.write(f"{log['log']}.proposed.jsonl", "\n".join(lines) + "\n")
    folder.write("report.html", render(result, results, figures))
    folder.write("config.yaml", resolved(conditions=conditions))
    about: dict[str, Any] = versions() | {"conditions": conditions.model_dump(mode="json")}
    about |= {"logs": [str(log.absolute()) for log in arguments.log]}
    logs = ({k: v for k, v in values.items() if k not in ("figures", "proposal", "key")} for values in results)
    records = [("conditions", about), *(("log", log) for log in logs), ("result", {"result": result})]
    folder.write_records([{"record": kind} | values for kind, values in records])
    folder.replace({f"logs/{values['log']}" for values in results})
    return result

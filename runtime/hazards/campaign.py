"""`headland campaign hazards`: every drive of `configs/hazards.yaml` on processes that are reused, judged by truth."""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

from configs.sensor_kinds import SENSOR_KINDS, sensors_of
from messages.errors import HeadlandError
from runtime.hazards.cases import draws_of, drives_of, load_list, with_plant, without
from runtime.hazards.drive import Task, drive_task, lost_task, task_of
from runtime.run_folder import RunFolder, named_errors, versions
from runtime.setup import load_setup
from runtime.workers import Work, run_all, stored_result
from validation.hazards.tables import failure_text, markdown, page, totals, unavoidable, write_parquet

MAX_UNAVOIDABLE = 0.05  # of the drives


def main(arguments: argparse.Namespace) -> int:
    """Drives what is missing; 0 without avoidable contact, false stop, failed drive, and too many unavoidable ones."""
    found = load_list()
    drives = draws_of(found, arguments.draws) if arguments.draws else drives_of(found, arguments.seeds, arguments.core)
    if arguments.plant is not None:
        drives = [with_plant(one, arguments.plant) for one in drives]
    if arguments.without is not None:
        _require_sensor(arguments.without)
        drives = [without(one, arguments.without) for one in drives]
    if arguments.only is not None:
        drives = [one for one in drives if re.search(arguments.only, one.name)]
        if not drives:
            raise HeadlandError(f"--only {arguments.only!r}: no drive has such a name")
    with RunFolder("campaign-hazards", arguments.out, {"campaign": "hazards"}, resumes=True) as folder:
        for made in ("drives", "drives.parquet", "objects.parquet"):
            folder.file(made)
        top, commit = folder.path, versions()["commit"]
        results = _all_results([task_of(one, top, commit) for one in drives], arguments)
        excused = unavoidable(results)
        share = round(len({row["drive"] for row in excused}) / len(results), 4)
        summary = totals(results) | {"unavoidable_share": share, "unavoidable": excused, "run_dir": str(top)}
        with named_errors(top):
            write_parquet(top, results)
            folder.file("table.html").write_text(page(results), encoding="utf-8")
            folder.file("summary.md").write_text(markdown(results), encoding="utf-8")
            folder.file("result.json").write_text(json.dumps(summary) + "\n", encoding="utf-8")
    if arguments.json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        sys.stdout.write(_text(summary, top))
    is_failed = any(summary[key] for key in ("avoidable_contacts", "false_stops", "failed_drives"))
    return 1 if is_failed or share > MAX_UNAVOIDABLE else 0


def _require_sensor(topic: str) -> None:
    sensors = load_setup("line", None, None, None, 1).vehicle.sensors
    known = [f"{kind}/{name}" for kind in SENSOR_KINDS for name in sensors_of(sensors, kind)]
    if topic not in known:
        raise HeadlandError(f"--without {topic!r}: not one of {', '.join(known)}")


def _all_results(tasks: list[Task], arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Results in the order of the drives; a line on standard error for each as it ends."""
    done = {task.drive.name: values for task in tasks if (values := stored_result(task.folder, task.key)) is not None}
    if done:
        sys.stderr.write(f"{len(done)} of {len(tasks)} driven before\n")
    waiting = [task for task in tasks if task.drive.name not in done]
    for task, values in run_all(Work(drive_task, lost_task), waiting, arguments.jobs, arguments.scheduler):
        done[task.drive.name] = values
        is_failed = "failed" in values or values["contacts"] or values["false_stops"]
        text = failure_text(values) if is_failed else f"{', '.join(filter(None, task.drive.labels.values()))}: passed"
        sys.stderr.write(f"[{len(done)}/{len(tasks)}] {task.drive.name}: {text}, {values.get('wall_s', 0.0):.0f} s\n")
    return [done[task.drive.name] for task in tasks]


def _text(summary: dict[str, Any], top: Path) -> str:
    counts = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in summary.items()
                       if isinstance(value, (int, float)))  # fmt: skip
    return f"{counts}; table: {top / 'table.html'}\n"

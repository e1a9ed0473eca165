"""One drive of the campaign as a task for a worker process: simulation, judgement and picture as plain values."""

import base64
import io
import json
import time
import traceback
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from configs.odd import load_odd
from configs.strict import parse
from datasets.parts import files_of
from runtime.hazards.cases import HazardDrive
from runtime.run_folder import versions
from runtime.setup import load_setup
from runtime.simulated_drive import drive_into_log
from runtime.workers import store_result
from simulation.scenario import Scenario
from validation.hazards.judge import judge, row_dict
from validation.hazards.log import read_hazard_log
from validation.hazards.picture import draw


@dataclass(frozen=True)
class Task:
    """A drive, its folder, and the hash of all that determines its result."""

    drive: HazardDrive
    folder: Path
    key: str

    @property
    def command(self) -> str:
        """Command line that repeats the drive."""
        return (f"./headland run --mission {self.drive.mission} --scenario {self.folder / 'scenario.yaml'} "
                f"--seed {self.drive.seed} --duration {self.drive.limit_s:g}")  # fmt: skip


def task_of(drive: HazardDrive, top: Path, commit: str) -> Task:
    """Task in a folder of its own below `top`."""
    text = json.dumps([asdict(drive), commit], sort_keys=True)
    return Task(drive, (top / "drives" / drive.name).absolute(), sha256(text.encode()).hexdigest())


def lost_task(task: Task, error: Exception) -> dict[str, Any]:
    """Result of a drive whose worker died."""
    return {"name": task.drive.name, "labels": task.drive.labels, "command": task.command, "failed": repr(error)}


def drive_task(task: Task) -> dict[str, Any]:
    """Drives and judges; an error of the drive is part of the result."""
    task.folder.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(task.drive.scenario, sort_keys=False)
    (task.folder / "scenario.yaml").write_text(text, encoding="utf-8")
    try:
        values = _judged(task)
    except Exception as error:  # one failed drive must not end the campaign
        where = traceback.format_exc().strip().splitlines()[-3:]
        return lost_task(task, error) | {"where": " ".join(where)}
    store_result(task.folder, values)
    return values


def _remove(log_path: Path) -> None:
    for part in files_of(log_path):
        part.unlink(missing_ok=True)


def _judged(task: Task) -> dict[str, Any]:
    began_s, cpu_s, drive, log_path = time.monotonic(), time.process_time(), task.drive, task.folder / "log.mcap"
    _remove(log_path)
    setup = load_setup(drive.mission, None, None, None, drive.seed)
    scenario = parse(Scenario, drive.scenario, drive.name)
    conditions = versions() | {"seed": str(drive.seed)}
    digest = drive_into_log(setup, scenario, task.folder, conditions, io.StringIO(), limit_s=drive.limit_s)
    log = read_hazard_log(log_path)
    judgement = judge(log, load_odd())
    _remove(log_path)  # the command repeats it bit for bit
    is_failed = bool(judgement.contacts or judgement.false_stops)
    picture = base64.b64encode(draw(log.drive, judgement, drive.name)).decode() if is_failed else None
    return {
        "key": task.key, "name": drive.name, "labels": drive.labels, "seed": drive.seed, "command": task.command,
        **judgement.totals, "outside_odd": list(judgement.outside_odd), "digest": digest,
        "wall_s": round(time.monotonic() - began_s, 1), "cpu_s": round(time.process_time() - cpu_s, 1),
        "objects": [row_dict(row) for row in judgement.objects],
        "stop_list": [asdict(stop) for stop in judgement.stops], "picture": picture,
    }  # fmt: skip

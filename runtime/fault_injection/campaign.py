"""`headland campaign faults`: one drive to each situation, and from there a forked process for each fault.

The simulation is deterministic and has one thread, so a fork goes on exactly as the drive itself would have gone on: a
cell costs only the seconds after its fault. What is whole in the folder is not driven again.
"""

import argparse
import contextlib
import json
import os
import re
import signal
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from configs.strict import CONFIGS, find, load
from datasets.log import LogWriter
from messages.errors import HeadlandError, LogError
from messages.message import Envelope
from messages.node import Node, World
from runtime.assembly import assemble, idle_of
from runtime.executor import Executor
from runtime.fault_injection.evaluation import Cell, Outcome, Seen, judge
from runtime.fault_injection.situations import SITUATIONS, Watch
from runtime.fault_injection.table import write_tables
from runtime.run_folder import RunFolder
from runtime.setup import Setup, load_setup
from safety.monitors.sensors import monitored_sensors
from simulation.faults.config import FaultsConfig, InjectedFault, fault_kinds_of
from simulation.faults.injection import FaultInjection
from simulation.scenario import Scenario

EYES = ("lidar", "radar", "camera", "ultrasonic")
NOT_BROKEN = ("operator_command", "truth_machine", "truth_objects")
LIMIT_S = 600.0  # of simulated time, on the way to a situation
CELL_LIMIT_S = 900.0  # of wall time
SEED = 1


@dataclass
class Drive:
    """A drive that can be forked."""

    setup: Setup
    world: World
    nodes: list[tuple[Node, int]]
    executor: Executor
    injection: FaultInjection
    watch: Watch
    config: FaultsConfig
    kept: list[Envelope]

    def topics(self) -> list[str]:
        """All that can break here: sensors, feedback frames, nodes, clock and log."""
        sensors = [topic for topic in self.world.writes if topic not in NOT_BROKEN]
        frames = [f"can/{name}" for name in self.config.frames]
        return [*sensors, *frames, *(f"node/{node.name}" for node, _ in self.nodes), "clock", "log"]

    def idle(self) -> tuple[str, ...]:
        """Sensors that look away from the direction of travel or detect nothing, with their nodes."""
        assert self.watch.truth is not None
        sensors, direction = self.setup.vehicle.sensors, int(np.sign(self.watch.truth.speed_mps))
        looking = [one for one in monitored_sensors(sensors, idle_of(self.setup)) if one.covers(direction)]
        seeing = {one.topic for one in looking}
        for name, lidar in sensors.lidar.items():
            seeing |= {f"lidar/{name}"} if np.cos(np.radians(lidar.mount.rpy_deg[2])) * direction > 0.0 else set()
        every = [topic for topic in self.world.writes if topic.partition("/")[0] in EYES]
        away = [topic for topic in every if topic not in seeing]
        nodes = [f"node/{prefix}{topic.replace('/', '_', 1)}" for topic in away for prefix in ("", "health_")]
        return (*away, *nodes)


def main(arguments: argparse.Namespace) -> int:
    """Run the missing cells; 0 when every cell is right."""
    if arguments.jobs < 1:
        raise HeadlandError(f"--jobs {arguments.jobs}: must be at least 1")
    known = [name for named in SITUATIONS.values() for name in named]
    asked = arguments.situations.split(",") if arguments.situations else known
    if strange := [name for name in asked if name not in known]:
        raise HeadlandError(f"--situations {strange[0]}: there are {', '.join(known)}")
    top = (arguments.out or RunFolder("campaign-faults", None).path).absolute()
    (top / "cells").mkdir(parents=True, exist_ok=True)
    for mission, named in SITUATIONS.items():
        wanted = {name: is_reached for name, is_reached in named.items() if name in asked}
        if wanted:
            drive_to(mission, wanted, top / "cells", arguments.only, arguments.jobs)
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((top / "cells").glob("*.json"))]
    write_tables(top, rows)
    wrong = [row for row in rows if not row["is_right"]]
    if arguments.json:
        sys.stdout.write(json.dumps({"cells": len(rows), "wrong": wrong, "run_dir": str(top)}) + "\n")
    else:
        sys.stdout.write(f"{len(rows) - len(wrong)} of {len(rows)} right; table: {top / 'table.html'}\n")
    return 0 if rows and not wrong else 1


def drive_to(
    mission: str, wanted: Mapping[str, Callable[[Watch], bool]], folder: Path, only: str | None, jobs: int
) -> None:
    """Drive a mission, and at each situation run its cells; raises HeadlandError when one does not come about."""
    setup = load_setup(mission, None, None, None, SEED)
    scenario = load(Scenario, find("scenarios", "empty" if mission == "dock" else "faults"))
    config = load(FaultsConfig, CONFIGS / "faults.yaml")
    injection = FaultInjection((), config, setup.stack.simulation.start_stamp_ns, SEED)
    watch, kept = Watch(), list[Envelope]()
    with assemble(setup, scenario, injection=injection) as (world, nodes):
        executor = Executor(world, nodes, (watch, injection), injection)
        drive = Drive(setup, world, nodes, executor, injection, watch, config, kept)
        for situation, is_reached in wanted.items():
            missing = [c for c in cells(drive, situation, only) if not (folder / f"{c.name}.json").is_file()]
            if not missing:
                continue
            sys.stderr.write(f"{situation}: {len(missing)} cells to run; driving there\n")
            watch.mark()
            executor.run(lambda reached=is_reached: reached(watch) or watch.seconds > LIMIT_S)  # type: ignore[misc]
            if not is_reached(watch):
                raise HeadlandError(f"situation {situation!r} did not come about within {LIMIT_S:.0f} s of {mission!r}")
            _fork_all(drive, missing, folder, jobs)


def cells(drive: Drive, situation: str, only: str | None) -> list[Cell]:
    """Every fault of every topic whose cell's name matches `only`."""
    found = [Cell(situation, topic, kind) for topic in drive.topics() for kind in fault_kinds_of(topic)]
    return [cell for cell in found if only is None or re.search(only, cell.name)]


def _fork_all(drive: Drive, missing: list[Cell], folder: Path, jobs: int) -> None:
    """Run each cell in a process of its own, some at a time; one that dies or never ends is told and goes without."""
    running: dict[int, tuple[Cell, float]] = {}
    waiting = list(reversed(missing))
    while waiting or running:
        while waiting and len(running) < jobs:
            cell = waiting.pop()
            pid = os.fork()
            if pid == 0:
                _run_and_exit(drive, cell, folder)
            running[pid] = (cell, time.monotonic())
        for pid in list(running):
            cell, began_s = running[pid]
            if os.waitpid(pid, os.WNOHANG)[0] == pid:
                del running[pid]
                _say(folder, cell, len(waiting) + len(running))
            elif time.monotonic() - began_s > CELL_LIMIT_S:
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)


def _run_and_exit(drive: Drive, cell: Cell, folder: Path) -> NoReturn:
    """The life of a forked process."""
    code = 1
    try:
        outcome = run_cell(drive, cell)
        if not outcome.is_right:
            _keep_log(drive, folder / f"{cell.name}.mcap")
        fresh = folder / f".{cell.name}.new"
        fresh.write_text(json.dumps(outcome.as_dict()), encoding="utf-8")
        fresh.replace(folder / f"{cell.name}.json")
        code = 0
    except BaseException:  # nothing of the parent's may go on in this process
        sys.stderr.write(traceback.format_exc())
    finally:
        sys.stderr.flush()
        os._exit(code)


def run_cell(drive: Drive, cell: Cell) -> Outcome:
    """Break what the cell says, now, and see what becomes of it."""
    watch, injection, config = drive.watch, drive.injection, drive.config.campaign
    truth, state = watch.truth, watch.state
    assert truth is not None
    assert state is not None
    idle = drive.idle()  # now: a machine that stands looks nowhere
    elapsed_s = (drive.executor.now_ns - drive.setup.stack.simulation.start_stamp_ns) * 1e-9
    injection.add_fault(InjectedFault(topic=cell.topic, kind=cell.kind, from_s=elapsed_s, for_s=1e6))
    watch.mark()
    drive.executor.watch(drive.kept.append)
    with contextlib.suppress(LogError):  # of the full disk, once the machine stands
        drive.executor.run(lambda: watch.still_s >= config.standstill_s or watch.seconds >= config.observation_s)
    now = watch.truth
    assert now is not None
    stopped_s = watch.seconds - watch.still_s if watch.still_s >= config.standstill_s else None
    seen = Seen(
        abs(truth.speed_mps), max(state.stopping_distance_m, 0.0), watch.travel_m, stopped_s, watch.error_m,
        now.contacts - truth.contacts, now.zone_exits - truth.zone_exits, watch.reason, tuple(watch.told),
    )  # fmt: skip
    writes = {node.name: node.writes for node, _ in drive.nodes}
    names = {topic: Cell(cell.situation, topic, cell.kind).names(config, writes) for topic in drive.topics()}
    own = names.pop(cell.topic)
    devices = {topic: called for topic, called in names.items() if not topic.startswith("node/")}
    max_age_s = cell.max_age_s(writes) if cell.is_needed(config, idle) else None
    return judge(cell, seen, config, own, devices, max_age_s, cell.is_missed(config, idle))


def _keep_log(drive: Drive, path: Path) -> None:
    """What was received since the fault, for whoever wants to know why."""
    path.unlink(missing_ok=True)
    with LogWriter(path, {}, drive.setup.stack.datasets.log, drive.setup.viewer()) as log:
        for envelope in drive.kept:
            log.write(envelope)


def _say(folder: Path, cell: Cell, left: int) -> None:
    try:
        row = json.loads((folder / f"{cell.name}.json").read_text(encoding="utf-8"))
    except OSError:
        sys.stderr.write(f"{cell.name}: no result\n")
        return
    stood = "went on" if row["travel_m"] is None else f"{row['travel_m']:.2f} m"
    allowed = "" if row["allowed_m"] is None else f" of {row['allowed_m']:.2f}"
    verdict = "right" if row["is_right"] else f"WRONG: {row['wrong']}"
    sys.stderr.write(f"[{left} left] {cell.name}: {stood}{allowed}, {row['reason'] or 'no reason'}; {verdict}\n")

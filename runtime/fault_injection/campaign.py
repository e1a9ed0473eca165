"""`headland campaign fault-injection`: drives to each situation and forks a process there for each fault.

Simulation and stack are deterministic and run in one thread here, so a fork continues exactly as the drive itself: a
cell costs only the seconds after its fault. Cells with a result in the folder are not repeated.
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
from typing import Any, NoReturn

import numpy as np

from configs.sensor_kinds import SENSOR_KINDS
from configs.strict import CONFIGS, find, load
from datasets.log import LogWriter
from messages.errors import HeadlandError, LogError
from messages.message import Envelope
from messages.node import Node, World
from runtime.assembly import assemble
from runtime.executor import Executor
from runtime.fault_injection.evaluation import Cell, MeasuredReaction, Outcome, evaluate, named_after_s
from runtime.fault_injection.situations import SITUATIONS, DriveMonitor
from runtime.fault_injection.table import summary, totals, write_tables
from runtime.processes import begin_worker
from runtime.run_folder import RunFolder, named_errors
from runtime.setup import Setup, load_setup, sensors_without_detector, with_model
from safety.monitors.sensors import monitored_sensors
from simulation.faults.config import Demand, Demanded, FaultKind, FaultsConfig, InjectedFault, fault_kinds_of
from simulation.faults.injection import FaultInjection
from simulation.scenario import Scenario
from simulation.world import Rendering
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.stopping import on_grade, stopping_distance_m

NOT_INJECTED = ("order/operator", "truth_machine", "truth_objects", "truth_shapes")
BEGINS_RIGHT = (FaultKind.FROZEN, FaultKind.REPEATED, FaultKind.SLOW)  # with a message that is still right
LIMIT_S = 600.0  # simulated time to reach a situation
CELL_LIMIT_S = 900.0  # wall time
SEED = 1


@dataclass
class Drive:
    """Drive that can be forked."""

    setup: Setup
    world: World
    nodes: list[tuple[Node, int]]
    executor: Executor
    injection: FaultInjection
    monitor: DriveMonitor
    config: FaultsConfig
    recorded: list[Envelope]

    def topics(self) -> list[str]:
        """FaultInjection targets: sensors, feedback frames, nodes, clock and log."""
        sensors = [topic for topic in self.world.writes if topic not in NOT_INJECTED]
        frames = [f"can/{name}" for name in self.config.frames]
        return [*sensors, *frames, *(f"node/{node.name}" for node, _ in self.nodes), "clock", "log"]

    def demanded(self, cell: Cell) -> Demanded:
        """The demand on a cell in the present direction of travel."""
        return self.config.campaign.demanded(cell.situation, cell.topic, cell.kind, cell.topic not in self.unused())

    def unused(self) -> tuple[str, ...]:
        """Sensors that do not cover the direction of travel or detect nothing, with their nodes."""
        assert self.monitor.truth is not None
        sensors, direction = self.setup.vehicle.sensors, int(np.sign(self.monitor.truth.speed_mps))
        monitored = monitored_sensors(sensors, sensors_without_detector(self.setup))
        covering = [one for one in monitored if one.covers(direction)]
        used = {one.topic for one in covering}
        for name, lidar in sensors.lidar.items():
            used |= {f"lidar/{name}"} if np.cos(np.radians(lidar.mount.rpy_deg[2])) * direction > 0.0 else set()
        obstacle_topics = [topic for topic in self.world.writes if topic.partition("/")[0] in SENSOR_KINDS]
        unused = [topic for topic in obstacle_topics if topic not in used]
        nodes = [f"node/{prefix}{topic.replace('/', '_', 1)}" for topic in unused for prefix in ("", "health_")]
        return (*unused, *nodes)


def main(arguments: argparse.Namespace, command: dict[str, Any]) -> int:
    """Runs the missing cells; 0 if every cell passed; `command` is the one that may continue the folder."""
    requested = (arguments.situations or ",".join(name for named in SITUATIONS.values() for name in named)).split(",")
    with RunFolder("campaign-fault-injection", arguments.out, command, resumes=True) as folder:
        top = folder.path
        for made in ("cells", "table.html", "table.parquet"):
            folder.file(made)
        with named_errors(top):
            (top / "cells").mkdir(exist_ok=True)
        for mission, named in SITUATIONS.items():
            situations = {name: is_reached for name, is_reached in named.items() if name in requested}
            if situations:
                drive_to(mission, situations, top / "cells", arguments)
        rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((top / "cells").glob("*.json"))]
        with named_errors(top):
            write_tables(top, rows)
    failed = [row for row in rows if not row["passed"]]
    if arguments.json:
        sys.stdout.write(json.dumps({**summary(rows), "failed": failed, "run_dir": str(top)}) + "\n")
    else:
        sys.stdout.write(f"{totals(rows)}\ntable: {top / 'table.html'}\n")
    return 0 if rows and not failed else 1


def drive_to(
    mission: str, situations: Mapping[str, Callable[[DriveMonitor], bool]], folder: Path, arguments: argparse.Namespace
) -> None:
    """Drives a mission and runs the cells of each situation; raises HeadlandError if a situation is not reached."""
    setup = with_model(load_setup(mission, None, None, None, SEED), arguments.model)
    scenario = load(Scenario, find("scenarios", "faults" if mission == "demo" else "empty"))
    scenario = scenario.model_copy(update={"plant": "slow_brake"})
    config = load(FaultsConfig, CONFIGS / "faults.yaml")
    injection = FaultInjection((), config, setup.stack.simulation.start_stamp_ns, SEED)
    monitor, recorded = DriveMonitor(load_conditions(None).braking.reaction_s), list[Envelope]()
    with assemble(setup, scenario, injection=injection, rendering=Rendering.IN_STEP) as (world, nodes):
        executor = Executor(world, nodes, (monitor, injection), injection)
        drive = Drive(setup, world, nodes, executor, injection, monitor, config, recorded)
        for situation, is_reached in situations.items():
            missing = [c for c in cells(drive, situation, arguments.only) if not (folder / f"{c.name}.json").is_file()]
            if not missing:
                continue
            sys.stderr.write(f"{situation}: {len(missing)} cells to run; driving to the situation\n")
            monitor.reset()
            executor.run(lambda reached=is_reached: reached(monitor) or monitor.seconds > LIMIT_S)  # type: ignore[misc]
            if not is_reached(monitor):
                raise HeadlandError(f"situation {situation!r} was not reached within {LIMIT_S:.0f} s of {mission!r}")
            # a cell without demand is refused before any runs; what demands most runs first
            missing.sort(key=lambda cell: _order(drive.demanded(cell)))
            _fork_all(drive, missing, folder, arguments.jobs)


def _order(demanded: Demanded) -> tuple[bool, bool]:
    """Sorts what demands a stop or a limit before what demands a name alone, and that before the rest."""
    return demanded.demand is Demand.CONTINUE, not demanded.is_named


def cells(drive: Drive, situation: str, only: str | None) -> list[Cell]:
    """Cells of every fault of every target whose name matches `only`."""
    found = [Cell(situation, topic, kind) for topic in drive.topics() for kind in fault_kinds_of(topic)]
    found = [c for c in found if c.kind is not FaultKind.SWAPPED or drive.injection.partner_of(c.topic) is not None]
    return [cell for cell in found if only is None or re.search(only, cell.name)]


def _fork_all(drive: Drive, missing: list[Cell], folder: Path, jobs: int) -> None:
    """Runs each cell in a process, `jobs` at a time; a cell that fails or times out is reported and has no result."""
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
                _print_result(folder, cell, len(waiting) + len(running))
            elif time.monotonic() - began_s > CELL_LIMIT_S:
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)


def _run_and_exit(drive: Drive, cell: Cell, folder: Path) -> NoReturn:
    """Body of a forked process."""
    code, parent = 1, os.getppid()
    try:
        begin_worker(parent)
        outcome = run_cell(drive, cell)
        if not outcome.passed:
            _write_log(drive, folder / f"{cell.name}.mcap")
        fresh = folder / f".{cell.name}.new"
        fresh.write_text(json.dumps(outcome.as_dict()), encoding="utf-8")
        fresh.replace(folder / f"{cell.name}.json")
        code = 0
    except BaseException:  # the parent's code must not continue in this process
        sys.stderr.write(traceback.format_exc())
    finally:
        sys.stderr.flush()
        os._exit(code)


def run_cell(drive: Drive, cell: Cell) -> Outcome:
    """Injects the fault of a cell now and measures the reaction."""
    monitor, injection, config = drive.monitor, drive.injection, drive.config.campaign
    demanded = drive.demanded(cell)  # before the stop: at standstill there is no direction of travel
    elapsed_s = (drive.executor.now_ns - drive.setup.stack.simulation.start_stamp_ns) * 1e-9
    injection.add_fault(InjectedFault(topic=cell.topic, kind=cell.kind, from_s=elapsed_s, for_s=1e6))
    drive.executor.add_sink(drive.recorded.append)
    _pass_right_messages(drive, cell)
    monitor.reset()
    truth = monitor.truth
    assert truth is not None
    own, others = _identifiers(drive, cell)
    _run_until(drive, lambda: monitor.standstill_s >= config.standstill_s)
    stopped_s = monitor.seconds - monitor.standstill_s if monitor.standstill_s >= config.standstill_s else None
    travel_m, end_speed_mps = monitor.travel_m, max(monitor.speeds_mps, default=0.0)
    if demanded.is_named:  # a fault may be named after the stop
        _run_until(drive, lambda: named_after_s(monitor.alarms, own) is not None)
    now, braking = monitor.truth, on_grade(load_conditions(None).braking, monitor.steepest)
    assert now is not None
    highest_mps = max(abs(truth.speed_mps), monitor.fastest_mps)
    allowed_m = stopping_distance_m(highest_mps, braking.reaction_s, braking)
    measured = MeasuredReaction(
        abs(truth.speed_mps), allowed_m, travel_m, stopped_s, end_speed_mps, monitor.path_error_m,
        now.contacts - truth.contacts, now.zone_exits - truth.zone_exits, monitor.reason, dict(monitor.alarms),
    )  # fmt: skip
    return evaluate(cell, measured, config, demanded, own, others)


def _pass_right_messages(drive: Drive, cell: Cell) -> None:
    """Runs until the last right message of a fault that begins with one: what is recorded first is not wrong yet."""
    monitor, passed, replay_s = drive.monitor, drive.injection.faulty_items, drive.config.plausible.replay_s
    monitor.reset()
    if cell.kind is FaultKind.REPLAY:
        drive.executor.run(lambda: monitor.seconds >= replay_s)
    elif cell.kind in BEGINS_RIGHT:
        drive.executor.run(lambda: passed[cell.topic] > 0 or monitor.seconds >= replay_s)


def _run_until(drive: Drive, is_decided: Callable[[], bool]) -> None:
    """Continues until a condition holds, at most to the end of the observation."""
    observation_s = drive.config.campaign.observation_s
    with contextlib.suppress(LogError):  # of a full disk, after the stop
        drive.executor.run(lambda: is_decided() or drive.monitor.seconds >= observation_s)


def _identifiers(drive: Drive, cell: Cell) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Texts that name the device of a cell, and by topic those of the other devices."""
    writes = {node.name: node.writes for node, _ in drive.nodes}
    identifiers = {
        topic: Cell(cell.situation, topic, cell.kind).identifiers(drive.config.campaign, writes)
        for topic in drive.topics()
    }
    own = identifiers.pop(cell.topic)
    if cell.kind is FaultKind.SWAPPED:  # either of the two names the fault
        own += identifiers.pop(drive.injection.partner_of(cell.topic) or cell.topic)
    return own, {topic: texts for topic, texts in identifiers.items() if not topic.startswith("node/")}


def _write_log(drive: Drive, path: Path) -> None:
    """Writes the messages since the fault, for the analysis of a failed cell."""
    path.unlink(missing_ok=True)
    with LogWriter(path, {}, drive.setup.stack.datasets.log, drive.setup.viewer()) as log:
        for envelope in drive.recorded:
            log.write(envelope)


def _print_result(folder: Path, cell: Cell, left: int) -> None:
    try:
        row = json.loads((folder / f"{cell.name}.json").read_text(encoding="utf-8"))
    except OSError:
        sys.stderr.write(f"{cell.name}: no result\n")
        return
    travel = "did not stop" if row["travel_m"] is None else f"{row['travel_m']:.2f} m"
    allowed = "" if row["allowed_m"] is None else f" of {row['allowed_m']:.2f}"
    verdict = "passed" if row["passed"] else f"FAILED: {row['failure']}"
    sys.stderr.write(f"[{left} left] {cell.name}: {travel}{allowed}, {row['reason'] or 'no reason'}; {verdict}\n")

"""`headland live`: starts the processes, monitors the drive, kills one on request, and evaluates the stop."""

import argparse
import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from configs.strict import CONFIGS, load
from datasets.disk import check_room
from datasets.reader import LogScan
from interfaces.orders.port import OrderPort
from messages.errors import HeadlandError
from messages.message import Envelope
from runtime.commands.end_of_run import LATCHED, EndOfDrive, expected_s
from runtime.commands.live import ProcessKill
from runtime.commands.progress import Progress
from runtime.fault_injection.situations import DriveMonitor
from runtime.interruption import Interruption
from runtime.live.can_bus import LOOPBACK, named_bus, open_bus
from runtime.live.config import ROLES, LiveConfig
from runtime.live.operated import Operated
from runtime.live.process import Start, run_process, started_at
from runtime.live.ring import RingReader
from runtime.live.ring_folder import rings_in_memory
from runtime.live.serialization import unpack
from runtime.run_folder import RunFolder, resolved, versions
from runtime.setup import Setup, load_scenario, setup_from, start_notes
from simulation.scenario import Scenario

TOPICS = (
    "truth_machine",
    "supervisor",
    "mission",
    "odom",
    "path",
    "fault/supervisor",
    "fault/executor",
    "fault/gateway",
)
SIGNALS = {"KILL": signal.SIGKILL, "STOP": signal.SIGSTOP}
SHUTDOWN_S = 10.0  # time for a process to close its files
OBSERVATION_S = 10.0  # observation time after a process was killed
MACHINE_OBSERVATION_S = 2.0  # the same after the machine process, which published the true motion


def run_live(
    arguments: argparse.Namespace, folder: RunFolder, kill: ProcessKill | None, interruption: Interruption, bus: str
) -> int:
    """Drives and prints the result; 0 if the mission ended without a fault, or the machine stopped after the kill."""
    setup = setup_from(arguments)
    scenario = load_scenario(arguments.scenario, setup.mission, arguments.field)
    result = drive(setup, scenario, folder, kill, arguments.duration, arguments.reaction_trials, interruption, bus)
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else _summary(result))
    return 0 if result["passed"] else 1


def drive(
    setup: Setup,
    scenario: Scenario,
    folder: RunFolder,
    kill: ProcessKill | None,
    duration_s: float | None,
    reaction_trials: int,
    interruption: Interruption | None = None,
    bus: str | None = None,
    operated: Operated | None = None,
) -> dict[str, Any]:
    """Starts all processes, drives, and stops them; returns the result, which is also in the folder.

    `bus` is a name for `open_bus`; None is a loopback bus of this run's own.
    """
    bus = bus or named_bus(LOOPBACK)
    open_bus(bus).shutdown()  # before the start of the processes: raises HeadlandError
    config = load(LiveConfig, CONFIGS / "live.yaml")
    min_free_mb = setup.stack.datasets.log.min_free_mb
    check_room(folder.path, expected_s(setup.plan.length_m, duration_s), config.thinned_log.mb_per_s, min_free_mb)
    setup = started_at(setup, time.time_ns())
    text = resolved(mission=setup.mission, site=setup.site, machine=setup.vehicle, implement=setup.implement,
                    stack=setup.stack, scenario=scenario, live=config)  # fmt: skip
    folder.file("config.yaml").write_text(text, encoding="utf-8")
    for name in ("log.mcap", "events", "reactions.jsonl"):
        folder.file(name)
    port = OrderPort(0) if operated is None else operated.port
    conditions = versions() | {"seed": str(setup.seed), "bus": bus, "order_port": str(port.number)}
    with rings_in_memory(config.ring_mib) as rings:
        folder.record("conditions", conditions | {"rings": str(rings["safety"].parent)})
        if operated is not None:
            operated.announce(rings, text)
        context = multiprocessing.get_context("fork")  # common modules are loaded once; no thread is running yet
        barrier, zero = context.Barrier(len(ROLES) + 1), context.Value("q", 0, lock=False)
        starts = [
            Start(role, setup, scenario, config, bus, port, folder.path, rings,
                  {"run": conditions, "config": {"yaml": text}}, reaction_trials, barrier, zero,
                  os.getpid())
            for role in ROLES
        ]  # fmt: skip
        processes = {s.role: context.Process(target=run_process, args=(s,), name=s.role) for s in starts}
        try:
            _start(processes, barrier, zero, config)
            with folder.file("console.log").open("w") as file:
                progress = Progress((sys.stderr, file), start_notes(setup))
                end = EndOfDrive(setup.plan.length_m) if operated is None else None
                monitored = _Drive(processes, rings, end, progress)
                result = monitored.run(
                    kill, duration_s, lambda: 0 < reaction_trials <= len(_reaction_rows(folder.path))
                    or (interruption is not None and interruption.is_requested),
                )  # fmt: skip
        finally:
            _stop(processes)
            port.close()
    result |= {"reactions": _reactions(folder.path), "run_dir": str(folder.path)}
    result |= _log_end(folder.path / "log.mcap", setup.stack.simulation.start_stamp_ns)
    folder.record("result", {"result": result})
    folder.finish()
    return result


class _Drive:
    """Drive as observed by the parent process through the rings."""

    def __init__(
        self, processes: Mapping[str, BaseProcess], rings: dict[str, Path], end: EndOfDrive | None, progress: Progress
    ) -> None:
        self._processes = processes
        self._readers = [RingReader(path) for path in rings.values()]
        self._monitor, self._end = DriveMonitor(), end
        self._sinks = (self._monitor, progress) if end is None else (self._monitor, end, progress)

    def run(self, kill: ProcessKill | None, duration_s: float | None, is_enough: Callable[[], bool]) -> dict[str, Any]:
        """Monitors until the drive has ended, the duration is over, or the observation after a kill is complete."""
        while (
            not (self._end is not None and self._end.is_reached())
            and (duration_s is None or self._monitor.seconds < duration_s)
            and not is_enough()
        ):
            self._receive()
            if kill is not None and self._monitor.seconds >= kill[2]:
                return self._kill(*kill[:2])
            if dead := [name for name, process in self._processes.items() if not process.is_alive()]:
                return self._observe_stop({"died": dead[0]})
        state = self._monitor.state
        passed = kill is None and state is not None and state.mode not in LATCHED
        return {"outcome": "over" if state is None else state.mode.value, "passed": passed,
                "alarms": self._monitor.alarms, "simulated_s": round(self._monitor.seconds, 2)}  # fmt: skip

    def _kill(self, name: str, signal_name: str) -> dict[str, Any]:
        os.kill(self._processes[name].pid or 0, SIGNALS[signal_name])
        return self._observe_stop({"killed": name, "signal": signal_name, "at_s": round(self._monitor.seconds, 2)})

    def _observe_stop(self, about: dict[str, Any]) -> dict[str, Any]:
        """Measures the stop of the machine after the end of a process."""
        monitor, truth, state = self._monitor, self._monitor.truth, self._monitor.state
        speed = abs(truth.speed_mps) if truth is not None else 0.0
        stopping_distance_m = state.stopping_distance_m if state is not None else 0.0
        at_s = monitor.seconds
        monitor.reset()
        began_s, is_machine = time.monotonic(), about.get("killed") == "machine"
        while (
            time.monotonic() - began_s < (MACHINE_OBSERVATION_S if is_machine else OBSERVATION_S)
            and monitor.standstill_s < 1.0
        ):
            self._receive()
        is_observed, stopped = is_machine or monitor.seconds > 0.0, is_machine or monitor.standstill_s >= 1.0
        return about | {
            "speed_mps": round(speed, 3), "travel_m": round(monitor.travel_m, 3),
            "allowed_m": round(stopping_distance_m, 3),
            "until_s": round(at_s + monitor.seconds, 2), "reason": monitor.reason, "alarms": monitor.alarms,
            "outcome": "stopped" if stopped else "not stopped",
            "passed": is_observed and stopped and monitor.travel_m <= stopping_distance_m,
        }  # fmt: skip

    def _receive(self) -> None:
        now_ns = time.monotonic_ns()
        for reader in self._readers:
            for record in reader.records():
                if (output := unpack(record, TOPICS)) is not None:
                    envelope = Envelope(output[0], 0, now_ns, output[1])
                    for sink in self._sinks:
                        sink(envelope)
        time.sleep(0.005)


def _start(processes: Mapping[str, BaseProcess], barrier: Any, zero: Any, config: LiveConfig) -> None:
    """Starts all processes and waits until they are ready; raises HeadlandError at a failure or timeout."""
    for process in processes.values():
        process.start()
    began_s = time.monotonic()
    while barrier.n_waiting < len(processes):
        dead = [name for name, process in processes.items() if not process.is_alive()]
        if dead or time.monotonic() - began_s > config.startup_s:
            raise HeadlandError(f"process {dead[0] if dead else 'group'} did not start; see the messages above")
        time.sleep(0.05)
    barrier.wait(config.startup_s)
    zero.value = time.monotonic_ns()
    barrier.wait(config.startup_s)


def _stop(processes: Mapping[str, BaseProcess]) -> None:
    """Terminates all processes; kills those that do not end in time."""
    alive = [process for process in processes.values() if process.pid is not None and process.is_alive()]
    for process in alive:
        os.kill(process.pid or 0, signal.SIGTERM)
        os.kill(process.pid or 0, signal.SIGCONT)
    until_s = time.monotonic() + SHUTDOWN_S
    for process in alive:
        process.join(max(0.1, until_s - time.monotonic()))
        if process.is_alive():
            process.kill()
            process.join()


def _reaction_rows(folder: Path) -> list[str]:
    """Lines of `reactions.jsonl`, one per reaction."""
    path = folder / "reactions.jsonl"
    return path.read_text(encoding="utf-8").splitlines() if path.is_file() else []


def _reactions(folder: Path) -> dict[str, Any] | None:
    """Percentiles of the reaction times, None without reactions."""
    rows = [json.loads(line) for line in _reaction_rows(folder)]
    if not rows:
        return None
    found: dict[str, Any] = {"n": len(rows)}
    for name in ("appeared_to_frame_s", "scan_to_frame_s"):
        values = [row[name] for row in rows if row[name] is not None]
        if values:
            found[name] = {f"p{p}": round(float(np.percentile(values, p)), 4) for p in (50, 90, 99, 100)}
    return found


def _log_end(path: Path, start_ns: int) -> dict[str, Any]:
    """Number of readable log messages and time of the last one."""
    last_ns, count = start_ns, 0
    if path.is_file():
        for entry in LogScan(path):
            last_ns, count = max(last_ns, entry.receive_ns), count + 1
    return {"log_messages": count, "log_until_s": round((last_ns - start_ns) * 1e-9, 2)}


def _summary(result: dict[str, Any]) -> str:
    """Result as one line of text."""
    travel = f", travel {result['travel_m']} m of {result['allowed_m']} m" if "travel_m" in result else ""
    reactions = f", reactions {result['reactions']}" if result["reactions"] else ""
    return f"{result['outcome']}{travel}{reactions}; log until {result['log_until_s']} s; {result['run_dir']}\n"

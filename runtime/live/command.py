"""`headland live`: start the processes, watch the drive, break one if asked, and judge."""

import argparse
import contextlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from configs.strict import CONFIGS, find, load
from messages.errors import HeadlandError
from messages.message import Envelope
from runtime.commands.end_of_run import LATCHED, EndOfDrive
from runtime.commands.progress import Progress
from runtime.fault_injection.situations import Watch
from runtime.live.config import ROLES, LiveConfig
from runtime.live.process import Start, run_process, started_at
from runtime.live.ring import RingReader, make_ring
from runtime.live.serialization import unpack
from runtime.run_folder import RunFolder, resolved, versions
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario

WATCHED = (
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
GRACE_S = 10.0  # for a process to close what it has open
AFTER_S = 10.0  # watched after a process was broken
UNSEEN_S = 2.0  # the same when it was the machine, whose motion nobody tells any more

Broken = tuple[str, str, float]  # which process, by which signal, after how many seconds


def main(arguments: argparse.Namespace) -> int:
    """Drive; 0 when the mission ended well, or when the machine stood in time after what was broken."""
    broken = _broken(arguments.break_)
    setup = load_setup(arguments.mission, arguments.machine, arguments.implement, arguments.field, arguments.seed)
    scenario = load(Scenario, find("scenarios", arguments.scenario or ("empty" if arguments.field else "demo")))
    folder = RunFolder("live", arguments.out)
    result = drive(setup, scenario, folder, broken, arguments.for_s, arguments.reactions)
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else _told(result))
    return 0 if result["is_good"] else 1


def drive(
    setup: Setup, scenario: Scenario, folder: RunFolder, broken: Broken | None, for_s: float | None, reactions: int
) -> dict[str, Any]:
    """Start all processes, drive, and stop them; gives the result, which is in the folder too."""
    config = load(LiveConfig, CONFIGS / "live.yaml")
    setup = started_at(setup, time.time_ns())
    text = resolved(mission=setup.mission, site=setup.site, machine=setup.vehicle, implement=setup.implement,
                    stack=setup.stack, scenario=scenario, live=config)  # fmt: skip
    (folder.path / "config.yaml").write_text(text, encoding="utf-8")
    conditions = versions() | {"seed": str(setup.seed)}
    folder.record("conditions", conditions)
    with _rings(config) as rings:
        context = multiprocessing.get_context("fork")  # what all need is loaded once, and no thread runs yet
        barrier, zero = context.Barrier(len(ROLES) + 1), context.Value("q", 0, lock=False)
        starts = [
            Start(role, setup, scenario, config, folder.path, rings, {"run": conditions, "config": {"yaml": text}},
                  reactions, barrier, zero)
            for role in ROLES
        ]  # fmt: skip
        processes = {s.role: context.Process(target=run_process, args=(s,), name=s.role) for s in starts}
        try:
            _start(processes, barrier, zero, config)
            with (folder.path / "console.log").open("w") as file:
                watched = _Drive(processes, rings, setup.plan.length_m, Progress((sys.stderr, file)))
                result = watched.run(broken, for_s, lambda: 0 < reactions <= len(_measured(folder.path)))
        finally:
            _stop(processes)
    result |= {"reactions": _reactions(folder.path), "run_dir": str(folder.path)}
    result |= _log_end(folder.path / "log.mcap", setup.stack.simulation.start_stamp_ns)
    folder.record("result", {"result": result})
    folder.finish()
    return result


class _Drive:
    """The drive as the parent sees it, through the others' rings."""

    def __init__(
        self, processes: Mapping[str, BaseProcess], rings: dict[str, Path], length_m: float, progress: Progress
    ) -> None:
        self._processes = processes
        self._readers = [RingReader(path) for path in rings.values()]
        self._watch, self._end, self._progress = Watch(), EndOfDrive(length_m), progress

    def run(self, broken: Broken | None, for_s: float | None, is_enough: Callable[[], bool]) -> dict[str, Any]:
        """Until the drive is over or long enough, or the machine has had its time after what was broken."""
        while not self._end.is_reached() and (for_s is None or self._watch.seconds < for_s) and not is_enough():
            self._listen()
            if broken is not None and self._watch.seconds >= broken[2]:
                return self._break(*broken[:2])
            if dead := [name for name, process in self._processes.items() if not process.is_alive()]:
                return self._after({"died": dead[0]})
        state = self._watch.state
        is_good = broken is None and state is not None and state.mode not in LATCHED
        return {"outcome": "over" if state is None else state.mode.value, "is_good": is_good,
                "told": self._watch.told, "simulated_s": round(self._watch.seconds, 2)}  # fmt: skip

    def _break(self, name: str, how: str) -> dict[str, Any]:
        os.kill(self._processes[name].pid or 0, SIGNALS[how])
        return self._after({"broken": name, "how": how, "at_s": round(self._watch.seconds, 2)})

    def _after(self, about: dict[str, Any]) -> dict[str, Any]:
        """What becomes of the machine when a process is gone."""
        watch, truth, state = self._watch, self._watch.truth, self._watch.state
        speed = abs(truth.speed_mps) if truth is not None else 0.0
        stopping_distance_m = state.stopping_distance_m if state is not None else 0.0
        at_s = watch.seconds
        watch.mark()
        began_s, is_gone = time.monotonic(), about.get("broken") == "machine"
        while time.monotonic() - began_s < (UNSEEN_S if is_gone else AFTER_S) and watch.still_s < 1.0:
            self._listen()
        is_seen, stood = is_gone or watch.seconds > 0.0, is_gone or watch.still_s >= 1.0
        return about | {
            "speed_mps": round(speed, 3), "travel_m": round(watch.travel_m, 3),
            "allowed_m": round(stopping_distance_m, 3),
            "until_s": round(at_s + watch.seconds, 2), "reason": watch.reason, "told": watch.told,
            "outcome": "stopped" if stood else "not stopped",
            "is_good": is_seen and stood and watch.travel_m <= stopping_distance_m,
        }  # fmt: skip

    def _listen(self) -> None:
        now_ns = time.monotonic_ns()
        for reader in self._readers:
            for record in reader.records():
                if (output := unpack(record, WATCHED)) is not None:
                    envelope = Envelope(output[0], 0, now_ns, output[1])
                    for sink in (self._watch, self._end, self._progress):
                        sink(envelope)
        time.sleep(0.005)


def _start(processes: Mapping[str, BaseProcess], barrier: Any, zero: Any, config: LiveConfig) -> None:
    """Start all and wait until all are warm; raises HeadlandError when one does not get there."""
    for process in processes.values():
        process.start()
    began_s = time.monotonic()
    while barrier.n_waiting < len(processes):
        dead = [name for name, process in processes.items() if not process.is_alive()]
        if dead or time.monotonic() - began_s > config.start_s:
            raise HeadlandError(f"process {dead[0] if dead else 'set'} did not start; see above")
        time.sleep(0.05)
    barrier.wait(config.start_s)
    zero.value = time.monotonic_ns()
    barrier.wait(config.start_s)


def _stop(processes: Mapping[str, BaseProcess]) -> None:
    """End all; who does not listen is killed."""
    alive = [process for process in processes.values() if process.pid is not None and process.is_alive()]
    for process in alive:
        os.kill(process.pid or 0, signal.SIGTERM)
        os.kill(process.pid or 0, signal.SIGCONT)
    until_s = time.monotonic() + GRACE_S
    for process in alive:
        process.join(max(0.1, until_s - time.monotonic()))
        if process.is_alive():
            process.kill()
            process.join()


@contextlib.contextmanager
def _rings(config: LiveConfig) -> Iterator[dict[str, Path]]:
    """A ring for each process, in memory."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(prefix="headland-", dir=memory if memory.is_dir() else None))
    try:
        rings = {role: folder / role for role in ROLES}
        for role, path in rings.items():
            make_ring(path, config.ring_mib[role] << 20)
        yield rings
    finally:
        shutil.rmtree(folder)


def _broken(text: str | None) -> Broken | None:
    """NAME:SIGNAL:SECONDS, such as perception:KILL:20; raises HeadlandError."""
    if text is None:
        return None
    parts = text.split(":")
    if len(parts) != 3 or parts[0] not in ROLES or parts[1] not in SIGNALS:
        raise HeadlandError(f"--break {text}: PROCESS:SIGNAL:SECONDS with {', '.join(ROLES)} and KILL or STOP")
    try:
        return parts[0], parts[1], float(parts[2])
    except ValueError as error:
        raise HeadlandError(f"--break {text}: {parts[2]!r} is no time") from error


def _measured(folder: Path) -> list[str]:
    """A line for each reaction."""
    path = folder / "reactions.jsonl"
    return path.read_text(encoding="utf-8").splitlines() if path.is_file() else []


def _reactions(folder: Path) -> dict[str, Any] | None:
    """Percentiles of what was measured."""
    rows = [json.loads(line) for line in _measured(folder)]
    if not rows:
        return None
    found: dict[str, Any] = {"n": len(rows)}
    for name in ("appeared_to_frame_s", "scan_to_frame_s"):
        values = [row[name] for row in rows if row[name] is not None]
        if values:
            found[name] = {f"p{p}": round(float(np.percentile(values, p)), 4) for p in (50, 90, 99, 100)}
    return found


def _log_end(path: Path, start_ns: int) -> dict[str, Any]:
    """Up to when the log can be read."""
    from datasets.records import RawMessage, walk

    last_ns, count = start_ns, 0
    if path.is_file():
        for record in walk(path):
            if isinstance(record, RawMessage):
                last_ns, count = max(last_ns, record.receive_ns), count + 1
    return {"log_messages": count, "log_until_s": round((last_ns - start_ns) * 1e-9, 2)}


def _told(result: dict[str, Any]) -> str:
    """The result for the eye."""
    travel = f", travel {result['travel_m']} m of {result['allowed_m']} m" if "travel_m" in result else ""
    reactions = f", reactions {result['reactions']}" if result["reactions"] else ""
    return f"{result['outcome']}{travel}{reactions}; log until {result['log_until_s']} s; {result['run_dir']}\n"

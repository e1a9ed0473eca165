"""Time and memory of `validate` on a long log: 64 lidar rings at 10 Hz, camera, odometry, IMU, GNSS, 20 true objects.

    ./headland benchmark validate_hour [--minutes 60] [--log FILE.mcap] [--out FOLDER]

The log is generated, deterministic, and kept with --log (which also reads an existing one); --out keeps the results.
Memory is the peak of the sum over the process and its children, once a second: resident pages with shared ones, and
with each shared page divided by its users (PSS). Processor time is that of all processes and threads, on one core or
several. Exit code 1 above 1 GiB of resident pages or 0.5 s of processor time per second of the log.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.long_drive import VEHICLE, write_drive
from benchmarks.recordings import ROOT

MAX_BYTES = 1 << 30
MAX_SHARE = 0.5  # of real time
SAMPLE_S = 1.0
PROFILED = "--profiled"


def profiled(out: Path, words: list[str]) -> int:
    """Runs `validate` and writes the seconds spent in nodes, sinks, log and passes over the recording to `out`."""
    began_s = time.thread_time()
    from datasets.log import LogWriter
    from runtime import __main__, bus, executor
    from runtime.replay import evaluate, prepare
    from runtime.replay import replay as passes
    from runtime.replay.world import ReplayWorld
    from validation.obstacle_stop import evaluation
    from validation.obstacle_stop.consistency.observer import ConsistencyObserver
    from validation.obstacle_stop.observer import Observer

    spent: dict[str, float] = defaultdict(float)

    def timed(name: str | Callable[[Any], str], call: Callable[..., Any]) -> Callable[..., Any]:
        def run(first: Any, *rest: Any) -> Any:
            began_s = time.thread_time()
            try:
                return call(first, *rest)
            finally:
                spent[name if isinstance(name, str) else name(first)] += time.thread_time() - began_s

        return run

    executor.Executor._step = timed("nodes", executor.Executor._step)  # type: ignore[method-assign]
    initial = executor.Executor.__init__

    def with_timed_nodes(self: Any, world: Any, nodes: Any, *rest: Any) -> None:
        initial(self, world, nodes, *rest)
        for node, _ in nodes:
            node.step = timed(f"  node {node.name}", node.step)

    executor.Executor.__init__ = with_timed_nodes  # type: ignore[method-assign,assignment]
    bus.Bus._pass_to_sinks = timed("sinks", bus.Bus._pass_to_sinks)  # type: ignore[method-assign]
    for sink in (Observer, ConsistencyObserver):
        sink.__call__ = timed(f"  {sink.__name__}", sink.__call__)  # type: ignore[method-assign]
    LogWriter.write = timed("  log", LogWriter.write)  # type: ignore[method-assign]
    ReplayWorld.step = timed("reading", ReplayWorld.step)  # type: ignore[method-assign]
    prepare.prepare = timed("opening and inspection", prepare.prepare)
    passes.trajectory_before = timed("trajectory", passes.trajectory_before)
    evaluation.evaluate_log = timed("evaluation", evaluation.evaluate_log)
    evaluate._figures = timed("figures", evaluate._figures)
    sys.argv[1:] = words
    code = __main__.main()
    spent["main thread"] = time.thread_time() - began_s
    out.write_text(json.dumps(spent))
    return code


@dataclass(frozen=True)
class Measured:
    """Result of `validate`, seconds by part, processor and wall seconds, peaks of resident and proportional bytes."""

    result: dict[str, Any]
    spent: dict[str, float]
    used_s: float
    wall_s: float
    resident_bytes: int
    proportional_bytes: int


def validate(log: Path, folder: Path, out: Path) -> Measured:
    """Runs `validate` in a process of its own."""
    vehicle, spent = folder / "vehicle.yaml", folder / "spent.json"
    vehicle.write_text(VEHICLE)
    words = ["validate", str(log), "--vehicle", str(vehicle), "--json", "--out", str(out)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "benchmarks.validate_hour", PROFILED, str(spent), *words]
    began_s, peaks = time.monotonic(), (0, 0)
    with (folder / "stdout").open("w+") as stdout:
        process = subprocess.Popen(command, stdout=stdout, cwd=ROOT)
        while process.poll() is None:
            now = memory_of(process.pid)
            peaks = max(peaks[0], now[0]), max(peaks[1], now[1])
            time.sleep(SAMPLE_S)
        wall_s = time.monotonic() - began_s
        stdout.seek(0)
        text = stdout.read()
    if not text:
        raise SystemExit("validate wrote no result")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Measured(json.loads(text), json.loads(spent.read_text()), used_s, wall_s, *peaks)


def memory_of(pid: int) -> tuple[int, int]:
    """Resident and proportional bytes of a process and its children; 0 for one that has ended."""
    folder = Path(f"/proc/{pid}")
    try:
        lines = (folder / "smaps_rollup").read_text().splitlines()[1:]
        children = [int(word) for path in folder.glob("task/*/children") for word in path.read_text().split()]
    except OSError:
        return 0, 0
    own = {line.partition(":")[0]: int(line.split()[1]) * 1024 for line in lines}
    rows = [(own.get("Rss", 0), own.get("Pss", 0)), *map(memory_of, children)]
    return sum(row[0] for row in rows), sum(row[1] for row in rows)


def main() -> int:
    """Prints time, memory and the shares of the parts."""
    if sys.argv[1:2] == [PROFILED]:
        return profiled(Path(sys.argv[2]), sys.argv[3:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--log", type=Path, help="the generated log, kept; an existing one is used")
    parser.add_argument("--out", type=Path, help="folder of the results, kept")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.log.parent if arguments.log else None) as name:
        log = arguments.log or Path(name) / "drive.mcap"
        if not log.exists():
            began_s = time.monotonic()
            write_drive(log, 60.0 * arguments.minutes)
            print(f"generated in {time.monotonic() - began_s:.0f} s: {log.stat().st_size / 1e6:.0f} MB")
        out = arguments.out or Path(name) / "out"
        measured = validate(log, Path(name), out)
        replayed_mb = sum(p.stat().st_size for p in out.rglob("*.mcap")) / 1e6
    result, real_s, used_s = measured.result, measured.result["hours"] * 3600.0, measured.used_s
    print(f"{real_s:.0f} s of driving: {result['state']}, {len(result['encounters'])} encounters, "
          f"{result['false_stops']} false stops; replay.mcap {replayed_mb:.0f} MB")  # fmt: skip
    print(f"processor {used_s / real_s:.3f} x real time ({used_s:.1f} s), wall {measured.wall_s / real_s:.3f} x real "
          f"time ({measured.wall_s:.1f} s)")  # fmt: skip
    print(f"peak of resident memory {measured.resident_bytes / 2**20:.0f} MiB, proportional "
          f"{measured.proportional_bytes / 2**20:.0f} MiB")  # fmt: skip
    measured.spent["other threads"] = used_s - measured.spent["main thread"]
    for part, part_s in sorted(measured.spent.items(), key=lambda row: -row[1]):
        print(f"  {part:<28}{1e3 * part_s / real_s:8.2f} ms per s")
    return 1 if measured.resident_bytes > MAX_BYTES or used_s > MAX_SHARE * real_s else 0


if __name__ == "__main__":
    sys.exit(main())

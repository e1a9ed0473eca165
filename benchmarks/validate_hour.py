"""Time and memory of `validate` on a long log: 64 lidar rings at 10 Hz, camera, odometry, IMU, GNSS, 20 true objects.

    ./headland benchmark validate_hour [--minutes 60] [--log FILE.mcap]

The log is generated, deterministic, and kept with --log (which also reads an existing one). Exit code 1 above 1 GiB of
resident memory or 0.5 x real time on one core.
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
from pathlib import Path
from typing import Any

from benchmarks.long_drive import VEHICLE, write_drive
from benchmarks.recordings import ROOT

MAX_BYTES = 1 << 30
MAX_SHARE = 0.5  # of real time
PROFILED = "--profiled"


def profiled(out: Path, words: list[str]) -> int:
    """Runs `validate` and writes the seconds spent in nodes, sinks, log and passes over the recording to `out`."""
    from datasets.log import LogWriter
    from runtime import __main__, bus, executor
    from runtime.replay.world import ReplayWorld

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
    LogWriter.write = timed("  log", LogWriter.write)  # type: ignore[method-assign]
    ReplayWorld.step = timed("reading", ReplayWorld.step)  # type: ignore[method-assign]
    sys.argv[1:] = words
    began_s = time.thread_time()
    code = __main__.main()
    spent["validate"] = time.thread_time() - began_s
    out.write_text(json.dumps(spent))
    return code


def validate(log: Path, folder: Path) -> tuple[dict[str, Any], dict[str, float], float, int]:
    """Result of `validate` in a process of its own, seconds by part, processor seconds and peak bytes."""
    vehicle, spent = folder / "vehicle.yaml", folder / "spent.json"
    vehicle.write_text(VEHICLE)
    words = ["validate", str(log), "--vehicle", str(vehicle), "--json", "--out", str(folder / "out")]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "benchmarks.validate_hour", PROFILED, str(spent), *words]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, check=False)
    if not done.stdout:
        raise SystemExit("validate wrote no result")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return json.loads(done.stdout), json.loads(spent.read_text()), used_s, after.ru_maxrss * 1024


def main() -> int:
    """Prints time, memory and the shares of the parts."""
    if sys.argv[1:2] == [PROFILED]:
        return profiled(Path(sys.argv[2]), sys.argv[3:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--log", type=Path, help="the generated log, kept; an existing one is used")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.log.parent if arguments.log else None) as name:
        log = arguments.log or Path(name) / "drive.mcap"
        if not log.exists():
            began_s = time.monotonic()
            write_drive(log, 60.0 * arguments.minutes)
            print(f"generated in {time.monotonic() - began_s:.0f} s: {log.stat().st_size / 1e6:.0f} MB")
        result, spent, used_s, peak_bytes = validate(log, Path(name))
        replayed_mb = sum(p.stat().st_size for p in Path(name).rglob("*.mcap") if p != log) / 1e6
    real_s = result["hours"] * 3600.0
    print(f"{real_s:.0f} s of driving: {result['state']}, {len(result['encounters'])} encounters, "
          f"{result['false_stops']} false stops; replay.mcap {replayed_mb:.0f} MB")  # fmt: skip
    print(f"wall {spent['validate'] / real_s:.3f} x real time, processor {used_s / real_s:.3f} x real time "
          f"({used_s:.1f} s); peak {peak_bytes / 2**20:.0f} MiB")  # fmt: skip
    for part, part_s in sorted(spent.items(), key=lambda row: -row[1]):
        print(f"  {part:<28}{1e3 * part_s / real_s:8.2f} ms per s")
    return 1 if peak_bytes > MAX_BYTES or used_s > MAX_SHARE * real_s else 0


if __name__ == "__main__":
    sys.exit(main())

"""Computing time: wall seconds per simulated second of every node, the world and the log, against the budget.

    ./headland benchmark stack [--seconds 60] [--seed 1] [--scenario SCENARIO]

These are on one core; then the total on two, as `run` drives. Exit code 1 if the total on one core exceeds 0.8 s per
simulated second, or the 99th percentile of a node its latency.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from configs.strict import find, load
from datasets.log import LogWriter
from runtime.assembly import assemble
from runtime.bus import Sink
from runtime.executor import Executor
from runtime.node_process import node_process
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario

LIMIT = 0.8


def main() -> int:
    """Drives the first seconds of the demo mission and measures every step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenario", default="demo", help="name or file: its objects and its environment")
    arguments = parser.parse_args()
    scenario = load(Scenario, find("scenarios", arguments.scenario))
    setup, seconds = load_setup("demo", None, None, None, arguments.seed), arguments.seconds
    spent: dict[str, list[float]] = defaultdict(list)
    wall_s, latency_ns = drive(setup, scenario, seconds, spent)
    over = print_table(spent, latency_ns, wall_s, seconds)
    if len(os.sched_getaffinity(0)) > 1:
        both_s, _ = drive(setup, scenario, seconds, None)
        sys.stdout.write(f"{'total on two cores':<20}{both_s / seconds:>12.4f}\n")
    return 1 if over or wall_s > LIMIT * seconds else 0


def drive(
    setup: Setup, scenario: Scenario, seconds: float, spent: dict[str, list[float]] | None
) -> tuple[float, dict[str, int]]:
    """Wall time (s) of the first seconds of the demo mission, and the latencies of the nodes.

    On one core with the time of every step in `spent`; None: on two cores as `run`, without these times.
    """
    with (
        assemble(setup, scenario) as (world, nodes),
        node_process(nodes, 2 if spent is None else 1) as process,
        tempfile.TemporaryDirectory() as folder,
        LogWriter(Path(folder) / "log.mcap", {}, setup.stack.datasets.log, setup.viewer()) as log,
    ):
        write: Sink = log.write
        if spent is not None:
            for node, _ in nodes:
                node.step = timed(node.step, spent[node.name])  # type: ignore[method-assign]
            world.step = timed(world.step, spent["world"])  # type: ignore[method-assign]
            write = timed(write, spent["log"])
        executor = Executor(world, nodes, [write], process=process)
        start_ns, began_s = executor.now_ns, time.perf_counter()
        executor.run(lambda: executor.now_ns - start_ns > seconds * 1e9)
        return time.perf_counter() - began_s, {node.name: ns for node, ns in nodes}


def timed(function: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    """Function that records the wall time of every call, including the work of a returned generator."""

    def call(*arguments: Any) -> Any:
        began_s = time.perf_counter()
        result = function(*arguments)
        result = list(result) if result is not None else None
        spent.append(time.perf_counter() - began_s)
        return result

    return call


def print_table(
    spent: dict[str, list[float]], latency_ns: dict[str, int], wall_s: float, simulated_s: float
) -> list[str]:
    """Prints the table; returns the nodes over budget."""
    sys.stdout.write(f"{'part':<20}{'s per sim s':>12}{'median ms':>11}{'p99 ms':>9}{'budget ms':>11}\n")
    over = []
    for name, times in sorted(spent.items(), key=lambda item: -sum(item[1])):
        median, p99 = 1e3 * np.percentile(times, (50, 99))
        budget = latency_ns.get(name, 0) / 1e6
        is_over = 0 < budget < p99
        over += [name] if is_over else []
        mark = "  OVER" if is_over else ""
        row = f"{sum(times) / simulated_s:>12.4f}{median:>11.3f}{p99:>9.2f}{budget or float('nan'):>11.1f}{mark}"
        sys.stdout.write(f"{name:<20}{row}\n")
    rest = wall_s - sum(map(sum, spent.values()))
    sys.stdout.write(f"{'executor and bus':<20}{rest / simulated_s:>12.4f}\n")
    sys.stdout.write(f"{'total':<20}{wall_s / simulated_s:>12.4f}   limit {LIMIT}\n")
    return over


if __name__ == "__main__":
    sys.exit(main())

"""Compiles every numba kernel once, on all cores: `python -m runtime.commands.warm_up`."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import can

from configs.strict import find, load
from runtime.assembly import locating, seeing, simulated
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario


def main() -> None:
    """Build each room in a process of its own; numba keeps on disk what it compiled."""
    rooms = (_simulation, seeing, locating)
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        for built in [pool.submit(_build, room) for room in rooms]:
            built.result()


def _build(room: Callable[[Setup], object]) -> None:
    room(load_setup("demo", None, None, None, 1, None))


def _simulation(setup: Setup) -> None:
    with can.Bus(interface="virtual", channel="kernels") as bus:
        simulated(setup, load(Scenario, find("scenarios", "demo")), bus).close()


if __name__ == "__main__":
    main()

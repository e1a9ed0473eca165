"""Compiles every numba kernel once, on all cores: `python -m runtime.commands.warm_up`."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import can

from configs.strict import find, load
from messages.node import Node
from runtime.assembly import localization_nodes, simulated_world
from runtime.perception_nodes import perception_nodes
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario


def main() -> None:
    """Builds each part of the stack in its own process; numba caches the compiled code on disk."""
    parts = (_simulation, _perception, localization_nodes)
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        for built in [pool.submit(_build, part) for part in parts]:
            built.result()


def _build(part: Callable[[Setup], object]) -> None:
    part(load_setup("demo", None, None, None, 1, None))


def _simulation(setup: Setup) -> None:
    with can.Bus(interface="virtual", channel="kernels") as bus:
        simulated_world(setup, load(Scenario, find("scenarios", "demo")), bus).close()


def _perception(setup: Setup) -> list[Node]:
    return perception_nodes(setup.vehicle, setup.implement, setup.stack.perception)


if __name__ == "__main__":
    main()

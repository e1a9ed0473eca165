"""Compiles every numba kernel once, on all cores: `python -m runtime.commands.warm_up`."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

import can

from configs.strict import find, load
from runtime.assembly import localization_nodes, simulated_world
from runtime.perception_nodes import perception_nodes
from runtime.safety_nodes import safety_nodes
from runtime.setup import Setup, load_setup
from simulation.scenario import Scenario


def main() -> None:
    """Builds each part of the stack in its own process; numba caches the compiled code on disk.

    Only the mission `demo` compiles the planner of field work, which takes longest.
    """
    parts = (_planning, _simulation, _safety, _perception, _localization)
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        for built in [pool.submit(part) for part in parts]:
            built.result()


def _setup(mission: str) -> Setup:
    return load_setup(mission, None, None, None, 1, None)


def _planning() -> None:
    _setup("demo")


def _simulation() -> None:
    with can.Bus(interface="virtual", channel="kernels") as bus:
        simulated_world(_setup("line"), load(Scenario, find("scenarios", "empty")), bus).close()


def _safety() -> None:
    with can.Bus(interface="virtual", channel="kernels") as bus:
        safety_nodes(_setup("line"), bus, is_ablation=False)


def _perception() -> None:
    setup = _setup("line")
    perception_nodes(setup.vehicle, setup.implement, setup.stack.perception)


def _localization() -> None:
    localization_nodes(_setup("line"))


if __name__ == "__main__":
    main()

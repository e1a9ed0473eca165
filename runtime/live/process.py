"""What each process of `headland live` is and does."""

import gc
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

from datasets.log import LogWriter
from messages.errors import HeadlandError, LogError
from messages.node import Node, World
from runtime import assembly
from runtime.live.can_bus import SharedBus
from runtime.live.clock import Clock
from runtime.live.config import LiveConfig, open_bus
from runtime.live.live_executor import Line, LiveExecutor, Nothing
from runtime.live.reactions import Reactions
from runtime.live.ring import RingReader, RingWriter
from runtime.setup import Setup
from simulation.rendering.materials import build_actor_surfaces
from simulation.scenario import Scenario


@dataclass(frozen=True)
class Start:
    """What a process is given at its start; `zero_ns` is set by the parent between the two meetings at `barrier`."""

    role: str
    setup: Setup
    scenario: Scenario
    config: LiveConfig
    folder: Path
    rings: dict[str, Path]
    metadata: dict[str, dict[str, str]]
    reactions: int
    barrier: Barrier
    zero_ns: Any


def run_process(start: Start) -> None:
    """The life of one process, until SIGTERM; what it dies of is told on standard error."""
    is_over: list[int] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's matter
    signal.signal(signal.SIGTERM, lambda number, frame: is_over.append(number))
    try:
        _live(start, is_over)
    except HeadlandError as error:
        sys.stderr.write(f"headland: {start.role}: {error}\n")
        sys.exit(2)
    except Exception:
        sys.stderr.write(f"headland: {start.role} failed: {traceback.format_exc()}")
        sys.exit(3)


def _live(start: Start, is_over: list[int]) -> None:
    others = {name: RingReader(path) for name, path in start.rings.items() if name != start.role}
    line = Line(RingWriter(start.rings[start.role]), others, start.config.silent_s if start.role == "safety" else {})
    with _parts(start) as (world, nodes, sinks):
        gc.collect()
        gc.freeze()  # a collection that walks through all that was built takes 0.1 s
        start.barrier.wait(start.config.start_s)
        start.barrier.wait(start.config.start_s)
        clock = Clock(start.setup.stack.simulation.start_stamp_ns, start.zero_ns.value)
        executor = LiveExecutor(world, nodes, sinks, clock, line, hears_all=start.role == "log")
        try:
            executor.run(lambda: bool(is_over))
        except LogError as error:
            sys.stderr.write(f"headland: {error}\n")


@contextmanager
def _parts(start: Start) -> Iterator[tuple[World, list[Node], list[Any]]]:
    """World, nodes and sinks of a process."""
    if start.role == "machine":
        with _machine(start) as world:
            yield world, [], []
    elif start.role == "log":
        config = start.setup.stack.datasets.log
        with LogWriter(start.folder / "log.mcap", start.metadata, config, start.setup.viewer()) as log:
            yield Nothing(), [], [log.write]
    elif start.role == "safety":
        with closing_bus(SharedBus(open_bus(start.config.can))) as bus:
            yield Nothing(), assembly.guarding(start.setup, bus, is_ablation=False), []
    else:
        yield Nothing(), _stack_nodes(start), []


def _stack_nodes(start: Start) -> list[Node]:
    """Those that neither see nor touch the machine's bus; control goes with the pose, which it follows at its rate."""
    if start.role == "perception":
        return assembly.seeing(start.setup)
    if start.role == "planning":
        return assembly.planning(start.setup)
    return [*assembly.locating(start.setup), *assembly.steering(start.setup)]


@contextmanager
def _machine(start: Start) -> Iterator[World]:
    bus = SharedBus(open_bus(start.config.can))
    with closing(assembly.simulated(start.setup, start.scenario, bus, renders_in_thread=True)) as world:
        build_actor_surfaces()
        yield Reactions(world, bus, start) if start.reactions else world


@contextmanager
def closing_bus(bus: Any) -> Iterator[Any]:
    """The bus, left at the end."""
    try:
        yield bus
    finally:
        bus.shutdown()


def started_at(setup: Setup, start_stamp_ns: int) -> Setup:
    """The same set-up with its world's clock beginning at this time."""
    simulation = setup.stack.simulation.model_copy(update={"start_stamp_ns": start_stamp_ns})
    return replace(setup, stack=setup.stack.model_copy(update={"simulation": simulation}))

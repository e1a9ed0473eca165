"""Processes of `headland live`: world, nodes and sinks of each role."""

import ctypes
import gc
import os
import secrets
import signal
import sys
import time
import traceback
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

from datasets.log import LogWriter
from interfaces.orders.port import OrderPort
from messages.errors import HeadlandError, LogError
from messages.node import Node, Output, World
from runtime import assembly
from runtime.live.can_bus import PunctualBus, open_bus
from runtime.live.clock import Clock
from runtime.live.config import LiveConfig
from runtime.live.live_executor import LiveExecutor, NoWorld, ProcessLinks
from runtime.live.reactions import ReactionTrials
from runtime.live.ring import RingReader, RingWriter
from runtime.live.thinned_log import NO_IMAGES_S, THINNED, ThinnedLog
from runtime.order_gate import order_gate
from runtime.perception_nodes import perception_nodes
from runtime.processes import begin_worker, end_with_parent
from runtime.run_folder import ROOT
from runtime.safety_nodes import safety_nodes
from runtime.setup import Setup
from simulation.rendering.materials import build_actor_surfaces
from simulation.scenario import Scenario
from simulation.world import Rendering

M_MMAP_THRESHOLD, LARGE_BYTES = -3, 128 << 10  # <malloc.h>: scans and images go back to the system when they are freed


@dataclass(frozen=True)
class Start:
    """Start parameters of a process; the parent sets `zero_ns` between the two waits at `barrier`."""

    role: str
    setup: Setup
    scenario: Scenario
    config: LiveConfig
    bus: str
    order_port: OrderPort
    folder: Path
    rings: dict[str, Path]
    metadata: dict[str, dict[str, str]]
    reaction_trials: int
    barrier: Barrier
    zero_ns: Any
    parent: int

    def clock(self) -> Clock:
        """Clock of all processes, once the parent has set `zero_ns`."""
        return Clock(self.setup.stack.simulation.start_stamp_ns, self.zero_ns.value)


def run_process(start: Start) -> None:
    """Runs one process until SIGTERM; errors go to standard error."""
    begin_worker(start.parent)
    try:
        _run(start)
    except HeadlandError as error:
        sys.stderr.write(f"headland: {start.role}: {error}\n")
        sys.exit(2)
    except Exception:
        sys.stderr.write(f"headland: {start.role} failed: {traceback.format_exc()}")
        sys.exit(3)


def _run(start: Start) -> None:
    others = {name: RingReader(path) for name, path in start.rings.items() if name != start.role}
    timeouts = start.config.timeout_s if start.role == "safety" else {}
    links = ProcessLinks(RingWriter(start.rings[start.role]), others, timeouts, start.config.settle_s)
    with _parts(start) as (world, nodes, sinks):
        gc.collect()
        gc.freeze()  # a full garbage collection takes 0.1 s
        stop_signals: list[int] = []
        take_priority(start.role, start.config)
        wait_for_start(start.barrier, start.parent, start.config.startup_s)
        signal.signal(signal.SIGTERM, lambda number, frame: stop_signals.append(number))
        executor = LiveExecutor(world, nodes, sinks, start.clock(), links, reads_all=start.role == "log")
        try:
            executor.run(lambda: bool(stop_signals))
        except LogError as error:
            sys.stderr.write(f"headland: {error}\n")


def wait_for_start(barrier: Barrier, parent: int, limit_s: float) -> None:
    """Waits until all processes are ready and the clock is set; SIGTERM, or the end of the parent, ends this one."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(0))  # closes its files
    end_with_parent(parent, signal.SIGTERM)
    barrier.wait(limit_s)
    barrier.wait(limit_s)


def take_priority(role: str, config: LiveConfig) -> None:
    """Takes the configured priority for this thread; threads that it starts, such as for images, have none."""
    try:
        os.nice(config.nice.get(role, 0))
        if role in config.realtime:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(config.realtime[role]))
    except PermissionError:
        if role == "safety":
            sys.stderr.write("headland: no permission for real-time priority: a busy computer may stop the machine\n")


@contextmanager
def _parts(start: Start) -> Iterator[tuple[World, list[Node], list[Any]]]:
    """World, nodes and sinks of a process by its role."""
    if start.role == "machine":
        with _machine(start) as world:
            yield world, [], []
    elif start.role == "log":
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        config = start.setup.stack.datasets.log
        thinned = start.config.thinned_log
        metadata = start.metadata | {THINNED: {"left_out": ", ".join(thinned.left_out)}}
        viewer = start.setup.viewer(image_s=thinned.image_s, cloud_s=thinned.cloud_s)
        event_viewer = start.setup.viewer(image_s=NO_IMAGES_S)
        with (
            LogWriter(start.folder / "log.mcap", metadata, config, viewer, rotates=True) as log,
            closing(ThinnedLog(log, start.folder / "events", thinned, config, event_viewer)) as sink,
        ):
            yield NoWorld(), [], [sink]
    elif start.role == "safety":
        gate = order_gate(start.setup, ROOT / start.config.order_folder, start.order_port)
        with closing_bus(open_bus(start.bus)) as bus:
            yield NoWorld(), [gate, *safety_nodes(start.setup, bus, is_ablation=False)], []
    else:
        yield NoWorld(), _stack_nodes(start), []


def _stack_nodes(start: Start) -> list[Node]:
    """Nodes without access to the CAN bus; the controller shares a process with the localizer, whose rate it has."""
    if start.role == "perception":
        setup = start.setup
        return perception_nodes(setup.vehicle, setup.implement, setup.stack.perception)
    if start.role == "planning":
        return assembly.planning_nodes(start.setup)
    return [*assembly.localization_nodes(start.setup), *assembly.control_nodes(start.setup)]


@contextmanager
def _machine(start: Start) -> Iterator[World]:
    bus = open_bus(start.bus)
    punctual = PunctualBus(bus)
    with closing(assembly.simulated_world(start.setup, start.scenario, punctual, Rendering.LATE)) as world:
        build_actor_surfaces()
        yield LateWorld(ReactionTrials(world, bus, start) if start.reaction_trials else world, punctual, start)


class LateWorld(World):
    """Simulated world that a scan makes late; its machine receives each frame at the time at which it arrived."""

    def __init__(self, world: World, bus: PunctualBus, start: Start) -> None:
        self.writes = world.writes
        self._world, self._bus, self._start = world, bus, start

    @cached_property
    def _clock(self) -> Clock:
        return self._start.clock()

    def next_ns(self) -> int | None:
        """Time of the next step of the world."""
        return self._world.next_ns()

    def step(self, now_ns: int) -> Iterable[Output]:
        """Steps the world, with the frames up to its own time."""
        late_s = (self._clock() - now_ns) * 1e-9
        self._bus.until_s = time.time() - late_s
        return self._world.step(now_ns)


@contextmanager
def closing_bus(bus: Any) -> Iterator[Any]:
    """Context that closes the bus at its end."""
    try:
        yield bus
    finally:
        bus.shutdown()


def started_at(setup: Setup, start_stamp_ns: int) -> Setup:
    """Setup whose world clock starts at this time (ns), with a new session."""
    simulation = setup.stack.simulation.model_copy(update={"start_stamp_ns": start_stamp_ns})
    return replace(
        setup, session=secrets.token_hex(16), stack=setup.stack.model_copy(update={"simulation": simulation})
    )

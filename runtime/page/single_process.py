"""Simulation of the page with one executor: that of `run`, not faster than real time, with orders from a port.

On a slow computer simulated time falls behind; the separate processes of `live` would miss their heartbeats there.
"""

import os
import sys
import time
from collections.abc import Callable

from datasets.log import LogWriter
from hmi.feed import is_recorded, is_shown
from messages.message import Envelope
from runtime.assembly import assemble
from runtime.commands.progress import Progress
from runtime.executor import Executor
from runtime.interruption import Interruption
from runtime.live.operated import Operated
from runtime.live.ring import RingWriter
from runtime.live.ring_folder import rings_in_memory
from runtime.live.serialization import header, pack
from runtime.node_process import node_process
from runtime.page.views import SCHEMAS
from runtime.run_folder import RunFolder, resolved, versions
from runtime.setup import Setup, start_notes
from simulation.scenario import Scenario

RING_MIB = 64
SCAN_NS = 400_000_000  # between two scans of a lidar or images of a camera that a page may show or record
LAG_S = 0.5  # a simulation that has fallen behind does not catch up more than this


def drive_in_one_process(
    setup: Setup, scenario: Scenario, folder: RunFolder, interruption: Interruption, operated: Operated,
    has_views: bool,
) -> None:  # fmt: skip
    """Drives until it is interrupted, into the log of the folder; raises LogError."""
    text = resolved(mission=setup.mission, site=setup.site, machine=setup.vehicle, implement=setup.implement,
                    stack=setup.stack, scenario=scenario)  # fmt: skip
    folder.file("config.yaml").write_text(text, encoding="utf-8")
    conditions = versions() | {"seed": str(setup.seed)}
    folder.record("conditions", conditions)
    metadata = {"run": conditions, "config": {"yaml": text}}
    with rings_in_memory({"simulation": RING_MIB}) as rings:
        operated.announce(rings, text)
        ring = RingWriter(rings["simulation"])
        log_path = folder.file("log.mcap")
        with (
            assemble(setup, scenario, order_port=operated.port) as (world, nodes),
            node_process(nodes, len(os.sched_getaffinity(0))) as process,
            folder.file("console.log").open("w") as console,
            LogWriter(log_path, metadata, setup.stack.datasets.log, setup.viewer(), rotates=True) as log,
        ):
            sinks = (log.write, Progress((sys.stderr, console), start_notes(setup)), ring_sink(ring, has_views))
            executor = Executor(world, nodes, sinks, process=process)
            executor.run(_paced(executor, lambda: interruption.is_requested))
    folder.finish()


def ring_sink(ring: RingWriter, has_views: bool = False) -> Callable[[Envelope], None]:
    """Messages that the page shows or records, of the others the topic alone, which it counts.

    Scans and images are thinned. With `has_views` also what the viewer topics need.
    """
    thinned = SCHEMAS.keys() if has_views else {"lidar", "camera"}
    scanned_ns: dict[str, int] = {}

    def write(envelope: Envelope) -> None:
        topic, now_ns = envelope.topic, envelope.receive_ns
        is_whole = is_shown(topic) or is_recorded(topic)
        if topic.partition("/")[0] in thinned:
            is_whole = now_ns - scanned_ns.get(topic, -SCAN_NS) >= SCAN_NS
            scanned_ns[topic] = now_ns if is_whole else scanned_ns.get(topic, now_ns)
        ring.write(pack((envelope.topic, envelope.message)) if is_whole else header(envelope.topic))

    return write


def _paced(executor: Executor, is_done: Callable[[], bool]) -> Callable[[], bool]:
    """End condition that sleeps while simulated time is ahead of real time."""
    offset_s = time.monotonic() - executor.now_ns * 1e-9

    def is_done_now() -> bool:
        nonlocal offset_s
        ahead_s = executor.now_ns * 1e-9 + offset_s - time.monotonic()
        if ahead_s > 0.0:
            time.sleep(min(ahead_s, LAG_S))
        elif ahead_s < -LAG_S:
            offset_s -= ahead_s + LAG_S
        return is_done()

    return is_done_now

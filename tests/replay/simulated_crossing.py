"""Log of a short simulated drive with a person who crosses the path."""

import fcntl
from pathlib import Path

import pytest

from configs.strict import parse
from datasets.log import LogWriter
from messages.message import Envelope
from runtime.assembly import assemble
from runtime.executor import Executor
from runtime.run_folder import resolved
from runtime.setup import load_setup
from simulation.scenario import Scenario
from tests.scenarios.straight import on_a_line

SECONDS = 33.0
SCENARIO = parse(
    Scenario,
    {
        "name": "crossing", "operator_commands": [{"at_s": 0.5, "command": "start", "expires_s": 5.0}],
        "encounters": [{
            "kind": "crossing", "name": "person", "actor": "person", "expected_stops": 1,
            "swath_fraction": [0.72, 0.74], "start_lateral_m": [4.0, 4.1], "skew_deg": [0.0, 1.0],
            "walk_speed_mps": [1.4, 1.5], "leave_speed_mps": [1.4, 1.5],
            "arrival_margin_s": [1.5, 1.6], "extra_stand_s": [4.5, 4.6],
        }],
    },
    "crossing",
)  # fmt: skip


def crossing(path: Path) -> Path:
    """Drives along a straight line in the demo field, from standstill until after the stop; returns the log."""
    setup = on_a_line(load_setup("yard", None, None, None, 1), 50.0, 10.0)
    config = resolved(
        mission=setup.mission, site=setup.site, machine=setup.vehicle, implement=setup.implement, stack=setup.stack,
        scenario=SCENARIO,
    )  # fmt: skip
    with (
        assemble(setup, SCENARIO) as (world, nodes),
        LogWriter(path, {"config": {"yaml": config}}, setup.stack.datasets.log, setup.viewer()) as log,
    ):
        failures: list[Envelope] = []
        executor = Executor(
            world, nodes, (log.write, lambda e: failures.append(e) if e.topic == "fault/executor" else None)
        )
        end_ns = executor.now_ns + round(SECONDS * 1e9)
        executor.run(lambda: executor.now_ns >= end_ns)
    assert not failures, failures[0].message
    return path


def crossing_of_session(factory: pytest.TempPathFactory) -> Path:
    """The log, driven once for all workers and folders of the test session."""
    top = factory.getbasetemp()
    top = top.parent if top.name.startswith("popen-") else top  # a worker's own folder
    path = top / "crossing.mcap"
    with (top / "crossing.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            crossing(top / "incomplete.mcap").rename(path)
    return path

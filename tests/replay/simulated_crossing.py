"""Log of a short simulated drive with a person who crosses the path."""

from pathlib import Path

from configs.strict import parse
from datasets.log import LogWriter
from messages.message import Envelope
from runtime.assembly import assemble
from runtime.executor import Executor
from runtime.run_folder import resolved
from runtime.setup import load_setup
from simulation.scenario import Scenario
from tests.scenarios.straight import on_a_line

SECONDS = 27.0
SCENARIO = parse(
    Scenario,
    {
        "name": "crossing", "operator_commands": [{"at_s": 3.0, "command": "start", "expires_s": 5.0}],
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

"""The entire stack in closed loop, in short drives; the campaign runs the demo mission."""

import io
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from messages.command import ControlCommand, Mode, SafeCommand
from messages.truth import TrueMachine
from runtime.setup import Setup, load_scenario, load_setup
from runtime.simulated_drive import drive_into_log
from simulation.faults.config import FaultKind, InjectedFault
from tests.scenarios.forward import Drive, forward, starting_early

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def setup() -> Setup:
    return load_setup("yard", None, None, None, 1)


def speed(drive: Drive) -> float:
    return drive.last("truth_machine", TrueMachine).speed_mps


def test_yard_exit_after_start_warning(setup: Setup) -> None:
    drive = forward(
        setup,
        lambda d: "control_command" in d.newest and d.last("control_command", ControlCommand).path_s_m > 12.0,
        25.0,
        starting_early("empty"),
    )
    assert drive.modes == ["standby", "start_warning", "automatic"]
    truth, control_command = drive.last("truth_machine", TrueMachine), drive.last("control_command", ControlCommand)
    assert speed(drive) > 1.5
    assert abs(control_command.xte_m) < 0.05
    assert abs(truth.T_map_base[0, 3] - 20.0) < 0.08  # the lane runs north along x = 20 m


@pytest.mark.parametrize(
    ("topic", "kind", "reason"),
    [
        ("node/localizer", FaultKind.RAISES, "node.exception"),
        ("node/localizer", FaultKind.HANGS, "odom.silent"),
        ("lidar/front", FaultKind.OFF, "lidar/front.silent"),
    ],
)
def test_failure_stop_and_reason(setup: Setup, topic: str, kind: FaultKind, reason: str) -> None:
    def stands(d: Drive) -> bool:
        assert d.failure is None or "injected fault" in d.failure
        d.failure = None
        is_stopped = "safe_command" in d.newest and d.last("safe_command", SafeCommand).mode is Mode.FAULT_STOP
        return is_stopped and abs(speed(d)) < 0.02

    faults = (InjectedFault(topic=topic, kind=kind, from_s=5.5, for_s=60.0),)
    drive = forward(setup, stands, 17.5, starting_early("empty"), faults=faults)
    assert "automatic" in drive.modes
    assert drive.last("safe_command", SafeCommand).reason == reason


DIGEST = """
import sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.scenarios.forward import forward, starting_early
from datasets.log import LogWriter
from runtime.setup import load_setup
for seed, is_driving in {drives}:
    setup = load_setup("yard", None, None, None, seed)
    with LogWriter(Path(sys.argv[1]) / f"{{seed}}-{{is_driving}}.mcap", {{}}, setup.stack.datasets.log, None) as log:
        if is_driving:
            forward(
                setup, lambda d: "control_command" in d.newest and d.newest["control_command"].path_s_m > 2.0, 20.0,
                starting_early("empty"), sinks=(log.write,),
            )
        else:
            forward(setup, lambda d: "lidar/front" in d.newest, 1.0, sinks=(log.write,))
        print(log.digest())
"""


def digests_of(folder: Path, *drives: tuple[int, bool]) -> list[str]:
    """Digests of drives in a new process: the seed of each, and whether it drives or ends with the first scan."""
    folder.mkdir()
    program = DIGEST.format(root=str(ROOT), drives=drives)
    done = subprocess.run([sys.executable, "-c", program, str(folder)], capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_digest_by_seed_across_processes(tmp_path: Path) -> None:
    one, other, first = digests_of(tmp_path / "first", (1, False), (2, False), (1, True))
    (again,) = digests_of(tmp_path / "again", (1, True))
    assert [len(digest) for digest in (one, other, first)] == [32, 32, 32]
    assert first == again
    assert one != other


@pytest.mark.parametrize(
    "faults", [(), (InjectedFault(topic="node/localizer", kind=FaultKind.RAISES, from_s=6.5, for_s=60.0),)]
)
def test_same_digest_on_one_core_and_on_two(setup: Setup, tmp_path: Path, faults: tuple[InjectedFault, ...]) -> None:
    scenario = load_scenario("empty", setup.mission, None).model_copy(update={"faults": faults})
    digests = []
    for cores in (1, 2):
        folder = tmp_path / str(cores)
        folder.mkdir()
        digests.append(drive_into_log(setup, scenario, folder, {}, io.StringIO(), limit_s=7.5, cores=cores))
    assert len(digests[0]) == 32
    assert digests[0] == digests[1]


def test_standstill_before_start_command(setup: Setup) -> None:
    places: list[np.ndarray] = []

    def note(envelope) -> None:  # type: ignore[no-untyped-def]
        if isinstance(envelope.message, TrueMachine):
            places.append(envelope.message.T_map_base[:2, 3])

    forward(setup, lambda d: "start_warning" in d.modes, 6.0, sinks=(note,))
    assert np.ptp(places, axis=0).max() < 0.01


def test_implement_too_heavy_to_pull_stops_the_machine() -> None:
    setup = load_setup("line", None, None, None, 1)
    simulation = setup.stack.simulation
    heavy = simulation.machine.implement.model_copy(update={"draft_n_per_m": 4000.0, "max_draft_n": 24000.0})
    machine = simulation.machine.model_copy(update={"implement": heavy})
    stack = setup.stack.model_copy(update={"simulation": simulation.model_copy(update={"machine": machine})})

    def stands(d: Drive) -> bool:
        return "safe_command" in d.newest and d.last("safe_command", SafeCommand).mode is Mode.FAULT_STOP

    drive = forward(replace(setup, stack=stack), stands, 30.0, starting_early("empty"))
    assert drive.last("safe_command", SafeCommand).reason == "drive.not_following"

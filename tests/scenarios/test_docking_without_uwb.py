"""Docking without UWB: the machine stops before the shed and reports the reason."""

import numpy as np

from messages.plan import MissionState, MissionStatus
from messages.truth import TrueMachine
from runtime.setup import load_setup
from simulation.faults.config import FaultKind, InjectedFault
from tests.scenarios.forward import Drive, forward


def test_docking_aborted_without_uwb() -> None:
    setup = load_setup("dock", None, None, None, 1, "wide")

    def is_aborted(drive: Drive) -> bool:
        return "mission" in drive.newest and drive.last("mission", MissionStatus).state is MissionState.ABORTED

    faults = (InjectedFault(topic="uwb/main", kind=FaultKind.OFF, from_s=0.0, for_s=1e4),)
    drive = forward(setup, is_aborted, 30.0, faults=faults)
    assert "UWB" in drive.last("mission", MissionStatus).text
    truth, dock = drive.last("truth_machine", TrueMachine), setup.site.bay("wide").dock
    assert truth.contacts == 0
    assert np.hypot(truth.T_map_base[0, 3] - dock.x_m, truth.T_map_base[1, 3] - dock.y_m) > 5.0
    assert abs(truth.speed_mps) < 0.01

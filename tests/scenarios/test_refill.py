"""A refill stop in the closed loop: the machine stands at the place until it is ordered to go on."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from geometry.pose2 import Pose2
from messages.command import Mode, SafeCommand
from messages.message import Envelope
from messages.plan import MissionState, MissionStatus
from messages.truth import TrueMachine
from planning.path import spliced
from planning.plan import RefillStop
from planning.profile import limit_acceleration
from runtime.setup import Setup, load_setup
from simulation.scenario import ScenarioCommand
from tests.scenarios.forward import Drive, forward, starting_early
from tests.scenarios.straight import on_a_line

PLACE_M, LENGTH_M = 5.0, 9.0  # of the path
UNCONFIRMED_S, CONFIRMED_S = 16.0, 21.0


def with_a_stop(setup: Setup) -> Setup:
    """A straight path that is interrupted by a refill stop."""
    straight = on_a_line(setup, LENGTH_M, 8.0)
    (path,) = straight.plan.paths
    cut = path.index_at(PLACE_M)
    parts = [spliced([(path, a, b + 1)], k + 1) for k, (a, b) in enumerate(pairwise((0, cut, len(path.s_m) - 1)))]
    stops = [np.append(p.speed_mps[:-1], 0.0) for p in parts]
    limited = [limit_acceleration(v, p.s_m, setup.plan.rig) for v, p in zip(stops, parts, strict=True)]
    first, last = (
        replace(p, speed_mps=v, is_working=np.zeros(len(v), np.uint8), is_last=p is parts[-1])
        for p, v in zip(parts, limited, strict=True)
    )
    stop = RefillStop(1, "seed", Pose2(15.0 + PLACE_M, 25.0, 0.0), 100.0, PLACE_M, first.path_id)
    return replace(straight, plan=replace(straight.plan, paths=(first, last), refills=(stop,)))


def test_stands_at_the_place_until_a_confirmed_order() -> None:
    setup = with_a_stop(load_setup("yard", None, None, None, 1))
    places: list[tuple[float, float]] = []
    waited: list[tuple[float, str]] = []

    def note(envelope: Envelope) -> None:
        message, time_s = envelope.message, envelope.message.stamp_ns * 1e-9
        if isinstance(message, TrueMachine):
            places.append((time_s, float(message.T_map_base[0, 3]) - 15.0))
        elif isinstance(message, MissionStatus) and message.state is MissionState.WAITING and message.path_id >= 0:
            waited.append((time_s, message.text))

    def is_over(drive: Drive) -> bool:
        return bool(places) and places[-1][1] > PLACE_M + 1.5

    orders = (
        ScenarioCommand(at_s=UNCONFIRMED_S, command="start", expires_s=4.0, is_confirmed=False),
        ScenarioCommand(at_s=CONFIRMED_S, command="start", expires_s=4.0),
    )
    scenario = starting_early("empty")
    scenario = scenario.model_copy(update={"operator_commands": (*scenario.operator_commands, *orders)})
    drive = forward(setup, is_over, 60.0, scenario, sinks=(note,))
    assert drive.modes == ["standby", "start_warning", "automatic"] * 2
    began_s = places[0][0]
    assert {text for _, text in waited} == {"waiting at refill place 1 (seed) for the start command"}
    assert waited[0][0] - began_s < UNCONFIRMED_S - 1.0
    standing = [x for t, x in places if waited[0][0] + 1.0 < t < began_s + CONFIRMED_S + 2.5]
    assert np.ptp(standing) < 0.02
    assert abs(np.mean(standing) - PLACE_M) < 0.2
    assert drive.last("safe_command", SafeCommand).mode is Mode.AUTOMATIC

"""The mode machine with constructed situations."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from configs.vehicle import kmh
from messages.command import Mode, OperatorCommand, OperatorCommandKind
from messages.faults import Fault, Response, Severity
from messages.perception import ObstacleClass
from messages.plan import MissionState, MissionStatus, PathSectionType
from safety.mode_machine import ModeMachine, filter_permitted
from safety.modes import Event
from safety.rules import RULES
from safety.rules.arbitration import Decision, evaluate_rules
from safety.rules.results import limit
from safety.rules.situation import Situation
from safety.stopping_distance import required_range
from safety.supervisor_config import SupervisorConfig
from safety.zones.protective_field import Clearance
from safety.zones.standing_bodies import StandingBody
from tests.clause import clause
from tests.safety.safety_world import START_NS, around, machine_state, situation_of

STANDING: dict[str, Any] = {"speed_mps": 0.0}
FAULTY: dict[str, Any] = {"timed_out_topics": ("imu",)}
PRESSED = {"machine": machine_state(START_NS, is_emergency_button_pressed=True)}


def near(main_m: float) -> dict[str, Any]:
    return {"clearance": Clearance(main_m, math.inf, np.empty((0, 3)))}


def mission(state: MissionState) -> MissionStatus:
    return MissionStatus(START_NS, state, PathSectionType.SWATH, 1, 1, 0.0, 0.0, 1.0, "", ())


class Bench:
    """A mode machine and its last situation."""

    def __init__(self, config: SupervisorConfig) -> None:
        self.config, self.now_ns, self.sequence, self.confirms = config, START_NS, 0, True
        self.mode_machine = ModeMachine(config.modes)
        self.fault_memory = self.mode_machine.fault_memory
        self.situation: Situation = situation_of(config)
        self.decision: Decision = evaluate_rules(self.situation, RULES)

    def show(
        self, *orders: OperatorCommandKind, after_s: float = 0.02, state: MissionState | None = None, **changes: Any
    ) -> Mode:
        """The mode after a situation to which no rule objects, except for the changes."""
        self.now_ns += round(after_s * 1e9)
        self.situation = situation_of(self.config, now_ns=self.now_ns, **changes)
        self.decision = evaluate_rules(self.situation, RULES)
        given = tuple(one for kind in orders for one in self.given(kind))
        self.mode_machine.update(given, self.situation, self.decision, None if state is None else mission(state))
        return self.mode_machine.mode

    def given(self, kind: OperatorCommandKind) -> list[OperatorCommand]:
        """A command; a confirmation that nobody is near goes before a start, unless the bench is without."""
        if kind is OperatorCommandKind.CONFIRM_CLEAR:
            return [self.order(kind, 60.0)]
        start = kind is OperatorCommandKind.START and self.confirms
        return [*([self.order(OperatorCommandKind.CONFIRM_CLEAR, 60.0)] if start else []), self.order(kind)]

    def order(self, kind: OperatorCommandKind, expires_s: float = 1000.0) -> OperatorCommand:
        self.sequence += 1
        return OperatorCommand(self.now_ns, kind, "operator", self.sequence, self.now_ns + round(expires_s * 1e9))

    def driving(self) -> "Bench":
        self.show(OperatorCommandKind.START, **STANDING)
        self.show(**STANDING)
        assert self.show(after_s=3.0, **STANDING) is Mode.AUTOMATIC
        return self

    @property
    def reason(self) -> str:
        return self.mode_machine.reason(self.situation, self.decision)

    @property
    def clearance_m(self) -> float:
        return self.mode_machine.braking_clearance_m(self.situation, self.decision)


@pytest.fixture
def bench(config: SupervisorConfig) -> Bench:
    return Bench(config)


def test_start_warning_of_3_s(bench: Bench) -> None:
    assert (bench.mode_machine.mode, bench.reason) == (Mode.STANDBY, "standby")
    assert bench.show(OperatorCommandKind.START, **STANDING) is Mode.START_WARNING
    assert bench.reason == "start_warning"
    assert bench.show(**STANDING) is Mode.START_WARNING
    assert bench.show(after_s=2.999, **STANDING) is Mode.START_WARNING
    assert bench.show(after_s=0.001, **STANDING) is Mode.AUTOMATIC
    assert bench.reason == ""


@clause("BD-5.5.1b")
def test_start_after_power_on_needs_a_confirmation(bench: Bench) -> None:
    bench.confirms = False
    start, confirm = OperatorCommandKind.START, OperatorCommandKind.CONFIRM_CLEAR
    assert bench.show(start, **STANDING) is Mode.STANDBY
    assert bench.reason == "operator_command.unconfirmed"
    late = bench.order(confirm, 60.001)
    bench.mode_machine.update((late,), bench.situation, bench.decision, None)
    assert bench.show(**STANDING) is Mode.STANDBY  # a confirmation is valid for at most 60 s
    valid = bench.order(confirm, 60.0)
    bench.mode_machine.update((valid,), bench.situation, bench.decision, None)
    assert bench.mode_machine.mode is Mode.START_WARNING  # by the start that waits
    bench.show(OperatorCommandKind.PAUSE, **STANDING)
    assert bench.show(start, **STANDING) is Mode.START_WARNING  # the sensors watched since
    for kind in (OperatorCommandKind.MANUAL, OperatorCommandKind.AUTOMATIC, start):
        bench.show(kind, **STANDING)
    assert bench.mode_machine.mode is Mode.STANDBY  # who drove the machine may stand beside it


def test_a_confirmation_expires_and_ends_with_a_clock_step(config: SupervisorConfig) -> None:
    start, confirm = OperatorCommandKind.START, OperatorCommandKind.CONFIRM_CLEAR
    for after_s in around(60.0, 0.001):
        bench = Bench(config)
        bench.confirms = False
        bench.mode_machine.update((bench.order(confirm, 60.0),), bench.situation, bench.decision, None)
        assert (bench.show(start, after_s=after_s, **STANDING) is Mode.START_WARNING) == (after_s <= 60.0), after_s
    bench = Bench(config)
    bench.confirms = False
    bench.mode_machine.update((bench.order(confirm, 60.0),), bench.situation, bench.decision, None)
    bench.show(clock_step_s=1.0, **STANDING)
    assert bench.show(start, **STANDING) is Mode.STANDBY


def test_resume_after_2500_ms_clear_and_1500_ms_warning(bench: Bench) -> None:
    bench.driving()
    assert bench.show(**near(1.0)) is Mode.OBSTACLE_STOP
    assert bench.reason == "protective_field"
    assert bench.show(**STANDING) is Mode.OBSTACLE_STOP
    assert bench.mode_machine.resume_in_s(bench.now_ns) == 2.5
    bench.show(after_s=2.0, **STANDING)
    assert bench.mode_machine.resume_in_s(bench.now_ns) == pytest.approx(0.5)
    bench.show(**STANDING, **near(1.0))
    assert bench.mode_machine.resume_in_s(bench.now_ns) == 2.5
    assert bench.mode_machine.resume_in_s(bench.now_ns + 10**9) == 2.5
    bench.show(**STANDING)
    assert bench.show(after_s=2.499, **STANDING) is Mode.OBSTACLE_STOP
    assert bench.mode_machine.resume_in_s(bench.now_ns + 10**9) == 0.0
    assert bench.show(after_s=0.001, **STANDING) is Mode.START_WARNING
    assert bench.mode_machine.resume_in_s(bench.now_ns) == 0.0
    bench.show(**STANDING)
    assert bench.show(after_s=1.499, **STANDING) is Mode.START_WARNING
    assert bench.show(after_s=0.001, **STANDING) is Mode.AUTOMATIC
    bench.show(OperatorCommandKind.PAUSE, **STANDING)
    bench.show(OperatorCommandKind.START, **STANDING)
    bench.show(**STANDING)
    assert bench.show(after_s=2.9, **STANDING) is Mode.START_WARNING  # the full time again


@clause("BD-5.2.4")
def test_no_resume_while_a_departure_is_unresolved(bench: Bench) -> None:
    bench.driving()
    assert bench.show(**near(1.0)) is Mode.OBSTACLE_STOP
    lost: dict[str, Any] = {**STANDING, "is_departure_unresolved": True, "is_somebody_near": True}
    bench.show(**lost)
    assert (bench.show(after_s=2.4, **lost), bench.reason) == (Mode.OBSTACLE_STOP, "protective_field")
    assert (bench.show(after_s=0.1, **lost), bench.reason) == (Mode.OBSTACLE_STOP, "operator_command.unconfirmed")
    assert bench.show(after_s=60.0, **lost) is Mode.OBSTACLE_STOP
    assert bench.show(**STANDING) is Mode.START_WARNING
    assert bench.show(**lost) is Mode.START_WARNING
    assert (bench.show(after_s=1.5, **lost), bench.reason) == (Mode.OBSTACLE_STOP, "operator_command.unconfirmed")
    bench.show(**STANDING)
    bench.show(after_s=2.5, **STANDING)
    bench.show(**STANDING)
    assert bench.show(after_s=1.5, **STANDING) is Mode.AUTOMATIC
    assert bench.show(**lost | {"speed_mps": 1.0}) is Mode.AUTOMATIC  # only standstill shows whether it has left
    assert (bench.show(**lost), bench.reason) == (Mode.OBSTACLE_STOP, "operator_command.unconfirmed")


def test_resume_speed(config: SupervisorConfig) -> None:
    for distance in around(required_range(0.5, config.braking.flat, 2.1) + 1e-6, 0.005):
        bench = Bench(config).driving()
        bench.show(**near(1.0))
        bench.show(**STANDING, **near(distance))
        is_clear = bench.show(after_s=2.5, **STANDING, **near(distance)) is Mode.START_WARNING
        assert is_clear == (distance > required_range(0.5, config.braking.flat, 2.1)), distance


def test_obstacle_stop_at_standstill(bench: Bench) -> None:
    bench.driving()
    control_command = bench.situation.inputs.control_command
    assert control_command is not None
    for nothing in (None, replace(control_command, speed_mps=0.0)):
        assert bench.show(**STANDING, **near(1.0), control_command=nothing) is Mode.AUTOMATIC
    distance = required_range(2.0, bench.config.braking.flat, 0.0) + 0.05  # within the margin, not inside the distance
    assert bench.show(**near(distance), allowance_m=distance) is Mode.AUTOMATIC
    assert bench.show(**STANDING, **near(2.1 + 0.062)) is Mode.OBSTACLE_STOP
    assert bench.show(OperatorCommandKind.PAUSE, **STANDING) is Mode.STANDBY
    assert bench.show(OperatorCommandKind.START, **STANDING) is Mode.START_WARNING
    assert bench.show(**STANDING, **near(1.0), control_command=None) is Mode.START_WARNING
    assert bench.show(after_s=3.0, **STANDING, **near(1.0), control_command=None) is Mode.OBSTACLE_STOP


@clause("BD-5.2.4")
@pytest.mark.parametrize(("gone_s", "start_s"), [(0.4, 3.0), (0.5, 3.0), (0.6, 3.1), (3.0, 5.5), (3.1, None)])
def test_a_start_waits_until_the_path_was_clear_for_2500_ms(bench: Bench, gone_s: float, start_s: float | None) -> None:
    step = partial(bench.show, after_s=0.1, **STANDING)
    step(OperatorCommandKind.START)
    modes = [step(**(near(1.0) if 0.1 * k < gone_s - 1e-6 else {})) for k in range(60)]
    gone = Mode.OBSTACLE_STOP if start_s is None else Mode.AUTOMATIC
    first = modes.index(gone)
    assert modes[:first] == [Mode.START_WARNING] * first
    assert first == (30 if start_s is None else round(10 * start_s))


@clause("BD-5.2.4")
def test_a_machine_that_rolls_during_the_start_warning_stops_at_once(bench: Bench) -> None:
    bench.show(OperatorCommandKind.START, **STANDING)
    assert bench.show(**near(0.3), speed_mps=1.0) is Mode.OBSTACLE_STOP


def test_creep_speed(config: SupervisorConfig) -> None:
    least = required_range(config.modes.creep_mps, config.braking.flat, 2.1)
    for distance in around(least, 0.002):
        bench = Bench(config).driving()
        assert (bench.show(**STANDING, **near(distance + 1e-6)) is Mode.AUTOMATIC) == (distance >= least - 1e-9), (
            distance
        )


def test_creep_and_resume_speed_at_their_limits(bench: Bench) -> None:
    def show(after_s: float, allowed_mps: float) -> Mode:
        bench.now_ns += round(after_s * 1e9)
        situation = situation_of(bench.config, now_ns=bench.now_ns, **STANDING)
        blocking = limit("protective_field", allowed_mps, "ahead")
        bench.mode_machine.update((), situation, replace(evaluate_rules(situation, RULES), blocking=blocking), None)
        return bench.mode_machine.mode

    bench.driving()
    assert show(0.02, 0.1) is Mode.AUTOMATIC
    assert show(0.02, 0.09) is Mode.OBSTACLE_STOP
    show(0.02, kmh(1.8))
    assert show(2.5, kmh(1.8)) is Mode.START_WARNING


def test_a_stop_before_somebody_in_view_names_them(config: SupervisorConfig) -> None:
    """A machine that may not resume before who stands in its path does not ask whether they left."""
    bench = Bench(config).driving()
    body = StandingBody(0.83, 0.0, ObstacleClass.PERSON)
    distance = required_range(0.3, config.braking.flat, 2.1)
    bench.show(**STANDING, **near(distance), standing_body=body, is_departure_unresolved=True)
    assert (bench.mode_machine.mode, bench.reason) == (Mode.OBSTACLE_STOP, "protective_field")


@clause("BD-5.2.4")
def test_no_creeping_up_to_a_body_that_stands_in_the_path(config: SupervisorConfig) -> None:
    distance = required_range(0.3, config.braking.flat, 2.1)
    for gap_m, mode in ((0.0, Mode.OBSTACLE_STOP), (0.1, Mode.AUTOMATIC)):
        body = StandingBody(0.83, gap_m, ObstacleClass.ANIMAL)
        bench = Bench(config).driving()
        assert bench.show(**near(distance), speed_mps=0.2, standing_body=body) is Mode.AUTOMATIC
        assert bench.show(**STANDING, **near(distance), standing_body=body) is mode
        assert bench.reason == "protective_field"
        assert bench.show(after_s=2.5, **STANDING, **near(distance), standing_body=body) is mode  # until it may resume


ASKED = frozenset({Event.RESET, Event.START, Event.PAUSE})


@pytest.mark.parametrize(("changes", "left"), [
    ({}, ASKED),
    ({"speed_mps": 0.05}, ASKED),
    ({"speed_mps": 0.06}, {Event.PAUSE}),
    ({"is_speed_known": False}, {Event.PAUSE}),
    (FAULTY, {Event.PAUSE, Event.RESET}),
    (PRESSED, {Event.PAUSE}),
])  # fmt: skip
def test_filter_permitted(config: SupervisorConfig, changes: dict[str, Any], left: set[Event]) -> None:
    situation = situation_of(config, **STANDING | changes)
    assert filter_permitted(ASKED, situation, evaluate_rules(situation, RULES)) == left


def test_fault_latch(bench: Bench) -> None:
    bench.show(**STANDING, **FAULTY)
    assert (bench.mode_machine.mode, bench.reason, bench.mode_machine.latched) == (Mode.STANDBY, "imu.silent", None)
    bench.driving()
    assert bench.show(**FAULTY) is Mode.FAULT_STOP
    bench.show(**STANDING, brake_ineffective_s=0.0, timed_out_topics=("odom",))
    assert bench.reason == "imu.silent"  # the first fault
    assert bench.show(OperatorCommandKind.RESET, **STANDING) is Mode.STANDBY
    assert (bench.reason, bench.mode_machine.latched) == ("standby", None)


def test_reason_of_an_emergency_stop(bench: Bench) -> None:
    bench.driving()
    assert bench.show(OperatorCommandKind.EMERGENCY_STOP) is Mode.EMERGENCY_STOP
    assert bench.reason == "operator_command.emergency_stop"
    bench.show(OperatorCommandKind.RESET, **STANDING)
    assert bench.show(**STANDING, **PRESSED) is Mode.EMERGENCY_STOP
    bench.show(OperatorCommandKind.EMERGENCY_STOP, **STANDING)
    assert bench.reason == "emergency_stop.button"


def test_reason_of_manual_mode(bench: Bench) -> None:
    bench.driving()
    assert bench.show(driver_override_s=2.0) is Mode.MANUAL
    assert bench.reason == "driver_override"
    bench.show(OperatorCommandKind.AUTOMATIC, **STANDING)
    assert bench.show(OperatorCommandKind.MANUAL, **STANDING) is Mode.MANUAL
    assert (bench.reason, bench.mode_machine.latched) == ("manual", None)


def test_reason_of_a_limit_below_the_command(bench: Bench) -> None:
    bench.driving()
    for speed, reason in ((2.0, ""), (2.0 - 0.02, ""), (1.9799, "speed_limit"), (1.0, "speed_limit")):
        bench.show(max_speed_mps=speed)
        assert bench.reason == reason, speed
    control_command = bench.situation.inputs.control_command
    assert control_command is not None
    bench.show(max_speed_mps=1.0, control_command=replace(control_command, speed_mps=-2.0))
    assert bench.reason == "speed_limit"
    bench.show(control_command=None)
    assert bench.reason == "speed_limit"


def test_braking_clearance(bench: Bench) -> None:
    bench.driving()
    bench.show(**near(20.0), max_speed_mps=1.0)
    assert math.isinf(bench.clearance_m)
    bench.show(**near(5.0))
    assert bench.clearance_m == 5.0
    bench.show(**near(1.0))
    assert bench.clearance_m == 0.0
    bench.show(**near(30.0), max_speed_mps=1.0)
    assert bench.clearance_m == 0.0  # full braking until standstill, also without the obstacle
    bench.show(**STANDING, **near(30.0), max_speed_mps=1.0)
    assert bench.clearance_m == 30.0
    bench.show(**near(30.0), max_speed_mps=1.0)
    assert bench.clearance_m == 30.0


@pytest.mark.parametrize("state", MissionState)
def test_finished_mode(config: SupervisorConfig, state: MissionState) -> None:
    bench = Bench(config).driving()
    assert bench.show(state=state) is Mode.AUTOMATIC
    is_over = state in (MissionState.FINISHED, MissionState.ABORTED)
    after = Mode.FINISHED if is_over else Mode.STANDBY if state is MissionState.WAITING else Mode.AUTOMATIC
    assert bench.show(state=state, **STANDING) is after
    bench.show(**STANDING)
    assert bench.mode_machine.mode is after  # the start command is used once


@pytest.mark.parametrize("order", [OperatorCommandKind.START, OperatorCommandKind.RESUME])
@pytest.mark.parametrize("is_paused", [False, True])
def test_a_waiting_mission_needs_a_confirmation(
    config: SupervisorConfig, order: OperatorCommandKind, is_paused: bool
) -> None:
    """Persons come near at a refill place: an order without, or with an earlier confirmation, is not taken."""
    bench, waiting = Bench(config).driving(), {"state": MissionState.WAITING, **STANDING}
    bench.confirms = False
    early = bench.order(OperatorCommandKind.CONFIRM_CLEAR, 60.0)  # while it drives there
    bench.mode_machine.update((early,), bench.situation, bench.decision, mission(MissionState.DRIVING))
    assert bench.show(state=MissionState.WAITING) is Mode.AUTOMATIC  # until it stands
    if is_paused:
        assert bench.show(OperatorCommandKind.PAUSE, state=MissionState.DRIVING, **STANDING) is Mode.STANDBY
    assert bench.show(**waiting) is Mode.STANDBY
    assert bench.show(order, **waiting) is Mode.STANDBY
    assert bench.reason == "operator_command.unconfirmed"
    bench.mode_machine.update(
        (bench.order(OperatorCommandKind.CONFIRM_CLEAR, 60.0),), bench.situation, bench.decision,
        mission(MissionState.WAITING),
    )  # fmt: skip
    assert bench.mode_machine.mode is Mode.START_WARNING
    assert bench.show(**waiting) is Mode.START_WARNING  # the mission has not seen it yet
    assert bench.show(state=MissionState.DRIVING, after_s=3.0, **STANDING) is Mode.AUTOMATIC


def test_waiting_start_after_a_clock_step(bench: Bench) -> None:
    bench.show(OperatorCommandKind.START, **STANDING, **FAULTY)
    bench.show(**STANDING, **FAULTY, clock_step_s=-1.0)
    assert bench.show(**STANDING) is Mode.STANDBY
    bench.show(OperatorCommandKind.START, **STANDING, **FAULTY)
    assert bench.show(**STANDING) is Mode.START_WARNING


@pytest.mark.parametrize("stop", [FAULTY, PRESSED, {"driver_override_s": 2.0}])
def test_reset_of_ended_faults(bench: Bench, stop: dict[str, Any]) -> None:
    response = Response.CONTROLLED_STOP
    fault = Fault(0, "a", "part", Severity.ALARM, True, response, True, "broken", "kaputt")
    bench.fault_memory.update([fault, replace(fault, is_active=False)])
    bench.driving().show(OperatorCommandKind.PAUSE, **STANDING)
    assert bench.fault_memory.active == (fault,)
    bench.driving().show(**stop)
    assert bench.fault_memory.active == (fault,)
    assert bench.show(OperatorCommandKind.RESET, OperatorCommandKind.AUTOMATIC, **STANDING) is Mode.STANDBY
    assert bench.fault_memory.active == ()


@pytest.mark.parametrize("is_still", [True, False])
def test_reset_in_standby_takes_ended_faults(bench: Bench, is_still: bool) -> None:
    fault = Fault(0, "a", "part", Severity.ALARM, True, Response.CONTROLLED_STOP, True, "broken", "kaputt")
    other = replace(fault, code="b")
    bench.fault_memory.update([fault, other, replace(fault, is_active=False)])
    speed = STANDING if is_still else {}
    assert bench.show(OperatorCommandKind.RESET, **speed) is Mode.STANDBY
    assert bench.fault_memory.active == ((other,) if is_still else (fault, other))


@clause("BD-5.2.4")
@pytest.mark.parametrize("without", [
    {"blind": ("lidar/front",)}, {"frozen": ("lidar/front",)}, {"timed_out_topics": ("lidar/front",)},
])  # fmt: skip
@pytest.mark.parametrize(("blind_s", "needs"), [(2.9, False), (3.1, True)])
def test_a_start_after_a_time_without_sight_needs_a_confirmation(
    bench: Bench, without: dict[str, Any], blind_s: float, needs: bool
) -> None:
    bench.driving()
    bench.show(OperatorCommandKind.PAUSE, **STANDING)
    bench.show(**STANDING, **without)
    bench.show(**STANDING, after_s=blind_s, **without)
    bench.show(OperatorCommandKind.RESET, **STANDING)
    bench.confirms = False
    assert (bench.show(OperatorCommandKind.START, **STANDING) is Mode.STANDBY) == needs
    if needs:
        assert bench.reason == "operator_command.unconfirmed"
        assert bench.show(OperatorCommandKind.CONFIRM_CLEAR, **STANDING) is Mode.START_WARNING


@clause("BD-5.2.4")
@pytest.mark.parametrize("lost", [{"blind": ("lidar/front",)}, {"has_pose_jumped": True}])
def test_no_resume_by_itself_after_a_time_without_sight_or_a_jump(bench: Bench, lost: dict[str, Any]) -> None:
    bench.driving()
    assert bench.show(**near(1.0)) is Mode.OBSTACLE_STOP
    bench.show(**STANDING, **near(1.0), **lost)
    bench.show(**STANDING, **near(1.0), after_s=3.1, **lost)
    bench.show(**STANDING)
    assert (bench.show(**STANDING, after_s=60.0), bench.reason) == (
        Mode.OBSTACLE_STOP, "operator_command.unconfirmed"
    )  # fmt: skip
    assert bench.show(OperatorCommandKind.CONFIRM_CLEAR, **STANDING) is Mode.START_WARNING


@clause("BD-5.2.4")
def test_a_start_while_the_mission_still_waits_uses_no_confirmation_up(bench: Bench) -> None:
    bench.driving()
    waiting: dict[str, Any] = {**STANDING, "state": MissionState.WAITING}
    assert bench.show(**waiting) is Mode.STANDBY
    bench.show(OperatorCommandKind.START, **waiting)
    bench.show(**waiting)
    assert bench.show(after_s=3.0, **waiting) is Mode.AUTOMATIC
    assert bench.show(**waiting) is Mode.STANDBY
    bench.confirms = False
    bench.show(OperatorCommandKind.START, after_s=10.0, **waiting)
    assert (bench.mode_machine.mode, bench.reason) == (Mode.STANDBY, "operator_command.unconfirmed")


@clause("BD-5.2.4")
@pytest.mark.parametrize(("after_s", "mode"), [(29.9, Mode.START_WARNING), (30.1, Mode.STANDBY)])
def test_a_start_does_not_wait_for_long(bench: Bench, after_s: float, mode: Mode) -> None:
    bench.confirms = False
    bench.show(OperatorCommandKind.START, **STANDING)
    assert bench.show(OperatorCommandKind.CONFIRM_CLEAR, after_s=after_s, **STANDING) is mode


@clause("BD-5.2.4")
def test_who_is_lost_or_near_keeps_a_machine_at_rest_there_without_a_command(bench: Bench) -> None:
    """As while its implement folds."""
    bench.driving()
    control_command = bench.situation.inputs.control_command
    assert control_command is not None
    still: dict[str, Any] = {**STANDING, "control_command": replace(control_command, speed_mps=0.0)}
    assert bench.show(**still) is Mode.AUTOMATIC
    assert bench.show(**still, is_departure_unresolved=True) is Mode.AUTOMATIC  # seen in the path
    assert bench.show(**still, is_departure_unresolved=True, is_somebody_near=True) is Mode.OBSTACLE_STOP

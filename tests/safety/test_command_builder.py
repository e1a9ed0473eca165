"""The command builder with constructed inputs; each command depends on the previous one."""

import math
from dataclasses import replace
from itertools import product
from typing import Any

import pytest

from configs.vehicle import FOLDED, Vehicle
from messages.command import ControlCommand, Mode, SafeCommand
from safety.config import SafetyConfig
from safety.output.command_builder import CommandBuilder, CommandInputs
from tests.clause import clause
from tests.safety.safety_world import START_NS, around, machine_state

CONTROL_COMMAND = ControlCommand(START_NS, 2.0, 0.0, 0.0, True, True, 1, 0.0, 0.0, 0.0, False)
UP = machine_state(START_NS, is_hitch_in_work=False)
STEP_S = 0.02


class Bench:
    """A command builder and its last inputs."""

    def __init__(self, vehicle: Vehicle, config: SafetyConfig) -> None:
        self.command_builder, self.now_ns = CommandBuilder(vehicle, config), START_NS
        self.inputs = CommandInputs(START_NS, Mode.STANDBY, "", CONTROL_COMMAND, machine_state(START_NS), 0.0, 0.0,
        8.0, math.inf,
                             config.braking.flat, 1, 0.0, False, False)  # fmt: skip

    def show(self, after_s: float = STEP_S, **changes: Any) -> SafeCommand:
        """The command after a time; changes of the inputs persist."""
        self.now_ns += round(after_s * 1e9)
        self.inputs = replace(self.inputs, now_ns=self.now_ns, **changes)
        return self.command_builder.command(self.inputs)

    def driving(self, mps: float = 1.0) -> "Bench":
        self.show(mode=Mode.AUTOMATIC, measured_mps=mps)
        return self


@pytest.fixture
def bench(vehicle: Vehicle, config: SafetyConfig) -> Bench:
    return Bench(vehicle, config)


def test_first_command(bench: Bench) -> None:
    command = bench.show(0.0, reason="standby", machine=replace(UP, fold_position=0.5), curvature_radpm=0.1)
    assert command == SafeCommand(
        stamp_ns=START_NS, mode=Mode.STANDBY, is_drive_enabled=False, speed_mps=0.0, deceleration_mps2=1.0,
        curvature_radpm=0.1, is_implement_lowered=False, is_pto_on=False, is_park_brake_set=True, is_horn_on=False,
        is_beacon_on=False, reason="standby", is_implement_folded=True,
    )  # fmt: skip
    assert bench.command_builder.last is command


def test_braking_of_fault_stop_and_obstacle_stop(bench: Bench, config: SafetyConfig) -> None:
    bench.driving()
    gentle = bench.show(mode=Mode.OBSTACLE_STOP)
    assert (gentle.speed_mps, gentle.deceleration_mps2) == (0.0, pytest.approx(config.jerk_mps3 * STEP_S))
    hard = bench.show(mode=Mode.FAULT_STOP)
    assert (hard.speed_mps, hard.deceleration_mps2) == (0.0, config.braking.deceleration_mps2)
    near = bench.show(mode=Mode.FAULT_STOP, clearance_m=0.4)
    assert near.deceleration_mps2 == pytest.approx(5.0)


@pytest.mark.parametrize("mode", Mode)
@clause("BD-5.5.1b")
def test_beacon_horn_and_drive_of_each_mode(bench: Bench, mode: Mode) -> None:
    engaged = mode in (Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP)
    command = bench.show(mode=mode)
    assert (command.is_beacon_on, command.is_drive_enabled) == (engaged, engaged)
    assert command.is_horn_on == (mode is Mode.START_WARNING)


def test_acceleration_limit(bench: Bench) -> None:
    assert bench.show(mode=Mode.AUTOMATIC).speed_mps == 0.0  # no time has passed yet
    assert bench.show().speed_mps == pytest.approx(0.6 * STEP_S)
    assert bench.show().speed_mps == pytest.approx(2 * 0.6 * STEP_S)
    assert bench.show(1.0).speed_mps == pytest.approx(0.024 + 0.6 * 0.1)  # no jump after a pause
    assert bench.show(-1.0).speed_mps == pytest.approx(0.084)
    assert bench.show(measured_mps=1.9, machine=machine_state(START_NS, is_park_brake_set=True)).speed_mps == 0.0


def test_creep_limit(bench: Bench) -> None:
    for allowed in around(0.1, 0.01):
        command = bench.driving(0.09).show(allowed_mps=allowed)
        assert (command.speed_mps > 0.0) == (allowed >= 0.1), allowed
        assert (command.deceleration_mps2 > 0.0) == (allowed < 0.1), allowed


def test_limit_below_the_creep_speed(bench: Bench) -> None:
    by_curve = 2.0 / (0.6 + 0.2 + 0.8)
    assert bench.driving(2.0).show(allowed_mps=0.09).deceleration_mps2 == pytest.approx(by_curve + 2.0 / 0.5)


def test_braking_to_a_limit(bench: Bench) -> None:
    bench.driving(2.0).show(0.1)
    assert bench.show(allowed_mps=1.0, measured_mps=2.0).deceleration_mps2 > 3.0
    assert (
        bench.show(control_command=replace(CONTROL_COMMAND, acceleration_mps2=-0.7), allowed_mps=8.0).deceleration_mps2
        == 0.7
    )
    assert (
        bench.show(
            measured_mps=-2.0, direction=-1, control_command=replace(CONTROL_COMMAND, speed_mps=-2.0)
        ).deceleration_mps2
        == 0.0
    )
    assert bench.show(allowed_mps=1.0).deceleration_mps2 > 0.06
    assert bench.show(control_command=None, measured_mps=None, allowed_mps=8.0).speed_mps == 0.0


def test_jerk_limit(bench: Bench) -> None:
    bench.driving()
    assert bench.show(
        control_command=replace(CONTROL_COMMAND, acceleration_mps2=-1.0)
    ).deceleration_mps2 == pytest.approx(0.06)
    assert bench.show().deceleration_mps2 == pytest.approx(0.12)
    bench.show(mode=Mode.STANDBY, control_command=CONTROL_COMMAND)
    assert bench.show().deceleration_mps2 == pytest.approx(0.24)


def test_jerk_limit_from_the_first_command(bench: Bench) -> None:
    gentle = replace(CONTROL_COMMAND, acceleration_mps2=-0.7)
    assert bench.show(mode=Mode.AUTOMATIC, measured_mps=1.0, control_command=gentle).deceleration_mps2 == 0.0


def test_configured_holding_brake(vehicle: Vehicle, config: SafetyConfig) -> None:
    weak = config.model_copy(update={"braking": config.braking.model_copy(update={"hold_mps2": 0.5})})
    bench = Bench(vehicle, weak)
    for _ in range(20):
        command = bench.show(mode=Mode.OBSTACLE_STOP, clearance_m=0.0)
    assert command.deceleration_mps2 == 0.5


def test_holding_brake_at_standstill(bench: Bench) -> None:
    bench.show(1.0, mode=Mode.AUTOMATIC, control_command=replace(CONTROL_COMMAND, speed_mps=0.0))
    for _ in range(20):
        command = bench.show()
    assert command.deceleration_mps2 == 1.0
    for _ in range(20):
        command = bench.show(mode=Mode.OBSTACLE_STOP, clearance_m=0.0)
    assert command.deceleration_mps2 == 1.0
    assert bench.show(measured_mps=1.0).deceleration_mps2 == 6.0
    assert bench.show(measured_mps=-1.0).deceleration_mps2 == 6.0
    assert bench.show(measured_mps=None).deceleration_mps2 <= 1.5


@pytest.mark.parametrize("mode", [Mode.FAULT_STOP, Mode.STANDBY, Mode.FINISHED])
def test_drive_enabled_until_the_end_of_a_controlled_stop(bench: Bench, mode: Mode) -> None:
    bench.driving()
    for speed, is_enabled in ((1.0, True), (0.06, True), (None, True), (0.05, False), (1.0, False)):
        command = bench.show(mode=mode, measured_mps=speed)
        assert command.is_drive_enabled == is_enabled, speed
        assert command.speed_mps == 0.0
    assert command.deceleration_mps2 == 1.5


@clause("BD-5.5.1a", "BD-5.5.2d")
def test_drive_not_enabled_before_engagement(bench: Bench) -> None:
    assert not bench.show(mode=Mode.FAULT_STOP, measured_mps=1.0).is_drive_enabled
    assert not bench.driving().show(mode=Mode.EMERGENCY_STOP).is_drive_enabled
    assert not bench.show(mode=Mode.STANDBY).is_drive_enabled


def test_emergency_brake(bench: Bench) -> None:
    assert bench.driving().show(mode=Mode.EMERGENCY_STOP).deceleration_mps2 == 6.0
    assert bench.show(measured_mps=None).deceleration_mps2 == 6.0
    assert bench.show(measured_mps=0.05).deceleration_mps2 == 1.0
    assert bench.show(measured_mps=-0.06).deceleration_mps2 == 6.0


def test_brake_with_a_driver(bench: Bench) -> None:
    assert bench.driving().show(mode=Mode.MANUAL, has_driver=True).deceleration_mps2 == 1.5
    assert bench.show(measured_mps=0.0).deceleration_mps2 == 0.0
    assert bench.show(measured_mps=1.0).deceleration_mps2 == 0.0
    assert bench.show(has_driver=False).deceleration_mps2 == 2.5
    assert bench.show(measured_mps=0.0).deceleration_mps2 == 1.0
    assert bench.show(mode=Mode.STANDBY, has_driver=True).deceleration_mps2 == 1.0


def test_park_brake_after_1500_ms(bench: Bench) -> None:
    assert bench.driving().show(mode=Mode.STANDBY, measured_mps=0.06).is_park_brake_set is False
    assert not bench.show(measured_mps=0.0).is_park_brake_set
    assert not bench.show(1.5).is_park_brake_set
    assert bench.show(0.001).is_park_brake_set
    assert bench.show(measured_mps=None).is_park_brake_set  # unchanged
    assert not bench.show(measured_mps=1.0).is_park_brake_set
    assert not bench.show(measured_mps=None).is_park_brake_set
    assert not bench.show(measured_mps=0.0).is_park_brake_set  # restarted
    assert not bench.show(1.5).is_park_brake_set
    assert bench.show().is_park_brake_set
    assert bench.show(mode=Mode.AUTOMATIC, control_command=replace(CONTROL_COMMAND, speed_mps=0.0)).is_park_brake_set
    assert bench.show(control_command=CONTROL_COMMAND).is_park_brake_set is False
    assert bench.show(2.0, mode=Mode.MANUAL).is_park_brake_set
    assert bench.show(has_driver=True).is_park_brake_set is False


def test_curvature_by_mode(bench: Bench) -> None:
    bench.driving()
    left = replace(CONTROL_COMMAND, curvature_radpm=1.0)
    assert bench.show(control_command=left).curvature_radpm == pytest.approx(0.3 * STEP_S)
    assert bench.show(0.1, curvature_radpm=0.05).curvature_radpm == pytest.approx(0.036)
    for _ in range(20):
        command = bench.show(0.1)
    assert command.curvature_radpm == pytest.approx(1.02 / 4.6)
    assert bench.show(mode=Mode.OBSTACLE_STOP, control_command=CONTROL_COMMAND).curvature_radpm < 1.02 / 4.6
    held = bench.show(measured_mps=0.0).curvature_radpm
    assert bench.show().curvature_radpm == held  # no steering at standstill
    assert bench.show(mode=Mode.AUTOMATIC).curvature_radpm < held
    assert bench.show(mode=Mode.EMERGENCY_STOP).curvature_radpm == 0.05
    assert bench.show(curvature_radpm=math.nan).curvature_radpm == 0.05
    assert bench.show(curvature_radpm=None).curvature_radpm == 0.05


def test_first_curvature(vehicle: Vehicle, config: SafetyConfig) -> None:
    for known, begun in ((0.1, 0.1), (None, 0.0)):
        bench = Bench(vehicle, config)
        assert bench.show(0.0, mode=Mode.AUTOMATIC, curvature_radpm=known).curvature_radpm == begun
    assert Bench(vehicle, config).show(curvature_radpm=None).curvature_radpm == 0.0


@clause("BD-5.5.1b")
def test_implement_and_pto(bench: Bench) -> None:
    def asked(**changes: Any) -> tuple[bool, bool]:
        command = bench.show(**changes)
        return command.is_implement_lowered, command.is_pto_on

    lowered, running = (replace(CONTROL_COMMAND, is_implement_lowered=a, is_pto_on=not a) for a in (True, False))
    assert asked(mode=Mode.START_WARNING, machine=None) == (False, False)  # before the first machine state
    assert asked(mode=Mode.STANDBY, machine=machine_state(START_NS)) == (True, False)
    assert asked(mode=Mode.AUTOMATIC, machine=UP, control_command=lowered) == (True, False)
    assert asked(control_command=running) == (False, True)
    assert asked(control_command=CONTROL_COMMAND) == (True, True)
    assert asked(control_command=None) == (True, True)
    assert asked(mode=Mode.OBSTACLE_STOP) == (True, False)  # who walks into it meets no turning tines
    assert asked(control_command=running) == (False, False)
    assert asked(control_command=lowered) == (False, False)
    assert asked(mode=Mode.AUTOMATIC, control_command=CONTROL_COMMAND) == (True, True)
    assert asked(is_pto_barred=True) == (True, False)
    assert asked(is_pto_barred=False) == (True, True)
    assert asked(mode=Mode.FAULT_STOP) == (False, False)
    assert asked(mode=Mode.AUTOMATIC) == (True, True)
    assert asked(mode=Mode.FAULT_STOP, machine=None) == (True, False)
    for fold in (*around(0.01, 0.001), 1.0 - FOLDED, math.nan):
        is_open = fold <= 0.01 + 1e-9
        assert asked(mode=Mode.AUTOMATIC, machine=replace(UP, fold_position=fold)) == (is_open, is_open), fold


def test_fold_after_standstill_with_raised_hitch(bench: Bench) -> None:
    fold = replace(CONTROL_COMMAND, is_implement_lowered=False, is_implement_folded=True)
    bench.show(0.0, mode=Mode.AUTOMATIC, control_command=fold, machine=UP)
    for after_s, is_folded in ((0.499, False), (0.001, True)):
        assert bench.show(after_s).is_implement_folded == is_folded
    assert bench.show(machine=machine_state(START_NS), control_command=CONTROL_COMMAND).is_implement_folded
    assert bench.show(machine=UP).is_implement_folded  # not unfolded while it is to be lowered
    assert bench.show(
        mode=Mode.OBSTACLE_STOP, control_command=replace(CONTROL_COMMAND, is_implement_lowered=False)
    ).is_implement_folded
    assert bench.show(mode=Mode.AUTOMATIC, control_command=None).is_implement_folded
    assert bench.show(
        control_command=replace(CONTROL_COMMAND, is_implement_lowered=False), measured_mps=0.1
    ).is_implement_folded
    bench.show(measured_mps=0.0)
    assert not bench.show(0.5).is_implement_folded


def test_half_folded_counts_as_folded(vehicle: Vehicle, config: SafetyConfig) -> None:
    for fold in around(0.5, 0.01):
        assert Bench(vehicle, config).show(machine=replace(UP, fold_position=fold)).is_implement_folded == (
            fold >= 0.5
        ), fold
    assert not Bench(vehicle, config).show(machine=None).is_implement_folded


@clause("BD-5.2.4")
def test_the_brake_holds_the_slope_until_the_park_brake_is_set(bench: Bench) -> None:
    grade_mps2 = 1.36  # 8°
    for mode, side in product((Mode.OBSTACLE_STOP, Mode.FAULT_STOP, Mode.EMERGENCY_STOP), (1.0, -1.0)):
        bench.driving(0.0)
        held = bench.show(mode=mode, measured_mps=0.0, downhill_mps2=side * grade_mps2, after_s=1.0)
        assert held.deceleration_mps2 >= 1.5 * grade_mps2, mode
    assert bench.show(downhill_mps2=20.0).deceleration_mps2 == bench.command_builder._config.braking.full_mps2


@clause("BD-5.2.4")
def test_downhill_the_brake_holds_gravity_as_well(bench: Bench, config: SafetyConfig) -> None:
    for downhill_mps2, more_mps2 in ((0.0, 0.0), (1.36, 1.36), (-1.36, 0.0)):
        bench.driving(2.0)
        asked = bench.show(mode=Mode.FAULT_STOP, measured_mps=2.0, downhill_mps2=downhill_mps2)
        assert asked.deceleration_mps2 == config.braking.deceleration_mps2 + more_mps2

"""Evaluation of fault injection cells: the demand on each fault, each failure alone, and the totals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.strict import CONFIGS, load
from messages.errors import ConfigError
from messages.message import Envelope
from messages.truth import TrueMachine
from runtime.fault_injection.evaluation import Cell, MeasuredReaction, evaluate
from runtime.fault_injection.situations import DriveMonitor
from runtime.fault_injection.table import summary, totals
from simulation.faults.config import Demand, Demanded, FaultKind, FaultsConfig, fault_kinds_of
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.stopping import on_grade, stopping_distance_m

CONFIG = load(FaultsConfig, CONFIGS / "faults.yaml").campaign
CELL = Cell("turn", "imu", FaultKind.OFF)
WHY = "a reason of at least twenty characters"
STOP = Demanded(targets=("imu",), demand=Demand.STOP, is_named=True, why=WHY)
GO_ON = Demanded(targets=("imu",), demand=Demand.CONTINUE, is_named=False, why=WHY)
GOOD = MeasuredReaction(2.0, 1.1, 1.0, 1.0, 0.0, 0.1, 0, 0, "imu.silent", {"imu.silent": 0.15, "(imu)": 0.3})
OTHERS = {"wheel": ("wheel",)}
TARGETS = (
    "lidar/front", "camera/front", "radar/front", "ultrasonic/rear_left", "imu", "gnss/main", "wheel", "uwb/main",
    "can/GuidanceMachineStatus", "can/WheelBasedSpeed", "can/RearHitchStatus", "can/RearPtoStatus", "can/CabState",
    "can/HeartbeatTractor", "node/lidar_front", "node/health_lidar_front", "node/camera_front", "node/tracker",
    "node/supervisor", "node/lidar_map", "node/radar_front", "clock", "log",
)  # fmt: skip


def failure(measured: MeasuredReaction, demanded: Demanded = STOP) -> str:
    return evaluate(CELL, measured, CONFIG, demanded, ("imu",), OTHERS).failure


@pytest.mark.parametrize("situation", ["swath", "turn", "obstacle", "docking"])
@pytest.mark.parametrize("is_used", [True, False])
def test_every_fault_has_a_demand(situation: str, is_used: bool) -> None:
    for target in TARGETS:
        for kind in fault_kinds_of(target):
            assert CONFIG.demanded(situation, target, kind, is_used).why


def test_fault_without_demand_is_refused() -> None:
    with pytest.raises(ConfigError, match="no demand on 'off' of 'sonar/front'"):
        CONFIG.demanded("turn", "sonar/front", FaultKind.OFF, True)


def test_limit_of_a_demand() -> None:
    for values in ({"demand": Demand.LIMIT}, {"demand": Demand.STOP, "limit_kmh": 6.0}):
        with pytest.raises(ValueError, match="limit_kmh belongs"):
            Demanded(targets=("imu",), is_named=True, why=WHY, **values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("target", "kind", "demand", "is_named"),
    [("lidar/front", "off", "stop", True), ("lidar/front", "replay", "stop", True),
     ("lidar/front", "swapped", "stop", True), ("lidar/front", "out_of_order", "continue", False),
     ("camera/front", "off", "limit", True), ("node/camera_front", "hangs", "limit", True),
     ("camera/front", "noisy", "continue", False), ("radar/front", "off", "continue", True),
     ("radar/front", "sign", "continue", False), ("node/health_radar_front", "hangs", "continue", True),
     ("imu", "nan", "stop", True), ("wheel", "sign", "continue", True), ("gnss/main", "drift", "continue", True),
     ("can/CabState", "off", "stop", True), ("can/CabState", "frozen", "continue", False),
     ("can/HeartbeatTractor", "frozen", "stop", True), ("node/lidar_map", "hangs", "continue", False),
     ("node/lidar_map", "raises", "continue", True), ("node/lidar_odometry_front", "hangs", "continue", True),
     ("can/GuidanceMachineStatus", "frozen", "continue", True), ("can/WheelBasedSpeed", "noisy", "continue", True),
     ("can/WheelBasedSpeed", "garbage", "stop", True),
     ("node/mission", "hangs", "stop", True), ("clock", "ahead", "stop", True), ("log", "full", "stop", True)],
)  # fmt: skip
def test_demand_on_a_used_device(target: str, kind: str, demand: str, is_named: bool) -> None:
    found = CONFIG.demanded("turn", target, FaultKind(kind), True)
    assert (found.demand.value, found.is_named) == (demand, is_named)


def test_passed_cell() -> None:
    outcome = evaluate(CELL, GOOD, CONFIG, STOP, ("imu",), OTHERS)
    assert (outcome.passed, outcome.named_s, outcome.allowed_m, outcome.demand) == (True, 0.15, 1.1, "stop")


@pytest.mark.parametrize("step_m", [-0.05, -0.01, 0.01, 0.05])
def test_limits_of_travel_and_path(step_m: float) -> None:
    assert failure(replace(GOOD, travel_m=1.1 + step_m)) == ("stopped late" if step_m > 0 else "")
    assert failure(replace(GOOD, path_error_m=CONFIG.max_path_error_m + step_m)).startswith("left") == (step_m > 0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [({"contacts": 1}, "contact"), ({"zone_exits": 1}, "zone exit"), ({"stopped_s": None}, "did not stop"),
     ({"reason": "tilt.roll", "alarms": {"tilt.roll": 0.1}}, "not named"),
     ({"reason": "wheel.silent", "alarms": {"wheel.silent": 0.1}}, "attributed to wheel; not named")],
)  # fmt: skip
def test_failure_text(changes: dict[str, Any], text: str) -> None:
    assert failure(replace(GOOD, **changes)) == text


def test_naming_is_demanded_before_an_obstacle_too() -> None:
    stopped = replace(GOOD, reason="obstacle.tracked", alarms={"obstacle.tracked": 0.1})
    assert failure(stopped) == "not named"
    assert failure(replace(stopped, alarms={"obstacle.tracked": 0.1, "imu.silent": 0.4})) == ""


def test_speed_limit() -> None:
    limited = STOP.model_copy(update={"demand": Demand.LIMIT, "limit_kmh": 6.0})
    slow = replace(GOOD, stopped_s=None, end_speed_mps=6.0 / 3.6)
    assert failure(slow, limited) == ""
    assert failure(replace(slow, end_speed_mps=1.7), limited) == "not limited"


def test_nothing_demanded() -> None:
    assert failure(replace(GOOD, stopped_s=None, reason="", alarms={}, end_speed_mps=2.0), GO_ON) == ""


def test_bridging_time() -> None:
    bridged = GO_ON.model_copy(update={"bridged_s": 5.0})
    for stopped_s, text in ((4.9, "stopped too early"), (5.1, "")):
        assert failure(replace(GOOD, stopped_s=stopped_s), bridged) == text
    assert failure(replace(GOOD, stopped_s=1.0, reason="tracked_obstacle"), bridged) == ""


def test_totals() -> None:
    late = replace(GOOD, travel_m=1.2, alarms={}, reason="")
    rows = [evaluate(CELL, one, CONFIG, STOP, ("imu",), OTHERS).as_dict() for one in (GOOD, late)]
    rows.append(evaluate(CELL, late, CONFIG, GO_ON, ("imu",), OTHERS).as_dict())
    values = summary(rows)
    assert (values["stops_demanded"], values["stops_within"]) == (2, 1)
    assert (values["naming_demanded"], values["named"]) == (2, 1)
    assert (values["named_median_s"], values["named_worst_s"], values["never_named"]) == (0.15, 0.15, ["imu off"])
    assert "1 of 2 demanded stops" in totals(rows)
    assert values["cells"] == 3


@pytest.mark.parametrize("direction", [1, -1])
def test_monitor_of_a_stop_on_a_grade(direction: int) -> None:
    """Speed gained within the reaction time counts, later speed does not; downhill in the direction of travel."""
    monitor = DriveMonitor(reaction_s=0.6)
    T = np.eye(4)
    T[2, 0] = -0.07 * direction
    for k in range(31):
        speed_mps = direction * (2.0 + 0.05 * k)
        machine = TrueMachine(
            k * 50_000_000, T.copy(), speed_mps, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0, False, 0, 0
        )  # fmt: skip
        monitor(Envelope("truth_machine", k, machine.stamp_ns, machine))
    assert monitor.fastest_mps == pytest.approx(2.6)
    assert monitor.steepest == pytest.approx(0.07)
    monitor.reset()
    assert (monitor.fastest_mps, monitor.steepest) == (0.0, 0.0)


def test_stopping_distance_on_a_grade() -> None:
    flat = load_conditions(None).braking
    for uphill in (0.0, -0.07):
        assert on_grade(flat, uphill) == flat
    downhill = on_grade(flat, 0.07)
    assert downhill.deceleration_mps2 == pytest.approx(flat.deceleration_mps2 - 0.686, abs=1e-3)
    assert stopping_distance_m(2.5, 0.6, downhill) > 1.1 * stopping_distance_m(2.5, 0.6, flat)


def test_every_demand_is_the_first_for_some_fault() -> None:
    first = [
        CONFIG.demanded(situation, target, kind, is_used)
        for situation in ("swath", "turn", "obstacle", "docking") for target in TARGETS
        for kind in fault_kinds_of(target) for is_used in (True, False)
    ]  # fmt: skip
    assert [one.why for one in CONFIG.demands if one not in first] == []

"""Evaluation of fault injection cells: each failure alone, and the maximum age."""

from dataclasses import replace

import pytest

from configs.strict import CONFIGS, load
from runtime.fault_injection.evaluation import Cell, MeasuredReaction, evaluate
from simulation.faults.config import FaultKind, FaultsConfig

CONFIG = load(FaultsConfig, CONFIGS / "faults.yaml").campaign
WRITES = {"mission": ("mission", "path"), "localizer": ("odom", "map_pose", "fault/localizer")}
CELL = Cell("turn", "imu", FaultKind.OFF)
GOOD = MeasuredReaction(2.0, 1.0, 1.1, 1.0, 0.1, 0, 0, "imu.silent", ("imu.silent",))
OTHERS = {"wheel": ("wheel",)}


def failure(measured: MeasuredReaction, max_age_s: float | None = 0.1) -> str:
    return evaluate(CELL, measured, CONFIG, ("imu",), OTHERS, max_age_s, False).failure


@pytest.mark.parametrize(
    ("topic", "age_s"),
    [("imu", 0.1), ("lidar/front", 0.35), ("node/mission", 0.4), ("node/localizer", 0.1), ("can/CabState", 0.3),
     ("log", 0.4)],
)  # fmt: skip
def test_max_age_of_a_cell(topic: str, age_s: float) -> None:
    assert Cell("turn", topic, FaultKind.OFF).max_age_s(WRITES) == pytest.approx(age_s)


def test_passed_cell() -> None:
    outcome = evaluate(CELL, GOOD, CONFIG, ("imu",), OTHERS, 0.1, False)
    assert (outcome.passed, outcome.is_fault_identified, outcome.allowed_m) == (True, True, pytest.approx(1.2))


@pytest.mark.parametrize("step_m", [-0.05, -0.01, 0.01, 0.05])
def test_allowed_travel_limit(step_m: float) -> None:
    assert failure(replace(GOOD, travel_m=1.2 + step_m)) == ("stopped late" if step_m > 0 else "")
    assert failure(replace(GOOD, path_error_m=CONFIG.max_path_error_m + step_m)).startswith("left") == (step_m > 0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [({"contacts": 1}, "contact"), ({"zone_exits": 1}, "zone exit"), ({"stopped_s": None}, "did not stop"),
     ({"reason": "tilt.roll", "alarms": ("tilt.roll",)}, "not identified"),
     ({"reason": "wheel.silent", "alarms": ("wheel.silent",)}, "attributed to wheel; not identified")],
)  # fmt: skip
def test_failure_text(changes: dict[str, object], text: str) -> None:
    assert failure(replace(GOOD, **changes)) == text


def test_no_stop_required() -> None:
    assert failure(replace(GOOD, stopped_s=None, reason="", alarms=()), None) == ""


@pytest.mark.parametrize(
    ("topic", "kind", "requires_stop", "requires_alarm"),
    [("lidar/front", "off", True, False), ("lidar/rear", "off", False, False),
     ("node/lidar_front", "hangs", True, False), ("radar/front", "off", False, True),
     ("radar/front", "garbage", False, False),
     ("node/radar_front", "hangs", False, True), ("node/health_radar_front", "hangs", False, True),
     ("node/health_camera_front", "hangs", False, False), ("node/lidar_map", "hangs", False, False),
     ("node/mission", "hangs", True, False), ("imu", "noisy", False, False)],
)  # fmt: skip
def test_required_reaction_by_topic(topic: str, kind: str, requires_stop: bool, requires_alarm: bool) -> None:
    cell, unused = Cell("turn", topic, FaultKind(kind)), ("lidar/rear", "node/health_camera_front")
    assert (cell.requires_stop(CONFIG, unused), cell.requires_alarm(CONFIG, unused)) == (requires_stop, requires_alarm)


def test_loss_must_be_identified() -> None:
    silent = replace(GOOD, stopped_s=None, reason="", alarms=("detection_range.limit",))
    assert evaluate(CELL, silent, CONFIG, ("imu",), OTHERS, None, True).failure == "loss not reported"
    assert evaluate(CELL, replace(silent, alarms=("imu.silent",)), CONFIG, ("imu",), OTHERS, None, True).failure == ""


def test_gnss_bridging_time() -> None:
    cell = Cell("turn", "gnss/main", FaultKind.OFF)
    for stopped_s in (4.9, 5.1):
        measured = replace(GOOD, stopped_s=stopped_s, reason="gnss.silent")
        expected = "" if stopped_s > 5.0 else "stopped too early"
        assert evaluate(cell, measured, CONFIG, ("gnss",), OTHERS, None, False).failure == expected

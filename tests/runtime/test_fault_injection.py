"""How the campaign judges a cell: each complaint alone, and the age that counts."""

from dataclasses import replace

import pytest

from configs.strict import CONFIGS, load
from runtime.fault_injection.evaluation import Cell, Seen, judge
from simulation.faults.config import FaultKind, FaultsConfig

CONFIG = load(FaultsConfig, CONFIGS / "faults.yaml").campaign
WRITES = {"mission": ("mission", "path"), "localizer": ("odom", "map_pose", "fault/localizer")}
CELL = Cell("turn", "imu", FaultKind.OFF)
GOOD = Seen(2.0, 1.0, 1.1, 1.0, 0.1, 0, 0, "imu.silent", ("imu.silent",))
OTHERS = {"wheel": ("wheel",)}


def wrong(seen: Seen, max_age_s: float | None = 0.1) -> str:
    return judge(CELL, seen, CONFIG, ("imu",), OTHERS, max_age_s, False).wrong


@pytest.mark.parametrize(
    ("topic", "age_s"),
    [("imu", 0.1), ("lidar/front", 0.35), ("node/mission", 0.4), ("node/localizer", 0.1), ("can/CabState", 0.3),
     ("log", 0.4)],
)  # fmt: skip
def test_the_age_that_counts(topic: str, age_s: float) -> None:
    assert Cell("turn", topic, FaultKind.OFF).max_age_s(WRITES) == pytest.approx(age_s)


def test_a_right_cell() -> None:
    outcome = judge(CELL, GOOD, CONFIG, ("imu",), OTHERS, 0.1, False)
    assert (outcome.is_right, outcome.is_named, outcome.allowed_m) == (True, True, pytest.approx(1.2))


@pytest.mark.parametrize("step_m", [-0.05, -0.01, 0.01, 0.05])
def test_the_way_allowed_is_speed_times_age_and_the_stopping_distance(step_m: float) -> None:
    assert wrong(replace(GOOD, travel_m=1.2 + step_m)) == ("stopped late" if step_m > 0 else "")
    assert wrong(replace(GOOD, error_m=CONFIG.max_path_error_m + step_m)).startswith("left") == (step_m > 0)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [({"contacts": 1}, "contact"), ({"zone_exits": 1}, "exit"), ({"stopped_s": None}, "went on"),
     ({"reason": "tilt.roll", "told": ("tilt.roll",)}, "not named"),
     ({"reason": "wheel.silent", "told": ("wheel.silent",)}, "blames wheel; not named")],
)  # fmt: skip
def test_what_is_wrong(changes: dict[str, object], complaint: str) -> None:
    assert wrong(replace(GOOD, **changes)) == complaint


def test_what_need_not_stop_may_go_on() -> None:
    assert wrong(replace(GOOD, stopped_s=None, reason="", told=()), None) == ""


@pytest.mark.parametrize(
    ("topic", "kind", "needed", "missed"),
    [("lidar/front", "off", True, False), ("lidar/rear", "off", False, False),
     ("node/lidar_front", "hangs", True, False), ("radar/front", "off", False, True),
     ("radar/front", "garbage", False, False),
     ("node/radar_front", "hangs", False, True), ("node/health_radar_front", "hangs", False, True),
     ("node/health_camera_front", "hangs", False, False), ("node/lidar_map", "hangs", False, False),
     ("node/mission", "hangs", True, False), ("imu", "noisy", False, False)],
)  # fmt: skip
def test_what_must_stop_and_what_must_be_missed(topic: str, kind: str, needed: bool, missed: bool) -> None:
    cell, idle = Cell("turn", topic, FaultKind(kind)), ("lidar/rear", "node/health_camera_front")
    assert (cell.is_needed(CONFIG, idle), cell.is_missed(CONFIG, idle)) == (needed, missed)


def test_what_must_be_missed_must_be_named() -> None:
    silent = replace(GOOD, stopped_s=None, reason="", told=("detection_range.limit",))
    assert judge(CELL, silent, CONFIG, ("imu",), OTHERS, None, True).wrong == "not missed"
    assert judge(CELL, replace(silent, told=("imu.silent",)), CONFIG, ("imu",), OTHERS, None, True).wrong == ""


def test_gnss_must_be_done_without_for_a_while() -> None:
    cell = Cell("turn", "gnss/main", FaultKind.OFF)
    for stopped_s in (4.9, 5.1):
        seen = replace(GOOD, stopped_s=stopped_s, reason="gnss.silent")
        wanted = "" if stopped_s > 5.0 else "stopped too early"
        assert judge(cell, seen, CONFIG, ("gnss",), OTHERS, None, False).wrong == wanted

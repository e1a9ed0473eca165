"""Outcome of complete logs after replay and evaluation."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from configs.strict import CONFIGS
from messages.errors import ConfigError, LogError
from runtime.replay.prepare import load_configuration, prepare
from runtime.replay.replay import replay
from tests.replay.recorded_drive import VEHICLE, drive, vehicle_file
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.evaluation import evaluate_log
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.totals import aggregate

CONDITIONS = load_conditions(None)
CONFIGURATION = load_configuration(CONDITIONS)


def evaluate(log: Path, folder: Path) -> dict:
    """Result of one log."""
    prepared = prepare(log, None, vehicle_file(folder), CONFIGURATION)
    setting = prepared.setting(log.name)
    observer = Observer(setting, CONDITIONS)
    replay(prepared, [observer])
    return aggregate(
        [evaluate_log(log.name, observer.finish(), setting.truth_frame is not None, CONDITIONS)], CONDITIONS
    )


@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["right bend", "left bend"])
def test_person_in_bend_in_time(tmp_path: Path, side: float) -> None:
    log = drive(tmp_path / "bend.mcap", (22.7, side * 8.9), seconds=3.6, curvature_radpm=side * 0.03)
    result = evaluate(log, tmp_path)
    assert [e["outcome"] for e in result["encounters"]] == ["in time"]
    assert result["state"] == "passed"
    assert result["encounters"][0]["margin_m"] > 0.0
    assert result["false_stops"] == 0


def test_person_without_returns_is_missed(tmp_path: Path) -> None:
    result = evaluate(drive(tmp_path / "gone.mcap", (20.0, 0.3), seconds=3.0, is_person_hidden=True), tmp_path)
    assert [e["outcome"] for e in result["encounters"]] == ["missed"]
    assert result["state"] == "failed"
    assert result["missed"] == 1


def test_reverse_driving_is_monitored_and_judged(tmp_path: Path) -> None:
    """A rear at −1 m and a person from −14.25 m on: due at a gap below S(3 m/s) = 4.18 m, after 3.02 s."""
    seen = evaluate(drive(tmp_path / "seen.mcap", (-14.5, 0.3), seconds=4.0, speed_mps=-3.0), tmp_path)
    (encounter,) = seen["encounters"]
    assert (encounter["outcome"], encounter["direction"], seen["false_stops"]) == ("in time", -1, 0)
    assert encounter["due_s"] == pytest.approx(3.1, abs=0.01)
    hidden = drive(tmp_path / "hidden.mcap", (-14.5, 0.3), seconds=4.0, speed_mps=-3.0, is_person_hidden=True)
    assert [e["outcome"] for e in evaluate(hidden, tmp_path)["encounters"]] == ["missed"]


def test_person_beside_corridor_is_no_encounter(tmp_path: Path) -> None:
    result = evaluate(drive(tmp_path / "beside.mcap", (20.0, 3.0), seconds=2.5), tmp_path)
    assert (result["encounters"], result["stops"], result["state"]) == ([], [], "not_shown")


def test_log_without_truth_reports_stops_and_no_misses(tmp_path: Path) -> None:
    result = evaluate(drive(tmp_path / "blind.mcap", (20.0, 0.3), seconds=2.5, has_truth=False), tmp_path)
    assert (result["state"], result["missed"], result["false_stops"]) == ("not_shown", None, None)
    assert result["stops"]
    assert result["encounters"][0]["outcome"] == "not shown"
    assert result["encounters"][0]["first_range_m"] > 8.0


def test_speed_from_scans_alone(tmp_path: Path) -> None:
    log = drive(tmp_path / "scans.mcap", (24.0, 0.3), seconds=2.5, has_odometry=False)
    assert prepare(log, None, vehicle_file(tmp_path), CONFIGURATION).odometry.kind == "scans"
    (encounter,) = evaluate(log, tmp_path)["encounters"]
    assert encounter["entry_speed_mps"] == pytest.approx(6.0, abs=0.8)
    assert encounter["outcome"] == "in time"


def test_missing_vehicle_values_named(tmp_path: Path) -> None:
    log = drive(tmp_path / "a.mcap", None, seconds=0.3)
    with pytest.raises(ConfigError, match=r"--vehicle FILE; required body\.front_m, .*mount\.xyz_m"):
        prepare(log, None, None, CONFIGURATION)
    file = tmp_path / "half.yaml"
    file.write_text(VEHICLE.replace("mount: {xyz_m: [1.0, 0.0, 1.8]}", "").replace("width_m: 1.8, ", ""))
    with pytest.raises(ConfigError, match=r"missing body\.width_m, sensors\.lidar\.points\.mount\.xyz_m\. There"):
        prepare(log, None, file, CONFIGURATION)


def test_log_without_lidar_refused(tmp_path: Path) -> None:
    file = tmp_path / "can.log"
    file.write_text("(1.000000) can0 123#0011\n")
    with pytest.raises(LogError, match="no lidar topic"):
        prepare(file, None, None, CONFIGURATION)


def test_unreadable_logs_reported_and_results_reused(tmp_path: Path) -> None:
    good = drive(tmp_path / "good.mcap", None, seconds=0.6)
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "none.log").write_text("(1.000000) can0 123#0011\n")
    logs = [str(good), str(tmp_path / "empty.mcap"), str(tmp_path / "none.log")]
    words = [sys.executable, "-m", "runtime", "validate", *logs, "--vehicle", str(vehicle_file(tmp_path))]
    words += ["--out", str(tmp_path / "out"), "--json", "--jobs", "1"]
    first = subprocess.run(words, capture_output=True, text=True, cwd=CONFIGS.parent)
    second = subprocess.run(words, capture_output=True, text=True, cwd=CONFIGS.parent)
    one, two = json.loads(first.stdout), json.loads(second.stdout)
    assert first.returncode == 2, first.stderr
    assert [f["log"] for f in one["failed_to_read"]] == ["empty.mcap", "none.log"]
    assert one["state"] == "not_shown"
    assert "1 of 3 evaluated before" in second.stderr
    assert one == two
    last = (tmp_path / "out" / "result.jsonl").read_text().splitlines()[-1]
    assert json.loads(last)["record"] == "end"


def test_truncated_log_evaluated_with_note(tmp_path: Path) -> None:
    complete = drive(tmp_path / "complete.mcap", None, seconds=3.0).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(complete[: len(complete) // 2])
    prepared = prepare(cut, None, vehicle_file(tmp_path), CONFIGURATION)
    assert any(note.startswith("byte ") for note in prepared.inspection_table()["notes"])
    assert 0.5 < prepared.inspection.span_s < 2.9

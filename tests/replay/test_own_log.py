"""Evaluation of a simulated log with its truth, unchanged and with the person removed from all sensor data."""

from pathlib import Path

import pytest

from messages.errors import LogError
from runtime.replay.evaluate import consistency_observer
from runtime.replay.object_removal import remove_object
from runtime.replay.prepare import ReplayInput, load_configuration, prepare
from runtime.replay.replay import replay
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.evaluation import evaluate_log
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.totals import aggregate

CONDITIONS = load_conditions(None)
pytestmark = pytest.mark.slow


def evaluate(prepared: ReplayInput) -> tuple[dict, set[str]]:
    """Result, and the codes of what contradicts the inputs of the log."""
    setting = prepared.setting("own")
    observer, consistency = Observer(setting, CONDITIONS), consistency_observer(prepared, setting)
    replay(prepared, [observer, consistency])
    result = aggregate([evaluate_log("own", observer.finish(), True, CONDITIONS)], CONDITIONS)
    return result, {finding.code for finding in consistency.finish() if finding.is_blocking}


def test_crossing_person_in_time_without_false_stop(log: Path) -> None:
    prepared = prepare(log, None, None, load_configuration(CONDITIONS))
    assert prepared.odometry.kind == "localizer"
    result, contradictions = evaluate(prepared)
    assert [(e["role"], e["outcome"], e["is_stop_requested"]) for e in result["encounters"]] == [
        ("person", "in time", True)
    ]
    assert (result["state"], result["missed"], result["false_stops"]) == ("passed", 0, 0)
    assert result["encounters"][0]["margin_m"] > 0.0
    assert contradictions == set()  # the lidar on the harrow is 0.6 m lower while the harrow works


def test_removed_person_is_missed(log: Path) -> None:
    prepared = prepare(log, None, None, load_configuration(CONDITIONS))
    result, _ = evaluate(remove_object(prepared, "person"))
    assert [(e["role"], e["outcome"]) for e in result["encounters"]] == [("person", "missed")]
    assert (result["state"], result["missed"], result["stops"]) == ("failed", 1, [])
    with pytest.raises(LogError, match=r"--remove-object cow: not in the ground truth \(objects: person"):
        remove_object(prepared, "cow")

"""Verdicts on the first forty KITTI frames, and on the same replay with altered outputs."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from messages.command import SupervisorState
from messages.faults import Response
from messages.message import Envelope
from messages.perception import Obstacles, Tracks
from runtime.replay.prepare import ReplayInput, load_configuration, prepare
from runtime.replay.replay import replay
from tests.recordings import DATA, needs
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.evaluation import evaluate_log
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.totals import aggregate

ROOT = Path(__file__).resolve().parents[3]
LOG, TRUTH = DATA / "kitti-seq-pcd", DATA / "kitti-tracking-truth"
CONDITIONS = load_conditions(None)
pytestmark = [
    needs("kitti-seq-pcd", "kitti-tracking-truth"),
    pytest.mark.slow,
]


@cache
def recorded() -> tuple[ReplayInput, list[Envelope]]:
    """Messages of the replay, computed once."""
    prepared = prepare(LOG, TRUTH, None, load_configuration(CONDITIONS))
    envelopes: list[Envelope] = []
    replay(prepared, [envelopes.append])
    return prepared, envelopes


def evaluate(change: Callable[[Envelope], Envelope | None] = lambda e: e) -> dict:
    """Result of the log after a change of each message, in order of delivery."""
    prepared, envelopes = recorded()
    observer = Observer(prepared.setting("kitti"), CONDITIONS)
    changed = [c for e in envelopes if (c := change(e)) is not None]
    for envelope in sorted(changed, key=lambda e: e.receive_ns):
        observer(envelope)
    log = evaluate_log("kitti", observer.finish(), True, CONDITIONS)
    return aggregate([log], CONDITIONS) | {"confirmation": log["confirmation"]}


def failures(result: dict) -> list[str]:
    """Names of the expectations that a result fails."""
    by_id = {e["id"]: e for e in result["encounters"]}
    van, cyclist = by_id.get(0), by_id.get(1)
    delays = {row["id"]: row["after_s"] for row in result["confirmation"]}
    checks = {
        "van": van is not None and abs(van["margin_m"] - 4.1) <= 0.4 and van["stop_requested_s"] is None,
        "cyclist": cyclist is not None and cyclist["outcome"] == "cut-in" and abs(cyclist["clearance_m"] - 4.9) <= 0.6
        and abs(cyclist["stopping_distance_m"] - 6.1) <= 0.5 and 3.2 <= cyclist["entry_s"] <= 3.9,
        "request": cyclist is not None and cyclist["request_delay_s"] is not None and cyclist["request_delay_s"] <= 0.1,
        "others": set(by_id) == {0, 1} and all(set(s["objects"]) <= {1} for s in result["stops"]),
        "false stops": result["false_stops"] == 0,
        "missed": result["missed"] == 0,
        "recall": all(row["recall"] == 1.0 for row in result["recall"] if row["to_m"] <= 30),
        "latency": all(delays[i] is not None and delays[i] <= 0.3 + 0.1 for i in (0, 1, 3)),
    }  # fmt: skip
    return [name for name, holds in checks.items() if not holds]


def test_unaltered_replay_meets_all_expectations() -> None:
    assert failures(evaluate()) == []


def test_permanent_stop_request_counts_as_false_stop() -> None:
    def change(e: Envelope) -> Envelope:
        if not isinstance(e.message, SupervisorState):
            return e
        rules = tuple(
            replace(r, response=Response.CONTROLLED_STOP, speed_limit_mps=0.0, text="!") for r in e.message.rules
        )
        hits = np.array([[6.0, 0.0, 0.5]], np.float32)
        return replace(e, message=replace(e.message, rules=rules, clearance_m=2.0, triggering_points_base_m=hits))

    assert "false stops" in failures(evaluate(change))


def test_missing_detections_count_as_missed() -> None:
    def change(e: Envelope) -> Envelope | None:
        if isinstance(e.message, SupervisorState):
            rules = tuple(replace(r, response=Response.NONE, speed_limit_mps=math.inf) for r in e.message.rules)
            return replace(
                e,
                message=replace(
                    e.message, rules=rules, clearance_m=math.inf, triggering_points_base_m=np.empty((0, 3), np.float32)
                ),
            )
        return None if isinstance(e.message, Obstacles | Tracks) else e

    failed = failures(evaluate(change))
    assert "missed" in failed
    assert "recall" in failed


def test_delay_of_half_a_second_fails_latency() -> None:
    def change(e: Envelope) -> Envelope:
        late = isinstance(e.message, SupervisorState | Obstacles | Tracks)
        return replace(e, receive_ns=e.receive_ns + 500_000_000) if late else e

    assert "latency" in failures(evaluate(change))

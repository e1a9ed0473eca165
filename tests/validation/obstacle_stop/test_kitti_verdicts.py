"""The verdicts on KITTI's first forty frames, and that judges who are easily pleased would be found out."""

import math
import os
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
from runtime.replay.prepare import Prepared, load_configuration, prepare
from runtime.replay.replay import replay
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.evaluation import judge_log
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.totals import put_together

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("HEADLAND_DATA", ROOT.parent / "shared" / "data"))
LOG, TRUTH = DATA / "kitti-seq-pcd", DATA / "kitti-tracking-truth"
CONDITIONS = load_conditions(None)
pytestmark = [
    pytest.mark.skipif(not (LOG.is_dir() and TRUTH.is_dir()), reason="no KITTI recording in shared/data"),
    pytest.mark.slow,
]


@cache
def recorded() -> tuple[Prepared, list[Envelope]]:
    """The replay's messages, once."""
    prepared = prepare(LOG, TRUTH, None, load_configuration(CONDITIONS))
    envelopes: list[Envelope] = []
    replay(prepared, [envelopes.append])
    return prepared, envelopes


def judged(change: Callable[[Envelope], Envelope | None] = lambda e: e) -> dict:
    """The log's result after each message was changed, in order of delivery."""
    prepared, envelopes = recorded()
    observer = Observer(prepared.setting("kitti"), CONDITIONS)
    changed = [c for e in envelopes if (c := change(e)) is not None]
    for envelope in sorted(changed, key=lambda e: e.receive_ns):
        observer(envelope)
    log = judge_log("kitti", observer.finish(), True, CONDITIONS)
    return put_together([log], CONDITIONS) | {"confirmation": log["confirmation"]}


def bars(result: dict) -> list[str]:
    """Which bars a result fails."""
    by_id = {e["id"]: e for e in result["encounters"]}
    van, cyclist = by_id.get(0), by_id.get(1)
    told = {row["id"]: row["after_s"] for row in result["confirmation"]}
    checks = {
        "van": van is not None and abs(van["margin_m"] - 4.1) <= 0.4 and van["asked_s"] is None,
        "cyclist": cyclist is not None and cyclist["outcome"] == "cut-in" and abs(cyclist["clearance_m"] - 4.9) <= 0.6
        and abs(cyclist["stopping_distance_m"] - 6.1) <= 0.5 and 3.2 <= cyclist["entered_s"] <= 3.9,
        "asked": cyclist is not None and cyclist["asked_after_s"] is not None and cyclist["asked_after_s"] <= 0.1,
        "others": set(by_id) == {0, 1} and all(set(s["objects"]) <= {1} for s in result["stops"]),
        "false stops": result["false_stops"] == 0,
        "missed": result["missed"] == 0,
        "recall": all(row["recall"] == 1.0 for row in result["recall"] if row["to_m"] <= 30),
        "latency": all(told[i] is not None and told[i] <= 0.3 + 0.1 for i in (0, 1, 3)),
    }  # fmt: skip
    return [name for name, holds in checks.items() if not holds]


def test_the_stack_as_it_is_keeps_every_bar() -> None:
    assert bars(judged()) == []


def test_everything_is_an_obstacle_fails() -> None:
    def change(e: Envelope) -> Envelope:
        if not isinstance(e.message, SupervisorState):
            return e
        rules = tuple(
            replace(r, response=Response.CONTROLLED_STOP, speed_limit_mps=0.0, text="!") for r in e.message.rules
        )
        hits = np.array([[6.0, 0.0, 0.5]], np.float32)
        return replace(e, message=replace(e.message, rules=rules, clearance_m=2.0, triggering_points_base_m=hits))

    assert "false stops" in bars(judged(change))


def test_nothing_is_an_obstacle_fails() -> None:
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

    failed = bars(judged(change))
    assert "missed" in failed
    assert "recall" in failed


def test_half_a_second_late_fails() -> None:
    def change(e: Envelope) -> Envelope:
        late = isinstance(e.message, SupervisorState | Obstacles | Tracks)
        return replace(e, receive_ns=e.receive_ns + 500_000_000) if late else e

    assert "latency" in bars(judged(change))

"""Verdicts on the first forty KITTI frames, as calculated by hand (by_hand.py), and with altered outputs."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from messages.command import SupervisorState
from messages.faults import Response
from messages.message import Envelope
from messages.motion import Odometry
from messages.perception import Obstacles, Tracks
from tests.validation.obstacle_stop import by_hand
from tests.validation.obstacle_stop.kitti import LABELS, NEEDED, judged, outputs

pytestmark = [NEEDED, pytest.mark.slow]
TOLERANCE = 0.101  # m, and the period of the labels


def _is_near(value: float | None, expected: float) -> bool:
    return value is not None and abs(value - expected) <= TOLERANCE


def failures(result: dict) -> list[str]:
    """Names of the expectations that a result fails."""
    by_id = {e["id"]: e for e in result["encounters"]}
    van, cyclist = by_id.get(0), by_id.get(1)
    delays = {row["id"]: row["after_s"] for row in result["confirmation"]}
    checks = {
        "van": van is not None and van["outcome"] == "no demand"
        and _is_near(van["least_margin_m"], by_hand.van_margin_m()),
        "cyclist": cyclist is not None and cyclist["outcome"] == "in time" and not cyclist["has_contact"]
        and _is_near(cyclist["margin_m"], by_hand.cyclist_margin_m()) and _is_near(cyclist["due_s"], by_hand.due_s()),
        "request": cyclist is not None and cyclist["request_delay_s"] is not None and cyclist["request_delay_s"] <= 0.1,
        "others": set(by_id) == {0, 1} and all(set(s["objects"]) <= {1} for s in result["stops"]),
        "false stops": result["false_stops"] == 0,
        "missed": result["missed"] == 0,
        "recall": all(row["recall"] == 1.0 for row in result["recall"] if row["to_m"] <= 30),
        "latency": all(delays[i] is not None and delays[i] <= 0.3 + 0.1 for i in (0, 1, 3)),
    }  # fmt: skip
    return [name for name, holds in checks.items() if not holds]


def test_numbers_of_the_calculation_by_hand_are_those_of_the_log() -> None:
    rows = [line.split() for line in LABELS.read_text().splitlines()]
    van = next(r for r in rows if r[:2] == ["0", "0"])
    cyclist = [r for r in rows if r[1] == "1" and 32 <= int(r[0]) < 40]
    assert np.array([van[13], van[15], van[16]], float) == pytest.approx(by_hand.VAN, abs=0.001)
    assert np.array([[r[13], r[15], r[16]] for r in cyclist], float) == pytest.approx(by_hand.CYCLIST, abs=0.001)
    for row, (length, width) in ((van, by_hand.VAN_M), (cyclist[0], by_hand.CYCLIST_M)):
        assert (float(row[12]), float(row[11])) == pytest.approx((length, width), abs=0.01)

    odometry = [e.message for e in outputs() if isinstance(e.message, Odometry)]
    t_s = np.array([o.stamp_ns - odometry[0].stamp_ns for o in odometry]) * 1e-9
    speeds = np.interp(by_hand.SPEEDS_S, t_s, [o.speed_mps for o in odometry])
    assert speeds == pytest.approx(by_hand.SPEEDS_MPS, abs=0.02)
    late = [o.yaw_rate_radps / o.speed_mps for o, t in zip(odometry, t_s, strict=True) if t >= 2.5]
    assert late == pytest.approx([by_hand.CURVATURE_RADPM] * len(late), abs=0.001)


def test_request_for_the_cyclist_stands_from_the_time_in_the_calculation_by_hand() -> None:
    first_ns = next(e.message.stamp_ns for e in outputs() if isinstance(e.message, Odometry))
    states = [
        ((e.receive_ns - first_ns) * 1e-9, e.message) for e in outputs() if isinstance(e.message, SupervisorState)
    ]
    slowest_mps = float(by_hand.SPEEDS_MPS.min())
    braking = [t for t, s in states if min((r.speed_limit_mps for r in s.rules), default=math.inf) < slowest_mps]
    assert braking[0] == pytest.approx(by_hand.REQUEST_S, abs=0.01)
    before = [t for t, _ in states if braking[0] <= t < by_hand.due_s() - 0.1]
    withdrawn = [later - t for t, later in pairwise(before) if t not in braking]
    assert sum(withdrawn) == pytest.approx(by_hand.WITHDRAWN_S, abs=0.01)


def test_unaltered_replay_meets_all_expectations() -> None:
    assert failures(judged()) == []


def test_state_is_passed_with_the_cyclist_as_the_only_trial() -> None:
    result = judged()
    assert (result["state"], result["missed_share"]["of"], result["false_stop_scans"]["count"]) == ("passed", 1, 0)


def test_permanent_stop_request_counts_as_false_stop() -> None:
    def change(e: Envelope) -> Envelope:
        if not isinstance(e.message, SupervisorState):
            return e
        rules = tuple(
            replace(r, response=Response.CONTROLLED_STOP, speed_limit_mps=0.0, text="!") for r in e.message.rules
        )
        hits = np.array([[6.0, 0.0, 0.5]], np.float32)
        return replace(e, message=replace(e.message, rules=rules, clearance_m=2.0, triggering_points_base_m=hits))

    assert "false stops" in failures(judged(change))


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

    failed = failures(judged(change))
    assert "missed" in failed
    assert "recall" in failed


def test_delay_of_half_a_second_fails_latency() -> None:
    def change(e: Envelope) -> Envelope:
        late = isinstance(e.message, SupervisorState | Obstacles | Tracks)
        return replace(e, receive_ns=e.receive_ns + 500_000_000) if late else e

    assert "latency" in failures(judged(change))

"""Verdicts on scripted drives: bends, reverse, implements, several objects, cut-ins, occlusion, drivers, latency."""

import math
from dataclasses import replace

import numpy as np
import pytest

from geometry.drawbar import Drawbar, Trailer
from geometry.rectangle import Rectangle
from messages.truth import Occlusion
from tests.validation.obstacle_stop.scripted import (
    CONDITIONS,
    FRONT_M,
    Request,
    Script,
    Thing,
    braking,
    judge,
    observe,
    standing,
    straight,
    with_implement,
)
from validation.obstacle_stop.avoidability import Outcome
from validation.obstacle_stop.encounters import Encounter
from validation.obstacle_stop.evaluation import evaluate_log
from validation.obstacle_stop.stopping import stopping_distance_m
from validation.obstacle_stop.stops import false_stop_scans, find_stops
from validation.obstacle_stop.totals import aggregate

BRAKING = CONDITIONS.braking
V = 6.0
S = stopping_distance_m(V, BRAKING.reaction_s, BRAKING)  # 12.0 m
BRAKED = stopping_distance_m(V, BRAKING.dead_time_s, BRAKING)  # from the request: 10.2 m
SIDE = 0.3
FOREVER = 99.0


def one(script: Script) -> Encounter:
    (encounter,) = judge(script)
    return encounter


def at_gap(gap_m: float, y_m: float = 0.0) -> Thing:
    """A person whose box is `gap_m` ahead at the start."""
    return standing(1, FRONT_M + gap_m + SIDE, y_m)


def test_person_without_any_request_is_missed_and_run_over() -> None:
    found = one(Script(straight(V), [at_gap(25.0)], seconds=5.0))
    assert (found.outcome, found.has_contact, found.margin_m) == (Outcome.MISSED, True, None)
    assert found.impact_speed_mps == pytest.approx(V)


def test_person_below_s_but_not_reached_is_missed() -> None:
    found = one(Script(braking(V, 3.0, 6.0), [at_gap(25.0)], seconds=6.0))  # stops 4 m before, braking from 7 m on
    assert (found.outcome, found.has_contact) == (Outcome.MISSED, False)


def test_person_in_path_whose_first_request_comes_too_late_is_no_cut_in() -> None:
    for first_s in (3.5, 3.6, 4.0):
        found = one(Script(straight(V), [at_gap(25.0)], [Request(first_s, FOREVER, 1)], 4.5))
        assert found.outcome is Outcome.LATE
        assert found.margin_m == pytest.approx(25.0 - V * first_s - BRAKED, abs=0.05)


def test_request_of_a_tenth_of_a_second_is_late() -> None:
    found = one(Script(straight(V), [at_gap(25.0)], [Request(2.0, 2.1, 1)], 4.5))
    assert (found.outcome, found.has_contact, found.margin_m) == (Outcome.LATE, True, None)
    assert one(Script(straight(V), [at_gap(25.0)], [Request(2.0, FOREVER, 1)], 4.5)).outcome is Outcome.IN_TIME


def test_request_counts_when_it_is_delivered() -> None:
    script = Script(straight(V), [at_gap(25.0)], [Request(2.0, FOREVER, 1)], 4.5)
    found = one(replace(script, latency_s=1.5))
    assert found.stop_requested_s == pytest.approx(3.5, abs=0.02)
    assert found.outcome is Outcome.LATE
    assert found.margin_m == pytest.approx(25.0 - V * 3.5 - BRAKED, abs=0.15)


def test_speed_limit_counts_as_what_it_requests() -> None:
    limits = [Request(1.5, 2.6, 1, 4.0), Request(2.6, FOREVER, 1, 2.0)]
    found = one(Script(straight(V), [at_gap(25.0)], limits, 6.0))
    assert (found.outcome, found.is_stop_requested) == (Outcome.LATE, False)
    assert found.impact_speed_mps == pytest.approx(2.0, abs=0.05)
    down = [Request(1.5 + 0.1 * k, 1.6 + 0.1 * k, 1, max(0.0, 6.0 - 0.4 * k)) for k in range(30)]
    found = one(Script(straight(V), [at_gap(25.0)], down, 4.5))
    assert found.outcome is Outcome.IN_TIME
    assert found.margin_m is not None


def test_machine_that_never_moves_shows_nothing() -> None:
    script = Script(straight(0.0), [at_gap(3.0)], [Request(1.0, FOREVER, 1)], 4.0)
    assert one(script).outcome is Outcome.NOT_SHOWN
    result = aggregate([evaluate_log("script", observe(script), True, CONDITIONS)], CONDITIONS)
    assert result["state"] == "not_shown"
    assert any("did not move" in row["reason"] for row in result["not_shown"])


def test_driver_who_brakes_first_shows_nothing() -> None:
    script = Script(braking(V, 0.5, 2.0), [at_gap(20.0)], seconds=6.0)
    assert one(script).outcome is Outcome.DRIVER
    assert one(replace(script, requests=[Request(3.0, FOREVER, 1)])).outcome is Outcome.DRIVER
    assert one(replace(script, is_manual=False)).outcome is Outcome.NO_DEMAND


def test_driver_who_brakes_after_the_request_was_due_does_not_help() -> None:
    found = one(Script(braking(V, 2.3, 5.0), [at_gap(25.0)], [Request(3.0, FOREVER, 1)], 6.0))
    assert (found.outcome, found.due_s) == (Outcome.LATE, pytest.approx(2.2, abs=0.05))


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("first_s", [1.5, 4.2])
def test_forward_and_reverse_alike(direction: int, first_s: float) -> None:
    v, gap = 3.0, 15.0
    end_m = FRONT_M if direction > 0 else 1.0
    thing = standing(1, direction * (end_m + gap + SIDE))
    found = one(Script(straight(direction * v), [thing], [Request(first_s, FOREVER, 1)], 6.0))
    margin = gap - v * first_s - stopping_distance_m(v, BRAKING.dead_time_s, BRAKING)
    assert found.direction == direction
    assert found.margin_m == pytest.approx(margin, abs=0.05)
    assert found.outcome is (Outcome.IN_TIME if margin >= 0.0 else Outcome.LATE)


def shunting(t: float) -> tuple[float, float, float]:
    """Forward at 2 m/s for 5 s, then reverse at 2 m/s."""
    return (2.0 * t if t < 5.0 else 20.0 - 2.0 * t), 0.0, 0.0


def test_person_behind_is_met_after_the_reversal() -> None:
    found = one(Script(shunting, [standing(1, -6.0)], seconds=14.0))
    assert (found.outcome, found.direction, found.has_contact) == (Outcome.MISSED, -1, True)
    assert found.entry_s >= 5.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_swept_path_of_a_bend(side: float) -> None:
    radius = 20.0

    def bend(t: float) -> tuple[float, float, float]:
        turn = V * t / radius
        return radius * math.sin(turn), side * radius * (1.0 - math.cos(turn)), side * turn

    turn = (18.0 + FRONT_M) / radius
    inside = (radius * math.sin(turn), side * radius * (1.0 - math.cos(turn)))
    found = one(Script(bend, [Thing(1, lambda t: inside)], [Request(0.5, FOREVER, 1)], 3.0))
    assert found.outcome is Outcome.IN_TIME
    assert found.margin_m == pytest.approx(18.0 - SIDE - 0.5 * V - BRAKED, abs=0.4)
    assert judge(Script(bend, [standing(1, FRONT_M + 18.0)], seconds=3.0)) == []  # straight ahead, beside the bend


def test_wing_of_an_implement_and_a_trailer_that_cuts_the_corner() -> None:
    beside = standing(1, 20.0, 2.6)
    assert judge(Script(straight(V), [beside], seconds=4.0)) == []
    wing = with_implement(Rectangle(-3.0, -1.5, 6.0))
    found = one(Script(straight(V), [beside], seconds=4.5, working=wing, half_width_m=3.0))
    assert (found.outcome, found.has_contact) == (Outcome.MISSED, True)
    assert found.entry_clearance_m == pytest.approx(20.0 - SIDE + 1.5, abs=0.05)

    def bend(t: float) -> tuple[float, float, float]:
        return 8.0 * math.sin(0.25 * t), 8.0 * (1.0 - math.cos(0.25 * t)), 0.25 * t

    inside = Thing(1, lambda t: (8.0 * math.sin(1.2) * 0.8, 8.0 - 8.0 * math.cos(1.2) * 0.8), (0.2, 0.2, 1.8))
    assert judge(Script(bend, [inside], seconds=8.0)) == []
    trailer = replace(
        with_implement(Rectangle(-1.0, 0.0, 1.0)), trailer=Trailer(Rectangle(-6.0, 0.0, 1.8), Drawbar(-1.0, 5.0))
    )
    assert one(Script(bend, [inside], seconds=8.0, working=trailer)).has_contact


def test_side_margin_demands_a_stop_without_contact() -> None:
    script = Script(straight(V), [at_gap(25.0, 0.9 + 0.3 + SIDE)], seconds=5.0, half_width_m=1.4)
    assert (one(script).outcome, one(script).has_contact) == (Outcome.MISSED, False)
    assert judge(replace(script, half_width_m=0.9)) == []


def test_several_objects_are_judged_each() -> None:
    things = [at_gap(25.0), standing(2, FRONT_M + 28.0, 0.5), standing(3, FRONT_M + 20.0, 4.0)]
    found = judge(Script(straight(V), things, [Request(2.0, FOREVER, 1)], 4.0))
    assert [(e.id, e.outcome) for e in found] == [(1, Outcome.IN_TIME), (2, Outcome.IN_TIME)]
    found = judge(Script(straight(V), things, [Request(2.0, FOREVER, 3)], 5.0))  # the one beside the path
    assert {e.id: e.outcome for e in found} == {1: Outcome.MISSED, 2: Outcome.MISSED}


def crossing(speed_mps: float, at_s: float, x_m: float) -> Thing:
    """A person who crosses the x axis at a time."""
    return Thing(1, lambda t: (x_m, speed_mps * (t - at_s)))


def test_crossing_pedestrian_was_predictable() -> None:
    walker = crossing(1.5, 4.0, FRONT_M + 4.0 * V + 2.0)
    assert one(Script(straight(V), [walker], [Request(3.4, FOREVER, 1)], 5.0)).outcome is Outcome.LATE
    early = one(Script(straight(V), [walker], [Request(1.5, FOREVER, 1)], 5.0))
    assert (early.outcome, early.has_contact) == (Outcome.IN_TIME, False)
    assert early.stop_requested_s is not None
    assert early.stop_requested_s < early.entry_s


def jumping(at_s: float, x_m: float) -> Thing:
    """A person who stands beside the path and is in it from one label to the next."""
    return Thing(1, lambda t: (x_m, 3.0 if t < at_s else 0.5))


def test_cut_in_only_with_a_prompt_request() -> None:
    person = jumping(2.0, FRONT_M + 2.0 * V + 5.0)
    prompt, slow = Request(2.2, FOREVER, 1), Request(2.6, FOREVER, 1)
    assert one(Script(straight(V), [person], [prompt], 4.0)).outcome is Outcome.CUT_IN
    assert one(Script(straight(V), [person], [slow], 4.0)).outcome is Outcome.LATE
    assert one(Script(straight(V), [person], [], 4.0)).outcome is Outcome.MISSED
    far = jumping(2.0, FRONT_M + 2.0 * V + 14.0)  # enters at a gap above S
    assert one(Script(straight(V), [far], [Request(3.2, FOREVER, 1)], 4.5)).outcome is Outcome.LATE


def test_flicker_of_a_request_does_not_excuse_the_next_one() -> None:
    person = jumping(2.0, FRONT_M + 2.0 * V + 5.0)
    flicker = [Request(2.1, 2.16, 1), Request(2.8, FOREVER, 1)]
    assert one(Script(straight(V), [person], flicker, 4.0)).outcome is Outcome.LATE


def test_occlusion_by_another_box_and_by_label() -> None:
    x = FRONT_M + 3.0 * V + 4.0
    person = Thing(1, lambda t: (x, 0.0))
    screen = Thing(2, lambda t: (x - 1.5, 0.0) if t < 3.0 else (x - 1.5, 40.0), (0.5, 8.0, 3.0))
    request = [Request(3.2, FOREVER, 1)]
    outcomes = {e.id: e.outcome for e in judge(Script(straight(V), [person, screen], request, 4.5))}
    assert outcomes[1] is Outcome.OCCLUDED
    assert one(Script(straight(V), [person], request, 4.5)).outcome is Outcome.LATE
    hidden = replace(person, occlusion=Occlusion.LARGELY)
    assert one(Script(straight(V), [hidden], request, 4.5)).outcome is Outcome.OCCLUDED
    shown = replace(person, occlusion=Occlusion.NONE)
    outcomes = {e.id: e.outcome for e in judge(Script(straight(V), [shown, screen], request, 4.5))}
    assert outcomes[1] is Outcome.LATE


def test_false_stops_are_not_absolved_by_an_object_touched_once() -> None:
    things = [standing(1, 20.0, 1.6)]
    dust = [Request(0.2 * k, 0.2 * k + 0.2, None, 0.0, (4.5, 0.0)) for k in range(20)]
    dust[10] = replace(dust[10], object_id=1)
    observed = observe(Script(straight(1.0), things, dust, 4.0))
    stops = find_stops("script", observed, True)
    assert [(s.is_false, s.objects) for s in stops] == [(True, ()), (False, (1,))]
    assert stops[0].until_s - stops[0].t_s == pytest.approx(3.9, abs=0.1)
    observed.scans = observed.motion.stamps_ns[::5]
    assert false_stop_scans(observed) == pytest.approx(0.95 * len(observed.scans), abs=2)


def test_bounds_required_by_the_conditions() -> None:
    script = Script(straight(V), [at_gap(25.0)], [Request(2.0, FOREVER, 1)], 4.5)
    strict = CONDITIONS.model_copy(update={"required_bounds": CONDITIONS.required_bounds.model_copy(
        update={"missed_share": 0.001})})  # fmt: skip
    log = evaluate_log("script", observe(script), True, CONDITIONS)
    assert aggregate([log], CONDITIONS)["state"] == "passed"
    result = aggregate([log], strict)
    assert result["state"] == "not_shown"
    assert "0.001 required" in result["not_shown"][0]["reason"]


def test_findings_that_spoil_the_truth_precede_a_failure() -> None:
    log = evaluate_log("script", observe(Script(straight(V), [at_gap(25.0)], seconds=5.0)), True, CONDITIONS)
    assert aggregate([log], CONDITIONS)["state"] == "failed"
    finding = {"code": "mount_pitch", "text": "ground plane", "numbers": {}, "is_blocking": True}
    assert aggregate([log | {"findings": [finding]}], CONDITIONS)["state"] == "failed"
    finding["code"] = "truth_shifted"
    assert aggregate([log | {"findings": [finding]}], CONDITIONS)["state"] == "not_shown"


def test_speed_of_the_ghost_does_not_depend_on_the_stamps_of_labels() -> None:
    for gap in np.linspace(20.0, 30.0, 5):
        found = one(Script(straight(V), [at_gap(float(gap))], [Request(1.2, FOREVER, 1)], 4.0))
        assert found.margin_m == pytest.approx(gap - 1.2 * V - BRAKED, abs=0.03)

"""Avoidability of contacts and stops in truth scripts agrees with the closed form of a stop."""

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.hazards.scripts import (
    FRONT_M,
    HALF_M,
    TOOL_HALF_M,
    drive,
    machine,
    moving_object,
    still_object,
    wall,
)
from validation.hazards.avoidability import avoidability_of
from validation.hazards.braking import BRAKING, speed_after, stopping_time, travel_after
from validation.hazards.contacts import approach_of
from validation.hazards.stops import is_justified
from validation.obstacle_stop.stopping import stopping_distance_m

V = 2.5
SIDE_M = HALF_M + 0.25  # place beside the machine at which a box touches it


def judged(track, one, *others):
    truth = drive(track, one, *others)
    contact = approach_of(truth, one).contact
    assert contact is not None
    return contact, avoidability_of(truth, one, contact)


def runs_in(at_s, x_m, speed=5.0, from_m=3.6):
    """Stands 3.6 m beside the path, then runs to its middle."""
    return moving_object([(at_s, x_m, from_m), (at_s + from_m / speed, x_m, 0.0)])


def braking_from(known_s, speed=V):
    return machine(lambda t: speed if t < known_s else speed_after(speed, t - known_s))


@pytest.mark.parametrize("speed", [0.2, 0.5, 1.0, 2.78, 5.0])
def test_closed_form(speed):
    t = np.linspace(0.0, stopping_time(speed), 20001)
    v = np.array([speed_after(speed, x) for x in t])
    driven = float((0.5 * (v[1:] + v[:-1]) * np.diff(t)).sum())
    assert driven == pytest.approx(stopping_distance_m(speed, BRAKING.reaction_s, BRAKING), abs=1e-3)
    assert travel_after(speed, stopping_time(speed) + 1.0) == pytest.approx(driven, abs=1e-3)
    assert v[-1] == pytest.approx(0.0, abs=1e-6)


def test_what_does_not_move_is_avoidable():
    one = still_object(10.0, 0.0, (0.0, 0.3))
    assert judged(machine(V, hitch=0.0), one)[1].reason == "does not move"


@pytest.mark.parametrize(("appears_s", "gap_m", "reason"), [
    (0.9, 0.05, "does not move"),
    (1.1, 0.05, "entered the path too near"),
    (1.1, 3.0, "visible in time to stop"),
])  # fmt: skip
def test_appears_beside_a_machine_that_has_just_set_off(appears_s, gap_m, reason):
    """At standstill until 1 s, then 0.3 m/s: nobody stops within 0.05 m for what is there only after that."""
    one = still_object(FRONT_M + 0.03 + gap_m + 0.25, 0.0)
    since = one.t_s >= appears_s - 1e-6
    one = replace(one, t_s=one.t_s[since], place_m=one.place_m[since], velocity_mps=one.velocity_mps[since],
                  shapes=one.shapes[int(np.argmax(since)):])  # fmt: skip
    track = machine(lambda t: 0.0 if t < 1.0 else 0.3, seconds=16.0)
    found = judged(track, one)[1]
    assert (found.is_unavoidable, found.reason) == (reason == "entered the path too near", reason)


def test_runs_in_too_near_and_the_machine_brakes_as_it_can():
    """Contact with the side of the machine 0.44 s after the start of the run: within the reaction time."""
    t0 = 2.0
    one = runs_in(t0, V * t0 + FRONT_M + 0.5)
    contact, found = judged(braking_from(t0), one)
    assert contact.t_s == pytest.approx(t0 + (3.6 - SIDE_M) / 5.0, abs=0.02)
    assert found.is_unavoidable
    assert found.reason == "entered the path too near"
    assert found.closed_form_mps == pytest.approx(speed_after(V, contact.t_s - found.known_s), abs=0.05)
    assert contact.machine_mps <= found.closed_form_mps + 0.1


def test_runs_in_too_near_and_the_machine_does_not_brake():
    """Contact 1.1 s after the start of the run; the closed form has lost more than 0.5 m/s by then."""
    t0, speed = 2.0, 2.0
    one = runs_in(t0, V * t0 + FRONT_M + 2.2, speed)
    contact, found = judged(machine(V), one)
    lost = V - speed_after(V, contact.t_s - t0)
    assert lost > 0.5
    assert not found.is_unavoidable
    assert found.reason == "contact faster than a stop would have left it"
    assert judged(braking_from(t0), one)[1].is_unavoidable


def test_runs_in_far_ahead_is_avoidable():
    one = runs_in(1.0, V + FRONT_M + stopping_distance_m(V, BRAKING.reaction_s, BRAKING) + 1.0)
    assert judged(machine(V), one)[1].reason == "visible in time to stop"


def test_steps_out_of_occlusion_before_a_fast_machine():
    """Hidden by a wall; too near for 2.5 m/s, but 3 km/h would have stopped."""
    x = 10.6
    one = moving_object([(1.6, x, 5.5), (1.6 + 5.5 / 4.0, x, 0.0)])
    hedge = wall(-5.0, 3.2, x - 0.5, 3.4)
    contact, found = judged(machine(V), one, hedge)
    assert found.reason == "too fast past an occlusion"
    assert not found.is_unavoidable
    assert contact.machine_mps == pytest.approx(V, abs=0.01)


def test_steps_out_of_occlusion_right_before_a_slow_machine():
    """3 km/h; the child comes round the end of a hedge 0.5 s before contact: not even then a stop is possible."""
    slow, t0 = 3.0 / 3.6, 3.0
    x = slow * (t0 + 0.67) + FRONT_M
    one = moving_object([(t0, x - 1.2, 4.5), (t0 + 0.25, x, 4.0), (t0 + 0.75, x, 0.9)])
    hedge = wall(-5.0, 3.2, x - 0.5, 3.4)
    contact, found = judged(machine(slow), one, hedge)
    assert found.is_unavoidable
    assert found.reason == "hidden until too near"
    assert contact.machine_mps <= found.closed_form_mps + 0.1


def test_in_reach_before_the_machine_set_off():
    one = moving_object([(3.2, FRONT_M + 1.5, 2.0), (3.9, FRONT_M + 1.5, 0.0)])
    track = machine(lambda t: 0.0 if t < 3.0 else min(1.5, 1.5 * (t - 3.0)))
    assert judged(track, one)[1].reason == "in reach before the machine set off"


@pytest.mark.parametrize(("speed", "reason"), [
    (1.25, "entered a PTO that could not stand yet"),
    (0.75, "visible in time to stop"),
])  # fmt: skip
def test_walks_into_a_running_pto_at_a_standing_machine(speed, reason):
    """3 m to the wing take 2.4 or 4 s from the start of the walk; a PTO that is stopped then stands after 3.0 s."""
    side_m = TOOL_HALF_M + 0.25
    one = moving_object([(3.6, 0.0, side_m + 3.0), (3.6 + 3.5 / speed, 0.0, side_m - 0.5)], seconds=12.0)
    track = machine(lambda t: 1.0 if 0.0 < t < 1.65 else 0.0, seconds=12.0, hitch=0.0, pto=50.0)
    contact, found = judged(track, one)
    assert (contact.machine_mps, contact.t_s) == (0.0, pytest.approx(3.6 + 3.0 / speed, abs=0.02))
    assert (found.is_unavoidable, found.reason) == (reason != "visible in time to stop", reason)


def test_stop_before_an_object_is_justified():
    track = machine(lambda t: max(0.0, V - 2.5 * max(0.0, t - 2.0)))
    assert is_justified(drive(track, still_object(9.5, 0.0)), 2.0)
    assert is_justified(drive(track, runs_in(1.5, 9.5, 2.0, 8.0)), 2.0)


def test_early_stop_before_an_object_in_the_lane_of_a_wing_is_justified():
    """5 m ahead of the front, but 9.6 m ahead of the wing that would touch it."""
    track = machine(lambda t: max(0.0, 0.5 - 2.5 * max(0.0, t - 2.0)))
    assert is_justified(drive(track, still_object(1.0 + FRONT_M + 5.0, 2.4)), 2.0)
    assert not is_justified(drive(track, still_object(1.0 + FRONT_M + 5.0, 4.6)), 2.0)


def test_stop_without_an_object_near_the_path_is_false():
    track = machine(lambda t: max(0.0, V - 2.5 * max(0.0, t - 2.0)))
    assert not is_justified(drive(track), 2.0)
    assert not is_justified(drive(track, still_object(40.0, 0.0)), 2.0)
    assert not is_justified(drive(track, still_object(14.0, 9.0)), 2.0)
    assert not is_justified(drive(track, still_object(9.5, 0.0, must_avoid=False)), 2.0)

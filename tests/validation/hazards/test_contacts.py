"""Contacts, places, speeds and near misses of truth scripts agree with their closed form."""

import math

import numpy as np
import pytest

from tests.validation.hazards.scripts import (
    FRONT_M,
    HALF_M,
    LIFT_M,
    TOOL_FRONT_M,
    TOOL_LOW_M,
    TOOL_REAR_M,
    TOP_M,
    drive,
    machine,
    moving_object,
    still_object,
    wall,
)  # fmt: skip
from validation.hazards.contacts import approach_of

V = 2.5
RAISED_M = TOOL_LOW_M + LIFT_M


# script: machine, object; expected part, time, point (None: not compared), relative speed, speed of the machine
CONTACTS = {
    "ahead": (machine(V), still_object(10.0, 0.0), "body", (10.0 - 0.25 - FRONT_M) / V, (9.75, 0.0), V, V),
    "reverse": (machine(-1.0), still_object(-6.0, 2.0), "wing_left", 6.0 - 0.25 + TOOL_REAR_M, (-5.75, 2.0), 1.0, 1.0),
    "wing": (
        machine(V, hitch=0.0), still_object(5.0, -2.25, (0.0, 0.3)), "wing_right", (4.75 - TOOL_FRONT_M) / V,
        (4.75, -2.25), V, V,
    ),
    "branch": (machine(V), still_object(8.0, 0.5, (2.0, 2.1)), "body", (7.75 - FRONT_M) / V, (7.75, 0.5), V, V),
    "oncoming": (
        machine(V), moving_object([(0.0, 20.0, 0.0), (6.0, 11.0, 0.0)]), "body", (20.0 - 0.25 - FRONT_M) / (V + 1.5),
        None, V + 1.5, V,
    ),
    "from behind": (
        machine(1.0), moving_object([(0.0, -8.0, 0.0), (6.0, 10.0, 0.0)]), "implement",
        (8.0 - 0.25 + TOOL_REAR_M) / 2.0, None, 2.0, 1.0,
    ),
    "from the side": (
        machine(1.0), moving_object([(0.0, 3.0, 6.0), (4.0, 3.0, -2.0)]), "body", (6.0 - 0.25 - HALF_M) / 2.0,
        None, math.hypot(1.0, 2.0), 1.0,
    ),
    "PTO at standstill": (
        machine(0.0, pto=50.0), moving_object([(0.0, -6.0, 0.0), (6.0, 0.0, 0.0)]), "implement",
        (6.0 - 0.25 + TOOL_REAR_M) / 1.0, None, 1.0, 0.0,
    ),
    "hitch lowers": (
        machine(0.0, hitch=lambda t: max(0.0, 1.0 - 0.1 * t)), still_object(-1.7, 0.2, (0.0, 0.35)), "implement",
        10.0 * (1.0 - (0.35 - TOOL_LOW_M) / LIFT_M), None, 0.0, 0.0,
    ),
    "fence": (machine(V), wall(12.0, -5.0, 12.2, 5.0), "body", (12.0 - FRONT_M) / V, None, V, V),
}  # fmt: skip


@pytest.mark.parametrize("name", CONTACTS)
def test_contact(name):
    track, one, part, t_s, place, relative, own = CONTACTS[name]
    contact = approach_of(drive(track, one), one).contact
    assert contact is not None
    assert contact.part == part
    assert contact.t_s == pytest.approx(t_s, abs=0.01)
    assert contact.relative_mps == pytest.approx(relative, abs=0.02)
    assert contact.machine_mps == pytest.approx(own, abs=0.02)
    if place is not None:
        assert np.hypot(contact.point_map_m[0] - place[0], contact.point_map_m[1] - place[1]) < 0.05
    assert not contact.is_walked_into


def test_speed_of_a_wing_in_a_turn():
    """The right end of the implement moves faster than the machine by yaw rate times its distance."""
    track = machine(2.0, yaw_rate=0.4)
    radius = 5.0  # of base about the centre (0, 5)
    angle, reach = 0.8, math.hypot(radius + 3.0, TOOL_REAR_M)
    bearing = angle - math.pi / 2.0 + math.atan2(TOOL_REAR_M, radius + 3.0)  # of the rear right corner at t = 2 s
    post = still_object(reach * math.cos(bearing), radius + reach * math.sin(bearing), (0.0, 2.0), half=0.02)
    contact = approach_of(drive(track, post), post).contact
    assert contact.part == "wing_right"
    assert contact.t_s <= 2.05
    assert contact.relative_mps == pytest.approx(0.4 * (radius + 3.0), abs=0.15)


@pytest.mark.parametrize(("back_m", "part"), [(-3.0, None), (FRONT_M + 2.0, "wing_left")])
def test_hood_of_a_standing_machine_whose_pto_runs_is_walked_into(back_m, part):
    """From ahead to the hood; then on through the machine, which holds it up, or away and round it to the implement."""
    round_it = [(3.5, FRONT_M + 2.0, 5.0), (4.5, -1.7, 5.0), (6.0, -1.7, 2.0)]
    to_hood = [(0.0, FRONT_M + 2.0, 0.0), (1.0, FRONT_M, 0.0), (3.0, back_m, 0.0)]
    one = moving_object([*to_hood, *(round_it if part else ())])
    found = approach_of(drive(machine(0.0, pto=50.0), one), one)
    assert (found.walked_into.part, found.walked_into.is_walked_into) == ("body", True)
    assert (found.contact and found.contact.part) == part


def test_standing_machine_that_is_walked_into_is_no_contact():
    one = moving_object([(0.0, 9.0, 0.0), (6.0, 3.0, 0.0)])
    found = approach_of(drive(machine(0.0), one), one)
    assert found.contact is None
    assert found.walked_into.is_walked_into
    assert found.walked_into.t_s == pytest.approx(9.0 - 0.25 - FRONT_M, abs=0.01)
    assert found.walked_into.relative_mps == pytest.approx(1.0, abs=0.02)
    assert not found.is_near_miss


def test_touched_machine_that_sets_off_is_a_contact():
    """An object in touch with a machine at standstill is hit when the wheels begin to turn."""
    one = still_object(FRONT_M + 0.2, 0.0)
    contact = approach_of(drive(machine(lambda t: 0.0 if t < 3.0 else 0.5 * (t - 3.0)), one), one).contact
    assert contact.t_s == pytest.approx(3.05, abs=0.06)


# script: object; smallest distance, near miss
PASSES = {
    "below the raised implement": (still_object(8.0, 2.0, (0.0, RAISED_M - 0.3)), 0.3, True),
    "above the machine": (still_object(8.0, 0.0, (TOP_M + 0.2, TOP_M + 0.3)), 0.2, True),
    "beside the wing": (still_object(8.0, 3.0 + 0.25 + 0.4), 0.4, True),
    "far": (still_object(8.0, 3.0 + 0.25 + 0.6), 0.6, False),
}


@pytest.mark.parametrize("name", PASSES)
def test_pass(name):
    one, margin, is_near_miss = PASSES[name]
    found = approach_of(drive(machine(V), one), one)
    assert found.contact is None
    assert found.margin_m == pytest.approx(margin, abs=0.01)
    assert found.is_near_miss is is_near_miss


def test_near_a_standing_machine_is_no_near_miss():
    one = still_object(FRONT_M + 0.25 + 0.2, 0.0)
    found = approach_of(drive(machine(0.0), one), one)
    assert found.margin_m == pytest.approx(0.2, abs=0.01)
    assert not found.is_near_miss

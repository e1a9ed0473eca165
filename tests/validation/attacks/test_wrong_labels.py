"""Labels that are wrong, missing, out of place or time, or that excuse; the person is real."""

import math
from dataclasses import replace

import numpy as np
import pytest

from geometry.transforms import planar
from messages.message import Envelope
from messages.truth import Occlusion, TrueMachine, TrueObject, TrueObjects
from tests.validation.attacks.attack import PERSON, Attack, blind, gap_m, person, two
from tests.validation.attacks.damages import (
    TRUTH,
    cloud,
    each,
    labels,
    of,
    one_label,
    stamped,
)
from tests.validation.attacks.recorded import Bench, drive, standing, walking
from tests.validation.obstacle_stop.closed_form import braked_m
from tests.validation.obstacle_stop.consistency.changes import (
    between,
    late_truth,
    moved_labels,
)
from tests.validation.obstacle_stop.consistency.world import START_NS

S_M = 4.0 * 0.6 + braked_m(4.0)
IN_LIDAR = drive(PERSON, truth_in_map=False)
NO_RECOGNITION = {"recognition_m": 0.0}  # BD-5.4.1b alone would find these


def moved(one: TrueObject, x_m: float, y_m: float, z_m: float = 0.0) -> TrueObject:
    return replace(one, center_map_m=one.center_map_m + np.array([x_m, y_m, z_m]))


def swapped(one: TrueObject, t_s: float) -> TrueObject:
    return replace(one, id={6: 7, 7: 6}.get(one.id, one.id)) if t_s > 1.0 else one


def of_one_id(truth: TrueObjects) -> TrueObjects:
    """Person 7 has the id of person 9, and comes after it."""
    mine = [replace(one, id=9) for one in truth.objects if one.id == 7]
    return replace(truth, objects=(*(one for one in truth.objects if one.id != 7), *mine))


def on_two_topics(envelopes: list[Envelope]) -> list[Envelope]:
    """The truth a second time, under another topic."""
    more = [replace(e, topic="truth_objects/more") for e in envelopes if isinstance(e.message, TrueObjects)]
    return sorted([*envelopes, *more], key=lambda e: e.receive_ns)


LABELS: dict[str, Attack] = {
    "box much too large": Attack("failed", "9: late", change=one_label(9, lambda o, t: replace(
        o, size_m=np.array([9.0, 3.0, 1.75])))),
    "box without size": Attack("not_shown", "person 9: size 0", change=one_label(9, lambda o, t: replace(
        o, size_m=0.0 * o.size_m))),
    "place is not a number": Attack("not_shown", "object 7: place, size or yaw is not a number", two(), one_label(
        7, lambda o, t: moved(o, math.nan, 0.0))),
    "box below the ground": Attack("not_shown", r"person 9: 3\.\d m below the ground", change=one_label(
        9, lambda o, t: moved(o, 0.0, 0.0, -5.0))),
    "label removed when a walker enters the path": Attack(
        "failed", "false stop: ", drive(walking(9, 16.0, -3.2, 0.0, 1.4)),
        one_label(9, lambda o, t: o if o.center_map_m[1] < -1.8 else None)),
    "no label when a blind walker enters the path": Attack(
        "not_shown", "person 7: they end", drive(
            walking(7, 14.0, -3.2, 0.0, 1.4, has_returns=blind), standing(9, 24.0, 0.2), seconds=5.0),
        one_label(7, lambda o, t: o if o.center_map_m[1] < -1.8 else None)),
    "labels end before the request is due": Attack(
        "not_shown", "person 7: they end", two(), one_label(7, lambda o, t: o if gap_m(t, 14.0) > S_M + 0.3 else None),
        conditions=NO_RECOGNITION),
    "labels begin with the first returns": Attack(
        "not_shown", "person 9: they begin", drive(person(lambda t: gap_m(t, 16.0) < 3.6), seconds=4.0),
        one_label(9, lambda o, t: o if gap_m(t, 16.0) < 3.9 else None)),
    "another id when the request is due": Attack(
        "failed", "encounter 77: (missed|late)", two(),
        one_label(7, lambda o, t: replace(o, id=7 if gap_m(t, 14.0) > S_M else 77))),
    "no labels while the request is due": Attack(
        "failed", "encounter 7: (missed|late)", two(),
        one_label(7, lambda o, t: o if not 0.0 < gap_m(t, 14.0) < S_M + 0.3 else None)),
    "largely occluded by nothing": Attack(
        "not_shown", "person 7: largely occluded, but nothing", two(),
        one_label(7, lambda o, t: replace(o, occlusion=Occlusion.LARGELY))),
    "teleports into the path": Attack(
        "failed", r"person 7: a jump by 6\.0 m", two(),
        one_label(7, lambda o, t: o if gap_m(t, 14.0) < S_M else moved(o, 0.0, 6.0))),
    "jumps to and fro": Attack("not_shown", r"person 9: a jump by", change=one_label(
        9, lambda o, t: moved(o, 0.0, 6.0 * (round(10.0 * t) % 2)))),
    "ids of two persons swapped": Attack(
        "not_shown", "person 6: a jump by", drive(standing(7, 16.0, 0.2), standing(6, 16.0, 3.5)), labels(swapped)),
    "one id for two persons": Attack("not_shown", "person 9: 2 boxes at one time", two(), of(TrueObjects, of_one_id)),
    "another id at every fourth scan": Attack(
        "not_shown", r"person 10\d\d: they begin", two(), one_label(
            7, lambda o, t: replace(o, id=1000 + round(10.0 * t) // 4)), conditions=NO_RECOGNITION),
    "on two topics": Attack("not_shown", "several topics of true objects", change=on_two_topics),
    "labelled sector beside the path": Attack(
        "not_shown", "truth_sector: .*± 5°", IN_LIDAR, cloud((3.4, 0.0, -1.2), 0.2, 60), about={"truth_view_deg": 5.0}),
    "may be touched": Attack("failed", "7: (missed|late)", two(), one_label(
        7, lambda o, t: replace(o, must_avoid=False))),
    "no objects": Attack("failed", "false stop: protective_field", change=labels(lambda o, t: None)),
    "no objects, and no returns": Attack("not_shown", "no encounter", drive(person(blind)), labels(lambda o, t: None)),
    "no truth": Attack("not_shown", "no ground truth", drive(PERSON, has_truth=False)),
    "2 m aside": Attack("not_shown", r"truth_shifted: .*\+2\.00 m", change=each(moved_labels(0.0, 2.0))),
    "1 m ahead": Attack("not_shown", r"truth_shifted: .*\+1\.00 m", change=each(moved_labels(1.0, 0.0))),
    "0.3 s late": Attack("not_shown", r"truth_shifted: .*0\.3 s late", IN_LIDAR, each(late_truth(0.3))),
    "turned by 6°": Attack("not_shown", "truth_shifted", change=labels(lambda o, t: replace(
        o, center_map_m=planar(0.0, 0.0, math.radians(6.0))[:3, :3] @ o.center_map_m))),
    "a leap of 18 s": Attack("not_shown", "truth_missing: no truth for 100 %", change=each(late_truth(18.0))),
    "times since the start": Attack("not_shown", "no ground truth", change=of(TRUTH, lambda m: replace(
        m, stamp_ns=m.stamp_ns - START_NS))),
    "frame that does not exist": Attack("not_shown", "the truth is in frame 'nowhere'", about={
        "truth_frame": "nowhere"}),
    "map given as frame of the lidar": Attack("not_shown", "truth_shifted", about={"truth_frame": "top"}),
    "machine of the truth stands": Attack("not_shown", "truth_poses: .*contradict", change=of(
        TrueMachine, lambda m: replace(m, T_map_base=np.eye(4)))),
    "machine of the truth 0.5 s late": Attack(
        "not_shown", r"truth_shifted: .*0\.5 s late", change=stamped(TrueMachine, 0.5)),
    "truth missing for 2 s": Attack("not_shown", "truth_missing", change=each(between(TRUTH, 1.0, 3.0, START_NS))),
}  # fmt: skip


@pytest.mark.parametrize("name", LABELS)
def test_wrong_labels_do_not_pass(bench: Bench, name: str) -> None:
    LABELS[name].check(bench)

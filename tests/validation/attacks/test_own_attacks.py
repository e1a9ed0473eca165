"""Attacks on `validate` beyond those of the issue: labels, odometry, scans, vehicle file, times, and harmless ones."""

import math
from dataclasses import replace

import numpy as np
import pytest

from datasets.importers.point_clouds import list_scan
from geometry.transforms import planar
from messages.message import Envelope
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import ImuSample, LidarScan, WheelSample
from messages.truth import Occlusion, TrueMachine, TrueObject, TrueObjects
from tests.validation.attacks.attack import DRIVE, PERSON, Attack, blind, configured, gap_m, person, two, with_body
from tests.validation.attacks.damages import (
    TRUTH,
    both,
    cloud,
    cut,
    delivered_late,
    each,
    every,
    labels,
    moved_poses,
    of,
    one_label,
    points,
    seconds,
    stamped,
)
from tests.validation.attacks.recorded import Bench, drive, envelopes_of, reasons, standing, walking
from tests.validation.obstacle_stop.closed_form import DEAD, braked_m
from tests.validation.obstacle_stop.consistency.changes import (
    between,
    late_scans,
    late_truth,
    moved_labels,
    scaled_odometry,
    without_rings,
)
from tests.validation.obstacle_stop.consistency.world import START_NS, Drive
from tests.validation.obstacle_stop.scripted import Request, Script, messages_of, straight
from tests.validation.obstacle_stop.scripted import standing as scripted

S_M = 4.0 * 0.6 + braked_m(4.0)
IN_LIDAR = drive(PERSON, truth_in_map=False)
BARE = drive(PERSON, truth_in_map=False, has_structure=False, objects=0)
BEND = drive(standing(9, 15.7, 2.0), curvature_radpm=0.015)
WAVES = drive(standing(9, 19.0, 1.0), seconds=6.0, turn_wave=0.06, speed_wave=0.4)
RINGS = DRIVE.lidar().elevation_deg
NO_RECOGNITION = {"recognition_m": 0.0}  # BD-5.4.1b alone would find these


def alone(envelopes: list[Envelope]) -> list[Envelope]:
    """Without other sources of motion."""
    return [e for e in envelopes if not isinstance(e.message, WheelSample | ImuSample)]


def moved(one: TrueObject, x_m: float, y_m: float, z_m: float = 0.0) -> TrueObject:
    return replace(one, center_map_m=one.center_map_m + np.array([x_m, y_m, z_m]))


def frozen(envelopes: list[Envelope]) -> list[Envelope]:
    """The same scan from 0.8 s on."""
    first = next(e.message for e in envelopes if isinstance(e.message, LidarScan) and seconds(e.message) > 0.79)
    return [
        replace(e, message=replace(first, stamp_ns=e.message.stamp_ns))
        if isinstance(e.message, LidarScan) and seconds(e.message) > 0.8 else e
        for e in envelopes
    ]  # fmt: skip


def of_another_log(envelopes: list[Envelope]) -> list[Envelope]:
    """The scans of another drive."""
    scans = iter([e.message for e in envelopes_of(drive(seed=8)) if isinstance(e.message, LidarScan)])
    return [replace(e, message=next(scans)) if isinstance(e.message, LidarScan) else e for e in envelopes]


def set_back(envelopes: list[Envelope]) -> list[Envelope]:
    """The clock is set back by 2 s after 2 s."""
    by = 2 * 10**9
    return [
        replace(e, receive_ns=e.receive_ns - by, message=replace(e.message, stamp_ns=e.message.stamp_ns - by))
        if seconds(e.message) > 2.0 else e
        for e in envelopes
    ]  # fmt: skip


def with_recorded_requests(envelopes: list[Envelope]) -> list[Envelope]:
    """The log holds outputs of a supervisor that brakes all the time."""
    script = Script(straight(4.0), [scripted(9, 16.0)], [Request(0.0, 4.0, 9)], 4.0)
    states = [e for e in messages_of(script) if e.topic == "supervisor"]
    return sorted([*envelopes, *states], key=lambda e: e.receive_ns)


def mirrored_yaw(odom: Odometry) -> Odometry:
    T = odom.T_odom_base
    turned = planar(float(T[0, 3]), -float(T[1, 3]), -math.atan2(T[1, 0], T[0, 0]))
    return replace(odom, T_odom_base=turned, yaw_rate_radps=-odom.yaw_rate_radps)


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


class Braking(Drive):
    """The driver brakes with 2 m/s² after 0.8 s."""

    def pose(self, t_s: float) -> tuple[float, float, float]:
        after = min(max(0.0, t_s - 0.8), 2.0)
        return 4.0 * min(t_s, 0.8) + 4.0 * after - after**2, 0.0, 0.0

    def rates(self, t_s):  # type: ignore[no-untyped-def]
        return 4.0 - 2.0 * np.clip(np.asarray(t_s) - 0.8, 0.0, 2.0), 0.0 * np.asarray(t_s)


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
    "map given as frame of the lidar": Attack("failed", "false stop: ", about={"truth_frame": "top"}),
    "machine of the truth stands": Attack("not_shown", "truth_poses: .*contradict", change=of(
        TrueMachine, lambda m: replace(m, T_map_base=np.eye(4)))),
    "machine of the truth 0.5 s late": Attack(
        "not_shown", r"truth_shifted: .*0\.5 s late", change=stamped(TrueMachine, 0.5)),
    "truth missing for 2 s": Attack("not_shown", "truth_missing", change=each(between(TRUTH, 1.0, 3.0, START_NS))),
}  # fmt: skip

MOTION: dict[str, Attack] = {
    "distances × 0.7": Attack("not_shown", r"odometry_contradicts_scans: .*2\.8 m/s against 4\.0", change=both(
        alone, each(scaled_odometry(0.7)))),
    "distances × 1.3": Attack("not_shown", r"odometry_contradicts_scans: .*5\.2 m/s against 4\.0", IN_LIDAR, both(
        alone, each(scaled_odometry(1.3)))),
    "distances × 0.7 on a bare field": Attack("not_shown", "speed_unconfirmed", BARE, both(
        alone, each(scaled_odometry(0.7)))),
    "distances × 0.7 in 3 s": Attack(
        "not_shown", r"odometry_contradicts_scans: .*2\.8 m/s against 4\.0", drive(standing(9, 13.0, 0.2), seconds=3.2),
        both(alone, each(scaled_odometry(0.7)))),
    "stands": Attack("not_shown", "no_motion", change=each(scaled_odometry(0.0))),
    "sign reversed": Attack("not_shown", r"odometry_contradicts_scans: .*-4\.0 m/s against 4\.0", change=each(
        scaled_odometry(-1.0))),
    "left and right reversed": Attack("not_shown", r"odometry_turn: .*-3\.4 °/s against 3\.[345]", BEND, of(
        Odometry, mirrored_yaw)),
    "0.5 s early": Attack("not_shown", r"time_offset: .*0\.50 s late against the odometry", WAVES, stamped(
        Odometry, -0.5)),
    "one stamp": Attack("not_shown", "fewer than two poses with different stamps", change=of(
        Odometry, lambda m: replace(m, stamp_ns=START_NS))),
    "missing for 2 s": Attack("not_shown", "odometry_missing", change=each(between(Odometry, 1.0, 3.0, START_NS))),
    "not a number for 2 s": Attack("not_shown", "odometry_missing", change=moved_poses(
        lambda T, t: math.nan * T if 1.0 < t < 3.0 else T)),
    "yaw drifts by 4°/s": Attack("not_shown", r"odometry_turn: .*4\.0 °/s against", change=moved_poses(
        lambda T, t: planar(0.0, 0.0, math.radians(4.0 * t)) @ T)),
    "in km/h": Attack("not_shown", r"odometry_contradicts_scans: .*14\.4 m/s against 4\.0", change=each(
        scaled_odometry(3.6))),
    "the driver brakes first": Attack(
        "not_shown", "no encounter", Braking(**vars(drive(standing(9, 20.0, 0.2)))), conditions=NO_RECOGNITION),
    "the driver brakes for a person without returns": Attack(
        "failed", "9: missed", Braking(**vars(drive(standing(9, 14.0, 0.2, has_returns=blind))))),
}  # fmt: skip

SCANS: dict[str, Attack] = {
    "of another log": Attack("failed", "9: missed", change=of_another_log),
    "left and right swapped": Attack("not_shown", "truth_shifted: .*left and right are swapped", change=points(
        lambda p, t: p * [1.0, -1.0, 1.0])),
    "left and right swapped in a bend": Attack("not_shown", "odometry_turn", BEND, points(
        lambda p, t: p * [1.0, -1.0, 1.0])),
    "front and rear swapped": Attack("not_shown", "odometry_contradicts_scans", change=points(
        lambda p, t: p * [-1.0, 1.0, 1.0])),
    "in millimetres": Attack("failed", "mount_without_ground", change=points(lambda p, t: 1000.0 * p)),
    "in feet": Attack("failed", "mount_height", change=points(lambda p, t: p / 0.3048)),
    "upside down": Attack("failed", "returns_below_ground", change=points(lambda p, t: p * [1.0, 1.0, -1.0])),
    "x and y swapped": Attack("not_shown", "odometry_contradicts_scans", change=points(lambda p, t: p[:, [1, 0, 2]])),
    "blind ahead": Attack("failed", "9: missed", change=points(
        lambda p, t: p[(np.abs(p[:, 1]) > 1.5) | (p[:, 0] < 0)])),
    "times of the points 0.5 s early": Attack("not_shown", "truth_shifted", change=of(LidarScan, lambda s: list_scan(
        s.stamp_ns, s.points_m, offset_s=np.full(len(s.points_m), -0.5)))),
    "empty": Attack("failed", "9: missed", change=points(lambda p, t: p[:0])),
    "empty before the encounter": Attack("failed", "9: (late|missed)", change=points(
        lambda p, t: p[:0] if 0.5 < t < 2.5 else p)),
    "frozen": Attack("not_shown", r"odometry_contradicts_scans: .*against -?0\.0 m/s", change=frozen),
    "0.2 s late": Attack("not_shown", "truth_shifted", change=each(late_scans(0.2))),
    "missing for 1.4 s": Attack("not_shown", "scans_missing", change=each(between(LidarScan, 0.6, 2.0, START_NS))),
    "every stamp twice": Attack("not_shown", "stamps_backwards", change=lambda es: [e for e in es for _ in range(2)]),
    "clock set back": Attack("not_shown", r"clock_set_back: .*by 1\.9 s", change=set_back),
    "half of the rings": Attack("not_shown", "rings_missing: .*return nothing", change=each(
        without_rings(RINGS, lambda ring: ring % 2 == 0))),
    "half of the rings configured": Attack("not_shown", "ring_table: only 5|ring_table: .*51 %", vehicle=configured(
        elevation_deg=list(RINGS[::2]))),
    "other elevations": Attack("not_shown", "rings_outside", vehicle=configured(
        elevation_deg=[0.5 * e for e in RINGS])),
    "range of the vehicle file too short": Attack(
        "failed", "7: (late|missed)", drive(
            standing(7, 14.0, 0.2, has_returns=lambda t: gap_m(t, 14.0) < 3.0), standing(9, 24.0, 0.2), seconds=5.0),
        vehicle=configured(range_m=[0.5, 7.0])),
    "field of view of the vehicle file too narrow": Attack("failed", "rings_missing", two(), vehicle=configured(
        field_of_view_deg=10.0)),
    "log ends before the encounter": Attack("not_shown", "too_few_scans", change=cut(0.0, 0.8)),
    "log ends with a limit of the speed": Attack(
        "not_shown", "encounter 9: censored", drive(standing(9, 20.0, 0.2), seconds=2.4)),
    "recorded requests": Attack("failed", "9: missed", drive(person(blind)), with_recorded_requests),
}  # fmt: skip
ATTACKS = {
    f"{kind}: {name}": one
    for kind, cases in (("labels", LABELS), ("odometry", MOTION), ("scans", SCANS))
    for name, one in cases.items()
}


@pytest.mark.parametrize("name", ATTACKS)
def test_attack_does_not_pass(bench: Bench, name: str) -> None:
    ATTACKS[name].check(bench)


# name → attack (state and reason unused) and the change of the gap at the request
HARMLESS: dict[str, tuple[Attack, float]] = {
    "box too small": (Attack("", "", change=one_label(9, lambda o, t: replace(
        o, size_m=np.array([0.1, 0.1, 0.3])))), 0.25),
    "box too large": (Attack("", "", change=one_label(9, lambda o, t: replace(
        o, size_m=np.array([2.6, 2.6, 1.75])))), -1.0),
    "class of the label": (Attack("", "", change=one_label(9, lambda o, t: replace(o, label=ObstacleClass.POLE))), 0.0),
    "half of the scans": (Attack("", "", change=every(LidarScan, 2)), 0.0),
    "truth at every fifth scan": (Attack("", "", change=every((TrueObjects,), 5)), 0.0),
    "odometry 0.5 s early at constant speed": (Attack("", "", change=stamped(Odometry, -0.5)), 0.0),
    "scans delivered 0.1 s late": (Attack("", "", change=delivered_late(LidarScan, 0.1)), 0.0),
    "jump of the odometry": (Attack("", "", change=moved_poses(
        lambda T, t: T @ planar(5.0, 0.0, 0.0) if t > 1.0 else T)), 0.0),
    "wrong speed beside right places": (Attack("", "", change=of(Odometry, lambda m: replace(
        m, speed_mps=0.5 * m.speed_mps))), 0.0),
    "a third of the points is not a number": (Attack("", "", change=points(lambda p, t: np.where(
        np.random.default_rng(1).random((len(p), 1)) < 0.33, np.nan, p))), 0.0),
    "front edge 1 m short": (Attack("", "", vehicle=with_body(front_m=2.6)), 1.0),
    "narrow outline": (Attack("", "", vehicle=with_body(width_m=0.6)), 0.0),
}  # fmt: skip


@pytest.mark.parametrize("name", HARMLESS)
def test_harmless_change_has_the_margin_computed(bench: Bench, name: str) -> None:
    attack, nearer_m = HARMLESS[name]
    result = bench.judge(attack.drive, attack.change, attack.vehicle)
    (one,) = (e for e in result["encounters"] if e["id"] == 9)
    assert (result["state"], one["outcome"]) == ("passed", "in time"), reasons(result)
    gap = gap_m(one["stop_requested_s"], 16.0) + nearer_m
    assert one["margin_m"] == pytest.approx(gap - 4.0 * DEAD - braked_m(4.0), abs=0.1)

"""Scans that are wrong, missing or late, and vehicle files that are not those of the lidar."""

from dataclasses import replace

import numpy as np
import pytest

from datasets.importers.point_clouds import list_scan
from messages.message import Envelope
from messages.sensors import LidarScan
from tests.validation.attacks.attack import DRIVE, Attack, blind, configured, gap_m, person, two
from tests.validation.attacks.damages import (
    cut,
    each,
    of,
    points,
    seconds,
)
from tests.validation.attacks.recorded import Bench, drive, envelopes_of, standing
from tests.validation.obstacle_stop.consistency.changes import (
    between,
    late_scans,
    without_rings,
)
from tests.validation.obstacle_stop.consistency.world import START_NS
from tests.validation.obstacle_stop.scripted import Request, Script, messages_of, straight
from tests.validation.obstacle_stop.scripted import standing as scripted

BEND = drive(standing(9, 15.7, 2.0), curvature_radpm=0.015)
RINGS = DRIVE.lidar().elevation_deg


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


@pytest.mark.parametrize("name", SCANS)
def test_wrong_scans_do_not_pass(bench: Bench, name: str) -> None:
    SCANS[name].check(bench)

"""Changes that change no margin, or by what can be computed."""

from dataclasses import replace

import numpy as np
import pytest

from geometry.transforms import planar
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.sensors import LidarScan
from messages.truth import TrueObjects
from tests.validation.attacks.attack import Attack, gap_m, with_body
from tests.validation.attacks.damages import (
    delivered_late,
    every,
    moved_poses,
    of,
    one_label,
    points,
    stamped,
)
from tests.validation.attacks.recorded import Bench, reasons
from tests.validation.obstacle_stop.closed_form import DEAD, braked_m

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

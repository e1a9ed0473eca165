"""Odometry that is wrong, missing or unconfirmed, and drivers who brake."""

import math
from dataclasses import replace

import numpy as np
import pytest

from geometry.transforms import planar
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import ImuSample, WheelSample
from tests.validation.attacks.attack import PERSON, Attack, blind
from tests.validation.attacks.damages import (
    both,
    each,
    moved_poses,
    of,
    stamped,
)
from tests.validation.attacks.recorded import Bench, drive, standing
from tests.validation.obstacle_stop.consistency.changes import (
    between,
    scaled_odometry,
)
from tests.validation.obstacle_stop.consistency.world import START_NS, Drive

IN_LIDAR = drive(PERSON, truth_in_map=False)
BARE = drive(PERSON, truth_in_map=False, has_structure=False, objects=0)
BEND = drive(standing(9, 15.7, 2.0), curvature_radpm=0.015)
WAVES = drive(standing(9, 19.0, 1.0), seconds=6.0, turn_wave=0.06, speed_wave=0.4)
NO_RECOGNITION = {"recognition_m": 0.0}  # BD-5.4.1b alone would find these


def alone(envelopes: list[Envelope]) -> list[Envelope]:
    """Without other sources of motion."""
    return [e for e in envelopes if not isinstance(e.message, WheelSample | ImuSample)]


def mirrored_yaw(odom: Odometry) -> Odometry:
    T = odom.T_odom_base
    turned = planar(float(T[0, 3]), -float(T[1, 3]), -math.atan2(T[1, 0], T[0, 0]))
    return replace(odom, T_odom_base=turned, yaw_rate_radps=-odom.yaw_rate_radps)


class Braking(Drive):
    """The driver brakes with 2 m/s² after 0.8 s."""

    def pose(self, t_s: float) -> tuple[float, float, float]:
        after = min(max(0.0, t_s - 0.8), 2.0)
        return 4.0 * min(t_s, 0.8) + 4.0 * after - after**2, 0.0, 0.0

    def rates(self, t_s):  # type: ignore[no-untyped-def]
        return 4.0 - 2.0 * np.clip(np.asarray(t_s) - 0.8, 0.0, 2.0), 0.0 * np.asarray(t_s)


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


@pytest.mark.parametrize("name", MOTION)
def test_wrong_motion_do_not_pass(bench: Bench, name: str) -> None:
    MOTION[name].check(bench)

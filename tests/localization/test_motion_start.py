"""Start with one antenna and in motion: right within its protection level, or refused with what is awaited."""

import dataclasses
import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from localization.localizer import Localizer
from tests.localization.harness import Run, configuration, errors, run
from tests.localization.synthetic_drive import DATUM, START_NS, SensorErrors, Truth, drive, tractor

LEGS = {
    "standstill": [(4.0, 0.0, 0.0), (100.0, 2.0, 0.05)],
    "forwards": [(6.0, 2.0, 0.0), (100.0, 1.0, 0.1)],
    "reverse": [(4.0, 0.0, 0.0), (100.0, -1.5, 0.05)],
}


@functools.cache
def truth_of(name: str) -> Truth:
    return drive(14, legs=LEGS[name], sensor_errors=SensorErrors(seed=5))


def with_one_antenna(truth: Truth, has_wheels: bool = True) -> list:
    messages = [m for m in truth.messages if has_wheels or m[1] != "wheel"]
    none = {"heading_rad": math.nan, "sigma_heading_rad": math.nan}
    return [(a, t, replace(m, **none) if t == "gnss/main" else m) for a, t, m in messages]


def without_wheels() -> Localizer:
    v = tractor()
    bare = v.model_copy(update={"sensors": v.sensors.model_copy(update={"wheels": None})})
    return Localizer(bare, DATUM, configuration())


def check_right(result: Run, truth: Truth, latest_s: float) -> None:
    e = errors(result, truth)
    assert e.t_s[0] < latest_s
    distance_m = np.linalg.norm(e.p_m[:, :2], axis=1)
    assert np.all(distance_m < e.level_m)
    assert np.max(distance_m) < 0.3
    assert np.degrees(np.max(np.abs(e.turn_rad[:, 2]))) < 4.0
    assert result.localizer.awaited == ""
    assert not any(f.is_active for f in result.faults if f.code in ("localization.lost", "localization.rebuilt"))


@pytest.mark.parametrize("name", sorted(LEGS))
def test_one_antenna_starts_after_a_few_metres(name):
    truth = truth_of(name)
    check_right(run(with_one_antenna(truth)), truth, 9.0)


def test_start_in_motion_with_two_antennas():
    truth = truth_of("forwards")
    check_right(run(truth.messages), truth, 5.0)


@pytest.mark.parametrize("name", ["forwards", "reverse"])
def test_without_wheels_the_accelerometer_tells_forwards_from_backwards(name):
    truth = truth_of(name)
    check_right(run(with_one_antenna(truth, has_wheels=False), localizer=without_wheels()), truth, 14.0)


def test_fixes_that_arrive_before_the_samples_of_their_time_prove_the_heading_too():
    truth = truth_of("forwards")
    early = [(m.stamp_ns if t == "gnss/main" else a + 30_000_000, t, m) for a, t, m in with_one_antenna(truth)]
    check_right(run(sorted(early, key=lambda m: m[0])), truth, 9.0)


def test_at_standstill_the_metres_that_are_missing_are_named():
    truth = truth_of("standstill")
    result = run(with_one_antenna(truth), seconds=4.0)
    assert not any(p.is_initialized for p in result.poses)
    assert result.localizer.awaited == "motion: 0.0 of 2.0 m for the heading"
    assert any(f.code == "gnss.no_heading" and f.is_active for f in result.faults)


def test_fixes_of_another_drive_are_refused_with_the_reason():
    """The track is mirrored: its curve contradicts the gyro."""
    truth = truth_of("standstill")

    def mirrored(fix):
        x, y, z = DATUM.to_map(fix.latitude_rad, fix.longitude_rad, fix.height_m)
        latitude, longitude, height = DATUM.to_ellipsoid(x, -y, z)
        return replace(fix, latitude_rad=latitude, longitude_rad=longitude, height_m=height)

    messages = [(a, t, mirrored(m) if t == "gnss/main" else m) for a, t, m in with_one_antenna(truth)]
    result = run(messages)
    assert not any(p.is_initialized for p in result.poses if p.stamp_ns > START_NS + 8_000_000_000)
    assert result.localizer.awaited.startswith("agreement of fixes, IMU and wheels")


def test_wheels_of_the_wrong_sign_are_refused():
    """Wheel speeds without a sign contradict the accelerometer and the track when the machine reverses."""
    truth = truth_of("reverse")

    def forwards(message):
        return dataclasses.replace(message, speed_mps=abs(message.speed_mps))

    messages = [(a, t, forwards(m) if t == "wheel" else m) for a, t, m in with_one_antenna(truth)]
    result = run(messages)
    started = [p for p in result.poses if p.is_initialized]
    for pose in started:
        off_m = np.linalg.norm((pose.T_map_base - truth.at(pose.stamp_ns))[:2, 3])
        assert off_m < pose.protection_level_m

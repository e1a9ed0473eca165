"""Localizer on imported recordings: fixes with unknown satellites and correction age, an IMU with other axes."""

import functools
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import Vehicle
from datasets.importers.formats import open_recording
from datasets.importers.selection import bind
from geometry.geodesy import Datum
from geometry.transforms import rpy_of
from localization.config import LocalizationConfig
from localization.gnss_gate import RejectionReason, check
from localization.localizer import Localizer
from messages.message import Message
from messages.motion import Odometry, PositionSource
from messages.sensors import GnssFix, GnssSolution, ImuSample, WheelSample
from tests.localization.harness import configuration, run
from tests.localization.synthetic_drive import tractor
from tests.recordings import DATA, needs

HUSKY = "robot-localization-bags/test/test1.bag"
WHEELBASE_M = 0.5
# The robot stands from 236 s to 247 s of the recording.
FROM_S, TO_S = 236.0, 246.0
# x of the IMU is right, y up, z back: gravity along +y, deceleration along +z
R_BASE_IMU = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
BINDINGS = {"imu": ("/imu/data", "imu"), "gnss/main": ("/fix", "gnss"),
            "odom/wheels": ("/husky_velocity_controller/odom", "odom")}  # fmt: skip
Received = tuple[int, str, Message]


@functools.cache
def recorded() -> tuple[Received, ...]:
    return tuple(bind(open_recording(DATA / HUSKY), BINDINGS).read())


def husky() -> Vehicle:
    """The robot; its skid steering has no angle."""
    values = tractor().model_dump()
    rpy_deg = np.degrees(rpy_of(np.vstack([np.c_[R_BASE_IMU, np.zeros(3)], [0, 0, 0, 1]]))).tolist()
    values["drivetrain"] |= {"wheelbase_m": WHEELBASE_M, "min_turning_radius_m": 0.3}
    values["sensors"] = {
        "imu": values["sensors"]["imu"] | {"mount": {"xyz_m": (0.1, 0.0, 0.3), "rpy_deg": rpy_deg}, "rate_hz": 30.0,
                                           "gyro_noise_dps_rthz": 0.05, "accelerometer_noise_ug_rthz": 500.0,
 "gyro_bias_dph": 200.0, "accelerometer_bias_mg": 20.0},
        "gnss": {"main": values["sensors"]["gnss"]["main"] | {"has_heading": False, "rate_hz": 2.5,
                                                              "mount": {"xyz_m": (0.0, 0.0, 0.8)}}},
        "wheels": values["sensors"]["wheels"] | {"rate_hz": 10.0},
    }  # fmt: skip
    return Vehicle.model_validate(values)


def husky_configuration() -> LocalizationConfig:
    """The stack's, for a gyro bias of 2 deg/s and wheel odometry at 10 Hz."""
    values = configuration().model_dump()
    values["odometry"]["wheels"]["max_gap_s"] = 0.5
    values["map_alignment"]["initial_alignment"]["max_rate_radps"] = 0.06
    return LocalizationConfig.model_validate(values)


def wheels_of(odom: Odometry) -> WheelSample:
    return WheelSample(odom.stamp_ns, odom.speed_mps, math.nan)  # skid steering: no angle


@needs(HUSKY)
def test_all_fixes_of_husky_are_usable() -> None:
    fixes = [m for _, _, m in recorded() if isinstance(m, GnssFix)]
    config = configuration().map_alignment.gnss
    assert len(fixes) == 989
    assert {m.satellites for m in fixes} == {None}
    assert all(math.isnan(m.correction_age_s) and math.isnan(m.hdop) for m in fixes)
    assert Counter(check(m, config) for m in fixes) == {RejectionReason.NONE: 989}
    assert {m.solution for m in fixes} == {GnssSolution.SBAS}


@needs(HUSKY)
@pytest.mark.parametrize("heading_rad", [math.nan, 0.5])
def test_localizer_takes_fixes_of_husky(heading_rad: float) -> None:
    """At standstill: position from the fixes; of a single antenna only the heading is missing."""
    begin = recorded()[0][0]
    start_ns, end_ns = begin + round(FROM_S * 1e9), begin + round(TO_S * 1e9)
    messages: list[Received] = []
    for t, topic, m in recorded():
        if start_ns <= t < end_ns:
            if isinstance(m, GnssFix):
                m = replace(m, heading_rad=heading_rad, sigma_heading_rad=math.radians(1.0))
            messages.append((t, "wheel", wheels_of(m)) if isinstance(m, Odometry) else (t, topic, m))
    fixes = [m for _, _, m in messages if isinstance(m, GnssFix)]
    datum = Datum(fixes[0].latitude_rad, fixes[0].longitude_rad, fixes[0].height_m)
    localizer = Localizer(husky(), datum, husky_configuration())
    result = run(messages, localizer=localizer, start_ns=start_ns)
    assert (localizer.dropped, len(fixes)) == (0, 25)
    assert sum(isinstance(m, ImuSample) for _, _, m in messages) > 250
    initialized = [p for p in result.poses if p.is_initialized]
    active = {f.code for f in result.faults if f.is_active}
    assert ("gnss.no_heading" in active, bool(initialized)) == (math.isnan(heading_rad), math.isfinite(heading_rad))
    if initialized:
        mean_m = np.mean([datum.to_map(m.latitude_rad, m.longitude_rad, m.height_m) for m in fixes], axis=0)
        base_m = (initialized[0].T_map_odom @ result.odom[0].T_odom_base)[:2, 3]
        assert np.linalg.norm(base_m - mean_m[:2]) < 1.0
        assert initialized[0].source is PositionSource.SINGLE


@needs(HUSKY)
def test_husky_knows_how_far_it_is_off_after_an_outage() -> None:
    """45 s without fixes, after 50 s whose fixes wander by metres within seconds: they teach little of the heading."""
    begin, end_s, outage_s = recorded()[0][0], 101.0, (50.0, 95.0)
    messages, withheld, datum = [], [], None
    for t, topic, m in recorded():
        if t - begin > end_s * 1e9:
            break
        if isinstance(m, GnssFix):
            datum = datum or Datum(m.latitude_rad, m.longitude_rad, m.height_m)
            if outage_s[0] < (t - begin) * 1e-9 < outage_s[1]:
                withheld.append(m)
                continue
        messages.append((t, "wheel", wheels_of(m)) if isinstance(m, Odometry) else (t, topic, m))
    localizer = Localizer(husky(), datum, husky_configuration())
    result = run(messages, localizer=localizer, start_ns=begin)
    assert "localization.rebuilt" not in {f.code for f in result.faults}
    poses = [p for p in result.poses if p.is_initialized]
    stamps = np.array([p.stamp_ns for p in poses])
    for fix in withheld:
        pose = poses[int(np.argmin(np.abs(stamps - fix.stamp_ns)))]
        place_m = datum.to_map(fix.latitude_rad, fix.longitude_rad, fix.height_m)
        assert math.dist(place_m[:2], pose.T_map_base[:2, 3]) < pose.protection_level_m + 2.0  # of the fix
    returned = [p for p in poses if (p.stamp_ns - begin) * 1e-9 > outage_s[1] + 3.0]
    assert returned
    assert all(p.source is PositionSource.SINGLE and p.protection_level_m < 15.0 for p in returned)

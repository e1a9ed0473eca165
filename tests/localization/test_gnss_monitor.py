"""Positions stated as fixed that are wrong, slip, and starts in float or with vibration."""

import dataclasses
import math

import numpy as np
import pytest

from benchmarks.localization_faults import CASES, Case, Draw, edited, lidar_motions, moved
from benchmarks.localization_robustness import judged, measured
from geometry.angles import wrap
from geometry.transforms import yaw_of
from localization.gnss_monitor import ODOMETRY, VELOCITY, GnssMonitor
from localization.separation import Separation
from messages.motion import PositionSource
from messages.sensors import GnssFix, WheelSample
from tests.localization.harness import configuration, run
from tests.localization.synthetic_drive import START_NS, SensorErrors, drive

BY_NAME = {case.name: case for case in CASES}


def driven(name: str | Case, from_s: float, for_s: float, seconds: float = 36.0):
    """One drive on a straight with the fault of a case at another time; its row and faults by code."""
    case: Case = dataclasses.replace(BY_NAME[name] if isinstance(name, str) else name, from_s=from_s, for_s=for_s)
    draw = Draw(2)
    draw.delay_s = 0.0
    truth = drive(seconds, legs=[(4.0, 0.0, 0.0), (100.0, 2.5, 0.0)], sensor_errors=SensorErrors(seed=2))
    result = run(edited(truth, case, draw))
    row = judged(case, "open", 2, result, truth, draw, 0.0)
    return row, [(f.code, f.is_active) for f in result.faults]


def at_once(name: str) -> Case:
    """A case whose second fault begins at 14 s."""
    case = BY_NAME[name]
    return dataclasses.replace(case, beside=tuple(dataclasses.replace(c, from_s=14.0) for c in case.beside))


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("ramp 0.033 m/s 30 s", "gnss.contradicts_velocity"),
        ("multipath 0.3 m 10 s", "gnss.contradicts_velocity"),
        ("wrong fix 0.2 m 20 s", "gnss.contradicts_velocity"),
        ("spoofed ramp 0.3 m/s 30 s", "gnss.contradicts_odometry"),
    ],
)
def test_a_wrong_position_stated_as_fixed_is_named_and_bounded(name, code):
    row, faults = driven(name, 14.0, 10.0 if name.startswith("multipath") else 14.0)
    assert (code, True) in faults
    assert row.misleading_s == [0.0] * 4
    assert row.max_excess_m < 0.0
    assert row.false_alarms == 0


def test_what_returns_agrees_with_the_reference_before_it_is_used():
    row, faults = driven("multipath 0.3 m 10 s", 14.0, 10.0)
    assert ("gnss.contradicts_velocity", False) in faults
    assert row.after[3] > 0.9
    row, faults = driven("wrong fix 0.5 m 20 s", 14.0, math.inf)
    assert ("gnss.contradicts_velocity", False) not in faults
    assert row.max_error_m < 0.4


def test_an_error_that_a_window_has_shown_is_covered_after_the_window_has_passed_its_begin():
    row = measured(BY_NAME["multipath 0.3 m 60 s"], "open", 1, 110.0)
    assert row.max_error_m > 0.25
    assert row.max_excess_m < 0.0
    assert row.misleading_s == [0.0] * 4


def test_slip_of_the_wheels_is_not_taken_for_a_fault_of_gnss():
    row, faults = driven("slip 25 % 10 s", 14.0, 10.0)
    assert ("wheel.slipping", True) in faults
    assert not any(code.startswith("gnss.contradicts") for code, _ in faults)
    assert row.max_error_m < 0.2  # 0.2 s of dead reckoning with the slip


def test_wheels_that_slip_while_positions_are_wrong_do_not_move_the_position():
    row, faults = driven(at_once("wrong fix 1 m 20 s + slip 25 % 10 s"), 14.0, 12.0, 27.0)
    assert ("gnss.contradicts_velocity", True) in faults
    assert row.max_error_m < 0.3  # the wheels say 8 m
    assert row.misleading_s == [0.0] * 4


def test_slip_without_fixes_is_seen_by_the_imu():
    row, _ = driven(at_once("outage 60 s + slip 25 % 10 s"), 14.0, 12.0, 27.0)
    assert row.max_error_m < 1.5  # the wheels say 8 m


def changed(name: str, kind: type, change) -> Case:
    return Case(name, lambda m, s, d: change(m) if isinstance(m, kind) else m)


def velocity_zero(fix: GnssFix) -> GnssFix:
    return dataclasses.replace(fix, velocity_enu_mps=np.zeros(3))


def velocity_north_east(fix: GnssFix) -> GnssFix:
    return dataclasses.replace(fix, velocity_enu_mps=fix.velocity_enu_mps[[1, 0, 2]])


@pytest.mark.parametrize("change", [velocity_zero, velocity_north_east])
def test_a_velocity_that_positions_and_odometry_contradict_is_named_and_not_believed(change):
    row, faults = driven(changed(change.__name__, GnssFix, change), 14.0, math.inf)
    assert ("gnss.velocity_refused", True) in faults
    assert row.misleading_s == [0.0] * 4
    assert row.max_error_m < 0.15
    assert row.max_excess_m < 0.0


def test_a_velocity_that_odometry_contradicts_as_positions_do_is_not_believed_either():
    def wrong(fix: GnssFix) -> GnssFix:
        velocity = fix.velocity_enu_mps + np.array([0.0, 3.0, 0.0])
        return dataclasses.replace(moved(fix, 0.0, 5.0), velocity_enu_mps=velocity)

    row, faults = driven(changed("both wrong", GnssFix, wrong), 14.0, math.inf)
    assert ("gnss.contradicts_odometry", True) in faults
    assert row.misleading_s == [0.0] * 4


@pytest.mark.parametrize("has_fixes", [True, False])
def test_wheels_that_stand_while_the_imu_moves_do_not_stop_the_position(has_fixes):
    case = changed("wheels at zero", WheelSample, lambda m: dataclasses.replace(m, speed_mps=0.0))
    beside = () if has_fixes else (dataclasses.replace(BY_NAME["outage 5 s"], from_s=10.0, for_s=12.0),)
    row, _ = driven(dataclasses.replace(case, beside=beside), 14.0, 6.0)
    assert row.max_error_m < 3.0
    assert row.misleading_s[3] == 0.0


def test_wrong_ambiguities_after_an_outage_are_covered():
    row, _ = driven(at_once("multipath 0.3 m 60 s + outage 20 s"), 14.0, 60.0, 40.0)
    assert row.max_error_m > 0.2
    assert row.misleading_s == [0.0] * 4
    row, _ = driven("outage 5 s", 14.0, 5.0, 26.0)
    assert row.after[2] == 1.0  # fixes that the position before them confirms
    row, _ = driven("float 30 s", 14.0, 15.0, 40.0)
    assert row.after[3] == 1.0  # by the velocity


@pytest.mark.parametrize("name", ["wrong fix 0.5 m 20 s + IMU gap 0.2 s", "spoofed ramp 0.3 m/s 30 s + IMU gap 0.2 s"])
def test_a_suspicion_and_bounds_outlast_a_gap(name):
    case = BY_NAME[name]
    gap = dataclasses.replace(case.beside[0], from_s=20.0)
    row, _ = driven(dataclasses.replace(case, beside=(gap,)), 14.0, 20.0)
    assert row.misleading_s == [0.0] * 4


class Separations:
    """Odometry separation that shows an error in every window."""

    def __init__(self, d_m):
        self._d_m = np.array([d_m, 0.0])

    def since(self, stamp_ns):
        return Separation(1.0, self._d_m, 1e-4 * np.eye(2), np.zeros(2))

    def by_lidar_since(self, stamp_ns):
        return None

    def slip_at(self, stamp_ns):
        return np.zeros(4), np.zeros(4)


@pytest.mark.parametrize(("by_velocity_m", "code"), [(0.01, ODOMETRY), (0.04, VELOCITY)])
def test_an_error_that_the_velocity_shows_too_is_no_spoofing(by_velocity_m, code, monkeypatch):
    monitor = GnssMonitor(configuration().map_alignment.gnss_monitor, Separations(0.1))
    monkeypatch.setattr(monitor, "_velocity", Separations(by_velocity_m))
    assert monitor.evaluate(START_NS, False, Separations(0.0).since(START_NS)).code == code


def test_start_in_float():
    row, faults = driven("start in float 20 s", 0.0, 12.0, 20.0)
    assert row.start_s is not None
    assert ("localization.rebuilt", True) not in faults
    assert row.max_excess_m < 0.0
    assert row.after[3] > 0.9


@pytest.mark.parametrize("name", ["vibration 1 m/s²", "vibration 2 m/s²"])
def test_start_with_vibration(name):
    row, _ = driven(name, 0.0, math.inf, 16.0)
    assert row.start_s is not None
    assert row.start_s < 5.0
    assert row.max_excess_m < 0.0


def test_slip_explains_only_what_lies_along_the_wheels():
    along = Separation(5.0, np.array([1.0, 0.0]), np.eye(2) * 0.01, np.array([10.0, 0.0]))
    across = dataclasses.replace(along, d_m=np.array([0.0, 1.0]))
    assert along.ratio == pytest.approx(10.0)
    assert along.ratio_beside_slip([along.wheel_m]) < 0.5
    assert across.ratio_beside_slip([across.wheel_m]) == pytest.approx(10.0)


def with_lidar(name: str, drift_mps: tuple[float, float, float], yaw_deg: float = 0.0):
    """Row and codes of a drive with lidar odometry of a mount that is off; it drifts from the begin of the fault."""
    case = dataclasses.replace(BY_NAME[name], from_s=14.0, for_s=14.0)
    draw = Draw(2)
    draw.delay_s = 0.0
    truth = drive(36.0, legs=[(4.0, 0.0, 0.0), (100.0, 2.5, 0.0)], sensor_errors=SensorErrors(seed=2))
    motions = []
    for arrival_ns, topic, motion in lidar_motions(truth, 2, 36.0, yaw_deg):
        T, is_late = motion.T_from_to.copy(), motion.stamp_ns > START_NS + 14_000_000_000
        T[:3, 3] += 0.2 * np.array(drift_mps) * is_late
        motions.append((arrival_ns, topic, dataclasses.replace(motion, T_from_to=T)))
    result = run(sorted(edited(truth, case, draw) + motions, key=lambda m: m[0]))
    return judged(case, "lidar", 2, result, truth, draw, 0.0), {f.code for f in result.faults if f.is_active}


def test_the_level_is_that_of_the_reference_once_a_wrong_fix_is_excluded():
    row, codes = with_lidar("wrong fix 1 m 20 s", (0.0, 0.0, 0.0))
    assert "gnss.contradicts_velocity" in codes
    assert row.misleading_s == [0.0] * 4
    assert row.available[-1] > 0.8  # below 0.5 m for 12 of 14 s; before, for none


def test_a_position_that_is_no_longer_by_gnss_is_dead_reckoning_at_once():
    case = dataclasses.replace(BY_NAME["multipath 0.3 m 10 s"], from_s=14.0)
    draw = Draw(2)
    draw.delay_s = 0.0
    truth = drive(22.0, legs=[(4.0, 0.0, 0.0), (100.0, 2.5, 0.0)], sensor_errors=SensorErrors(seed=2))
    result = run(edited(truth, case, draw))
    (begin_ns,) = (f.stamp_ns for f in result.faults if f.is_active and f.code == "gnss.contradicts_velocity")
    suspected = [p for p in result.poses if p.stamp_ns > begin_ns + 100_000_000]
    assert {p.source for p in suspected} == {PositionSource.DEAD_RECKONING}
    assert all(p.protection_level_m < 0.3 for p in suspected if p.stamp_ns < begin_ns + 1_000_000_000)


@pytest.mark.parametrize("shift_ms", [-50, 50])
def test_stamps_that_had_shifted_the_position_are_in_the_level_without_fixes(shift_ms):
    """2.78 m/s: 0.14 m along the path."""
    truth = drive(24.0, legs=[(4.0, 0.0, 0.0), (100.0, 2.78, 0.0)], sensor_errors=SensorErrors(seed=2))
    late = [
        (t, topic, dataclasses.replace(m, stamp_ns=m.stamp_ns + shift_ms * 1_000_000) if topic == "gnss/main" else m)
        for t, topic, m in truth.messages
        if topic != "gnss/main" or m.stamp_ns < START_NS + 18e9
    ]
    alone = [p for p in run(late).poses if p.source is PositionSource.DEAD_RECKONING]
    assert len(alone) > 30
    errors_m = [math.dist(p.T_map_base[:2, 3], truth.at(p.stamp_ns)[:2, 3]) for p in alone]
    assert max(errors_m) > 0.1
    assert all(e < p.protection_level_m for e, p in zip(errors_m, alone, strict=True))


def test_lidar_odometry_shows_what_slip_of_the_wheels_hides():
    row, codes = with_lidar("spoofed ramp 0.05 m/s 30 s", (0.0, 0.0, 0.0))
    assert codes & {"gnss.contradicts_odometry", "gnss.contradicts_velocity"}
    assert row.misleading_s == [0.0] * 4
    assert row.max_excess_m < 0.02


@pytest.mark.parametrize("yaw_deg", [-0.6, 0.6])
def test_a_lidar_mounted_off_in_yaw_is_learned(yaw_deg):
    row, codes = with_lidar("clean", (0.0, 0.0, 0.0), yaw_deg)
    assert not {c for c in codes if c.startswith("gnss.")}
    assert row.max_excess_m < 0.0
    assert row.available[-1] == 1.0  # the level stays below 0.5 m
    row, codes = with_lidar("spoofed ramp 0.1 m/s 30 s", (0.0, 0.0, 0.0), yaw_deg)
    assert codes & {"gnss.contradicts_odometry", "gnss.contradicts_velocity"}
    assert row.misleading_s == [0.0] * 4
    row, _ = with_lidar("outage 30 s", (0.0, 0.0, 0.0), yaw_deg)  # 35 m in 14 s, which the mount turns by 0.37 m
    assert row.max_error_m < 0.12
    assert row.max_excess_m < 0.0


def test_lidar_odometry_that_the_wheels_contradict_is_not_believed_against_gnss():
    row, codes = with_lidar("clean", (0.0, 0.3, 0.0))
    assert not {c for c in codes if c.startswith("gnss.")}
    assert row.max_error_m < 0.05


def test_lidar_odometry_that_is_wrong_by_as_much_as_wheels_slip_is_covered():
    row, _ = with_lidar("clean", (0.5, 0.0, 0.0))
    assert row.max_excess_m < 0.0


def test_vibration_that_hides_the_tilt_is_in_the_level_and_teaches_no_slip():
    row, faults = driven("vibration 5 m/s²", 0.0, math.inf, 30.0)
    assert row.start_s is not None
    assert row.max_excess_m < 0.0
    assert not any(code.startswith("gnss.contradicts") for code, _ in faults)


@pytest.mark.parametrize("name", ["gnss stamps -50 ms", "gnss stamps +50 ms"])
def test_headings_that_are_late_in_a_turn_are_used_again_after_it(name):
    case, draw = BY_NAME[name], Draw(2)
    legs = [(4.0, 0.0, 0.0), (8.0, 2.5, 0.0), (math.pi * 6.0 / 1.6, 1.6, 1 / 6.0), (100.0, 2.5, 0.0)]
    truth = drive(33.0, legs=legs, sensor_errors=SensorErrors(seed=2))
    result = run(edited(truth, case, draw))
    row = judged(case, "open", 2, result, truth, draw, 0.0)
    assert row.max_excess_m < 0.0
    pose = result.poses[-1]
    off_rad = wrap(yaw_of(pose.T_map_base) - yaw_of(truth.at(pose.stamp_ns)))
    assert abs(math.degrees(off_rad)) < 0.1


def test_antennas_that_are_exchanged_are_noticed_in_the_first_metres():
    row, _ = driven("heading 180° from start", 0.0, math.inf, 20.0)
    assert row.detect_s is not None
    assert max(row.misleading_s) < 3.5  # at rest nothing shows it: base is off by twice the lever arm of the antenna


def test_a_wrong_compass_is_named_and_not_followed():
    row, faults = driven("heading 5° 30 s", 14.0, 10.0, 30.0)
    assert ("gnss.heading_refused", True) in faults
    assert ("gnss.heading_refused", False) in faults
    assert row.max_error_m < 0.05
    assert row.false_alarms == 0

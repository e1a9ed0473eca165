"""Localizer node on synthetic drives: accuracy, integrity, and behaviour with faults."""

import dataclasses
import functools
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from localization.gnss_gate import RejectionReason
from localization.graph.smoother import Smoother
from localization.localizer import Localizer
from messages.errors import ConfigError
from messages.faults import Response
from messages.motion import LidarLocalization, LidarOdometry, PositionSource
from messages.sensors import GnssFix, GnssSolution, ImuSample
from tests.localization.harness import Run, configuration, errors, run
from tests.localization.synthetic_drive import DATUM, START_NS, SensorErrors, drive, tractor


@functools.cache
def long_drive():
    truth = drive(38, sensor_errors=SensorErrors(seed=3))
    return truth, run(truth.messages)


@functools.cache
def short_truth():
    return drive(14, legs=[(4.0, 0.0, 0.0), (100.0, 2.0, 0.0)], sensor_errors=SensorErrors(seed=4))


def at(seconds):
    return START_NS + int(seconds * 1e9)


def edited(truth, change):
    """Messages with each (arrival, topic, message) replaced by `change`; None removes it."""
    return [m for m in map(change, truth.messages) if m is not None]


def fix_between(start_s, end_s, change):
    """An edit of the fixes in an interval."""

    def edit(entry):
        arrival, topic, message = entry
        if topic != "gnss/main" or not at(start_s) <= message.stamp_ns < at(end_s):
            return entry
        message = change(message)
        return None if message is None else (arrival, topic, message)

    return edit


def codes(result: Run):
    return [(f.code, f.is_active) for f in result.faults]


def jump(result: Run):
    """Largest step of `odom` beyond its own speed, m."""
    a = result.odom
    step_m = np.array([np.linalg.norm(y.T_odom_base[:3, 3] - x.T_odom_base[:3, 3]) for x, y in itertools.pairwise(a)])
    dt = np.diff([m.stamp_ns for m in a]) * 1e-9
    return float(np.max(step_m - np.array([abs(m.speed_mps) for m in a[1:]]) * np.minimum(dt, 0.05)))


def test_accuracy_and_integrity_with_rtk():
    truth, result = long_drive()
    e = errors(result, truth)
    m = e.t_s > 10
    assert np.all(np.std(e.p_m[m, 1]) < 0.010)
    assert np.sqrt(np.mean(e.p_m[m, :2] ** 2)) < 0.012
    assert np.degrees(np.std(e.turn_rad[m, 2])) < 0.1
    assert np.degrees(np.max(np.abs(e.turn_rad[m, :2]))) < 0.25
    assert 0.2 < np.mean(e.nees[m, 0]) < 2.5
    assert np.all(np.linalg.norm(e.p_m[m, :2], axis=1) < e.level_m[m])
    assert np.all(e.level_m[m] < 0.30)
    assert all(p.accuracy_95_m < 0.05 for p in result.poses if p.stamp_ns > at(10))
    assert result.localizer.dropped == 0


def test_odom_is_continuous_at_50_hz():
    _, result = long_drive()
    stamps = np.diff([m.stamp_ns for m in result.odom])
    assert set(stamps) == {20_000_000}
    assert jump(result) < 2e-3
    assert np.allclose(result.odom[0].T_odom_base[:2, 3], 0.0)


def test_speed_and_yaw_rate_accuracy():
    truth, result = long_drive()
    k = [round((m.stamp_ns - START_NS) * 1e-9 / 0.002) for m in result.odom]
    m = np.array([o.stamp_ns > at(15) for o in result.odom])
    speed = np.array([o.speed_mps for o in result.odom]) - truth.speed_mps[k]
    assert np.sqrt(np.mean(speed[m] ** 2)) < 0.05
    rate = np.array([o.yaw_rate_radps for o in result.odom]) - truth.yaw_rate_radps[k]
    assert np.sqrt(np.mean(rate[m] ** 2)) < 0.005


def test_unknown_steering_angle_is_no_reason_to_refuse_the_speed():
    def without_angle(entry):
        arrival, topic, message = entry
        if topic == "wheel":
            message = replace(message, steering_angle_rad=math.nan)
        return arrival, topic, message

    known, unknown = run(short_truth().messages), run(edited(short_truth(), without_angle))
    assert len(unknown.poses) == len(known.poses) > 50
    ends = [r.odom[-1].T_odom_base[:2, 3] for r in (known, unknown)]
    assert np.linalg.norm(ends[0] - ends[1]) < 0.01
    assert np.isfinite([m.curvature_radpm for m in unknown.odom]).all()
    assert codes(unknown) == codes(known)


def test_same_input_same_output_to_the_bit():
    first, second = (run(short_truth().messages) for _ in range(2))
    for a, b in ((first.odom, second.odom), (first.poses, second.poses)):
        assert len(a) == len(b) > 50
        for x, y in zip(a, b, strict=True):
            assert all(np.array_equal(u, v, equal_nan=u.dtype.kind == "f") for u, v in map(pair, pairs(x, y)))


def pairs(x, y):
    return [(getattr(x, f.name), getattr(y, f.name)) for f in dataclasses.fields(x)]


def pair(uv):
    return np.asarray(uv[0]), np.asarray(uv[1])


def test_no_start_at_standstill_without_heading():
    silent = fix_between(0, 99, lambda f: replace(f, heading_rad=math.nan, sigma_heading_rad=math.nan))
    result = run(edited(short_truth(), silent), seconds=4)
    assert not any(p.is_initialized for p in result.poses)
    assert all(p.source is PositionSource.NONE and math.isinf(p.protection_level_m) for p in result.poses)
    assert ("gnss.no_heading", True) in codes(result)
    assert len(result.odom) > 80


@pytest.mark.parametrize("offset_m", [0.15, 0.5])
def test_jump_of_fixed_solution_is_rejected(offset_m):
    away = offset_m / 6.37e6
    truth = short_truth()
    result = run(edited(truth, fix_between(10, 11, lambda f: replace(f, latitude_rad=f.latitude_rad + away))))
    e = errors(result, truth)
    assert np.max(np.linalg.norm(e.p_m[e.t_s > 8, :2], axis=1)) < 0.05
    assert ("gnss.refused", True) in codes(result)
    assert ("gnss.refused", False) in codes(result)


def test_dead_reckoning_without_gnss():
    truth = short_truth()
    result = run(edited(truth, fix_between(9, 99, lambda f: None)))
    e = errors(result, truth)
    level = e.level_m[e.t_s > 10]
    assert np.all(np.diff(level[::50]) > 0)
    assert level[-1] > level[0] + 0.05
    assert np.all(np.linalg.norm(e.p_m[:, :2], axis=1) < e.level_m)
    assert abs(e.p_m[-1, 1]) < 0.06
    assert result.poses[-1].source is PositionSource.DEAD_RECKONING
    assert result.poses[-1].gnss_age_s == pytest.approx(14 - 9, abs=0.3)


def test_float_after_fixed_solution():
    def worse(f):
        up = np.array([0.2, 0.2, 0.4])
        return replace(f, solution=GnssSolution.RTK_FLOAT, sigma_enu_m=up, latitude_rad=f.latitude_rad + 0.2 / 6.37e6)

    truth = short_truth()
    result = run(edited(truth, fix_between(9, 99, worse)))
    e = errors(result, truth)
    assert np.max(np.linalg.norm(e.p_m[e.t_s > 9, :2], axis=1)) < 0.12
    assert result.poses[-1].source is PositionSource.RTK_FLOAT
    assert result.poses[-1].protection_level_m > 0.4


def test_invalid_samples_are_dropped_and_counted():
    rng = np.random.default_rng(0)

    def spoil(entry):
        arrival, topic, message = entry
        if rng.random() > 0.03 or message.stamp_ns < at(6):
            return entry
        if topic == "imu":
            return arrival, topic, replace(message, rate_radps=np.array([math.nan, 0, 0]))
        if topic == "wheel":
            return arrival, topic, replace(message, speed_mps=math.inf)
        return arrival, topic, replace(message, latitude_rad=math.nan)

    truth = short_truth()
    result = run(edited(truth, spoil))
    e = errors(result, truth)
    assert result.localizer.dropped > 20
    assert np.max(np.linalg.norm(e.p_m[:, :2], axis=1)) < 0.06
    assert {(f"{kind}.invalid", True) for kind in ("imu", "wheel", "gnss")} <= set(codes(result))


@pytest.mark.parametrize("gap_s", [0.8, 2.0, 5.5])
def test_invalid_imu_samples_are_a_gap_to_the_next_valid_one(gap_s):
    def spoil(entry):
        arrival, topic, message = entry
        if topic != "imu" or not at(10) < message.stamp_ns < at(10 + gap_s):
            return entry
        return arrival, topic, replace(message, rate_radps=np.full(3, math.nan))

    truth = drive(17, legs=[(4.0, 0.0, 0.0), (100.0, 2.0, 0.0)], sensor_errors=SensorErrors(seed=4))
    result = run(edited(truth, spoil))
    late = [p for p in result.poses if p.stamp_ns > at(10 + gap_s)]
    assert [p.is_initialized for p in late[:5]] == [gap_s < 5.0] * 5
    placed = [p for p in late if p.is_initialized]
    gaps_m = [float(np.linalg.norm((p.T_map_base - truth.at(p.stamp_ns))[:2, 3])) for p in placed]
    assert all(gap_m < p.protection_level_m for gap_m, p in zip(gaps_m, placed, strict=True))


def test_a_gap_of_all_sensors_in_a_half_turn_is_bridged():
    def without(entry):
        arrival, topic, message = entry
        if at(10.4) <= message.stamp_ns < at(13.4):
            return None
        is_late = isinstance(message, GnssFix) and message.stamp_ns > at(10.4)  # and no heading any more
        return arrival, topic, replace(message, heading_rad=math.nan) if is_late else message

    legs = [(4.0, 0.0, 0.0), (7.0, 2.5, 0.0), (100.0, 1.6, 1 / 6.0)]
    truth = drive(17, legs=legs, sensor_errors=SensorErrors(seed=6))
    late = [p for p in run(edited(truth, without)).poses if p.stamp_ns > at(13.4)]
    assert all(p.is_initialized for p in late)
    error_m = np.array([np.linalg.norm((p.T_map_base - truth.at(p.stamp_ns))[:2, 3]) for p in late])
    level_m = np.array([p.protection_level_m for p in late])
    assert error_m[0] > 0.3  # the turn began without a measurement
    assert np.all(error_m < level_m)
    assert level_m[0] > 5.0
    assert np.max(level_m[10:]) < 0.5  # after a second


def test_fixes_that_are_held_while_the_machine_moves_are_no_measurements():
    held = {}

    def hold(fix):
        return replace(held.setdefault("fix", fix), stamp_ns=fix.stamp_ns)

    truth = short_truth()
    result = run(edited(truth, fix_between(10, 13, hold)))
    assert ("gnss.silent", True) in codes(result)
    assert result.localizer.fixes[RejectionReason.REPEATED] > 25
    assert np.max(np.linalg.norm(errors(result, truth).p_m[:, :2], axis=1)) < 0.15


def test_an_imu_on_its_side_does_not_start():
    def turned(entry):
        arrival, topic, message = entry
        if topic != "imu":
            return entry
        y_up = {"rate_radps": message.rate_radps[[0, 2, 1]], "acceleration_mps2": message.acceleration_mps2[[0, 2, 1]]}
        return arrival, topic, replace(message, **y_up)

    result = run(edited(short_truth(), turned), seconds=8)
    assert not any(p.is_initialized for p in result.poses)
    assert result.localizer.awaited.startswith("a tilt below 45 deg")


@pytest.mark.parametrize("topic", ["imu", "wheel"])
def test_no_odom_after_sensor_timeout(topic):
    truth = short_truth()
    result = run([m for m in truth.messages if m[1] != topic or not at(10) < m[0] < at(10.6)])
    quiet = [m for m in result.odom if at(10.15) < m.stamp_ns < at(10.58)]
    assert quiet == []
    fault = next(f for f in result.faults if f.code == f"{topic}.silent" and f.stamp_ns > at(5))
    assert fault.response is Response.CONTROLLED_STOP
    assert fault.stamp_ns < at(10.15)
    assert (f"{topic}.silent", False) in codes(result)
    assert result.odom[-1].stamp_ns > at(13.9)
    e = errors(result, truth)
    assert np.max(np.linalg.norm(e.p_m[e.t_s > 12, :2], axis=1)) < 0.1


@pytest.mark.parametrize("topic", [None, "imu", "wheel", "gnss/main"])
def test_start_without_fault_unless_a_sensor_stays_silent(topic):
    truth = short_truth()
    result = run([m for m in truth.messages if m[1] != topic], seconds=3)
    silent = [f for f in result.faults if f.code.endswith(".silent")]
    assert [f.code for f in silent] == ([] if topic is None else [f"{topic.partition('/')[0]}.silent"])
    assert all(f.stamp_ns < at(1.2) for f in silent)


@pytest.mark.parametrize("topic", ["lidar_odometry/front", "lidar_localization"])
def test_silent_lidar_node_is_named(topic):
    def motion(k):
        stamp_ns = at(0.1 * k)
        lost = LidarOdometry(stamp_ns, stamp_ns - 100_000_000, np.eye(4), np.eye(6), False, "degenerate", 0)
        if topic == "lidar_localization":
            lost = LidarLocalization(stamp_ns, np.eye(4), np.eye(6), False, "not needed", 0)
        return stamp_ns + 60_000_000, topic, lost

    motions = [motion(k) for k in (*range(10, 40), *range(60, 80))]
    result = run(sorted([*short_truth().messages, *motions], key=lambda entry: entry[0]), seconds=8)
    kind = topic.partition("/")[0]
    silent = [(round((f.stamp_ns - at(0)) * 1e-9, 1), f.is_active) for f in result.faults if kind in f.code]
    assert silent == [(5.0, True), (6.1, False)]


@pytest.mark.parametrize("hours", [-1, 1])
def test_clock_jump(hours):
    leap = round(hours * 3600e9)
    truth = drive(14, legs=[(8.0, 0.0, 0.0), (100.0, 2.0, 0.0)], sensor_errors=SensorErrors(seed=4))
    early = [m for m in truth.messages if m[0] < at(6)]
    late = [(a + leap, t, replace(m, stamp_ns=m.stamp_ns + leap)) for a, t, m in truth.messages if a >= at(6)]
    first = run(early, seconds=6)
    second = run(late, localizer=first.localizer, start_ns=at(6) + leap)
    assert ("clock.jumped", True) in codes(second)
    moved = dataclasses.replace(
        second,
        odom=[replace(o, stamp_ns=o.stamp_ns - leap) for o in second.odom],
        poses=[replace(p, stamp_ns=p.stamp_ns - leap) for p in second.poses],
    )
    e = errors(moved, truth)
    assert len(second.odom) > 350
    assert np.max(np.linalg.norm(e.p_m[e.t_s > 7, :2], axis=1)) < 0.06


def test_fixes_with_wrong_stamps_are_dropped():
    truth = short_truth()
    off = fix_between(9, 12, lambda f: replace(f, stamp_ns=f.stamp_ns + 3_600_000_000_000))
    result = run(edited(truth, off))
    e = errors(result, truth)
    assert result.localizer.dropped == 30
    assert np.max(np.linalg.norm(e.p_m[:, :2], axis=1)) < 0.06


def test_graph_failure_rebuilds(monkeypatch):
    update, calls = Smoother._update, []

    def failing(self, *arguments):
        calls.append(1)
        if len(calls) in (30, 45):
            raise RuntimeError("Indeterminate linear system")
        update(self, *arguments)

    monkeypatch.setattr(Smoother, "_update", failing)
    truth = short_truth()
    result = run(truth.messages)
    e = errors(result, truth)
    assert codes(result).count(("localization.rebuilt", True)) == 2
    assert np.max(np.linalg.norm(e.p_m[:, :2], axis=1)) < 0.06
    assert jump(result) < 2e-3


def test_position_lost_by_graph_failures_among_queued_fixes(monkeypatch):
    """Fixes that arrive five at a time: the second failure loses the position while others wait."""
    update, calls = Smoother._update, []

    def failing(self, *arguments):
        calls.append(1)
        if len(calls) in (30, 31, 32):
            raise RuntimeError("Indeterminate linear system")
        update(self, *arguments)

    monkeypatch.setattr(Smoother, "_update", failing)
    burst_ns = 500_000_000
    late = [
        (-(-t // burst_ns) * burst_ns if topic.startswith("gnss") else t, topic, m)
        for t, topic, m in short_truth().messages
    ]
    result = run(sorted(late, key=lambda m: m[0]))
    fixes = result.localizer.fixes
    assert ("localization.lost", True) in codes(result)
    assert sum(fixes.values()) + 5 >= sum(topic.startswith("gnss") for _, topic, _ in late)


def test_realignment_at_standstill():
    away = 5.0 / 6.37e6
    truth = drive(71, legs=[(80.0, 0.0, 0.0)])
    result = run(edited(truth, fix_between(6, 99, lambda f: replace(f, latitude_rad=f.latitude_rad + away))))
    moved = result.poses[-1].T_map_base[:2, 3] - result.poses[40].T_map_base[:2, 3]
    assert moved == pytest.approx([0.0, 5.0], abs=0.05)
    assert ("localization.lost", True) in codes(result)
    assert jump(result) < 2e-3


def test_vehicle_without_imu_raises():
    v = tractor()
    bare = v.model_copy(update={"sensors": v.sensors.model_copy(update={"imu": None})})
    with pytest.raises(ConfigError, match=r"sensors\.imu"):
        Localizer(bare, DATUM, configuration())


def test_unknown_gnss_sensor_raises():
    config = configuration()
    gnss = config.map_alignment.gnss.model_copy(update={"sensor": "roof"})
    alignment = config.map_alignment.model_copy(update={"gnss": gnss})
    with pytest.raises(ConfigError, match=r"sensors\.gnss\.roof"):
        Localizer(tractor(), DATUM, config.model_copy(update={"map_alignment": alignment}))


def test_lidar_sensor_from_configuration():
    config = configuration()
    rear = config.model_copy(update={"lidar_odometry": config.lidar_odometry.model_copy(update={"sensor": "rear"})})
    assert "lidar_odometry/front" in Localizer(tractor(), DATUM, config).reads
    assert "lidar_odometry/rear" in Localizer(tractor(), DATUM, rear).reads


@pytest.mark.parametrize("latency_s", [0.05, 0.45])
def test_late_and_repeated_fixes_are_used_once(latency_s):
    truth = drive(25.0, sensor_errors=SensorErrors(seed=3, gnss_latency_s=latency_s))
    again = [(a + 30_000_000, topic, m) for a, topic, m in truth.messages if topic == "gnss/main"]
    result = run(sorted([*truth.messages, *again], key=lambda m: m[0]), seconds=24.0)
    placed = [p for p in result.poses if p.is_initialized]
    assert {p.source for p in placed} == {PositionSource.RTK_FIXED}
    gaps_m = [np.linalg.norm((p.T_map_base - truth.at(p.stamp_ns))[:2, 3]) for p in placed]
    assert max(gaps_m) < 0.05
    assert all(p.protection_level_m > gap_m for p, gap_m in zip(placed, gaps_m, strict=True))
    assert result.localizer.fixes[RejectionReason.LATE] > 200


@pytest.mark.parametrize("has_two_antennas", [True, False])
def test_fixes_without_height_place_the_machine(has_two_antennas):
    truth = drive(16.0, legs=[(4.0, 0.0, 0.0), (12.0, 2.0, 0.02)])
    update = {"height_m": math.nan} | ({} if has_two_antennas else {"heading_rad": math.nan})
    messages = [(t, k, replace(m, **update) if isinstance(m, GnssFix) else m) for t, k, m in truth.messages]
    last = run(messages).poses[-1]
    assert last.is_initialized
    error_m = np.linalg.norm((last.T_map_base - truth.at(last.stamp_ns))[:2, 3])
    assert error_m < 0.05 < last.protection_level_m < 1.0


def test_imu_in_units_of_gravity_is_refused_with_the_reason():
    truth = drive(8.0, legs=[(8.0, 0.0, 0.0)])
    in_g = [
        (t, k, replace(m, acceleration_mps2=m.acceleration_mps2 / 9.80665) if isinstance(m, ImuSample) else m)
        for t, k, m in truth.messages
    ]
    result = run(in_g)
    assert not any(p.is_initialized for p in result.poses)
    assert result.localizer.awaited.startswith("gravity: the specific force at standstill is 1.0 m/s2")

"""Initial alignment, dead reckoning and steering offset."""

import math

import numpy as np
import pytest

from geometry.transforms import rpy_of, transform
from localization.dead_reckoning.dead_reckoning import Calibration, DeadReckoning, PoseHistory
from localization.dead_reckoning.imu_track import ImuTrack, Steps
from localization.dead_reckoning.initial_alignment import (
    InitialPosition,
    TiltEstimate,
    initial_pose,
    mean_position,
    tilt_from_gravity,
)
from localization.dead_reckoning.kernels import first_in_voxel
from localization.dead_reckoning.steering_offset import SteeringOffset
from localization.gnss_gate import Position
from messages.sensors import GnssSolution, ImuSample
from tests.localization.harness import configuration
from tests.localization.synthetic_drive import tractor

CONFIG = configuration()
STILL = Calibration(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


def steps(n, dt, rate):
    return Steps(
        np.full(n, dt),
        np.arange(n) * dt * 1e9,
        np.zeros((n, 3)),
        np.tile(np.array(rate, float), (n, 1)),
        np.zeros((n, 2)),
    )


@pytest.mark.parametrize("roll", np.radians([-10, 0, 3]))
@pytest.mark.parametrize("pitch", np.radians([-8, 0, 5]))
def test_tilt_from_gravity(roll, pitch):
    T = transform((0, 0, 0), (roll, pitch, 1.0))
    tilt = tilt_from_gravity(T[:3, :3].T @ [0, 0, 9.81], np.array([1e-3, 0, 0]))
    assert (tilt.roll_rad, tilt.pitch_rad) == pytest.approx((roll, pitch))
    assert tilt.gravity_mps2 == pytest.approx(9.81)


def test_initial_pose_on_slope_subtracts_lever_arm():
    tilt, position = (
        TiltEstimate(math.radians(3), 0.0, np.zeros(3), 9.81),
        InitialPosition(np.array([10.0, 5, 3]), np.ones(3), 0.0),
    )
    T = initial_pose(tilt, position, np.array([0.0, 0.0, 3.0]))
    assert T[1, 3] == pytest.approx(5 + 3 * math.sin(math.radians(3)))


def fixes(start_headings, spread_m=0.0):
    return [
        Position(
            k,
            np.array([k % 2 * spread_m, 0, 0]),
            np.full(3, 0.01),
            np.zeros(3),
            h,
            0.002,
            0.0,
            GnssSolution.RTK_FIXED,
            np.zeros(3),
            0.03,
            np.full(3, 0.01),
        )
        for k, h in enumerate(start_headings)
    ]


def test_mean_position_needs_consistent_headings_and_positions():
    assert mean_position(fixes([math.nan] * 10)) is None
    assert mean_position(fixes([0.1] * 10, spread_m=0.2)) is None
    assert mean_position(fixes([0.1] * 9 + [0.3])) is None
    found = mean_position(fixes([math.pi - 0.001, -math.pi + 0.001] * 5))
    assert found is not None
    assert abs(found.heading_rad) == pytest.approx(math.pi)


def test_full_circle_closes():
    dead_reckoning = DeadReckoning(CONFIG.odometry.dead_reckoning, np.eye(4), STILL)
    poses = dead_reckoning.advance(steps(1000, 0.01, [0, 0, 2 * math.pi / 10]), np.full(1000, 2.0))
    assert np.linalg.norm(poses[-1][:3, 3]) < 1e-3
    assert np.max(np.abs(poses[:, :2, 3])) == pytest.approx(2 * 2.0 * 10 / (2 * math.pi), rel=1e-3)


def test_corrections_never_step():
    dead_reckoning = DeadReckoning(CONFIG.odometry.dead_reckoning, transform((0, 0, 0), (0.02, 0, 0)), STILL)
    goal = Calibration(np.array([0, 0, 1e-3]), np.array([0.9, 0.02, 0.0, 0.0]))
    up = transform((0, 0, 0), (-0.01, 0, 0))[:3, :3].T @ [0, 0, 1]
    dead_reckoning.correct(goal, up, dead_reckoning.T_odom_base)
    poses = dead_reckoning.advance(steps(1500, 0.01, [0, 0, 0]), np.full(1500, 2.0))
    steps_m = np.diff(poses[:, :3, 3], axis=0)
    assert np.max(np.abs(np.diff(steps_m, axis=0))) < 2e-4
    assert rpy_of(poses[-1])[0] == pytest.approx(-0.01, abs=2e-3)
    assert dead_reckoning.calibration.slip == pytest.approx(goal.slip, abs=1e-6)


def test_pose_history_limits():
    history = PoseHistory(1.0)
    for k in range(20):
        history.add(k * 100_000_000, transform((k, 0, 0), (0, 0, 0.1 * k)))
    assert history.at(1_850_000_000)[0, 3] == pytest.approx(18.5)
    assert history.at(1_900_000_001) is None
    assert history.at(899_999_999) is None
    assert history.at(900_000_000) is not None


def test_imu_track_rejects_invalid_samples():
    track = ImuTrack(tractor().sensors.imu, configuration().odometry.imu)
    good = ImuSample(10, np.array([0, 0, 9.81]), np.zeros(3))
    assert track.add(good)
    assert not track.add(good)
    for bad in ([math.nan, 0, 9.8], [math.inf, 0, 0], [0, 0, 6.001 * 9.80665], [0.0, 0.0]):
        assert not track.is_valid(ImuSample(20, np.array(bad, float), np.zeros(3)))
    assert track.is_valid(ImuSample(20, np.array([0, 0, 5.999 * 9.80665]), np.zeros(3)))


def test_imu_steps_cover_any_interval():
    track = ImuTrack(tractor().sensors.imu, configuration().odometry.imu)
    for k in range(10):
        track.add(ImuSample(k * 10, np.array([0, 0, 9.81]), np.array([0.01 * k, 0, 0])))
    for start in range(0, 60, 7):
        for end in range(start + 1, 90, 7):
            found = track.between(start, end)
            expected = sum(0.01 * k * max(0, min(end, 10 * k) - max(start, 10 * k - 10)) for k in range(10))
            assert found.rate_radps[:, 0] @ found.dt_s == pytest.approx(expected * 1e-9)
            assert found.dt_s.sum() == pytest.approx((end - start) * 1e-9)


@pytest.mark.parametrize("offset_deg", [-0.3, 0.0, 0.3, 1.0])
def test_steering_offset_converges(offset_deg):
    steering = SteeringOffset(CONFIG.odometry.steering_offset, 2.55)
    for _ in range(3000):
        steering.update(math.atan(2.55 * 0.02) + math.radians(offset_deg), 2.0, 0.04, 0.02)
    assert math.degrees(steering.offset_rad) == pytest.approx(offset_deg, abs=0.01)
    assert steering.curvature(math.atan(2.55 * 0.02) + math.radians(offset_deg)) == pytest.approx(0.02, abs=1e-4)


def test_steering_offset_unchanged_at_standstill():
    steering = SteeringOffset(CONFIG.odometry.steering_offset, 2.55)
    for _ in range(1000):
        steering.update(0.3, 0.0, 0.0, 0.02)
    assert steering.offset_rad == 0.0


def test_voxel_filter_keeps_one_point_per_cube():
    rng = np.random.default_rng(3)
    points = rng.uniform(-20, 20, (5000, 3))
    kept = first_in_voxel(points, 2.0)
    cells = np.floor(points / 2.0).astype(int)
    assert len(kept) == len(np.unique(cells, axis=0)) == len(np.unique(cells[kept], axis=0))
    assert len(first_in_voxel(np.zeros((0, 3)), 1.0)) == 0

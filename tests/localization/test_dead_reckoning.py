"""Alignment, the continuous pose and the steering offset."""

import math

import numpy as np
import pytest

from geometry.transforms import rpy_of, transform
from localization.dead_reckoning.dead_reckoning import Calibration, DeadReckoning, PoseHistory
from localization.dead_reckoning.imu_track import InertialTrack, Steps
from localization.dead_reckoning.initial_alignment import Level, Placed, level_of, place_of, pose_of
from localization.dead_reckoning.kernels import first_in_voxel
from localization.dead_reckoning.steering_offset import Steering
from localization.gnss_gate import Position
from messages.sensors import GnssSolution, ImuSample
from tests.localization.localization_bench import configuration
from tests.localization.localization_drive import tractor

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
def test_gravity_gives_roll_and_pitch(roll, pitch):
    T = transform((0, 0, 0), (roll, pitch, 1.0))
    level = level_of(T[:3, :3].T @ [0, 0, 9.81], np.array([1e-3, 0, 0]))
    assert (level.roll_rad, level.pitch_rad) == pytest.approx((roll, pitch))
    assert level.gravity_mps2 == pytest.approx(9.81)


def test_the_antenna_on_a_slope_is_brought_down_to_the_ground():
    level, placed = Level(math.radians(3), 0.0, np.zeros(3), 9.81), Placed(np.array([10.0, 5, 3]), np.ones(3), 0.0)
    T = pose_of(level, placed, np.array([0.0, 0.0, 3.0]))
    assert T[1, 3] == pytest.approx(5 + 3 * math.sin(math.radians(3)))


def fixes(headings, spread_m=0.0):
    return [
        Position(
            k, np.array([k % 2 * spread_m, 0, 0]), np.full(3, 0.01), np.zeros(3), h, 0.002, 0.0, GnssSolution.RTK_FIXED
        )
        for k, h in enumerate(headings)
    ]


def test_place_needs_headings_and_agreement():
    assert place_of(fixes([math.nan] * 10)) is None
    assert place_of(fixes([0.1] * 10, spread_m=0.2)) is None
    assert place_of(fixes([0.1] * 9 + [0.3])) is None
    found = place_of(fixes([math.pi - 0.001, -math.pi + 0.001] * 5))
    assert found is not None
    assert abs(found.heading_rad) == pytest.approx(math.pi)


def test_a_full_circle_closes():
    reckoning = DeadReckoning(CONFIG.motion.dead_reckoning, np.eye(4), STILL)
    poses = reckoning.advance(steps(1000, 0.01, [0, 0, 2 * math.pi / 10]), np.full(1000, 2.0))
    assert np.linalg.norm(poses[-1][:3, 3]) < 1e-3
    assert np.max(np.abs(poses[:, :2, 3])) == pytest.approx(2 * 2.0 * 10 / (2 * math.pi), rel=1e-3)


def test_corrections_glide_in_and_never_step():
    reckoning = DeadReckoning(CONFIG.motion.dead_reckoning, transform((0, 0, 0), (0.02, 0, 0)), STILL)
    goal = Calibration(np.array([0, 0, 1e-3]), np.array([0.9, 0.02, 0.0, 0.0]))
    up = transform((0, 0, 0), (-0.01, 0, 0))[:3, :3].T @ [0, 0, 1]
    reckoning.correct(goal, up, reckoning.T_odom_base)
    poses = reckoning.advance(steps(1500, 0.01, [0, 0, 0]), np.full(1500, 2.0))
    way = np.diff(poses[:, :3, 3], axis=0)
    assert np.max(np.abs(np.diff(way, axis=0))) < 2e-4
    assert rpy_of(poses[-1])[0] == pytest.approx(-0.01, abs=2e-3)
    assert reckoning.calibration.slip == pytest.approx(goal.slip, abs=1e-6)


def test_history_interpolates_within_and_knows_its_ends():
    history = PoseHistory(1.0)
    for k in range(20):
        history.add(k * 100_000_000, transform((k, 0, 0), (0, 0, 0.1 * k)))
    assert history.at(1_850_000_000)[0, 3] == pytest.approx(18.5)
    assert history.at(1_900_000_001) is None
    assert history.at(899_999_999) is None
    assert history.at(900_000_000) is not None


def test_track_refuses_what_is_impossible():
    track = InertialTrack(tractor().sensors.imu, 0.2)
    good = ImuSample(10, np.array([0, 0, 9.81]), np.zeros(3))
    assert track.add(good)
    assert not track.add(good)
    for bad in ([math.nan, 0, 9.8], [math.inf, 0, 0], [0, 0, 6.001 * 9.80665], [0.0, 0.0]):
        assert not track.add(ImuSample(20, np.array(bad, float), np.zeros(3)))
    assert track.add(ImuSample(20, np.array([0, 0, 5.999 * 9.80665]), np.zeros(3)))


def test_steps_cover_any_stretch_exactly():
    track = InertialTrack(tractor().sensors.imu, 0.2)
    for k in range(10):
        track.add(ImuSample(k * 10, np.array([0, 0, 9.81]), np.array([0.01 * k, 0, 0])))
    for start in range(0, 60, 7):
        for end in range(start + 1, 90, 7):
            found = track.between(start, end)
            expected = sum(0.01 * k * max(0, min(end, 10 * k) - max(start, 10 * k - 10)) for k in range(10))
            assert found.rate_radps[:, 0] @ found.dt_s == pytest.approx(expected * 1e-9)
            assert found.dt_s.sum() == pytest.approx((end - start) * 1e-9)


@pytest.mark.parametrize("offset_deg", [-0.3, 0.0, 0.3, 1.0])
def test_the_steering_offset_is_learnt(offset_deg):
    steering = Steering(CONFIG.motion.steering, 2.55)
    for _ in range(3000):
        steering.learn(math.atan(2.55 * 0.02) + math.radians(offset_deg), 2.0, 0.04, 0.02)
    assert math.degrees(steering.offset_rad) == pytest.approx(offset_deg, abs=0.01)
    assert steering.curvature(math.atan(2.55 * 0.02) + math.radians(offset_deg)) == pytest.approx(0.02, abs=1e-4)


def test_standing_teaches_nothing():
    steering = Steering(CONFIG.motion.steering, 2.55)
    for _ in range(1000):
        steering.learn(0.3, 0.0, 0.0, 0.02)
    assert steering.offset_rad == 0.0


def test_thinning_keeps_one_of_each_cube():
    rng = np.random.default_rng(3)
    points = rng.uniform(-20, 20, (5000, 3))
    kept = first_in_voxel(points, 2.0)
    cells = np.floor(points / 2.0).astype(int)
    assert len(kept) == len(np.unique(cells, axis=0)) == len(np.unique(cells[kept], axis=0))
    assert len(first_in_voxel(np.zeros((0, 3)), 1.0)) == 0

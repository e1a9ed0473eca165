"""Functions of the obstacle stop evaluation at their limits."""

import math

import numpy as np
import pytest

from geometry.arrays import Float64
from messages.message import Message
from runtime.replay.log_inspection import LogInspection, Stream
from runtime.replay.trajectory import Trajectory, driven_sections, motion_of
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.driving_corridor import DrivingCorridor, project
from validation.obstacle_stop.frames import is_in_ring
from validation.obstacle_stop.ghost import STEP_S, drive_ghost
from validation.obstacle_stop.ranges import confirmed, range_without_failure, rate_bounds, share_bounds
from validation.obstacle_stop.recorded_motion import turning_points
from validation.obstacle_stop.stopping import safe_speed_mps, stopping_distance_m
from validation.obstacle_stop.swept_path import arc

BRAKING = load_conditions(None).braking


@pytest.mark.parametrize(("kmh", "s_m"), [(7.0, 2.3), (15.0, 6.8), (30.0, 20.5)])
def test_stopping_distance_values_of_requirements(kmh: float, s_m: float) -> None:
    assert stopping_distance_m(kmh / 3.6, 0.6, BRAKING) == pytest.approx(s_m, abs=0.06)


def test_stopping_distance_continuous_at_brake_build_up() -> None:
    knee = 0.5 * BRAKING.deceleration_mps2 * BRAKING.build_up_s
    assert stopping_distance_m(knee - 1e-9, 0.6, BRAKING) == pytest.approx(
        stopping_distance_m(knee + 1e-9, 0.6, BRAKING), abs=1e-6
    )


def test_safe_speed_inverts_stopping_distance() -> None:
    v = safe_speed_mps(40.0, 2.0, BRAKING)
    assert 2.0 * stopping_distance_m(v, 0.6, BRAKING) == pytest.approx(40.0, abs=1e-6)
    assert v * 3.6 == pytest.approx(29.6, abs=0.5)


def test_exact_bounds() -> None:
    assert share_bounds(0, 3000)[1] == pytest.approx(1.0 - 0.025 ** (1 / 3000), rel=1e-9)
    assert share_bounds(10, 10)[1] == 1.0
    assert rate_bounds(0, 2.0)[1] == pytest.approx(-math.log(0.025) / 2.0, rel=1e-9)
    assert rate_bounds(3, 0.0) == (0.0, None)


def test_range_ends_at_first_missed_detection() -> None:
    flags = [(30.0, True), (20.0, False), (10.0, True), (5.0, True)]
    assert range_without_failure(flags) == 10.0
    assert range_without_failure([(5.0, False)]) is None
    assert [found for _, found in confirmed([(9.0, True), (8.0, True), (7.0, True), (6.0, False)])] == [True, False]


def test_projection_on_bend_and_beyond_ends() -> None:
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    s, aside = project(path, np.array([[5.0, 1.0], [11.0, -1.0], [9.0, 5.0], [-0.1, 0.0], [10.0, 10.1]]))
    assert s[:3] == pytest.approx([5.0, 10.0, 15.0])
    assert aside[:3] == pytest.approx([1.0, math.sqrt(2.0), 1.0])
    assert np.isinf(aside[3:]).all()


def test_corridor_clearance_from_front_within_half_width() -> None:
    corridor = DrivingCorridor(np.array([[-1.0, 0.0], [20.0, 0.0]]), 4.0, 1.4)
    clearances = corridor.clearances(np.array([[5.0, 1.4], [5.0, 1.41], [2.9, 0.0], [9.0, 0.0]]))
    assert clearances.tolist() == pytest.approx([2.0, math.inf, math.inf, 6.0])


def test_point_in_ring() -> None:
    ring = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    assert is_in_ring(np.array([[2.0, 2.0], [5.0, 2.0]]), ring).tolist() == [True, False]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_path_extension_keeps_last_curvature(side: float) -> None:
    stamps = (np.arange(31) * 1e8).astype(np.int64)
    turn = side * 0.05 * 0.5 * np.arange(31)
    poses = np.tile(np.eye(4), (31, 1, 1))
    for k, a in enumerate(turn):
        poses[k, :2, :2] = [[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]
        poses[k, :2, 3] = side * math.sin(a) / (side * 0.05) * side, side * (1.0 - math.cos(a)) / 0.05
    poses[:, 0, 3] = np.abs(poses[:, 0, 3])
    (stage,) = driven_sections(Trajectory(stamps, poses, motion_of(stamps, poses)), 20.0)
    end = arc(np.zeros(3), side * 0.05, np.array([35.0]))[0]
    assert stage.path.p_map_m[-1] == pytest.approx(end[:2], abs=0.05)
    assert motion_of(stamps, poses)[15, 0] == pytest.approx(5.0, abs=1e-3)


def test_path_split_at_reversal() -> None:
    stamps = (np.arange(60) * 1e8).astype(np.int64)
    x = np.concatenate([np.arange(20) * 0.2, 3.8 - np.arange(20) * 0.2, np.arange(20) * 0.2])
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, 0, 3] = x
    stages = driven_sections(Trajectory(stamps, poses, motion_of(stamps, poses)), 10.0)
    assert [stage.path.direction for stage in stages] == [1, -1, 1]
    assert [round(float(stage.s_m[-1]), 3) for stage in stages] == pytest.approx([3.8, 3.8, 3.8])
    assert stages[1].path.p_map_m[-1] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert (np.abs(stages[1].path.heading_rad) < 1e-9).all()  # of the machine, not of the motion
    assert stages[0].path.s_m[-1] < 4.0 < stages[2].path.s_m[-1]


def test_noise_at_standstill_is_no_reversal() -> None:
    ahead = np.concatenate([np.linspace(0.0, 5.0, 50), 5.0 + np.random.default_rng(1).normal(0.0, 0.03, 100)])
    assert turning_points(ahead) == [0]
    assert turning_points(np.concatenate([ahead, np.linspace(5.0, 4.0, 20)])) == [0, int(np.argmax(ahead))]


def inspection(**ages_s: float) -> LogInspection:
    """Streams whose messages are received so long after their stamps."""
    out = LogInspection()
    for name, age_s in ages_s.items():
        stream = out.streams[name] = Stream(name)
        for k in range(10):
            stream.add(round((k + age_s) * 1e9), Message(k * 10**9))
    return out


@pytest.mark.parametrize(
    ("ages_s", "expected_s"),
    [
        ({"lidar": 0.1, "imu": 0.01}, 0.0),
        ({"lidar": 8.0, "imu": 8.0}, 0.0),  # all late by the same: a latency
        ({"lidar": 50.0, "imu": 0.01}, 0.0),  # one stream alone
        ({"lidar": 5000.1, "imu": 5000.0}, 5000.0),
        ({"lidar": -30.0, "imu": -29.9}, -30.0),  # received before it was measured
        ({"lidar": -0.01, "imu": 0.0}, 0.0),
    ],
)
def test_clock_difference_is_common_to_all_streams_and_larger_than_any_latency(
    ages_s: dict[str, float], expected_s: float
) -> None:
    assert inspection(**ages_s).clock_offset_ns(10.0) == pytest.approx(expected_s * 1e9, abs=1e3)


def _better_brake(first_gap_m: float, least_mps: float) -> tuple[Float64, Float64, Float64, Float64, Float64]:
    """Recording of a machine without dead time: times, distances, speeds, limits and gaps to something that stands.

    The limit falls with the root of the gap beyond 2 m, down to `least_mps`; the machine drives at 0.7 of it.
    """
    t_s = np.arange(0.0, 20.0, STEP_S)
    s_m, v_mps, limit_mps = np.zeros(len(t_s)), np.full(len(t_s), 2.8), np.full(len(t_s), math.inf)
    for k in range(1, len(t_s)):
        s_m[k] = s_m[k - 1] + v_mps[k - 1] * STEP_S
        limit = max(least_mps, math.sqrt(1.5 * max(0.0, first_gap_m - s_m[k] - 2.0)))
        limit_mps[k] = limit if limit < 2.8 else math.inf
        v_mps[k] = min(2.8, max(least_mps, 0.7 * float(limit_mps[k - 1])))
    return t_s, s_m, v_mps, limit_mps, first_gap_m - s_m


def test_ghost_nearer_than_a_machine_that_brakes_better_obeys_the_request_at_its_gap() -> None:
    t_s, s_m, v_mps, limit_mps, gap_m = _better_brake(20.0, 0.0)
    ghost = drive_ghost(t_s, s_m, v_mps, limit_mps, gap_m, BRAKING)
    assert ghost.speed_mps[-1] == 0.0
    assert 18.0 <= ghost.s_m[-1] < 18.2
    unknown = drive_ghost(t_s, s_m, v_mps, limit_mps, np.full(len(gap_m), math.inf), BRAKING)
    assert unknown.s_m[-1] > 20.0  # by time alone it obeys what was requested farther away


def test_ghost_is_not_stopped_by_a_request_that_was_never_made() -> None:
    """A limit that never falls below 1 m/s stops no machine, however near it is."""
    t_s, s_m, v_mps, limit_mps, gap_m = _better_brake(20.0, 1.0)
    ghost = drive_ghost(t_s, s_m, v_mps, limit_mps, gap_m, BRAKING)
    assert ghost.speed_mps.min() >= 1.0 - 1e-9
    assert ghost.s_m[-1] > 20.0

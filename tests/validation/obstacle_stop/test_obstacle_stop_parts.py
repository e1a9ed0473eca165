"""The parts of the judgement, each at its edges."""

import math

import numpy as np
import pytest

from runtime.replay.trajectory import Trajectory, carried_on, motion_of, stages_of
from validation.obstacle_stop.boxes import Box, beams_at
from validation.obstacle_stop.conditions import load_conditions
from validation.obstacle_stop.driving_corridor import Tube, places
from validation.obstacle_stop.frames import inside_ring
from validation.obstacle_stop.ranges import confirmed, range_without_failure, rate_bounds, share_bounds
from validation.obstacle_stop.stopping import safe_speed_mps, stopping_distance_m

BRAKING = load_conditions(None).braking


@pytest.mark.parametrize(("kmh", "s_m"), [(7.0, 2.3), (15.0, 6.8), (30.0, 20.5)])
def test_stopping_distances_of_the_requirements(kmh: float, s_m: float) -> None:
    assert stopping_distance_m(kmh / 3.6, 0.6, BRAKING) == pytest.approx(s_m, abs=0.06)


def test_stopping_distance_is_continuous_where_the_brake_is_just_built_up() -> None:
    knee = 0.5 * BRAKING.deceleration_mps2 * BRAKING.build_up_s
    assert stopping_distance_m(knee - 1e-9, 0.6, BRAKING) == pytest.approx(
        stopping_distance_m(knee + 1e-9, 0.6, BRAKING), abs=1e-6
    )


def test_safe_speed_inverts_the_stopping_distance() -> None:
    v = safe_speed_mps(40.0, 2.0, BRAKING)
    assert 2.0 * stopping_distance_m(v, 0.6, BRAKING) == pytest.approx(40.0, abs=1e-6)
    assert v * 3.6 == pytest.approx(29.6, abs=0.5)


def test_bounds_are_exact() -> None:
    assert share_bounds(0, 3000)[1] == pytest.approx(1.0 - 0.025 ** (1 / 3000), rel=1e-9)
    assert share_bounds(10, 10)[1] == 1.0
    assert rate_bounds(0, 2.0)[1] == pytest.approx(-math.log(0.025) / 2.0, rel=1e-9)
    assert rate_bounds(3, 0.0) == (0.0, None)


def test_ranges_end_at_the_first_failure() -> None:
    flags = [(30.0, True), (20.0, False), (10.0, True), (5.0, True)]
    assert range_without_failure(flags) == 10.0
    assert range_without_failure([(5.0, False)]) is None
    assert [found for _, found in confirmed([(9.0, True), (8.0, True), (7.0, True), (6.0, False)])] == [True, False]


def test_points_are_placed_along_a_bend_and_left_out_beyond_its_ends() -> None:
    way = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    s, aside = places(way, np.array([[5.0, 1.0], [11.0, -1.0], [9.0, 5.0], [-0.1, 0.0], [10.0, 10.1]]))
    assert s[:3] == pytest.approx([5.0, 10.0, 15.0])
    assert aside[:3] == pytest.approx([1.0, math.sqrt(2.0), 1.0])
    assert np.isinf(aside[3:]).all()


def test_gaps_count_from_the_front_and_end_at_the_half_width() -> None:
    tube = Tube(np.array([[-1.0, 0.0], [20.0, 0.0]]), 4.0, 1.4)
    gaps = tube.gaps(np.array([[5.0, 1.4], [5.0, 1.41], [2.9, 0.0], [9.0, 0.0]]))
    assert gaps.tolist() == pytest.approx([2.0, math.inf, math.inf, 6.0])


def test_beams_tell_hidden_from_gone() -> None:
    box = Box(1, "person", "p", np.array([10.0, 0.0, 1.0]), np.array([1.0, 1.0, 2.0]), 0.3)
    origin = np.array([0.0, 0.0, 1.0])
    points = np.array(
        [[20.0, 0.0, 1.0], [5.0, 0.0, 1.0], [10.0, 0.0, 1.0], [20.0, 9.0, 1.0], [-20.0, 0.0, 1.0]], np.float32
    )
    assert beams_at(points, origin, box) == (1, 1)


def test_ring() -> None:
    ring = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    assert inside_ring(np.array([[2.0, 2.0], [5.0, 2.0]]), ring).tolist() == [True, False]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_way_is_carried_on_with_its_last_curvature(side: float) -> None:
    stamps = (np.arange(31) * 1e8).astype(np.int64)
    turn = side * 0.05 * 0.5 * np.arange(31)
    poses = np.tile(np.eye(4), (31, 1, 1))
    for k, a in enumerate(turn):
        poses[k, :2, :2] = [[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]
        poses[k, :2, 3] = side * math.sin(a) / (side * 0.05) * side, side * (1.0 - math.cos(a)) / 0.05
    poses[:, 0, 3] = np.abs(poses[:, 0, 3])
    (stage,) = stages_of(Trajectory(stamps, poses, motion_of(stamps, poses)), 20.0)
    end = carried_on(np.array([0.0, 0.0, 0.0, 0.0]), side * 0.05, 35.0)[-1]
    assert stage.path.p_map_m[-1] == pytest.approx(end[1:3], abs=0.05)
    assert motion_of(stamps, poses)[15, 0] == pytest.approx(5.0, abs=1e-3)


def test_a_way_is_cut_where_the_vehicle_went_back() -> None:
    stamps = (np.arange(60) * 1e8).astype(np.int64)
    x = np.concatenate([np.arange(20) * 0.2, 3.8 - np.arange(20) * 0.2, np.arange(20) * 0.2])
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, 0, 3] = x
    stages = stages_of(Trajectory(stamps, poses, motion_of(stamps, poses)), 10.0)
    assert len(stages) == 2
    assert stages[0].path.s_m[-1] < 4.0 < stages[1].path.s_m[-1]

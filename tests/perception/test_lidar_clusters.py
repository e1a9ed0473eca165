"""Clusters of obstacle points and their bounding boxes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.lidar.boxes import fit_boxes
from perception.lidar.clusters import Clusters, find_clusters, new_cell_grid, select
from tests.perception.lidar_scenes import LIDAR_CONFIG

CONFIG = LIDAR_CONFIG.clusters
ORIGIN = np.zeros(2)


def find(points, point_class=None):
    point_class = np.full(len(points), 2, np.uint8) if point_class is None else np.array(point_class, np.uint8)
    cell_grid = new_cell_grid(CONFIG)
    found = find_clusters(np.asarray(points, np.float32), point_class, ORIGIN, CONFIG, cell_grid)
    assert (cell_grid == -1).all()
    return found


def blob(x, y, n=12, seed=0, size=0.2, z=1.0):
    rng = np.random.default_rng(seed)
    return np.array([x, y, z]) + rng.uniform(-size, size, (n, 3))


def members(found):
    return [set(found.indices[a:b].tolist()) for a, b in zip(found.offsets[:-1], found.offsets[1:], strict=True)]


def test_clusters_one_metre_apart_are_separate():
    points = np.concatenate([blob(10, -0.5, seed=1), blob(10, 0.5, seed=2)])
    assert members(find(points)) == [set(range(12)), set(range(12, 24))]


def test_sparse_distant_cluster():
    points = np.array([[35.0, y, 1.0] for y in (0.0, 0.6, 1.2, 1.8)])
    assert members(find(points)) == [{0, 1, 2, 3}]
    near = points - [30.0, 0.0, 0.0]
    assert members(find(near)) == []


@pytest.mark.parametrize("n", range(CONFIG.min_returns - 2, CONFIG.min_returns + 3))
def test_min_returns(n):
    points = np.array([[8.0, 0.01 * i, 1.0] for i in range(n)])
    assert len(members(find(points))) == (n >= CONFIG.min_returns)


def test_low_points_join_occupied_cell_only():
    points = np.array([[10.0, 0.0, 1.0]] * 4 + [[10.0, 0.01, 0.05], [10.0, 3.0, 0.05], [10.0, 0.0, 5.0]])
    assert members(find(points, [2, 2, 2, 2, 1, 1, 0])) == [{0, 1, 2, 3, 4}]


def test_single_obstacle_point_over_ground():
    points = np.array([[10.0, 0.0, 1.0]] + [[10.0, 0.01 * i, 0.0] for i in range(20)])
    assert members(find(points, [2] + [1] * 20)) == []


def test_points_beyond_max_range_and_empty_input():
    assert members(find(np.zeros((0, 3)))) == []
    assert members(find(np.full((5, 3), CONFIG.max_range_m + 1.0))) == []


def test_select_preserves_indices():
    found = find(np.concatenate([blob(10, 0), blob(10, 5), blob(10, -5)]))
    kept = select(found, np.array([True, False, True]))
    assert members(kept) == [members(found)[0], members(found)[2]]


def one(points, above=None, front=(3.5, 1.15), origin=(0.0, 0.0)):
    points = np.asarray(points, np.float32)
    n = len(points)
    above = points[:, 2].copy() if above is None else np.asarray(above, np.float32)
    clusters = Clusters(np.array([0, n], np.int32), np.arange(n, dtype=np.int32))
    classes = np.where(above >= 0.15, 2, 1).astype(np.uint8)
    return fit_boxes(clusters, points, above, classes, front, np.array(origin))


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(0.4, 6.0), st.floats(0.1, 1.0), st.floats(-30, 30), st.floats(-30, 30))
def test_box_of_rotated_rectangle(yaw, length, ratio, x, y):
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 21) * length, np.linspace(-0.5, 0.5, 21) * length * ratio)
    c, s = np.cos(yaw), np.sin(yaw)
    points = np.stack([x + c * u - s * v, y + s * u + c * v, 0.5 + 0 * u], axis=2).reshape(-1, 3)
    boxes = one(points)
    true = length, max(length * ratio, 0.05)
    area = boxes.size_m[0, 0] * boxes.size_m[0, 1]
    assert area <= true[0] * true[1] * 1.15 + 0.02
    assert boxes.center_m[0, :2] == pytest.approx([x, y], abs=0.05 * length + 0.02)
    assert -np.pi / 2 <= boxes.yaw_rad[0] < np.pi / 2
    assert boxes.size_m[0, 0] >= boxes.size_m[0, 1]
    corner = np.abs((points[:, :2] - boxes.center_m[0, :2]) @ [[np.cos(boxes.yaw_rad[0])], [np.sin(boxes.yaw_rad[0])]])
    assert corner.max() <= boxes.size_m[0, 0] / 2 + 0.02 * length + 0.01


@pytest.mark.parametrize("turn_deg", range(-40, 50, 10))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_box_of_l_shape(turn_deg, sign):
    rng = np.random.default_rng(abs(turn_deg))
    u, v = np.r_[rng.uniform(-2.0, 2.0, 200), np.full(60, 2.0)], np.r_[np.full(200, 0.8), rng.uniform(-0.8, 0.8, 60)]
    turn, v = np.radians(turn_deg), sign * v
    c, s = np.cos(turn), np.sin(turn)
    points = np.column_stack([10.0 + c * u - s * v, 3.0 + s * u + c * v, np.full(260, 0.5)])
    lidar = 10.0 + c * 8.0 - s * sign * 8.0, 3.0 + s * 8.0 + c * sign * 8.0
    boxes = one((points + rng.normal(0.0, 0.02, points.shape)).astype(np.float32), origin=lidar)
    apart = (boxes.yaw_rad[0] - turn + np.pi / 2) % np.pi - np.pi / 2
    assert abs(np.degrees(apart)) < 4.0
    assert boxes.size_m[0, :2] == pytest.approx([4.0, 1.6], abs=0.3)


@pytest.mark.parametrize("turn_deg", range(-40, 50, 10))
def test_box_of_body_with_leaning_sides(turn_deg):
    """A car narrows to its roof: most returns of its sides are away from the edges of its box."""
    rng = np.random.default_rng(50 + turn_deg)
    along, across = rng.uniform(-2.0, 2.0, 700), rng.uniform(-0.8, 0.8, 300)
    z, lean = rng.uniform(0.2, 1.6, 1000), 0.35
    u = np.r_[along * (1.0 - 0.2 * z[:700]), 2.0 - lean * z[700:]]
    v = np.r_[0.8 - lean * z[:700], across * (1.0 - 0.4 * z[700:])]
    turn = np.radians(turn_deg)
    c, s = np.cos(turn), np.sin(turn)
    points = np.column_stack([10.0 + c * u - s * v, 3.0 + s * u + c * v, z])
    lidar = 10.0 + c * 6.0 - s * 7.0, 3.0 + s * 6.0 + c * 7.0
    boxes = one(points + rng.normal(0.0, 0.02, points.shape), origin=lidar)
    apart = (boxes.yaw_rad[0] - turn + np.pi / 2) % np.pi - np.pi / 2
    assert abs(np.degrees(apart)) < 6.0


def test_box_of_single_return():
    boxes = one([[5.0, 1.0, 1.0]])
    assert boxes.size_m[0] == pytest.approx([0.05, 0.05, 0.05])
    assert boxes.center_m[0] == pytest.approx([5.0, 1.0, 1.0])


def test_nearest_return_is_obstacle_point():
    points = [[9.0, 0.0, 0.05], [10.0, 4.0, 1.0], [10.5, 0.5, 1.0], [8.0, 0.0, -1.0]]
    assert one(points).nearest_m[0] == pytest.approx([10.5, 0.5, 1.0])
    assert one(points).top_m[0] == pytest.approx(1.0)

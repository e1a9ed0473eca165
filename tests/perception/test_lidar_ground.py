"""Ground surface with slopes, furrows, ghosts and thinned scans; heights of obstacles on it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.lidar.grid import build_grid
from perception.lidar.ground import find_ground, fit_plane
from tests.perception.lidar_scenes import FRONT, LIDAR_CONFIG, box, cast, listed

CONFIG = LIDAR_CONFIG.ground
GRID = build_grid(CONFIG.sector_deg, CONFIG.first_bin_m, CONFIG.bin_growth, CONFIG.max_range_m)
T = FRONT.mount.T_base_sensor
CENTER = T[:2, 3].copy()


def ground_of(scan, extra=None):
    points = scan.points_m + T[:3, 3].astype(np.float32)
    if extra is not None:
        points = np.concatenate([points, extra]).astype(np.float32)
    return points, find_ground(points, np.ones(len(points), np.uint8), CENTER, GRID, CONFIG)


def heights_of(points, ground, corners):
    inside = ((points >= corners[0] - 0.05) & (points <= corners[1] + 0.05)).all(axis=1)
    return points[inside], ground.height_m[inside]


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.08, 0.0), (-0.08, 0.0), (0.0, 0.08), (0.05, -0.06)])
def test_sloping_ground(slope):
    points, ground = ground_of(cast(slope=slope))
    near = np.hypot(*(points[:, :2] - CENTER).T) < 40.0
    assert np.abs(ground.height_m[near]).max() < 0.15
    plane = fit_plane(ground, CENTER, GRID, 12.0)
    assert plane[:3] == pytest.approx(np.array([-slope[0], -slope[1], 1.0]) / np.hypot(1, np.hypot(*slope)), abs=0.02)
    assert np.linalg.norm(plane[:3]) == pytest.approx(1.0)


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_furrows_and_height_of_box(share):
    corners = box(12.0, 1.0, 0.5, 0.5, 0.5)
    points, ground = ground_of(listed(cast([corners], furrow_m=0.08), share))
    own, heights = heights_of(points, ground, corners + np.array([[0, 0, 0.12], [0, 0, 0]]))
    assert len(own) > 2
    assert heights - own[:, 2] == pytest.approx(0.0, abs=0.12)
    flat = np.hypot(points[:, 0] - 12.0, points[:, 1] - 1.0) > 1.0
    assert np.quantile(ground.height_m[flat], 0.999) < 0.2


def test_ghost_returns_below_ground():
    rng = np.random.default_rng(1)
    ghosts = np.stack([rng.uniform(5, 25, 300), rng.uniform(-5, 5, 300), rng.uniform(-3.0, -0.3, 300)], axis=1)
    _points, ground = ground_of(cast(), ghosts)
    real = np.abs(ground.height_m[:-300])
    assert np.quantile(real, 0.99) < 0.1
    assert (ground.height_m[-300:] < -0.2).all()


def test_mound_is_not_ground():
    corners = box(12.0, 0.0, 2.0, 2.0, 0.6)
    points, ground = ground_of(cast([corners]))
    _, heights = heights_of(points, ground, corners + np.array([[0, 0, 0.4], [0, 0, 0]]))
    assert len(heights) > 10
    assert heights.min() > 0.25


def test_unusable_points_have_no_height():
    points = np.array([[8.0, 0.0, 0.0], [np.nan, 1.0, 1.0], [500.0, 0.0, 0.0]], np.float32)
    ground = find_ground(points, np.array([1, 0, 1], np.uint8), CENTER, GRID, CONFIG)
    assert np.isfinite(ground.height_m).tolist() == [True, False, False]


def test_empty_scan_gives_base_plane():
    ground = find_ground(np.zeros((0, 3), np.float32), np.zeros(0, np.uint8), CENTER, GRID, CONFIG)
    assert fit_plane(ground, CENTER, GRID, 12.0) == pytest.approx([0.0, 0.0, 1.0, 0.0])


@settings(derandomize=True, max_examples=20, deadline=None)
@given(st.integers(0, 119), st.integers(0, 1000))
def test_heights_invariant_to_rotation_and_order(sectors, seed):
    points, ground = ground_of(cast([box(12.0, 1.0, 1.0, 2.0, 1.5)], noise_m=0.0))
    angle = np.radians(sectors * CONFIG.sector_deg)
    c, s = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = (points[:, :2] - CENTER) @ np.array([[c, s], [-s, c]]) + CENTER
    order = np.random.default_rng(seed).permutation(len(points))
    again = find_ground(turned[order], np.ones(len(points), np.uint8), CENTER, GRID, CONFIG)
    off = np.abs(again.height_m - ground.height_m[order])
    assert np.quantile(off, 0.99) < 0.03


def test_ground_that_falls_away_begins_at_its_height():
    """Beyond the top of a crest the nearest ring is as high as it is, though all ground next to it is lower."""
    rng = np.random.default_rng(1)
    range_m = np.repeat([2.4, 3.2, 4.2, 5.4, 6.8, 8.4, 10.2], 500)
    azimuth = np.tile(np.linspace(-1.2, 1.2, 500), 7)
    x, y = CENTER[0] + range_m * np.cos(azimuth), range_m * np.sin(azimuth)
    for fall in (0.15, 0.25, 0.35, -0.25):
        points = np.stack([x, y, -fall * (x - 4.0) + rng.normal(0.0, 0.01, len(x))], axis=1).astype(np.float32)
        points = np.asfortranarray(points)
        ground = find_ground(points, np.ones(len(points), np.uint8), CENTER, GRID, CONFIG)
        nearest = (range_m == 2.4) & (np.abs(azimuth) < 0.3)
        assert np.abs(ground.height_m[nearest]).max() < 0.12, fall

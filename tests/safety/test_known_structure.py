"""Known structure: distances to surfaces, roof outline, discs of the walls."""

import math
from dataclasses import replace

import numpy as np
import pytest

from configs.site import Post, Shed
from configs.vehicle import Vehicle
from safety.config import SafetyConfig
from safety.zones.footprint import footprint_of
from safety.zones.known_structure import SPACING_M, KnownStructure, discs_along, edges_of, structure_of_shed
from safety.zones.swept_area import SweptArea, arc_poses, spaced, sweep_along
from tests.safety.safety_world import around

SURVEY = KnownStructure(
    walls=np.array([[10.0, -5.0, 10.0, 5.0], [10.0, 5.0, 20.0, 5.0]]),
    half_thickness_m=0.1,
    posts=np.array([[0.0, 8.0, 0.3], [30.0, 8.0, 0.5]]),
    roof=np.array([[10.0, -5.0], [22.0, -5.0], [22.0, 5.0], [10.0, 5.0]]),
)


@pytest.mark.parametrize(("x", "y", "distance_m"), [
    (7.0, 0.0, 2.9), (10.0, 0.0, -0.1), (13.0, 1.0, 2.9), (7.0, -9.0, 4.9), (23.0, 9.0, 4.9), (15.0, 8.0, 2.9),
    (0.0, 8.0, -0.3), (0.0, 9.3, 1.0), (-3.0, 12.0, 4.7), (30.0, 6.0, 1.5), (10.0, 5.0, -0.1), (16.0, 5.04, -0.06),
])  # fmt: skip
def test_distance_to_nearest_surface(x: float, y: float, distance_m: float) -> None:
    points = np.array([(x, y), (50.0, 50.0)])
    assert SURVEY.distance_m(points)[0] == pytest.approx(distance_m)


def test_slanted_and_zero_length_wall() -> None:
    bare = KnownStructure(np.array([[1.0, 1.0, 5.0, 4.0], [9.0, 9.0, 9.0, 9.0]]), 0.0, np.empty((0, 3)), SURVEY.roof)
    points = np.array([(3.0 - 0.6, 2.5 + 0.8), (-2.0, -3.0), (12.0, 13.0), (5.0 + 0.6, 4.0 - 0.8)])
    assert bare.distance_m(points) == pytest.approx([1.0, 5.0, 5.0, 1.0])
    short = replace(bare, walls=np.array([[0.0, 0.0, 0.3, 0.4]]))
    assert short.distance_m(np.array([(0.15 - 0.8, 0.2 + 0.6), (0.6, 0.8)])) == pytest.approx([1.0, 0.5])
    assert np.isinf(KnownStructure(np.empty((0, 4)), 0.1, np.empty((0, 3)), SURVEY.roof).distance_m(points)).all()


def test_is_near() -> None:
    for near_m in (0.0, 3.0):
        for away in around(near_m, 0.01):
            for x, y in ((10.0 - away, 0.0), (22.0 + away, 1.0), (15.0, 5.0 + away), (15.0, -5.0 - away)):
                is_near = away <= near_m + 1e-9
                assert SURVEY.is_near(np.array([x, y, 0.3]), near_m) == is_near, (x, y, near_m)
    for x, y, is_near in ((16.0, 0.0, True), (24.9, 5.7, True), (24.9, 5.9, False), (7.1, -5.7, True)):
        assert SURVEY.is_near(np.array([x, y, 0.3]), 3.0) == is_near, (x, y)
    post = replace(SURVEY, posts=np.array([[25.5, 0.0, 0.3]]))
    assert not post.is_near(np.array([25.5, 0.0, 0.3]), 3.0)


@pytest.fixture
def area(vehicle: Vehicle, implement, config: SafetyConfig) -> SweptArea:
    s = spaced(8.0, 0.4)
    return sweep_along(footprint_of(vehicle, implement), 1, s, arc_poses(0.0, 1, s), 0.0, config.field, True)


def test_is_under_roof(area: SweptArea) -> None:
    for until_m, way_m in ((0.0, 0.0), (3.0, 2.8)):
        for edge in around(3.5 + way_m, 0.01):
            pose = np.array([16.0, -5.0 - edge - 1e-6, math.pi / 2])
            assert SURVEY.is_under_roof(area.up_to(until_m), pose) == (edge < 3.5 + way_m - 1e-9), (until_m, edge)


def test_clear_distance(area: SweptArea) -> None:
    for clearance in (0.0, 0.5):
        head_on = SURVEY.clear_distance_m(area, np.array([2.0, 0.0, 0.0]), clearance)
        assert head_on == pytest.approx(10.0 - 0.1 - 5.5 - clearance, abs=0.03)
        post = SURVEY.clear_distance_m(area, np.array([0.0, 0.0, math.pi / 2]), clearance)
        assert post == pytest.approx(8.0 - 0.3 - 3.5 - clearance, abs=0.03)
    assert SURVEY.clear_distance_m(area, np.array([2.0, 0.0, math.pi]), 0.0) == math.inf
    assert SURVEY.clear_distance_m(area, np.array([80.0, 0.0, 0.0]), 0.0) == math.inf


def test_clear_distance_without_lateral_margin(area: SweptArea) -> None:
    for y in around(8.0 - 0.3 - 3.05 - 0.2, 0.01):
        distance = SURVEY.clear_distance_m(area, np.array([-6.0, y, 0.0]), 0.2)
        assert math.isfinite(distance) == (y >= 8.0 - 0.3 - 3.05 - 0.2 - 1e-9), y


def test_disc_reach(vehicle: Vehicle, config: SafetyConfig) -> None:
    s = spaced(20.0, 0.4)
    far = sweep_along(footprint_of(vehicle, None), 1, s, arc_poses(0.0, 1, s), 0.0, config.field, True)
    alone = KnownStructure(np.empty((0, 4)), 0.1, np.array([[0.0, 0.0, 0.3]]), SURVEY.roof)
    for away in (14.9, 15.0, 15.1):
        assert math.isfinite(alone.clear_distance_m(far, np.array([-away, 0.0, 0.0]), 0.0)) == (away <= 15.0), away


def test_structure_of_shed() -> None:
    corner = ((0.0, 0.0), (0.0, 8.0), (6.0, 8.0))
    posts = (Post(at_m=(6.0, 0.0), radius_m=0.12), Post(at_m=(3.0, 0.0), radius_m=0.2))
    outline = ((0.0, 0.0), (6.0, 0.0), (6.0, 8.0), (0.0, 8.0))
    shed = Shed(name="shed", height_m=4.0, outline_m=outline, walls_m=(corner,), wall_thickness_m=0.3, posts=posts)
    found = structure_of_shed(shed)
    assert found.walls.tolist() == [[0.0, 0.0, 0.0, 8.0], [0.0, 8.0, 6.0, 8.0]]
    assert found.half_thickness_m == pytest.approx(0.15)
    assert found.posts.tolist() == [[6.0, 0.0, 0.12], [3.0, 0.0, 0.2]]
    assert found.roof.tolist() == [list(corner) for corner in outline]
    bare = structure_of_shed(shed.model_copy(update={"walls_m": (), "posts": ()}))
    assert (bare.walls.shape, bare.posts.shape) == ((0, 4), (0, 3))


def test_edges_of_polygon() -> None:
    assert edges_of(np.array([(0.0, 0.0), (4.0, 1.0), (2.0, 3.0)])).tolist() == [
        [0.0, 0.0, 4.0, 1.0], [4.0, 1.0, 2.0, 3.0], [2.0, 3.0, 0.0, 0.0],
    ]  # fmt: skip


@pytest.mark.parametrize(("length_m", "count"), [(0.0, 2), (0.1, 2), (4 * SPACING_M, 5), (4 * SPACING_M + 0.01, 6)])
def test_discs_along_wall(length_m: float, count: int) -> None:
    start, ahead = np.array([2.0, 3.0]), np.array([0.6, 0.8])
    discs = discs_along(np.array([*start, *(start + length_m * ahead)]), 0.1)
    expected = [(*(start + share * length_m * ahead), 0.1) for share in np.linspace(0.0, 1.0, count)]
    assert discs == pytest.approx(np.array(expected))

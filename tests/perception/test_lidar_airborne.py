"""Dust and birds in the perception of lidars: no clusters of dust, birds are airborne, who is among them is not."""

import numpy as np
import pytest

from messages.perception import ObstacleClass
from perception.class_order import CLASSES
from perception.lidar.classes import class_scores
from perception.lidar.obstacles import Pipeline
from tests.perception.lidar_scenes import FRONT, LIDAR_CONFIG, VEHICLE, box, cast, listed, person

AIRBORNE = CLASSES.index(ObstacleClass.AIRBORNE)


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline(FRONT, VEHICLE, None, LIDAR_CONFIG)


def dust(share):
    """Isolated returns 0.8 to 8 m off on a share of the beams."""

    def add(mm, rng):
        found_mm = rng.uniform(800.0, 8000.0, mm.shape).astype(np.uint16)
        return np.where((rng.random(mm.shape) < share) & ((mm == 0) | (found_mm < mm)), found_mm, mm)

    return add


def obstacles_of(pipeline, scan):
    return pipeline.run(scan, None, "lidar_front", 0)[1]


def found_at(obstacles, x, y):
    """Rows of the obstacles whose centre is within 0.6 m of a place."""
    return np.flatnonzero(np.hypot(*(obstacles.center_base_m[:, :2] - [x, y]).T) < 0.6)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.02])
def test_dust_has_no_clusters_and_who_is_in_it_has_one(pipeline, share):
    near = 0
    for seed in range(5):
        obstacles = obstacles_of(pipeline, cast([person(6.0, 2.0)], seed=seed, extra=dust(share)))
        (row,) = found_at(obstacles, 6.0, 2.0)
        assert obstacles.size_m[row, 2] > 1.2
        near += len(obstacles.yaw_rad) - 1
    assert near <= 1


def test_dust_in_a_list_has_no_clusters(pipeline):
    """The returns of a list are put in the beams of the lidar, where those of dust have no others next to them."""
    scans = [listed(cast([person(9, 2)], seed=seed, extra=dust(0.02)), seed=seed) for seed in range(5)]
    assert [len(obstacles_of(pipeline, scan).yaw_rad) for scan in scans] == [1] * 5


@pytest.mark.parametrize(("x", "low_m"), [(7.0, 1.0), (10.0, 1.3), (15.0, 1.4), (20.0, 1.5)])
def test_birds_are_airborne_without_the_ground_below_them(pipeline, x, low_m):
    obstacles = obstacles_of(pipeline, cast([box(x, 1.0, 0.4, 1.2, 0.25, low=low_m)]))
    (row,) = found_at(obstacles, x, 1.0)
    assert obstacles.class_scores[row].argmax() == AIRBORNE
    assert obstacles.size_m[row, 2] < 0.4


@pytest.mark.parametrize("x", [6.0, 9.0, 14.0, 20.0])
def test_who_stands_below_a_bird_is_not_airborne(pipeline, x):
    bird = box(x, 1.0, 0.4, 1.2, 0.15, low=2.0)
    legs = [box(x, 1.0 + side, 0.15, 0.15, 0.85) for side in (-0.15, 0.15)]
    body = [*legs, box(x, 1.0, 0.3, 0.5, 0.7, low=0.85)]
    for bodies in (body, [person(x, 1.0)], [person(x, 1.0), bird], [box(x, 1.0, 0.25, 0.3, 1.05)]):
        obstacles = obstacles_of(pipeline, cast(bodies))
        (row,) = found_at(obstacles, x, 1.0)
        assert obstacles.class_scores[row].argmax() != AIRBORNE
        assert obstacles.center_base_m[row, 2] - obstacles.size_m[row, 2] / 2 < 0.4


def test_shapes_are_of_bodies_on_the_ground():
    size_m, top_m = np.array([[0.5, 0.4, 1.7]] * 2), np.array([1.7, 1.7])
    standing, floats = class_scores(size_m, top_m, np.array([False, True]), np.zeros(2, np.uint8))
    assert standing.argmax() == CLASSES.index(ObstacleClass.PERSON)
    assert standing[AIRBORNE] == 0.0
    assert floats.argmax() == AIRBORNE
    assert floats.sum() == pytest.approx(1.0)

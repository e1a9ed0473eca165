"""Tracked obstacles piece by piece: what may be left out before its gap is measured, and what may not."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.pose2 import to_frame
from messages.perception import ObstacleClass, Track, Tracks
from safety.config import SafetyConfig
from safety.zones.footprint import Footprint, footprint_of
from safety.zones.swept_area import SweptArea, arc_poses, spaced, sweep_along
from safety.zones.tracked_obstacles import (
    NO_CRITICAL_OBJECT,
    CriticalObject,
    box_points,
    is_beside,
    is_fragment_of,
    is_within_reach,
    nearest_critical_object,
    predicted,
    velocity_sigma_mps,
    without_known_structure,
)
from tests.safety.safety_world import START_NS, WAGON, around

HERE = np.zeros(3)


def track(x: float, y: float, vx: float = 0.0, vy: float = 0.0, size: tuple[float, float, float] = (0.5, 0.4, 1.7),
          label: ObstacleClass = ObstacleClass.PERSON, id: int = 1, yaw: float = 0.0) -> Track:  # fmt: skip
    covariance = np.diag([0.01, 0.01, 0.01, 0.01])
    return Track(id, label, 0.9, np.array([x, y, 0.8]), np.array([vx, vy, 0.0]), covariance, np.array(size), yaw,
                 START_NS - 10**9, START_NS, True, ("lidar/front",))  # fmt: skip


@pytest.fixture
def footprint(vehicle: Vehicle, implement) -> Footprint:
    return footprint_of(vehicle, implement)


@pytest.fixture
def area(footprint: Footprint, config: SafetyConfig) -> SweptArea:
    s = spaced(14.0, 0.4)
    return sweep_along(footprint, 1, s, arc_poses(0.0, 1, s), 0.0, config.field, True)


def critical_object(
    area: SweptArea, footprint: Footprint, config: SafetyConfig, *tracks: Track, **changes: Any
) -> CriticalObject:
    is_known = changes.pop("is_known", None)
    tracked = config.tracked.model_copy(update=changes)
    return nearest_critical_object(area, footprint, Tracks(START_NS, tracks), HERE, 0.0, 4.0, tracked, is_known)


def test_sigma_is_that_of_the_less_certain_component() -> None:
    for along, across in ((0.04, 0.01), (0.01, 0.04)):
        unsure = replace(track(0.0, 0.0), covariance=np.diag([9.0, 9.0, along, across]))
        assert velocity_sigma_mps(unsure) == pytest.approx(0.2)


def test_places_to_come_reach_half_the_smaller_side_on_the_ground(config: SafetyConfig) -> None:
    walker = track(1.0, 2.0, 1.0, -2.0, size=(0.8, 0.6, 0.1))
    places, reach = predicted(walker, np.array([0.0, 1.0, 3.0]), config.tracked)
    assert places == pytest.approx(np.array([(1.0, 2.0), (2.0, 0.0), (4.0, -4.0)]))
    assert reach == pytest.approx([0.3, 0.4, 0.5])


def test_rim_of_a_turned_box() -> None:
    places = box_points(track(1.0, 2.0, size=(4.0, 2.0, 9.0), yaw=0.5))
    local = np.array([(a, b) for a in (-2.0, 0.0, 2.0) for b in (-1.0, 0.0, 1.0)])
    assert places == pytest.approx(to_frame(np.array([1.0, 2.0, 0.5]), local))


def test_what_is_within_reach() -> None:
    pose = np.array([3.0, -2.0, 1.0])
    for away in around(10.0 + 15.0 + 4.0 * 1.0 + 0.5, 0.01):  # sweep, bodies, motion, half of the box
        moving = track(3.0 + 0.6 * away, -2.0 + 0.8 * away, 0.6, 0.8, size=(0.3, 0.4, 9.0))
        assert is_within_reach(moving, pose, 10.0, 4.0) == (away <= 29.5 + 1e-9), away
    for x, y in ((math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0)):
        assert not is_within_reach(track(x, y), pose, 10.0, 4.0)


def test_what_is_beside_the_sweep(area: SweptArea) -> None:
    (x_low, x_high), (y_low, y_high) = area.box.x_m, area.box.y_m
    reach = 0.5 + area.step_m
    for more, is_out in ((-0.01, False), (0.0, False), (0.01, True)):
        for x, y in ((x_low - (reach + more), 0.0), (x_high + (reach + more), 0.0),
                     (5.0, y_low - (reach + more)), (5.0, y_high + (reach + more))):  # fmt: skip
            if more or (x, y) != (x, 0.0):
                assert is_beside(track(x, y, size=(0.3, 0.4, 9.0)), HERE, area) == is_out, (x, y)
    for x, y in ((x_low - reach, 0.0), (x_high + reach, 0.0), (5.0, y_low - reach), (5.0, y_high + reach)):
        assert not is_beside(track(x, y, size=(0.3, 0.4, 9.0)), HERE, area), (x, y)


def test_a_piece_lies_on_the_box_or_half_a_metre_from_it() -> None:
    for yaw, slack in ((0.0, 0.0), (0.5, 1e-6)):
        car = track(0.0, 0.0, size=(4.0, 2.0, 9.0), id=2, yaw=yaw)
        for u, v in itertools.product((-2.51, -2.5, 0.0, 1.2, 2.5, 2.51), (-1.51, -1.5, 0.0, 0.7, 1.5, 1.51)):
            place = to_frame(np.array([0.0, 0.0, yaw]), np.array([[u * (1 - slack), v * (1 - slack)]]))[0]
            expected = abs(u) <= 2.5 and abs(v) <= 1.5
            assert is_fragment_of(track(*place), [car], 0.5) == expected, (yaw, u, v)


def test_a_piece_is_smaller_than_its_whole_and_another() -> None:
    car = track(0.0, 0.0, size=(4.0, 2.0, 1.5), id=2)
    assert not is_fragment_of(replace(car, id=3), [car], 0.5)
    assert not is_fragment_of(replace(track(0.0, 0.0), id=2), [car], 0.5)
    assert is_fragment_of(track(0.0, 0.0), [track(0.0, 0.0), car], 0.5)


def test_walls_are_told_by_places_on_the_ground() -> None:
    def is_known(points: np.ndarray) -> np.ndarray:
        assert points.shape[1] == 2
        return points[:, 0] > 5.0

    tracks = [track(1.0, 0.0, size=(length, 0.5, 1.0), id=k) for k, length in enumerate((2.0, 2.1))]
    assert [one.id for one in without_known_structure(tracks, is_known, 2.0)] == [0]


def test_what_is_explained_is_no_threat(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    person, hedge = track(9.0, 0.0, vx=-1.0), track(9.0, 0.0, vx=-2.0, size=(3.0, 0.5, 1.0))
    for one, is_wall, counts in ((person, False, True), (person, True, False), (hedge, False, False)):
        found = critical_object(
            area, footprint, config, one, is_known=lambda points, known=is_wall: np.full(len(points), known)
        )
        assert (found != NO_CRITICAL_OBJECT) == counts


def test_none_hides_the_next(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    coming = track(9.0, 0.0, vx=-1.0, id=7)
    for uncovered_areas in (
        track(9.0, 0.0, label=ObstacleClass.UNKNOWN), track(9.0, 8.0), track(-8.0, 0.0, vx=1.0), track(1.0, -4.5),
        track(9.0, 0.0, size=(13.0, 1.0, 1.0)),
    ):  # fmt: skip
        found = critical_object(area, footprint, config, uncovered_areas, coming)
        assert (found.label, found.id) == (ObstacleClass.PERSON, 7)
    assert critical_object(area, footprint, config, coming, replace(coming, id=8)).id == 7  # of equals the first


def test_motion_is_looked_at_from_now_on_in_steps(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    leaving = track(7.0, 3.0, vy=3.0)
    assert critical_object(area, footprint, config, leaving) != NO_CRITICAL_OBJECT
    crossing = track(7.0, 10.0, vy=-7.0)
    assert critical_object(area, footprint, config, crossing) != NO_CRITICAL_OBJECT
    assert critical_object(area, footprint, config, crossing, steps=2) == NO_CRITICAL_OBJECT


def test_only_what_is_long_carries_pieces(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    piece = track(9.5, 4.2, vy=-1.5, size=(0.4, 0.1, 0.5))
    for length in around(config.tracked.fragment_parent_m, 0.01):
        post = track(9.5, 4.4, size=(length, 0.5, 1.0), label=ObstacleClass.UNKNOWN, id=2)
        assert (critical_object(area, footprint, config, post, piece) == NO_CRITICAL_OBJECT) == (
            length >= config.tracked.fragment_parent_m
        ), length


def test_the_own_trailer_in_a_bend_is_no_threat(vehicle: Vehicle, config: SafetyConfig) -> None:
    footprint, s = footprint_of(vehicle, WAGON), spaced(14.0, 0.4)
    area = sweep_along(footprint, 1, s, arc_poses(0.1, 1, s), 0.1, config.field, True)
    for x, counts in ((-3.0, False), (9.0, True)):
        moving = track(x, -0.8 if x < 0.0 else 3.0, vx=2.5, size=(0.4, 0.4, 1.0))
        found = nearest_critical_object(area, footprint, Tracks(START_NS, (moving,)), HERE, 0.1, 4.0, config.tracked)
        assert (found != NO_CRITICAL_OBJECT) == counts, x

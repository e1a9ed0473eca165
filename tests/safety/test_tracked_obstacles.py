"""Tracked obstacles: selection of tracks, prediction, fragments, clearance."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.pose2 import to_frame
from messages.perception import ObstacleClass, Track, Tracks
from safety.config import SafetyConfig, TrackedConfig
from safety.zones.footprint import Footprint, footprint_of
from safety.zones.swept_area import SweptArea, arc_poses, spaced, sweep_along
from safety.zones.tracked_obstacles import (
    NO_CRITICAL_OBJECT,
    CriticalObject,
    KnownStructureFilter,
    box_points,
    horizon_s,
    is_ahead,
    is_beside,
    is_fragment_of,
    is_moving,
    is_within_reach,
    nearest_critical_object,
    predicted,
    tracks_near,
    velocity_sigma_mps,
    without_known_structure,
    without_posts,
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
    return nearest_ahead(area, footprint, Tracks(START_NS, tracks), 4.0, tracked, is_known)


def nearest_ahead(
    area: SweptArea, footprint: Footprint, tracks: Tracks | None, stop_s: float, config: TrackedConfig,
    is_known: KnownStructureFilter | None = None, curvature: float = 0.0,
) -> CriticalObject:  # fmt: skip
    """What the collision monitor does with the tracks ahead."""
    predicted_s = horizon_s(stop_s, config)
    near = tracks_near(area, tracks, HERE, predicted_s, config, is_known)
    ahead = [one for one in near if is_ahead(one[0], footprint, HERE, curvature, area.direction, config.self_filter_m)]
    return nearest_critical_object(area, ahead, HERE, predicted_s, config)


def test_velocity_sigma() -> None:
    for along, across in ((0.04, 0.01), (0.01, 0.04)):
        unsure = replace(track(0.0, 0.0), covariance=np.diag([9.0, 9.0, along, across]))
        assert velocity_sigma_mps(unsure) == pytest.approx(0.2)


def test_predicted_radius(config: SafetyConfig) -> None:
    walker = track(1.0, 2.0, 1.0, -2.0, size=(0.8, 0.6, 0.1))
    places, reach = predicted(walker, np.array([0.0, 1.0, 3.0]), config.tracked)
    assert places == pytest.approx(np.array([(1.0, 2.0), (2.0, 0.0), (4.0, -4.0)]))
    assert reach == pytest.approx([0.3, 0.4, 0.5])


def test_box_points_of_rotated_box() -> None:
    places = box_points(track(1.0, 2.0, size=(4.0, 2.0, 9.0), yaw=0.5))
    local = np.array([(a, b) for a in (-2.0, 0.0, 2.0) for b in (-1.0, 0.0, 1.0)])
    assert places == pytest.approx(to_frame(np.array([1.0, 2.0, 0.5]), local))


def test_is_within_reach() -> None:
    pose = np.array([3.0, -2.0, 1.0])
    for away in around(10.0 + 15.0 + 4.0 * 1.0 + 0.5, 0.01):  # sweep, bodies, motion, half of the box
        moving = track(3.0 + 0.6 * away, -2.0 + 0.8 * away, 0.6, 0.8, size=(0.3, 0.4, 9.0))
        assert is_within_reach(moving, pose, 10.0, 4.0) == (away <= 29.5 + 1e-9), away
    for x, y in ((math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0)):
        assert not is_within_reach(track(x, y), pose, 10.0, 4.0)


def test_is_beside(area: SweptArea) -> None:
    (x_low, x_high), (y_low, y_high) = area.box.x_m, area.box.y_m
    reach = 0.5 + area.step_m
    for more, is_out in ((-0.01, False), (0.0, False), (0.01, True)):
        for x, y in ((x_low - (reach + more), 0.0), (x_high + (reach + more), 0.0),
                     (5.0, y_low - (reach + more)), (5.0, y_high + (reach + more))):  # fmt: skip
            if more or (x, y) != (x, 0.0):
                assert is_beside(track(x, y, size=(0.3, 0.4, 9.0)), HERE, area) == is_out, (x, y)
    for x, y in ((x_low - reach, 0.0), (x_high + reach, 0.0), (5.0, y_low - reach), (5.0, y_high + reach)):
        assert not is_beside(track(x, y, size=(0.3, 0.4, 9.0)), HERE, area), (x, y)


def test_fragment_distance() -> None:
    for yaw, slack in ((0.0, 0.0), (0.5, 1e-6)):
        car = track(0.0, 0.0, size=(4.0, 2.0, 9.0), id=2, yaw=yaw)
        for u, v in itertools.product((-2.51, -2.5, 0.0, 1.2, 2.5, 2.51), (-1.51, -1.5, 0.0, 0.7, 1.5, 1.51)):
            place = to_frame(np.array([0.0, 0.0, yaw]), np.array([[u * (1 - slack), v * (1 - slack)]]))[0]
            expected = abs(u) <= 2.5 and abs(v) <= 1.5
            assert is_fragment_of(track(*place, 1.0), [car], 0.5) == expected, (yaw, u, v)


def test_fragment_size() -> None:
    car = track(0.0, 0.0, size=(4.0, 2.0, 1.5), id=2)
    part = track(0.0, 0.0, 1.0)
    assert not is_fragment_of(replace(part, size_m=car.size_m), [car], 0.5)
    assert not is_fragment_of(replace(part, id=2), [car], 0.5)
    assert is_fragment_of(part, [part, car], 0.5)


def test_a_vehicle_of_unknown_velocity_has_no_fragments() -> None:
    car = track(0.0, 0.0, size=(4.0, 2.0, 1.5), id=2)
    for sigma_mps, expected in ((1.2, True), (1.21, False), (4.0, False)):
        unsure = replace(car, covariance=np.diag([0.01, 0.01, 0.01, sigma_mps**2]))
        assert is_fragment_of(track(0.0, 0.0, 1.2), [unsure], 0.5) == expected, sigma_mps


def test_known_structure_by_position() -> None:
    def is_known(points: np.ndarray) -> np.ndarray:
        assert points.shape[1] == 2
        return points[:, 0] > 5.0

    tracks = [track(1.0, 0.0, size=(length, 0.5, 1.0), id=k) for k, length in enumerate((2.0, 2.1))]
    assert [one.id for one in without_known_structure(tracks, is_known, 2.0)] == [0]


def test_gate_posts(config: SafetyConfig) -> None:
    posts = np.array([[0.0, 0.0], [8.0, 0.0]])
    at = [track(8.0, y, id=number) for number, y in enumerate((0.29, 0.31))]
    wide = track(0.0, 0.0, size=(0.61, 0.61, 1.7), id=2)
    joined, beside, long = (  # with a piece of fence along y
        replace(track(8.0, y, size=(size, 0.4, 1.5), id=number), yaw_rad=math.pi / 2)
        for number, (y, size) in enumerate(((-1.1, 1.7), (-1.2, 1.7), (0.0, 2.1)), start=3)
    )
    for moves, kept in ((False, [1, 2, 4, 5]), (True, [0, 1, 2, 3, 4, 5])):
        near = [(one, moves) for one in (*at, wide, joined, beside, long)]
        assert [one.id for one, _ in without_posts(near, posts, config.tracked)] == kept
    for age_s, kept in ((0.9, [0]), (1.0, [0, 3])):  # a box that grows seems to move
        moving = [(replace(one, last_seen_ns=one.first_seen_ns + round(age_s * 1e9)), True) for one in (at[0], joined)]
        assert [one.id for one, _ in without_posts(moving, posts, config.tracked)] == kept
    for moves in (False, True):
        near = [(one, moves) for one in (*at, wide, joined, beside, long)]
        assert without_posts(near, posts[:0], config.tracked) == near
    unknown = track(math.nan, 0.0)
    assert without_posts([(unknown, False)], posts, config.tracked) == [(unknown, False)]


def test_track_on_known_structure(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    person, hedge = track(9.0, 0.0, vx=-1.0), track(9.0, 0.0, vx=-2.0, size=(3.0, 0.5, 1.0))
    for one, is_wall, counts in ((person, False, True), (person, True, False), (hedge, False, False)):
        found = critical_object(
            area, footprint, config, one, is_known=lambda points, known=is_wall: np.full(len(points), known)
        )
        assert (found != NO_CRITICAL_OBJECT) == counts


def test_excluded_track_keeps_next(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    coming = track(9.0, 0.0, vx=-1.0, id=7)
    for uncovered_areas in (
        track(9.0, 0.0, label=ObstacleClass.UNKNOWN), track(9.0, 8.0), track(-8.0, 0.0, vx=1.0), track(1.0, -4.5),
        track(9.0, 0.0, size=(13.0, 1.0, 1.0)),
    ):  # fmt: skip
        found = critical_object(area, footprint, config, uncovered_areas, coming)
        assert (found.label, found.id) == (ObstacleClass.PERSON, 7)
    assert critical_object(area, footprint, config, coming, replace(coming, id=8)).id == 7  # of equals the first


def test_prediction_steps(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    leaving = track(7.0, 3.0, vy=3.0)
    assert critical_object(area, footprint, config, leaving) != NO_CRITICAL_OBJECT
    crossing = track(7.0, 10.0, vy=-7.0)
    assert critical_object(area, footprint, config, crossing) != NO_CRITICAL_OBJECT
    assert critical_object(area, footprint, config, crossing, steps=2) == NO_CRITICAL_OBJECT


def test_fragment_parent_length(area: SweptArea, footprint: Footprint, config: SafetyConfig) -> None:
    piece = track(9.5, 4.2, vy=-1.5, size=(0.4, 0.1, 0.5))
    for length in around(config.tracked.fragment_parent_m, 0.01):
        post = track(9.5, 4.4, size=(length, 0.5, 1.0), label=ObstacleClass.UNKNOWN, id=2)
        assert (critical_object(area, footprint, config, post, piece) == NO_CRITICAL_OBJECT) == (
            length >= config.tracked.fragment_parent_m
        ), length


def test_own_trailer_in_curve(vehicle: Vehicle, config: SafetyConfig) -> None:
    footprint, s = footprint_of(vehicle, WAGON), spaced(14.0, 0.4)
    area = sweep_along(footprint, 1, s, arc_poses(0.1, 1, s), 0.1, config.field, True)
    for x, counts in ((-3.0, False), (9.0, True)):
        moving = track(x, -0.8 if x < 0.0 else 3.0, vx=2.5, size=(0.4, 0.4, 1.0))
        found = nearest_ahead(area, footprint, Tracks(START_NS, (moving,)), 4.0, config.tracked, curvature=0.1)
        assert (found != NO_CRITICAL_OBJECT) == counts, x


SHAPES: list[Footprint] = []


def moving_track(x: float, y: float, vx: float = 0.0, vy: float = 0.0, sigma: float = 0.1, label=ObstacleClass.PERSON,
          size=(0.5, 0.5, 1.7), is_confirmed: bool = True) -> Track:  # fmt: skip
    covariance = np.diag([0.01, 0.01, sigma**2, sigma**2])
    return Track(1, label, 0.9, np.array([x, y, 0.8]), np.array([vx, vy, 0.0]), covariance, np.array(size), 0.0,
                 START_NS - 10**9, START_NS, is_confirmed, ("lidar/front",))  # fmt: skip


@pytest.fixture
def sweep(vehicle: Vehicle, implement, config: SafetyConfig) -> SweptArea:
    s = spaced(14.0, 0.4)
    SHAPES[:] = [footprint_of(vehicle, implement)]
    return sweep_along(SHAPES[0], 1, s, arc_poses(0.0, 1, s), 0.0, config.field, True)


def clearance(sweep: SweptArea, config: SafetyConfig, *tracks: Track, stop_s: float = 2.0) -> float:
    return nearest_ahead(sweep, SHAPES[0], Tracks(START_NS, tracks), stop_s, config.tracked).clearance_m


def test_crossing_track(sweep: SweptArea, config: SafetyConfig) -> None:
    assert clearance(sweep, config, moving_track(10.0, 5.0, vy=-1.4)) == pytest.approx(6.5, abs=0.8)
    assert math.isinf(clearance(sweep, config, moving_track(10.0, 5.0, vy=1.4)))
    assert math.isinf(clearance(sweep, config, moving_track(10.0, 5.0)))
    assert math.isinf(clearance(sweep, config, moving_track(10.0, 8.0, vy=-1.0)))
    assert clearance(sweep, config, moving_track(10.0, 8.0, vy=-1.0), stop_s=4.5) < 8.0


def test_receding_track(sweep: SweptArea, config: SafetyConfig) -> None:
    assert math.isinf(clearance(sweep, config, moving_track(10.0, 4.5, vx=1.4)))
    assert math.isinf(clearance(sweep, config, moving_track(-8.0, 0.0, vx=-1.4)))
    assert math.isinf(clearance(sweep, config, moving_track(10.0, 5.0, vy=-0.3)))


def test_track_beside_is_left_to_the_bystanders(sweep: SweptArea, config: SafetyConfig) -> None:
    foremost_m = SHAPES[0].foremost_m(1)
    for x in around(foremost_m - 0.05, 0.02):
        walker = moving_track(x + 1e-9, 3.4, vy=-1.5, size=(0.1, 0.1, 1.0))
        assert math.isfinite(clearance(sweep, config, walker)) == (x >= foremost_m - 0.05 - 1e-9), x
    assert math.isinf(clearance(sweep, config, moving_track(-2.6, 0.9, vx=2.3, sigma=0.7)))


def test_approaching_track_clearance(sweep: SweptArea, config: SafetyConfig) -> None:
    standing, coming = (clearance(sweep, config, moving_track(10.0, 0.0, vx=v)) for v in (0.0, -1.4))
    assert standing == pytest.approx(6.25, abs=0.1)
    assert coming == pytest.approx(10 - 3.5 - 2.8 - 0.25 - 0.3 - 0.2, abs=0.2)


def test_static_track_by_class(sweep: SweptArea, config: SafetyConfig) -> None:
    for label in ObstacleClass:
        assert math.isinf(clearance(sweep, config, moving_track(9.0, 0.0, label=label))) == (
            label in (ObstacleClass.UNKNOWN, ObstacleClass.AIRBORNE)
        )
    assert math.isinf(clearance(sweep, config, moving_track(9.0, 0.0, is_confirmed=False)))
    assert math.isinf(clearance(sweep, config, moving_track(math.nan, 0.0)))
    assert clearance(sweep, config, moving_track(9.0, 0.0), moving_track(7.0, 0.0)) == pytest.approx(3.25, abs=0.1)
    turned = replace(moving_track(10.0, 4.5, size=(4.0, 1.0, 1.5), label=ObstacleClass.VEHICLE), yaw_rad=math.pi / 2)
    assert math.isfinite(clearance(sweep, config, turned))
    assert math.isinf(clearance(sweep, config, replace(turned, yaw_rad=0.0, p_odom_m=np.array([10.0, 5.0, 0.5]))))


def test_what_floats_is_left_to_the_raw_field(sweep: SweptArea, config: SafetyConfig) -> None:
    for label in (ObstacleClass.AIRBORNE, ObstacleClass.PERSON):
        found = clearance(sweep, config, moving_track(9.0, -3.0, vy=4.0, label=label))
        assert math.isinf(found) == (label is ObstacleClass.AIRBORNE)


def test_no_tracks(sweep: SweptArea, config: SafetyConfig) -> None:
    assert nearest_ahead(sweep, SHAPES[0], None, 2.0, config.tracked) == NO_CRITICAL_OBJECT


def test_fragment_of_static_track(sweep: SweptArea, config: SafetyConfig) -> None:
    car = moving_track(9.0, 5.0, size=(4.0, 1.8, 1.6), label=ObstacleClass.VEHICLE)
    piece = moving_track(9.5, 4.2, vy=-1.5, size=(0.4, 0.1, 0.5), label=ObstacleClass.PERSON)
    assert math.isfinite(clearance(sweep, config, replace(piece, id=8)))
    assert math.isinf(clearance(sweep, config, car, replace(piece, id=8)))
    walker = replace(piece, id=8, p_odom_m=np.array([9.5, 3.5, 0.9]))
    assert math.isfinite(clearance(sweep, config, car, walker))


def test_static_track_length_limit(sweep: SweptArea, config: SafetyConfig) -> None:
    for long in (3.0, 11.9, 12.0, 12.1, 17.0):
        geofence = moving_track(8.0, 0.0, label=ObstacleClass.VEHICLE, size=(long, 1.5, 1.5))
        critical_object = nearest_ahead(sweep, SHAPES[0], Tracks(START_NS, (geofence,)), 4.0, config.tracked)
        assert (critical_object != NO_CRITICAL_OBJECT) == (long <= config.tracked.max_static_length_m), long
    for broad in (2.0, 2.9, 3.1, 4.0):
        cars = moving_track(8.0, 0.0, label=ObstacleClass.VEHICLE, size=(5.0, broad, 1.5))
        critical_object = nearest_ahead(sweep, SHAPES[0], Tracks(START_NS, (cars,)), 4.0, config.tracked)
        assert (critical_object != NO_CRITICAL_OBJECT) == (broad <= config.tracked.max_static_width_m), broad


def test_coasting_unclassified_track(sweep: SweptArea, config: SafetyConfig) -> None:
    for label, unseen_ms in itertools.product((ObstacleClass.UNKNOWN, ObstacleClass.PERSON), (0, 240, 250, 260, 900)):
        crossing = moving_track(7.0, 3.0, vy=-1.5, label=label)
        tracks = Tracks(crossing.last_seen_ns + unseen_ms * 1_000_000, (crossing,))
        critical_object = nearest_ahead(sweep, SHAPES[0], tracks, 4.0, config.tracked)
        counts = label is ObstacleClass.PERSON or unseen_ms <= 250
        assert (critical_object != NO_CRITICAL_OBJECT) == counts, (label, unseen_ms)


def test_moving_thresholds(config: SafetyConfig) -> None:
    for speed in around(0.4, 0.01):
        assert is_moving(moving_track(0, 0, vx=speed), config.tracked) == (speed >= 0.4), speed
    greatest = 1.0 / config.tracked.moving_sigmas
    for sigma in around(greatest, 0.01):
        assert is_moving(moving_track(0, 0, vx=1.0, sigma=sigma), config.tracked) == (sigma <= greatest + 1e-12), sigma
    for speed in around(config.tracked.long_moving_mps, 0.01):
        car = moving_track(0, 0, vx=speed, label=ObstacleClass.VEHICLE)
        assert is_moving(car, config.tracked) == (speed >= config.tracked.long_moving_mps), speed
    assert not is_moving(moving_track(0, 0, vx=math.nan), config.tracked)
    for speed in (1.0, 2.9, 3.0, 3.1, 7.0):
        pole = replace(moving_track(0, 0, vx=speed), label=ObstacleClass.POLE)
        assert is_moving(pole, config.tracked) == (speed <= config.tracked.max_static_class_speed_mps), speed
        assert is_moving(replace(pole, label=ObstacleClass.PERSON), config.tracked)
    for age_ms in around(500, 1):
        young = replace(moving_track(0, 0, vx=1.0), first_seen_ns=START_NS - round(age_ms * 1e6))
        assert is_moving(young, config.tracked) == (age_ms >= 500), age_ms
    for size in around(2.0, 0.01):
        hedge = moving_track(0, 0, vx=1.0, size=(0.2, size, 1.0), label=ObstacleClass.UNKNOWN)
        assert is_moving(hedge, config.tracked) == (size <= 2.0), size
        assert is_moving(replace(hedge, label=ObstacleClass.VEHICLE), config.tracked)


def test_larger_moving_track_is_no_fragment(sweep: SweptArea, config: SafetyConfig) -> None:
    stands = replace(moving_track(10.0, 5.2, label=ObstacleClass.UNKNOWN, size=(1.6, 1.6, 1.5)), id=2)
    comes = moving_track(10.0, 5.0, vy=-1.8, label=ObstacleClass.VEHICLE, size=(3.0, 1.7, 1.5))
    assert clearance(sweep, config, stands, comes) < 9.0

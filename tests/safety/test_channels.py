"""Tracked obstacles, geofence, and the arithmetic of the command."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from configs.site import Area, Bay, DatumConfig, Gate, Lane, PoseConfig, Shed, Site
from configs.vehicle import FOLDED, Vehicle
from geometry.pose2 import from_frame, point_from_frame, to_frame
from geometry.transforms import planar
from messages.command import ControlCommand
from messages.motion import MapPose, Odometry, PositionSource
from messages.perception import ObstacleClass, Track, Tracks
from safety.collision_monitor import class_at
from safety.config import SafetyConfig
from safety.monitors.vehicle import direction_of, is_forced, position_sigma_m
from safety.output.limiters import (
    braking_demand,
    curve_deceleration,
    limit_acceleration,
    limit_curvature,
    limit_jerk,
    stopping_deceleration,
    target_speed,
)
from safety.pose_history import PoseHistory, tilt_of, valid_map_pose, valid_odometry
from safety.stopping_distance import Braking
from safety.zones.footprint import Box, Footprint, bounding_box, fold_of, footprint_of, footprints_of, is_between
from safety.zones.geofence import (
    Geofence,
    Ring,
    band,
    bay_rings,
    distance_across,
    distance_inside_m,
    geofence_of,
    is_within,
    lane_rings,
)
from safety.zones.swept_area import SweptArea, arc_poses, spaced, sweep_along
from safety.zones.tracked_obstacles import NO_CRITICAL_OBJECT, is_moving, nearest_critical_object
from tests.safety.safety_world import START_NS, around, straight_path

from tests.safety.safety_world import machine_state  # isort: skip

NOMINAL = Braking(0.6, 0.4, 2.5)
HERE = np.zeros(3)
SHAPES: list[Footprint] = []


def track(x: float, y: float, vx: float = 0.0, vy: float = 0.0, sigma: float = 0.1, label=ObstacleClass.PERSON,
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
    return nearest_critical_object(
        sweep, SHAPES[0], Tracks(START_NS, tracks), HERE, 0.0, stop_s, config.tracked
    ).clearance_m


def test_who_will_step_into_the_way_counts(sweep: SweptArea, config: SafetyConfig) -> None:
    assert clearance(sweep, config, track(10.0, 5.0, vy=-1.4)) == pytest.approx(6.5, abs=0.8)
    assert math.isinf(clearance(sweep, config, track(10.0, 5.0, vy=1.4)))
    assert math.isinf(clearance(sweep, config, track(10.0, 5.0)))
    assert math.isinf(clearance(sweep, config, track(10.0, 8.0, vy=-1.0)))
    assert clearance(sweep, config, track(10.0, 8.0, vy=-1.0), stop_s=4.5) < 8.0


def test_who_goes_along_or_away_does_not(sweep: SweptArea, config: SafetyConfig) -> None:
    assert math.isinf(clearance(sweep, config, track(10.0, 4.5, vx=1.4)))
    assert math.isinf(clearance(sweep, config, track(-8.0, 0.0, vx=-1.4)))
    assert math.isinf(clearance(sweep, config, track(10.0, 5.0, vy=-0.3)))


def test_the_own_implement_and_what_follows_do_not_count(sweep: SweptArea, config: SafetyConfig) -> None:
    for x in around(-1.1, 0.02):
        beside = track(x - 0.05 + 1e-6, 4.2, vx=0.5, vy=-1.5, size=(0.1, 0.1, 1.0))
        assert math.isfinite(clearance(sweep, config, beside)) == (x >= -1.1 - 1e-9), x
    assert math.isinf(clearance(sweep, config, track(1.0, 4.2, vy=-1.5, label=ObstacleClass.UNKNOWN)))
    assert math.isfinite(clearance(sweep, config, track(4.0, 4.2, vy=-1.5, label=ObstacleClass.UNKNOWN)))
    assert math.isinf(clearance(sweep, config, track(-2.6, 0.9, vx=2.3, sigma=0.7)))
    for y in around(3.45, 0.02):
        near = track(-1.1, y + 1e-6, vx=1.0, vy=-1.5, size=(0.1, 0.1, 0.1))
        assert math.isfinite(clearance(sweep, config, near)) == (y >= 3.45 - 1e-9), y


def test_who_comes_towards_the_machine_is_nearer_than_he_stands(sweep: SweptArea, config: SafetyConfig) -> None:
    standing, coming = (clearance(sweep, config, track(10.0, 0.0, vx=v)) for v in (0.0, -1.4))
    assert standing == pytest.approx(6.25, abs=0.1)
    assert coming == pytest.approx(10 - 3.5 - 2.8 - 0.25 - 0.3 - 0.2, abs=0.2)


def test_what_stands_counts_by_its_class(sweep: SweptArea, config: SafetyConfig) -> None:
    for label in ObstacleClass:
        assert math.isinf(clearance(sweep, config, track(9.0, 0.0, label=label))) == (label is ObstacleClass.UNKNOWN)
    assert math.isinf(clearance(sweep, config, track(9.0, 0.0, is_confirmed=False)))
    assert math.isinf(clearance(sweep, config, track(math.nan, 0.0)))
    assert clearance(sweep, config, track(9.0, 0.0), track(7.0, 0.0)) == pytest.approx(3.25, abs=0.1)
    turned = replace(track(10.0, 4.5, size=(4.0, 1.0, 1.5), label=ObstacleClass.VEHICLE), yaw_rad=math.pi / 2)
    assert math.isfinite(clearance(sweep, config, turned))
    assert math.isinf(clearance(sweep, config, replace(turned, yaw_rad=0.0, p_odom_m=np.array([10.0, 5.0, 0.5]))))


def test_no_tracks_no_threat(sweep: SweptArea, config: SafetyConfig) -> None:
    assert nearest_critical_object(sweep, SHAPES[0], None, HERE, 0.0, 2.0, config.tracked) == NO_CRITICAL_OBJECT


def test_a_piece_of_what_stands_does_not_move(sweep: SweptArea, config: SafetyConfig) -> None:
    car = track(9.0, 5.0, size=(4.0, 1.8, 1.6), label=ObstacleClass.VEHICLE)
    piece = track(9.5, 4.2, vy=-1.5, size=(0.4, 0.1, 0.5), label=ObstacleClass.PERSON)
    assert math.isfinite(clearance(sweep, config, replace(piece, id=8)))
    assert math.isinf(clearance(sweep, config, car, replace(piece, id=8)))
    walker = replace(piece, id=8, p_odom_m=np.array([9.5, 3.5, 0.9]))
    assert math.isfinite(clearance(sweep, config, car, walker))


def test_a_standing_box_longer_than_any_machine_is_left_to_the_raw_field(
    sweep: SweptArea, config: SafetyConfig
) -> None:
    for long in (3.0, 11.9, 12.0, 12.1, 17.0):
        geofence = track(8.0, 0.0, label=ObstacleClass.VEHICLE, size=(long, 1.5, 1.5))
        critical_object = nearest_critical_object(
            sweep, SHAPES[0], Tracks(START_NS, (geofence,)), np.zeros(3), 0.0, 4.0, config.tracked
        )
        assert (critical_object != NO_CRITICAL_OBJECT) == (long <= config.tracked.max_static_length_m), long


def test_what_has_no_class_must_be_seen_to_count_as_moving(sweep: SweptArea, config: SafetyConfig) -> None:
    for label, unseen_ms in itertools.product((ObstacleClass.UNKNOWN, ObstacleClass.PERSON), (0, 240, 250, 260, 900)):
        crossing = track(7.0, 3.0, vy=-1.5, label=label)
        tracks = Tracks(crossing.last_seen_ns + unseen_ms * 1_000_000, (crossing,))
        critical_object = nearest_critical_object(sweep, SHAPES[0], tracks, np.zeros(3), 0.0, 4.0, config.tracked)
        counts = label is ObstacleClass.PERSON or unseen_ms <= 250
        assert (critical_object != NO_CRITICAL_OBJECT) == counts, (label, unseen_ms)


def test_moving_needs_speed_and_certainty(config: SafetyConfig) -> None:
    for speed in around(0.4, 0.01):
        assert is_moving(track(0, 0, vx=speed), config.tracked) == (speed >= 0.4), speed
    greatest = 1.0 / config.tracked.moving_sigmas
    for sigma in around(greatest, 0.01):
        assert is_moving(track(0, 0, vx=1.0, sigma=sigma), config.tracked) == (sigma <= greatest + 1e-12), sigma
    for speed in around(config.tracked.long_moving_mps, 0.01):
        car = track(0, 0, vx=speed, label=ObstacleClass.VEHICLE)
        assert is_moving(car, config.tracked) == (speed >= config.tracked.long_moving_mps), speed
    assert not is_moving(track(0, 0, vx=math.nan), config.tracked)
    for speed in (1.0, 2.9, 3.0, 3.1, 7.0):
        pole = replace(track(0, 0, vx=speed), label=ObstacleClass.POLE)
        assert is_moving(pole, config.tracked) == (speed <= config.tracked.max_static_class_speed_mps), speed
        assert is_moving(replace(pole, label=ObstacleClass.PERSON), config.tracked)
    for age_ms in around(500, 1):
        young = replace(track(0, 0, vx=1.0), first_seen_ns=START_NS - round(age_ms * 1e6))
        assert is_moving(young, config.tracked) == (age_ms >= 500), age_ms
    for size in around(2.0, 0.01):
        hedge = track(0, 0, vx=1.0, size=(0.2, size, 1.0), label=ObstacleClass.UNKNOWN)
        assert is_moving(hedge, config.tracked) == (size <= 2.0), size
        assert is_moving(replace(hedge, label=ObstacleClass.VEHICLE), config.tracked)


def test_class_of_the_cause() -> None:
    tracks = Tracks(START_NS, (track(9.0, 0.0, label=ObstacleClass.ANIMAL), track(5.0, 0.0, is_confirmed=False)))
    assert class_at(np.array([[8.8, 0.1]]), tracks) is ObstacleClass.ANIMAL
    assert class_at(np.array([[5.0, 0.1]]), tracks) is ObstacleClass.UNKNOWN


L_SHAPE = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 4.0), (4.0, 4.0), (4.0, 10.0), (0.0, 10.0)])


def test_point_in_polygon() -> None:
    for x in around(4.0, 0.01):
        assert is_within(np.array([[x, 7.0]]), L_SHAPE)[0] == (x < 4.0), x
        assert is_within(np.array([[7.0, x]]), L_SHAPE)[0] == (x < 4.0), x
        assert is_within(np.array([[x, 7.0]]), L_SHAPE[::-1])[0] == (x < 4.0), x
    grid = np.stack(np.meshgrid(np.arange(-0.95, 11.0, 0.5), np.arange(-0.95, 11.0, 0.5)), -1).reshape(-1, 2)
    inside = (grid > 0).all(1) & (grid < 10).all(1) & ~((grid > 4).all(1))
    assert np.array_equal(is_within(grid, L_SHAPE), inside)
    diamond = np.array([(0.0, -5.0), (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0)])
    assert is_within(np.array([[0.0, 0.0], [6.0, 0.0]]), diamond).tolist() == [True, False]  # at the height of corners
    for y in around(3.0, 0.01):
        assert is_within(np.array([[4.0, y]]), np.array([(0.0, 0.0), (10.0, 0.0), (0.0, 5.0)]))[0] == (y < 3.0), y
    assert Geofence((L_SHAPE,)).contains(np.array([[1.0, 1.0]])).tolist() == [True]
    assert Geofence((L_SHAPE,)).contains(np.empty((0, 2))).tolist() == []


def test_a_ring_may_be_left_out_a_millionth_of_a_metre_beside_it() -> None:
    ring = Ring(L_SHAPE)
    for away, may_intersect in ((0.0, True), (0.9e-6, True), (1.1e-6, False)):
        for x, y in (((10.0 + away, 11.0), (1.0, 2.0)), ((-1.0, -away), (1.0, 2.0)),
                     ((1.0, 2.0), (10.0 + away, 11.0)), ((1.0, 2.0), (-1.0, -away))):  # fmt: skip
            assert ring.may_intersect(Box(x, y)) == may_intersect, (x, y)
            assert ring.has_side_in(Box(x, y)) == (away == 0.0), (x, y)
    assert not ring.has_side_in(Box((1.0, 2.0), (1.0, 2.0)))


@pytest.fixture
def site() -> Site:
    return Site(
        name="s", version=1, datum=DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=100.0),
        boundary_m=((0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (0.0, 50.0)),
        no_go=(Area(name="pond", outline_m=((20.0, 20.0), (25.0, 20.0), (25.0, 25.0))),),
        lanes=(Lane(name="lane", center_m=((-30.0, -20.0), (10.0, -20.0), (10.0, 0.0)), width_m=8.0),),
        gates=(Gate(name="gate", posts_m=((6.0, 0.0), (14.0, 0.0))),),
        yard=Area(name="yard", outline_m=((-60.0, -40.0), (-30.0, -40.0), (-30.0, 0.0), (-60.0, 0.0))),
        start=PoseConfig(x_m=-45.0, y_m=-20.0, heading_deg=0.0), is_fenced=True,
        shed=Shed(
            name="shed", height_m=4.0, outline_m=((-80.0, -40.0), (-60.0, -40.0), (-60.0, -20.0), (-80.0, -20.0))
        ),
    )  # fmt: skip


def test_fence_of_a_site(site: Site) -> None:
    geofence = geofence_of(site)
    inside = [(5, 5), (-45, -20), (-29.9, -20), (-30.0, -20), (10, -1), (10, 0), (10, 0.9), (13, -22)]
    outside = [(22, 21), (-10, -10), (51, 10), (10, -25), (15, -23), (-61, -10), (-70, -30)]
    assert geofence.contains(np.array(inside, float)).all()
    assert not geofence.contains(np.array(outside, float)).any()
    assert not geofence_of(site.model_copy(update={"shed": None})).contains(np.array([[-70.0, -30.0]])).any()


def corners_of(box: Box) -> tuple[float, ...]:
    return (*box.x_m, *box.y_m)


def test_rings_of_a_lane_overlap_in_its_bends_and_at_its_ends() -> None:
    lane = Lane(name="lane", center_m=((0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (10.5, 6.0)), width_m=4.0)
    boxes = [corners_of(bounding_box(ring)) for ring in lane_rings(lane)]
    expected = [(-1.0, 12.0, -2.0, 2.0), (8.0, 12.0, -2.0, 8.0), (8.0, 11.5, 4.0, 8.0)]
    assert np.array(boxes) == pytest.approx(np.array(expected))
    (alone,) = lane_rings(lane.model_copy(update={"center_m": ((0.0, 0.0), (10.0, 0.0))}))
    assert corners_of(bounding_box(alone)) == pytest.approx((-1.0, 11.0, -2.0, 2.0))


def test_band_about_a_short_line() -> None:
    ring = band(np.array([(0.0, 0.0), (0.3, 0.4)]), 1.0)
    assert ring == pytest.approx(np.array([(-0.8, 0.6), (0.8, -0.6), (1.1, -0.2), (-0.5, 1.0)]))


def test_rings_of_a_bay() -> None:
    bay = Bay(name="bay", dock=PoseConfig(x_m=5.0, y_m=3.0, heading_deg=90.0), width_m=3.0)
    shed = Shed(name="shed", height_m=4.0, outline_m=((0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (0.0, 8.0)), bays=(bay,))
    within, apron = (corners_of(bounding_box(ring)) for ring in bay_rings(shed, bay))
    assert within == pytest.approx((3.5, 6.5, 0.075, 8.0))
    assert apron == pytest.approx((1.5, 8.5, 7.9, 12.0))


@pytest.mark.parametrize("size", [1.0, 0.05])
def test_way_across_leads_to_the_first_side(size: float) -> None:
    ring, start = size * L_SHAPE, size * np.array([2.0, 3.0])
    for angle in np.arange(0.01, 2 * math.pi, 0.07):
        ahead = np.array([math.cos(angle), math.sin(angle)])
        way = distance_across(start, ahead, ring)
        assert is_within(start + np.linspace(0.0, way - 1e-6, 200)[:, None] * ahead, ring).all(), angle
        assert not is_within((start + (way + 1e-6) * ahead)[None], ring)[0], angle
    assert distance_across(start, np.array([1.0, 0.0]), ring) == pytest.approx(8.0 * size)


def test_way_inside() -> None:
    geofence = Geofence((L_SHAPE,))
    points = np.array([(x, 2.0) for x in np.arange(5.0, 15.0, 0.5)])
    ways = np.arange(0.0, 10.0, 0.5)
    assert distance_inside_m(geofence, points, ways, 0.5) == pytest.approx(4.5)
    assert distance_inside_m(geofence, points[:5], ways[:5], 0.5) == math.inf
    assert distance_inside_m(geofence, points[-5:], ways[:5], 0.5) == -1.0
    assert distance_inside_m(geofence, points[-5:], ways[1:6], 1.0) == 0.0


def control_command(speed: float = 2.0, acceleration: float = 0.0, curvature: float = 0.0) -> ControlCommand:
    return ControlCommand(START_NS, speed, acceleration, curvature, True, True, 1, 0.0, 0.0, 0.0, False)


def test_target_speed() -> None:
    assert target_speed(None, 5.0, 0.0, 0.1) == 0.0
    assert target_speed(control_command(math.nan), 5.0, 0.0, 0.1) == 0.0
    assert target_speed(control_command(2.0), 5.0, 0.0, 0.1) == 2.0
    assert target_speed(control_command(-2.0), 1.0, 0.0, 0.1) == -1.0
    assert target_speed(control_command(-2.0), 1.0, 1.0, 0.1) == 0.0
    assert target_speed(control_command(0.03), 5.0, 0.0, 0.1) == 0.03  # control's own last centimetres
    assert math.copysign(1.0, target_speed(control_command(0.0), 5.0, 0.0, 0.1)) == 1.0
    assert target_speed(control_command(2.0), 5.0, 1.0, 0.1) == 2.0
    assert target_speed(control_command(0.4), 5.0, 1.0, 0.1) == 0.4
    assert target_speed(control_command(-2.0), 1.0, 0.2, 0.1) == -1.0  # creeping, it may turn round
    assert target_speed(control_command(-2.0), 1.0, 0.21, 0.1) == 0.0
    for allowed in around(0.1, 0.01):
        assert (target_speed(control_command(2.0), allowed, 0.0, 0.1) > 0.0) == (allowed >= 0.1), allowed


def test_rising_is_limited_and_falling_is_not() -> None:
    assert limit_acceleration(2.0, 1.0, 1.0, 0.1) == pytest.approx(1.1)
    assert limit_acceleration(-2.0, -1.0, -1.0, 0.1) == pytest.approx(-1.1)
    assert limit_acceleration(0.5, 1.0, 1.0, 0.1) == 0.5
    assert limit_acceleration(0.0, 1.0, 1.0, 0.1) == 0.0
    assert limit_acceleration(2.0, 0.0, 1.5, 0.1) == pytest.approx(1.6)
    assert limit_acceleration(2.0, -1.0, -1.0, 0.1) == pytest.approx(0.1)
    assert limit_acceleration(2.0, 1.0, 0.0, 0.1) == pytest.approx(1.1)  # of a machine that is slow to follow
    assert limit_acceleration(1.0, 1.0, 1.0, 0.1) == 1.0


def test_slowing(config: SafetyConfig) -> None:
    braking = config.braking
    assert braking_demand(control_command(), 3.0, 2.0, math.inf, NOMINAL, braking) == 0.0
    assert braking_demand(control_command(acceleration=-0.7), 3.0, 2.0, math.inf, NOMINAL, braking) == 0.7
    assert braking_demand(control_command(acceleration=math.nan), 3.0, 2.0, math.inf, NOMINAL, braking) == 0.0
    assert braking_demand(None, 3.0, 2.0, math.inf, NOMINAL, braking) == 0.0
    assert (
        braking_demand(control_command(acceleration=-99.0), 3.0, 2.0, math.inf, NOMINAL, braking) == braking.full_mps2
    )
    for over in around(0.05, 0.01):
        asked = braking_demand(control_command(), 2.0, 2.0 + over, math.inf, NOMINAL, braking)
        assert (asked > 0.0) == (over > 0.05 + 1e-9), over
    assert braking_demand(control_command(), 0.0, 3.0, 1.5, NOMINAL, braking) == braking.full_mps2
    assert braking_demand(control_command(), 0.0, 0.05, math.inf, NOMINAL, braking) == 0.0
    assert braking_demand(control_command(), 2.0, 2.2, 20.0, NOMINAL, braking) < 2.0
    by_curve = curve_deceleration(2.2, NOMINAL)
    assert braking_demand(control_command(), 2.0, 2.2, math.inf, NOMINAL, braking) == pytest.approx(
        by_curve + 0.4
    )  # gone in 0.5 s


def test_slowing_along_the_curve() -> None:
    assert curve_deceleration(2.0, NOMINAL) == pytest.approx(2.0 / (0.6 + 0.2 + 0.8))
    assert curve_deceleration(2.0, Braking(0.6, 0.5, 0.8)) == pytest.approx(2.0 / (0.6 + 0.25 + 2.5))
    assert curve_deceleration(2.0, Braking(0.6, 0.4, 0.0)) == 0.0


def test_stopping_and_easing(config: SafetyConfig) -> None:
    assert stopping_deceleration(2.0, math.inf, config.braking) == config.braking.controlled_mps2
    assert stopping_deceleration(3.0, 2.0, config.braking) == pytest.approx(9.0 / 2.0 / 1.1)
    assert limit_jerk(1.0, 0.0, 1.5, 0.06) == 0.06
    assert limit_jerk(1.5, 0.0, 1.5, 0.06) == 0.06
    assert limit_jerk(1.6, 0.0, 1.5, 0.06) == 1.6
    assert limit_jerk(0.2, 1.0, 1.5, 0.06) == 0.2


def test_steered() -> None:
    assert limit_curvature(None, 0.1, 0.2, 0.01) == 0.1
    assert limit_curvature(control_command(curvature=math.nan), 0.1, 0.2, 0.01) == 0.1
    assert limit_curvature(control_command(curvature=9.0), 0.1, 0.2, 1.0) == 0.2
    assert limit_curvature(control_command(curvature=-9.0), 0.1, 0.2, 0.01) == pytest.approx(0.09)


def test_direction() -> None:
    back = straight_path(direction=-1)
    assert direction_of(0.5, back, None, -1) == 1
    assert direction_of(-0.5, None, None, 1) == -1
    assert direction_of(0.05, back, control_command(2.0), 1) == -1
    assert direction_of(None, straight_path(), None, -1) == 1
    assert direction_of(0.0, None, control_command(-1.0), 1) == -1
    assert direction_of(0.0, None, control_command(1.0), -1) == 1
    assert direction_of(0.0, None, control_command(0.0), -1) == -1
    assert direction_of(0.0, None, None, -1) == -1


def test_hand_force_and_sigma() -> None:
    for torque in around(2.0, 0.1):
        assert is_forced(machine_state(0, driver_torque_nm=-torque), 2.0) == (torque >= 2.0 - 1e-12), torque
    assert is_forced(machine_state(0, driver_torque_nm=math.nan), 2.0)
    assert not is_forced(None, 2.0)
    assert position_sigma_m(None) == 0.0


def test_box_that_the_fence_holds() -> None:
    geofence = Geofence((L_SHAPE,), (np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]]),))
    for x in np.arange(-2.0, 12.0, 0.37):
        for y in np.arange(-2.0, 12.0, 0.41):
            corners = np.array([[x, y], [x + 0.5, y], [x, y + 0.9], [x + 0.5, y + 0.9]])
            if geofence.contains_box(Box((x, x + 0.5), (y, y + 0.9))):
                assert geofence.contains(corners).all(), (x, y)
    assert geofence.contains_box(Box((2.1, 2.6), (2.1, 3.0)))
    assert not geofence.contains_box(Box((1.4, 1.6), (1.4, 1.6)))  # all of it in what is forbidden
    assert not geofence.contains_box(Box((1.9, 2.6), (1.4, 1.6)))
    assert not Geofence(()).contains_box(Box((0.0, 1.0), (0.0, 1.0)))
    gate = np.array([[2.0, 2.0], [2.4, 2.0], [2.4, 4.0], [2.0, 4.0]])  # another ring's side crosses the box
    assert Geofence((gate, L_SHAPE)).contains_box(Box((2.1, 2.6), (2.1, 3.0)))
    assert not Geofence((gate,)).contains_box(Box((2.1, 2.6), (2.1, 3.0)))


def test_box_from_elsewhere_holds_the_box() -> None:
    box, pose = Box((-3.0, 5.0), (-1.0, 2.0)), np.array([3.0, -2.0, 2.3])
    corners = np.array([[x, y] for x in box.x_m for y in box.y_m])
    seen, moved = box.in_parent(pose), to_frame(pose, corners)
    assert (seen.x_m, seen.y_m) == (
        pytest.approx((moved[:, 0].min(), moved[:, 0].max())),
        pytest.approx((moved[:, 1].min(), moved[:, 1].max())),
    )
    assert point_from_frame(pose, 1.5, -4.0) == tuple(from_frame(pose, np.array([[1.5, -4.0]]))[0])


def test_frames_and_trail() -> None:
    pose = np.array([3.0, -2.0, 0.7])
    points = np.array([[1.0, 2.0], [-4.0, 0.5]])
    assert from_frame(pose, to_frame(pose, points)) == pytest.approx(points)
    assert all(math.isnan(angle) or angle == 0.0 for angle in tilt_of(np.full((4, 4), np.nan)))
    for sine in (-1.0 - 1e-9, 1.0 + 1e-9):  # rounded
        upright = np.eye(4)
        upright[2, 0] = sine
        assert tilt_of(upright)[1] == pytest.approx(-math.copysign(math.pi / 2, sine))
    with pytest.raises(ValueError, match="empty"):
        PoseHistory().pose_at(0)


def odometry(stamp_ms: int, x_m: float, y_m: float, **changes: float) -> Odometry:
    T = planar(x_m, y_m, 0.5)
    return replace(Odometry(stamp_ms * 10**6, T, 1.0, 0.0, 0.0, 0.0, 0.0, np.eye(6)), **changes)


def test_the_trail_adds_up_the_way_of_whatever_is_newer() -> None:
    pose_history = PoseHistory()
    assert pose_history.driven_m == 0.0
    for stamp, x, y in ((0, 1.0, 2.0), (500, 4.0, 6.0), (500, 9.0, 9.0), (400, 9.0, 9.0), (1000, 4.0, 5.0)):
        pose_history.add(odometry(stamp, x, y))
    assert pose_history.driven_m == 6.0
    assert tuple(pose_history.pose_at(0)) == pytest.approx((1.0, 2.0, 0.5))
    for stamp, y in ((-100, 2.0), (249, 2.0), (250, 2.0), (251, 6.0), (749, 6.0), (751, 5.0), (2000, 5.0)):
        assert pose_history.pose_at(stamp * 10**6)[1] == y, stamp
    pose_history.add(odometry(1001, 4.0, 5.0))  # what is more than a second old is forgotten
    assert pose_history.pose_at(0)[1] == 6.0


def test_what_is_no_number_is_no_odometry_and_no_pose() -> None:
    good = odometry(0, 1.0, 2.0)
    assert valid_odometry(good) is good
    for name in ("speed_mps", "yaw_rate_radps", "curvature_radpm", "acceleration_mps2"):
        assert valid_odometry(replace(good, **{name: math.nan})) is None, name
    assert valid_odometry(replace(good, T_odom_base=np.full((4, 4), np.nan))) is None
    assert valid_odometry(None) is None
    pose = MapPose(0, np.eye(4), np.eye(4), np.eye(6), PositionSource.RTK_FIXED, math.inf, 0.1, True)
    assert valid_map_pose(pose) is pose
    assert valid_map_pose(replace(pose, T_map_odom=np.full((4, 4), np.nan))) is None
    assert valid_map_pose(None) is None


def test_shapes_of_a_fold(vehicle: Vehicle, implement) -> None:
    footprints = footprints_of(vehicle, implement)
    assert (footprints.working, footprints.transport) == (
        footprint_of(vehicle, implement),
        footprint_of(vehicle, implement.folded),
    )
    assert footprints.is_foldable
    for fold in (None, 0.0, *around(FOLDED, 0.001), 1.0):
        is_narrow = fold is not None and fold >= FOLDED
        assert footprints.at(fold) is (footprints.transport if is_narrow else footprints.working), fold
    stiff = implement.model_copy(update={"fold": None})
    assert not footprints_of(vehicle, stiff).is_foldable
    bare = footprints_of(vehicle, None)
    assert (bare.working, bare.is_foldable) == (footprint_of(vehicle, None), False)


def test_fold_as_old_as_its_group_may_be() -> None:
    for age_ms in around(350, 1):
        machine = machine_state(START_NS, fold_position=0.5, implement_stamp_ns=START_NS - round(age_ms * 1e6))
        assert fold_of(machine, 0.35) == (0.5 if age_ms <= 350 else None), age_ms
    assert fold_of(None, 0.35) is None
    for fold, between in ((1.0 - FOLDED, False), (FOLDED, False), (0.5, True), (0.011, True), (0.989, True)):
        assert is_between(fold) == between, fold


def test_a_larger_thing_that_moves_is_no_piece_of_a_smaller_that_stands(sweep: SweptArea, config: SafetyConfig) -> None:
    stands = replace(track(10.0, 5.2, label=ObstacleClass.UNKNOWN, size=(1.6, 1.6, 1.5)), id=2)
    comes = track(10.0, 5.0, vy=-1.8, label=ObstacleClass.VEHICLE, size=(3.0, 1.7, 1.5))
    assert clearance(sweep, config, stands, comes) < 9.0

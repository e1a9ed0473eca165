"""Geofence: polygons, boxes, and the zones of a site."""

import math
from dataclasses import replace

import numpy as np
import pytest

from configs.site import Area, Bay, DatumConfig, Gate, Lane, PoseConfig, Shed, Site
from configs.vehicle import MountedImplement, Vehicle
from geometry.transforms import planar
from safety.collision_monitor import CollisionMonitor
from safety.config import SafetyConfig
from safety.zones.footprint import Box, bounding_box, footprints_of
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
from tests.safety.safety_world import around
from tests.safety.test_collision_monitor import SEEN, odometry, pose

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


def test_ring_rejection_tolerance() -> None:
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


def test_geofence_of_site(site: Site) -> None:
    geofence = geofence_of(site)
    inside = [(5, 5), (-45, -20), (-29.9, -20), (-30.0, -20), (10, -1), (10, 0), (10, 0.9), (13, -22)]
    outside = [(22, 21), (-10, -10), (51, 10), (10, -25), (15, -23), (-61, -10), (-70, -30)]
    assert geofence.contains(np.array(inside, float)).all()
    assert not geofence.contains(np.array(outside, float)).any()
    assert geofence.posts.tolist() == [[6.0, 0.0], [14.0, 0.0]]
    assert not geofence_of(site.model_copy(update={"shed": None})).contains(np.array([[-70.0, -30.0]])).any()


def corners_of(box: Box) -> tuple[float, ...]:
    return (*box.x_m, *box.y_m)


def test_lane_ring_overlap() -> None:
    lane = Lane(name="lane", center_m=((0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (10.5, 6.0)), width_m=4.0)
    boxes = [corners_of(bounding_box(ring)) for ring in lane_rings(lane)]
    expected = [(-1.0, 12.0, -2.0, 2.0), (8.0, 12.0, -2.0, 8.0), (8.0, 11.5, 4.0, 8.0)]
    assert np.array(boxes) == pytest.approx(np.array(expected))
    (alone,) = lane_rings(lane.model_copy(update={"center_m": ((0.0, 0.0), (10.0, 0.0))}))
    assert corners_of(bounding_box(alone)) == pytest.approx((-1.0, 11.0, -2.0, 2.0))


def test_band_of_short_line() -> None:
    ring = band(np.array([(0.0, 0.0), (0.3, 0.4)]), 1.0)
    assert ring == pytest.approx(np.array([(-0.8, 0.6), (0.8, -0.6), (1.1, -0.2), (-0.5, 1.0)]))


def test_bay_rings() -> None:
    bay = Bay(name="bay", dock=PoseConfig(x_m=5.0, y_m=3.0, heading_deg=90.0), width_m=3.0)
    shed = Shed(name="shed", height_m=4.0, outline_m=((0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (0.0, 8.0)), bays=(bay,))
    within, apron = (corners_of(bounding_box(ring)) for ring in bay_rings(shed, bay))
    assert within == pytest.approx((3.5, 6.5, 0.075, 8.0))
    assert apron == pytest.approx((1.5, 8.5, 7.9, 12.0))


@pytest.mark.parametrize("size", [1.0, 0.05])
def test_distance_across_first_side(size: float) -> None:
    ring, start = size * L_SHAPE, size * np.array([2.0, 3.0])
    for angle in np.arange(0.01, 2 * math.pi, 0.07):
        ahead = np.array([math.cos(angle), math.sin(angle)])
        distance = distance_across(start, ahead, ring)
        assert is_within(start + np.linspace(0.0, distance - 1e-6, 200)[:, None] * ahead, ring).all(), angle
        assert not is_within((start + (distance + 1e-6) * ahead)[None], ring)[0], angle
    assert distance_across(start, np.array([1.0, 0.0]), ring) == pytest.approx(8.0 * size)


def test_distance_inside() -> None:
    geofence = Geofence((L_SHAPE,))
    points = np.array([(x, 2.0) for x in np.arange(5.0, 15.0, 0.5)])
    distances = np.arange(0.0, 10.0, 0.5)
    assert distance_inside_m(geofence, points, distances, 0.5) == pytest.approx(4.5)
    assert distance_inside_m(geofence, points[:5], distances[:5], 0.5) == math.inf
    assert distance_inside_m(geofence, points[-5:], distances[:5], 0.5) == -1.0
    assert distance_inside_m(geofence, points[-5:], distances[1:6], 1.0) == 0.0


def test_geofence_contains_box() -> None:
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


@pytest.mark.parametrize(("left_m", "is_inside"), [(0.0, True), (-0.1, True), (0.1, False), (math.nan, True)])
def test_the_geofence_is_held_on_the_shifted_line(
    full: Vehicle, implement: MountedImplement, config: SafetyConfig, left_m: float, is_inside: bool
) -> None:
    """A machine on its path beside the edge: the distance to where it will be outside on the line that is driven."""
    edge = Geofence((np.array([(-50.0, -50.0), (200.0, -50.0), (200.0, 3.06), (-50.0, 3.06)]),))
    collision_monitor = CollisionMonitor(footprints_of(full, implement), full.sensors, edge, None, config)
    here = replace(odometry(), T_odom_base=planar(3.0, 0.0, 0.0), curvature_radpm=0.0)
    there = replace(pose(), T_map_odom=np.eye(4), T_map_base=planar(3.0, 0.0, 0.0))
    seen = replace(SEEN, odom=here, map_pose=there, line_shift_m=(0.0, left_m))
    collision_monitor.update(seen, 1, 2.0, config.braking.flat, 2.1)
    distance_m, swept_field = collision_monitor.geofence_distance_m(), collision_monitor.swept_field
    assert distance_m is not None
    assert swept_field is not None
    assert math.isinf(distance_m) if is_inside else 0.0 <= distance_m < config.field.blend_m
    assert swept_field.is_planned is not math.isnan(left_m)  # else the arc of the measured steering

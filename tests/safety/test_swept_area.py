"""Swept area: contact against brute force, margins, curves, reverse, trailed implements."""

import itertools
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.vehicle import Vehicle
from geometry.drawbar import Drawbar, steady_angle
from geometry.pose2 import to_frame
from geometry.rectangle import Rectangle
from safety.config import SafetyConfig
from safety.zones.footprint import Footprint, carriers, footprint_of, outline, trailer_poses
from safety.zones.protective_field import box_of, is_at, look_ahead_m, position_on_path, sweep_field
from safety.zones.swept_area import (
    SweptArea,
    arc_poses,
    distance_to_contact_m,
    outline_of,
    outline_points,
    path_poses,
    spaced,
    sweep_along,
    unwrapped,
)
from tests.safety.safety_world import WAGON, around, straight_path

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60)


@pytest.fixture
def footprint(vehicle: Vehicle, implement) -> Footprint:
    return footprint_of(vehicle, implement)


def arc(
    footprint: Footprint,
    config: SafetyConfig,
    curvature: float,
    length: float,
    direction: int = 1,
    foremost: bool = False,
) -> SweptArea:
    s = spaced(length, 0.25)
    return sweep_along(footprint, direction, s, arc_poses(curvature, direction, s), curvature, config.field, foremost)


def test_straight_contact(footprint: Footprint, config: SafetyConfig) -> None:
    area = arc(footprint, config, 0.0, 20.0)
    distances = distance_to_contact_m(np.array([[10.0, 0.0], [10.0, 2.0], [10.0, 4.0], [-3.0, 0.0], [30.0, 0.0]]), area)
    assert distances[:2] == pytest.approx([6.5, 11.1])  # the machine's front at 3.5, the implement's at -1.1
    assert np.all(np.isinf(distances[2:]))


def test_what_is_above_a_body_is_not_touched(footprint: Footprint, config: SafetyConfig) -> None:
    """The raised harrow reaches 1.55 m, the machine 2.9 m, and 0.3 m more count."""
    area = arc(footprint, config, 0.0, 20.0)
    points = np.array([[10.0, 0.0], [10.0, 2.0]])
    for height_m, machine_m, harrow_m in (
        (0.0, 6.5, 11.1),
        (1.84, 6.5, 11.1),
        (1.86, 6.5, math.inf),
        (3.3, math.inf, math.inf),
    ):
        found = distance_to_contact_m(points, area, height_m=np.full(2, height_m))
        assert found == pytest.approx([machine_m, harrow_m]), height_m


def test_distance_from_foremost_point(footprint: Footprint, config: SafetyConfig) -> None:
    area = arc(footprint, config, 0.0, 20.0, foremost=True)
    distances = distance_to_contact_m(np.array([[10.0, 0.0], [10.0, 2.0], [2.0, 2.0]]), area)
    assert distances == pytest.approx([6.5, 6.5, 0.0])


def test_nan_points(footprint: Footprint, config: SafetyConfig) -> None:
    s = spaced(20.0, 0.25)
    poses = arc_poses(0.0, 1, s)
    poses[-1] = np.nan
    area = sweep_along(footprint, 1, s, poses, 0.0, config.field, False)
    distances = distance_to_contact_m(
        np.array([[10.0, 0.0], [np.nan, 0.0], [10.0, 2.0]]), area, np.array([0.0, 0.0, np.nan])
    )
    assert distances[0] == pytest.approx(6.5)
    assert np.all(np.isinf(distances[1:]))


@pytest.mark.parametrize("side", [1, -1])
def test_lateral_boundary(footprint: Footprint, config: SafetyConfig, side: int) -> None:
    area = arc(footprint, config, 0.0, 20.0)
    edge = 3.05 + config.field.lateral_margin_far_m
    for y in around(edge, 0.01):
        is_met = np.isfinite(distance_to_contact_m(np.array([[12.0, side * y]]), area)[0])
        assert is_met == (y <= edge + 1e-9), y


def test_lateral_margin_growth(footprint: Footprint, config: SafetyConfig) -> None:
    area = arc(footprint, config, 0.0, 10.0)
    assert area.lateral_m[0] == config.field.lateral_margin_near_m
    assert area.lateral_m[-1] == config.field.lateral_margin_far_m
    assert np.all(np.diff(area.lateral_m) >= 0.0)


@pytest.mark.parametrize("direction", [1, -1])
def test_leading_edge_in_reverse(footprint: Footprint, config: SafetyConfig, direction: int) -> None:
    area = arc(footprint, config, 0.0, 10.0, direction, foremost=True)
    point = np.array([[6.0, 0.0]]) if direction > 0 else np.array([[-6.0, 0.0]])
    assert distance_to_contact_m(point, area)[0] == pytest.approx(2.5 if direction > 0 else 3.6)
    assert np.isinf(distance_to_contact_m(-point, area)[0])
    assert footprint.foremost_m(direction) == pytest.approx(3.5 if direction > 0 else -2.4)


def test_outline_width(footprint: Footprint, config: SafetyConfig) -> None:
    for direction, lead in ((1, 3.5), (-1, -1.0)):
        area = arc(footprint, config, 0.15, 6.0, direction)
        half = 3.05 + area.lateral_m
        sides = [[(lead, side * width) for width in half] for side in (1, -1)]
        left, right = (
            np.array([to_frame(pose, np.array([p]))[0] for pose, p in zip(area.poses, side, strict=True)])
            for side in sides
        )
        assert outline_of(area) == pytest.approx(np.concatenate([left, right[::-1]])), direction


def test_outline_points(footprint: Footprint, config: SafetyConfig) -> None:
    area = arc(footprint, config, 0.15, 6.0)
    points, distances = outline_points(area, 0.5)
    expected = [to_frame(pose, outline(body)) for body, poses in area.bodies for pose in poses[::2]]
    assert points == pytest.approx(np.concatenate(expected))
    assert distances == pytest.approx(np.concatenate([np.repeat(area.s_m[::2], 8) for _ in area.bodies]))


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("curvature", [0.2, -0.2])
def test_contact_on_outside_of_curve(
    footprint: Footprint, config: SafetyConfig, curvature: float, direction: int
) -> None:
    """The outer end travels farther than base: by 60 % at a harrow of 6 m in the tightest curve."""
    area = arc(footprint, config, curvature, 7.0, direction)
    for x, y in itertools.product(np.arange(-10.0, 10.0, 1.3), np.arange(-8.0, 9.0, 1.7)):
        bare = brute_contact(np.array([x, y]), footprint, curvature, direction, area.length_m)
        assert distance_to_contact_m(np.array([[x, y]]), area)[0] <= bare + 0.01, (x, y)


def test_extra_and_lateral_margins(footprint: Footprint, config: SafetyConfig) -> None:
    area = arc(footprint, config, 0.0, 20.0)
    for extra, aside in ((0.0, 5.0), (0.0, -0.2), (0.5, -0.2), (5.0, 0.0)):
        edge = 3.05 + config.field.lateral_margin_far_m + extra + aside
        for y in around(edge, 0.01):
            is_met = np.isfinite(distance_to_contact_m(np.array([[12.0, y]]), area, extra, aside)[0])
            assert is_met == (y <= edge + 1e-9), (extra, aside, y)
        assert distance_to_contact_m(np.array([[10.0, 0.0]]), area, extra, aside)[0] == pytest.approx(6.5 - extra)
        for x, y in ((23.4 + extra, 0.0), (-2.3 - extra, 0.0)):
            assert np.isfinite(distance_to_contact_m(np.array([[x, y]]), area, extra, aside)[0]), (extra, aside, x)
    assert distance_to_contact_m(np.array([[10, 0]]), area, 1, 0)[0] == pytest.approx(5.5)


def test_path_ends_and_deviation_blend() -> None:
    path, s = straight_path(length_m=10.0), spaced(5.0, 0.5)
    assert path_poses(path, 0.0, np.zeros(3), s, 5.0)[:, 0] == pytest.approx(s)
    assert path_poses(path, 8.0, np.array([8.0, 0.0, 0.0]), s, 5.0)[:, 0] == pytest.approx(np.minimum(s, 2.0))
    beside = path_poses(path, 0.0, np.array([0.0, 1.0, 0.0]), s, 5.0)
    assert beside[:, 1] == pytest.approx(-s / 5.0)
    assert path_poses(path, 0.0, np.array([0.0, 1.0, 0.0]), s, 2.0)[:, 1] == pytest.approx(-np.minimum(1.0, s / 2.0))


def test_up_to_cuts_all_arrays(footprint: Footprint, config: SafetyConfig) -> None:
    whole = arc(footprint, config, 0.1, 6.0)
    part = whole.up_to(2.1)
    assert (part.length_m, len(part.s_m)) == (2.0, 9)
    assert part.poses == pytest.approx(whole.poses[:9])
    assert part.lateral_m == pytest.approx(whole.lateral_m[:9])
    assert all(len(places) == 9 for _, places in part.bodies)
    here = whole.up_to(0.0)
    assert here.length_m == 0.0
    assert distance_to_contact_m(np.array([[0.0, 0.0], [8.0, 0.0]]), here).tolist() == [0.0, math.inf]


def test_step_of_long_field(footprint: Footprint, config: SafetyConfig) -> None:
    assert len(spaced(120.0, 0.4)) == 61
    for count, step in ((1, config.field.step_m), (2, 0.3), (3, 0.3)):
        s = 0.3 * np.arange(count) + 1.0
        poses = np.column_stack([s, 0 * s, 0 * s])
        assert sweep_along(footprint, 1, s, poses, 0.0, config.field, True).step_m == pytest.approx(step)


def test_unwrapped_headings() -> None:
    smooth = np.array([3.0, 3.1, 3.2])
    assert unwrapped(smooth) is smooth
    assert unwrapped(np.array([3.0, 3.1, 3.2 - 2 * math.pi])) == pytest.approx(smooth)


def brute_contact(point: np.ndarray, footprint: Footprint, curvature: float, direction: int, length: float) -> float:
    """First distance, in steps of 5 mm, at which a body without margins covers the point."""
    s = np.arange(0.0, length, 0.005)
    best = math.inf
    for body, poses in carriers(footprint, arc_poses(curvature, direction, s), curvature):
        c, n = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        dx, dy = point[0] - poses[:, 0], point[1] - poses[:, 1]
        x, y = c * dx + n * dy, c * dy - n * dx
        inside = (x >= body.rear_m) & (x <= body.front_m) & (np.abs(y) <= body.half_width_m)
        if inside.any():
            best = min(best, float(s[np.argmax(inside)]))
    return best


@given(st.floats(-8.0, 12.0), st.floats(-8.0, 8.0), st.floats(-0.21, 0.21), st.sampled_from([1, -1]), st.booleans())
@SETTINGS
def test_contact_never_later_than_brute_force(x, y, curvature, direction, is_trailed):
    footprint = SHAPES[is_trailed]
    area = arc(footprint, CONFIG, curvature, 7.0, direction)
    truth = brute_contact(np.array([x, y]), footprint, curvature, direction, area.length_m)
    assert distance_to_contact_m(np.array([[x, y]]), area)[0] <= truth + 0.02


@pytest.fixture(autouse=True)
def _footprints(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    global CONFIG
    CONFIG = config
    SHAPES[False], SHAPES[True] = footprint_of(vehicle, implement), footprint_of(vehicle, WAGON)


SHAPES: dict[bool, Footprint] = {}
CONFIG: SafetyConfig


def test_implement_swing_out(footprint: Footprint, config: SafetyConfig) -> None:
    """Turning left, the right rear corner swings out beyond the straight swept area, onto the point."""
    point = np.array([[-1.0, -3.3]])
    assert np.isinf(distance_to_contact_m(point, arc(footprint, config, 0.0, 4.0))[0])
    assert np.isfinite(distance_to_contact_m(point, arc(footprint, config, 0.2, 4.0))[0])


def test_trailed_implement(vehicle: Vehicle) -> None:
    footprint = footprint_of(vehicle, WAGON)
    assert footprint.foremost_m(-1) == pytest.approx(-6.7)
    assert footprint.leads_m(1) == pytest.approx((0.0, 4.7))
    assert footprint_of(vehicle, None).trailed is None
    assert len(footprint_of(vehicle, None).rigid) == 1
    drawbar = Drawbar(-1.2, 4.0)
    assert steady_angle(drawbar, 0.0) == 0.0
    s = np.arange(0.0, 30.0, 0.05)
    follow = trailer_poses(drawbar, arc_poses(0.1, 1, s), 0.0)
    behind = follow[-1, 2] - (0.1 * s[-1])
    assert behind == pytest.approx(steady_angle(drawbar, 0.1), abs=0.02)
    assert math.isfinite(steady_angle(drawbar, 2.0))


def test_arc_poses() -> None:
    poses = arc_poses(0.2, 1, np.array([0.0, 5.0 * math.pi / 2]))
    assert poses[1] == pytest.approx([5.0, 5.0, math.pi / 2])
    assert arc_poses(0.0, -1, np.array([2.0]))[0] == pytest.approx([-2.0, 0.0, 0.0])


def test_spaced_limit() -> None:
    assert len(spaced(300.0, 0.25)) <= 62
    assert spaced(0.25, 0.25) == pytest.approx([0.0, 0.25])


def test_path_poses() -> None:
    path = straight_path()
    poses = path_poses(path, 10.0, np.array([10.0, 0.4, 0.1]), np.arange(0.0, 8.0, 0.5), 5.0)
    assert poses[0] == pytest.approx([0.0, 0.0, 0.0])
    c, s = math.cos(0.1), math.sin(0.1)
    expected = [c * 7.5 + s * -0.4, c * -0.4 - s * 7.5, -0.1]
    assert poses[-1] == pytest.approx(expected)


@pytest.mark.parametrize("turns", [1, -1, 3])
def test_path_headings_of_other_turns(turns: int) -> None:
    path = straight_path(curvature=0.1)
    poses = path_poses(path, 3.0, np.array([*path.p_map_m[30], 0.3 + turns * 2 * math.pi]), np.array([0.0, 1.0]), 5.0)
    assert poses[1, 2] == pytest.approx(0.1, abs=1e-6)


def test_up_to(footprint: Footprint, config: SafetyConfig) -> None:
    area = arc(footprint, config, 0.1, 20.0)
    points, distances = outline_points(area, 0.1)
    for way_m in (0.0, 4.9, 5.0, 5.1, 30.0):
        part_points, part_ways = outline_points(area.up_to(way_m), 0.1)
        assert sorted(map(tuple, part_points)) == sorted(map(tuple, points[distances <= way_m])), way_m
        assert part_ways.max() == area.up_to(way_m).length_m


def test_position_on_path_of_command(config: SafetyConfig, vehicle: Vehicle) -> None:
    path = straight_path(7)
    assert position_on_path(None, None) is None
    assert position_on_path(straight_path(1, 0.0), None) is None
    place = position_on_path(path, None)
    assert place is not None
    assert place.s_m == 0.0
    for offset in around(1.0, 0.01):
        assert is_at(place, np.array([0.0, offset, 0.0]), config.field) == (offset <= 1.0), offset
    for turn in around(20.0, 0.1):
        at = is_at(place, np.array([0.0, 0.0, math.radians(turn - 1e-9)]), config.field)
        assert at == (turn <= 20.0 + 1e-6), turn


def test_field_without_position(config: SafetyConfig, footprint: Footprint) -> None:
    place = position_on_path(straight_path(), None)
    pose = np.zeros(3)
    planned = sweep_field(place, pose, 0.1, 1, 10.0, 3.0, footprint, config.field)
    assert planned.is_planned
    assert planned.arc is not None
    for other in (sweep_field(None, pose, 0.1, 1, 10.0, 3.0, footprint, config.field),
                  sweep_field(place, None, 0.1, 1, 10.0, 3.0, footprint, config.field),
                  sweep_field(place, np.array([0.0, 3.0, 0.0]), 0.1, 1, 10.0, 3.0, footprint,
                  config.field)):  # fmt: skip
        assert not other.is_planned
        assert other.arc is None
        assert other.main.poses[-1, 2] > 0.1


def test_field_ends_with_path(config: SafetyConfig, footprint: Footprint) -> None:
    distance = sweep_field(
        position_on_path(straight_path(1, 3.0), None), np.zeros(3), 0.0, 1, 20.0, 1.0, footprint, config.field
    )
    assert distance.main.length_m == pytest.approx(3.0, abs=0.4)
    assert np.isinf(distance_to_contact_m(np.array([[8.0, 0.0]]), distance.main)[0])


def test_look_ahead_minimum(config: SafetyConfig) -> None:
    assert look_ahead_m(0.0, config.braking.flat, config.field, 2.0) == config.field.min_length_m
    assert look_ahead_m(5.0, config.braking.flat, config.field, 2.0) > 10.0


def test_box_and_outline_contain_area(config: SafetyConfig, footprint: Footprint) -> None:
    distance = sweep_field(None, None, 0.2, 1, 8.0, 3.0, footprint, config.field)
    box = box_of(distance, 0.0)
    points, distances = outline_points(distance.main, 0.5)
    assert np.all((points[:, 0] >= box.x_m[0]) & (points[:, 0] <= box.x_m[1]))
    assert np.all((points[:, 1] >= box.y_m[0]) & (points[:, 1] <= box.y_m[1]))
    assert distances.max() <= distance.main.length_m
    assert outline_of(distance.main).shape == (2 * len(distance.main.s_m), 2)
    assert outline_of(arc(footprint, config, 0.0, 3.0, -1))[0, 0] < 0.0
    assert len(outline(Rectangle(-1.0, 1.0, 2.0))) == 8


@given(st.lists(st.tuples(st.floats(-5.0, 15.0), st.floats(-6.0, 6.0)), min_size=1, max_size=20))
@SETTINGS
def test_more_points_never_lengthen_the_gap(points: list[tuple[float, float]]) -> None:
    area = arc(SHAPES[False], CONFIG, 0.05, 10.0)
    clearances = [distance_to_contact_m(np.array(points[: k + 1]), area).min() for k in range(len(points))]
    assert all(b <= a + 1e-9 for a, b in pairwise(clearances))  # one point or several: products round differently
    wider = distance_to_contact_m(np.array(points), area, 0.5)
    assert np.all(wider <= distance_to_contact_m(np.array(points), area) + 1e-9)
    assert len(distance_to_contact_m(np.empty((0, 2)), area)) == 0

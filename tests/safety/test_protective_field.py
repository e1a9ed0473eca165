"""The raw field piece by piece: bodies, place on the path, ways, gaps, and cells of returns."""

import math
from dataclasses import fields, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.pose2 import to_frame
from geometry.rectangle import Rectangle
from messages.command import ControlCommand
from messages.plan import Path, PathSection, PathSectionType
from safety.config import SafetyConfig
from safety.sources.multiple_evaluation import cell_keys, evaluate, thin
from safety.stopping_distance import required_range, stopping_distance
from safety.zones.footprint import (
    Box,
    Drawbar,
    Footprint,
    carriers,
    footprint_of,
    is_inside,
    outline,
    steady_angle,
    trailer_poses,
)
from safety.zones.protective_field import (
    FREE,
    Clearance,
    PathPosition,
    SweptField,
    arc_length_m,
    box_of,
    clearance_to,
    is_at,
    look_ahead_m,
    position_on_path,
    section_type_at,
    sweep_field,
)
from safety.zones.swept_area import SweptArea, arc_poses, path_poses, spaced, sweep_along
from tests.safety.safety_world import START_NS, around, straight_path
from tests.safety.safety_world import WAGON as NARROW_WAGON

WAGON = NARROW_WAGON.model_copy(update={"width_m": 3.2})


@pytest.fixture
def footprint(vehicle: Vehicle, implement) -> Footprint:
    return footprint_of(vehicle, implement)


@pytest.fixture
def pulling(vehicle: Vehicle) -> Footprint:
    return footprint_of(vehicle, WAGON)


def bent_path(sections: tuple[PathSection, ...] = ()) -> Path:
    """East for 2 m, then north for 2 m, with a corner at each metre; ways count from 3 m on."""
    path = straight_path(7, 0.4)
    p = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (2.0, 2.0)])
    heading = np.array([0.0, 0.0, 0.5, 1.5, 2.0])
    return replace(
        path, p_map_m=p, s_m=np.arange(3.0, 7.5), heading_rad=heading, curvature_radpm=np.zeros(5),
        sections=sections or path.sections, section_index=np.array([0, 0, 1, 1, 2], np.int32),
    )  # fmt: skip


def following(path_id: int, s_m: float) -> ControlCommand:
    return ControlCommand(START_NS, 2.0, 0.0, 0.0, True, True, path_id, s_m, 0.0, 0.0, False)


def is_equal(a: Any, b: Any) -> bool:
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(is_equal(x, y) for x, y in zip(a, b, strict=True))
    return bool(np.allclose(a, b)) if isinstance(a, np.ndarray | float) else a == b


def assert_equal(a: SweptArea | None, b: SweptArea) -> None:
    assert a is not None
    for one in fields(SweptArea):
        assert is_equal(getattr(a, one.name), getattr(b, one.name)), one.name


def test_outlines_follow_from_the_vehicle(vehicle: Vehicle, footprint: Footprint, pulling: Footprint) -> None:
    machine = Rectangle(-1.0, 3.5, 2.3)
    assert footprint_of(vehicle, None) == Footprint((machine,), None, None, 2.9)
    assert footprint == Footprint((machine, Rectangle(-2.4, -1.1, 6.1)), None, None, 2.9)
    assert pulling == Footprint((machine,), Rectangle(-5.5, 0.0, 3.2), Drawbar(-1.2, 4.0), 2.9)


def test_leading_edges_in_both_directions(footprint: Footprint, pulling: Footprint) -> None:
    for one, direction, foremost, leads in (
        (footprint, 1, 3.5, (0.0, 4.6)), (footprint, -1, -2.4, (1.4, 0.0)),
        (pulling, 1, 3.5, (0.0, 4.7)), (pulling, -1, -6.7, (5.7, 0.0)),
    ):  # fmt: skip
        assert one.foremost_m(direction) == pytest.approx(foremost)
        assert one.leads_m(direction) == pytest.approx(leads)


def test_a_rectangle_holds_its_edges_and_a_margin() -> None:
    body = Rectangle(-1.0, 3.0, 4.0)
    for margin in (0.0, 0.5):
        for x, y in ((-1.0 - margin, 0.0), (3.0 + margin, 0.0), (0.0, 2.0 + margin), (0.0, -2.0 - margin)):
            for further in (0.0, 0.01):
                point = np.array([x, y]) + further * np.sign([x, y])
                assert is_inside(body, point[:1], point[1:], margin)[0] == (further == 0.0), (margin, point)
    assert not is_inside(body, np.array([9.0]), np.array([9.0]), 0.0)[0]


def test_outline_has_corners_and_middles_of_sides() -> None:
    expected = {(-1.0, -2.0), (-1.0, 0.0), (-1.0, 2.0), (1.0, -2.0), (1.0, 2.0), (3.0, -2.0), (3.0, 0.0), (3.0, 2.0)}
    found = outline(Rectangle(-1.0, 3.0, 4.0))
    assert set(map(tuple, found.tolist())) == expected
    assert len(found) == 8


@pytest.mark.parametrize("curvature", [-0.2, -0.05, 0.0, 0.05, 0.2])
def test_steadily_pulled_the_axle_rolls_about_the_machines_centre(curvature: float) -> None:
    drawbar = Drawbar(-1.2, 4.0)
    angle = steady_angle(drawbar, curvature)
    ahead = np.array([math.cos(angle), math.sin(angle)])
    axle = np.array([-1.2, 0.0]) - 4.0 * ahead
    assert abs(angle) < math.pi / 2
    assert curvature * float(axle @ ahead) - float(ahead[1]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_in_too_narrow_a_bend_the_drawbar_stands_across(side: int) -> None:
    expected = side * (math.atan(-1.2 * 2.0) - math.pi / 2)
    assert steady_angle(Drawbar(-1.2, 4.0), side * 2.0) == pytest.approx(expected)


def test_a_trailer_follows_its_hitch_step_by_step() -> None:
    poses = np.array([[0.0, 0.0, 0.3], [0.5, 0.3, 0.5], [0.8, 0.9, 0.9], [0.7, 1.4, 1.4]])
    found = trailer_poses(Drawbar(-1.2, 4.0), poses, 0.1)
    hitch = [to_frame(pose, np.array([[-1.2, 0.0]]))[0] for pose in poses]
    assert found[:, :2] == pytest.approx(np.array(hitch))
    assert found[0, 2] == pytest.approx(0.3 + steady_angle(Drawbar(-1.2, 4.0), 0.1))
    for before, after in pairwise(found):
        left = np.array([-math.sin(before[2]), math.cos(before[2])])
        assert after[2] - before[2] == pytest.approx(float((after[:2] - before[:2]) @ left) / 4.0)


def test_carriers_are_base_and_for_what_is_pulled_the_hitch(footprint: Footprint, pulling: Footprint) -> None:
    poses = arc_poses(0.1, 1, np.arange(0.0, 3.0, 0.5))
    assert carriers(footprint, poses, 0.1) == ((footprint.rigid[0], poses), (footprint.rigid[1], poses))
    (machine, own), (wagon, hitch) = carriers(pulling, poses, 0.1)
    assert (machine, wagon) == (pulling.rigid[0], pulling.trailed)
    assert own is poses
    assert hitch == pytest.approx(trailer_poses(Drawbar(-1.2, 4.0), poses, 0.1))


def test_the_place_is_where_control_says_on_the_same_path() -> None:
    path = bent_path()
    assert position_on_path(path, following(7, 4.2)) == PathPosition(path, 4.2)
    for control_command in (None, following(8, 4.2), following(7, math.nan), following(7, math.inf)):
        assert position_on_path(path, control_command) == PathPosition(path, 3.0)
    shortest = replace(path, s_m=path.s_m[:2])
    assert position_on_path(shortest, None) == PathPosition(shortest, 3.0)
    assert position_on_path(replace(path, s_m=path.s_m[:1]), None) is None


def test_the_leg_of_a_place_is_that_of_its_stretch() -> None:
    sections = (
        PathSection(PathSectionType.DOCK, 1, 0, 1),
        PathSection(PathSectionType.SWATH, 2, 2, 3),
        PathSection(PathSectionType.TURN, 3, 4, 4),
    )
    path = bent_path(sections)
    for s_m, leg in ((2.0, PathSectionType.DOCK), (4.0, PathSectionType.DOCK), (4.1, PathSectionType.SWATH), (6.0,
    PathSectionType.SWATH), (6.1, PathSectionType.TURN),
                     (7.0, PathSectionType.TURN), (9.0, PathSectionType.TURN)):  # fmt: skip
        assert section_type_at(PathPosition(path, s_m)) is leg, s_m


def test_a_pose_is_at_its_place_within_a_metre_and_20_degrees(config: SafetyConfig) -> None:
    place, end = PathPosition(bent_path(), 6.0), PathPosition(bent_path(), 20.0)
    for x, y, is_there in ((2.0, 1.0, True), (3.0, 1.0, True), (1.0, 1.0, True), (2.0, 2.0, True), (2.0, 0.0, True),
                           (2.8, 1.7, False), (3.01, 1.0, False), (2.0, -0.01, False)):  # fmt: skip
        assert is_at(place, np.array([x, y, 1.5]), config.field) == is_there, (x, y)
        assert is_at(place, np.array([x, y, 1.5 + 2.0 * math.pi]), config.field) == is_there, (x, y)
    assert is_at(end, np.array([2.0, 2.9, 2.0]), config.field)
    most = math.radians(20.0)
    level = PathPosition(bent_path(), 3.0)
    for turn, is_there in ((most, True), (-most, True), (most + 1e-6, False), (-most - 1e-6, False), (math.pi, False)):
        assert is_at(level, np.array([0.0, 0.0, turn]), config.field) == is_there, turn


def test_the_field_reaches_as_far_as_half_a_metre_per_second_more_needs(config: SafetyConfig) -> None:
    flat = config.braking.flat
    assert look_ahead_m(5.0, flat, config.field, 2.0) == pytest.approx(required_range(5.5, flat, 2.0) + 1.0)
    assert look_ahead_m(0.5, flat, config.field, 0.0) == config.field.min_length_m
    helpless = replace(flat, deceleration_mps2=0.0)
    assert look_ahead_m(5.0, helpless, config.field, 2.0) == 101.0
    assert arc_length_m(5.0, flat, config.field) == pytest.approx(stopping_distance(5.0, flat) + 0.3 + 0.5)
    assert arc_length_m(5.0, helpless, config.field) == pytest.approx(60.8)


@pytest.mark.parametrize(("place_m", "left_m"), [(10.0, 12.7), (90.15, 9.85), (99.9, 0.4), (100.0, 0.4)])
def test_along_a_plan_both_path_and_arc_are_swept(
    config: SafetyConfig, pulling: Footprint, place_m: float, left_m: float
) -> None:
    path, field, pose = straight_path(), config.field, np.array([place_m, 0.2, 0.1])
    way = sweep_field(PathPosition(path, place_m), pose, 0.1, 1, 8.0, 3.0, pulling, field)
    s = spaced(left_m, 0.4)
    poses = path_poses(path, place_m, pose, s, field.blend_m)
    assert way.is_planned
    assert_equal(way.main, sweep_along(pulling, 1, s, poses, 0.1, field, True))
    s = spaced(3.0, 0.1)
    assert_equal(way.arc, sweep_along(pulling, 1, s, arc_poses(0.1, 1, s), 0.1, field, False))


@pytest.mark.parametrize(("direction", "lead_m"), [(1, 4.7), (-1, 5.7)])
def test_without_a_place_the_arc_is_swept_over_the_whole_length(
    config: SafetyConfig, pulling: Footprint, direction: int, lead_m: float
) -> None:
    way = sweep_field(None, np.zeros(3), 0.1, direction, 8.0, 3.0, pulling, config.field)
    s = spaced(8.0 + lead_m, 0.4)
    poses = arc_poses(0.1, direction, s)
    assert_equal(way.main, sweep_along(pulling, direction, s, poses, 0.1, config.field, True))
    assert (way.arc, way.is_planned) == (None, False)


def way_of(main: Any, arc: Any = None) -> SweptField:
    """A way of which only the boxes are asked for."""
    return SweptField(SimpleNamespace(box=main), None if arc is None else SimpleNamespace(box=arc), True)  # type: ignore[arg-type]


def test_the_box_holds_both_sweeps_and_slack() -> None:
    a, b = Box((-1.0, 5.0), (-2.0, 9.0)), Box((-3.0, 4.0), (-1.0, 10.0))
    for way in (way_of(a, b), way_of(b, a)):
        assert box_of(way, 0.5) == Box((-3.5, 5.5), (-2.5, 10.5))
    assert box_of(way_of(a), 0.5) == Box((-1.5, 5.5), (-2.5, 9.5))


def test_gaps_to_hits_in_odom(config: SafetyConfig, footprint: Footprint) -> None:
    way = sweep_field(PathPosition(straight_path(), 0.0), np.zeros(3), 0.0, 1, 20.0, 12.0, footprint, config.field)
    pose = np.array([5.0, -3.0, 0.7])

    def clearance(*places: tuple[float, float, float], laid: SweptField = way, **aside: Any) -> Clearance:
        base = np.array(places)
        return clearance_to(laid, np.column_stack([to_frame(pose, base[:, :2]), base[:, 2]]), pose, **aside)

    found = clearance((10.0, 0.0, 1.5), (12.0, 1.0, 0.5), (12.0, 4.0, 0.7))
    assert (found.main_m, found.arc_m) == pytest.approx((6.5, 6.5))
    assert found.triggering_points_base_m == pytest.approx(np.array([(10.0, 0.0, 1.5), (12.0, 1.0, 0.5)]))
    far = clearance((18.0, 0.0, 1.0))  # beyond the arc
    assert (far.main_m, far.arc_m) == pytest.approx((14.5, math.inf))
    assert len(far.triggering_points_base_m) == 1
    for y in around(3.35, 0.01):
        for aside in (-0.5, np.array([-0.5]), 0.5):
            edge = y + float(np.sum(aside)) - 1e-6
            beside = clearance((9.0, edge, 1.0), aside_m=aside)
            assert math.isfinite(beside.main_m) == (y <= 3.35 + 1e-9), (y, aside)
            assert math.isfinite(beside.arc_m) == (y <= 3.35 + 1e-9), (y, aside)
    wide = clearance((10.0, 0.0, 1.0), aside_m=0.5)
    assert (wide.main_m, wide.arc_m) == pytest.approx((6.5, 6.5))
    alone = clearance((10.0, 0.0, 1.0), laid=replace(way, arc=None))
    assert (alone.main_m, alone.arc_m) == pytest.approx((6.5, math.inf))
    assert len(alone.triggering_points_base_m) == 1
    assert clearance_to(way, np.empty((0, 3)), pose) is FREE
    assert (FREE.main_m, FREE.arc_m, FREE.triggering_points_base_m.shape) == (math.inf, math.inf, (0, 3))


def test_the_key_of_a_cell_is_its_three_numbers() -> None:
    zero = 1 << 20
    places = np.array([(0.0, 0.0, 0.0), (0.5, -0.5, 1.0), (0.99, -0.01, 1.49), (-1.0, 2.0, -0.1)])
    cells = [(0, 0, 0), (1, -1, 2), (1, -1, 2), (-2, 4, -1)]
    expected = [((zero + x) << 42) + ((zero + y) << 21) + zero + z for x, y, z in cells]
    assert cell_keys(places, 0.5).tolist() == expected


def test_cells_with_enough_returns_are_hits_and_remembered() -> None:
    keys = np.array([9, 5, 9, 7, 9, 9, 5, 4])
    hits, cells = evaluate(keys, np.array([4, 5, 11]), 4, 2)
    assert hits.tolist() == [True, True, True, False, True, True, True, False]
    assert cells.tolist() == [5, 9]


def test_one_point_of_each_square_is_kept_in_its_order() -> None:
    grid = np.array([(x, y, z) for x in (-0.3, 0.1, 0.6) for y in (-0.3, 0.1, 0.6) for z in (2.0, 1.0)])
    assert thin(grid, 0.5).tolist() == grid[::2].tolist()
    assert len(thin(np.array([(0.0, 0.0, 0.0), (0.499, 0.499, 3.0), (0.5, 0.0, 0.0)]), 0.5)) == 2

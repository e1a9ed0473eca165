"""Protective field: path position, swept field, box, clearance."""

import math
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.pose2 import to_frame
from messages.command import ControlCommand
from messages.plan import Path, PathSection, PathSectionType
from safety.config import SafetyConfig
from safety.stopping_distance import required_range, stopping_distance
from safety.zones.footprint import (
    Box,
    Footprint,
    footprint_of,
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
    """East for 2 m, then north for 2 m, a point at each metre; distances start at 3 m."""
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


def test_position_on_path() -> None:
    path = bent_path()
    assert position_on_path(path, following(7, 4.2)) == PathPosition(path, 4.2)
    for control_command in (None, following(8, 4.2), following(7, math.nan), following(7, math.inf)):
        assert position_on_path(path, control_command) == PathPosition(path, 3.0)
    shortest = replace(path, s_m=path.s_m[:2])
    assert position_on_path(shortest, None) == PathPosition(shortest, 3.0)
    assert position_on_path(replace(path, s_m=path.s_m[:1]), None) is None


def test_section_type_at() -> None:
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


def test_path_deviation_limits(config: SafetyConfig) -> None:
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


def test_look_ahead_speed_margin(config: SafetyConfig) -> None:
    flat = config.braking.flat
    assert look_ahead_m(5.0, flat, config.field, 2.0) == pytest.approx(required_range(5.5, flat, 2.0) + 1.0)
    assert look_ahead_m(0.5, flat, config.field, 0.0) == config.field.min_length_m
    helpless = replace(flat, deceleration_mps2=0.0)
    assert look_ahead_m(5.0, helpless, config.field, 2.0) == 101.0
    assert arc_length_m(5.0, flat, config.field) == pytest.approx(stopping_distance(5.0, flat) + 0.3 + 0.5)
    assert arc_length_m(5.0, helpless, config.field) == pytest.approx(60.8)


@pytest.mark.parametrize(("path_s_m", "left_m"), [(10.0, 12.7), (90.15, 9.85), (99.9, 0.4), (100.0, 0.4)])
def test_field_along_plan(config: SafetyConfig, pulling: Footprint, path_s_m: float, left_m: float) -> None:
    path, field, pose = straight_path(), config.field, np.array([path_s_m, 0.2, 0.1])
    way = sweep_field(PathPosition(path, path_s_m), pose, 0.1, 1, 8.0, 3.0, pulling, field)
    s = spaced(left_m, 0.4)
    poses = path_poses(path, path_s_m, pose, s, field.blend_m)
    assert way.is_planned
    assert_equal(way.main, sweep_along(pulling, 1, s, poses, 0.1, field, True))
    s = spaced(3.0, 0.1)
    assert_equal(way.arc, sweep_along(pulling, 1, s, arc_poses(0.1, 1, s), 0.1, field, False))


@pytest.mark.parametrize(("direction", "lead_m"), [(1, 4.7), (-1, 5.7)])
def test_field_without_plan(config: SafetyConfig, pulling: Footprint, direction: int, lead_m: float) -> None:
    way = sweep_field(None, np.zeros(3), 0.1, direction, 8.0, 3.0, pulling, config.field)
    s = spaced(8.0 + lead_m, 0.4)
    poses = arc_poses(0.1, direction, s)
    assert_equal(way.main, sweep_along(pulling, direction, s, poses, 0.1, config.field, True))
    assert (way.arc, way.is_planned) == (None, False)


def way_of(main: Any, arc: Any = None) -> SweptField:
    """Swept field of which only the boxes are used."""
    return SweptField(SimpleNamespace(box=main), None if arc is None else SimpleNamespace(box=arc), True)  # type: ignore[arg-type]


def test_box_of_field() -> None:
    a, b = Box((-1.0, 5.0), (-2.0, 9.0)), Box((-3.0, 4.0), (-1.0, 10.0))
    for way in (way_of(a, b), way_of(b, a)):
        assert box_of(way, 0.5) == Box((-3.5, 5.5), (-2.5, 10.5))
    assert box_of(way_of(a), 0.5) == Box((-1.5, 5.5), (-2.5, 9.5))


def test_clearance_to_hits(config: SafetyConfig, footprint: Footprint) -> None:
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

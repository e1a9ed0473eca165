"""Footprints, boxes, self mask and trailed implements."""

import math
from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import FOLDED, Vehicle
from geometry.pose2 import from_frame, point_from_frame, to_frame
from safety.zones.footprint import Box, Footprint, fold_of, footprint_of, footprints_of, hitch_of, is_between
from safety.zones.swept_area import arc_poses
from tests.safety.safety_world import START_NS, around

from tests.safety.safety_world import machine_state  # isort: skip
from itertools import pairwise

from configs.vehicle import TrailedImplement
from geometry.drawbar import Drawbar, steady_angle
from geometry.rectangle import Rectangle
from safety.zones.footprint import carriers, is_inside, is_own, outline, parts_of, trailer_poses
from tests.safety.safety_world import WAGON as NARROW_WAGON


def test_box_in_parent_frame() -> None:
    box, pose = Box((-3.0, 5.0), (-1.0, 2.0)), np.array([3.0, -2.0, 2.3])
    corners = np.array([[x, y] for x in box.x_m for y in box.y_m])
    seen, moved = box.in_parent(pose), to_frame(pose, corners)
    assert (seen.x_m, seen.y_m) == (
        pytest.approx((moved[:, 0].min(), moved[:, 0].max())),
        pytest.approx((moved[:, 1].min(), moved[:, 1].max())),
    )
    assert point_from_frame(pose, 1.5, -4.0) == tuple(from_frame(pose, np.array([[1.5, -4.0]]))[0])


def test_footprint_by_fold_position(vehicle: Vehicle, implement) -> None:
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


def test_fold_position_age_limit() -> None:
    for age_ms in around(350, 1):
        machine = machine_state(START_NS, fold_position=0.5, implement_stamp_ns=START_NS - round(age_ms * 1e6))
        assert fold_of(machine, 0.35) == (0.5 if age_ms <= 350 else None), age_ms
    assert fold_of(None, 0.35) is None
    for fold, between in ((1.0 - FOLDED, False), (FOLDED, False), (0.5, True), (0.011, True), (0.989, True)):
        assert is_between(fold) == between, fold


def test_hitch_position_age_limit() -> None:
    for age_ms in around(350, 1):
        machine = machine_state(START_NS, hitch=0.2, implement_stamp_ns=START_NS - round(age_ms * 1e6))
        assert hitch_of(machine, 0.35) == (0.2 if age_ms <= 350 else 1.0), age_ms
    assert hitch_of(None, 0.35) == 1.0
    assert hitch_of(machine_state(START_NS, hitch=math.nan), 0.35) == 1.0


AREA = Box((-4.0, 20.0), (-7.0, 5.0))


def test_box_contains() -> None:
    inside = [(-4.0, 0.0), (20.0, 0.0), (0.0, -7.0), (0.0, 5.0), (math.nan, 0.0), (0.0, math.nan)]
    outside = [(-4.01, 0.0), (20.01, 0.0), (0.0, -7.01), (0.0, 5.01), (math.nan, 6.0)]
    assert AREA.contains(np.array(inside + outside)).tolist() == [True] * 6 + [False] * 5


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.8, -2.5, 3.0])
def test_box_in_rotated_parent_frame(yaw: float) -> None:
    pose, area = np.array([5.0, -3.0, yaw]), Box((-4.0, 20.0), (-9.0, 5.0))
    corners = to_frame(pose, np.array([(x, y) for x in area.x_m for y in area.y_m]))
    found = area.in_parent(pose)
    assert (*found.x_m, *found.y_m) == pytest.approx(
        (corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max())
    )


def test_trailer_self_mask(vehicle: Vehicle) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    footprint = footprint_of(vehicle, wagon)
    yaw = math.atan(0.2 * -1.2) - math.asin(4.0 * 0.2 * math.cos(math.atan(0.2 * -1.2)))
    hitch = np.array([-1.2, 0.0, yaw])
    for x, y, is_on in ((-5.6, 0.0, True), (-5.61, 0.0, False), (-3.0, 1.6, True), (-3.0, 1.61, False),
                        (-3.0, -1.6, True), (-3.0, -1.61, False), (-5.5, 1.5, True)):  # fmt: skip
        inner = np.array([[x + (1e-6 if is_on else 0.0), y - math.copysign(1e-6, y) if is_on else y]])
        point = to_frame(hitch, inner)[0]
        assert is_own(np.array([[point[0]], [point[1]], [1.0]]), footprint, 0.2, 0.1)[0] == is_on, (x, y)
    assert is_own(np.array([[0.0], [0.0], [1.0]]), footprint, 0.2, 0.1)[0]
    assert not is_own(np.array([[-3.0], [3.0], [1.0]]), footprint_of(vehicle, None), 0.2, 0.1)[0]


def test_what_stands_between_the_parts_is_not_own(vehicle: Vehicle) -> None:
    """Parts of the tractor: hood 0.42 m to either side, front wheel at x 2.55, rear wheel up to x 0.82; margin 0.15."""
    footprint = footprint_of(vehicle, None)
    places = {
        (1.5, 0.9): False, (1.5, 0.5): True, (0.95, 0.9): True, (1.1, 0.95): False, (3.4, -0.9): False,
        (2.55, 1.2): True, (2.0, 1.2): True, (1.5, 1.4): False, (-0.9, 0.9): True, (3.6, 0.0): True,
    }  # fmt: skip
    xyz = np.array([(x, y, 0.4) for x, y in places]).T
    assert is_own(xyz, footprint, 0.0, 0.15).tolist() == list(places.values())
    assert is_own(xyz, replace(footprint, parts=()), 0.0, 0.15).tolist() == [abs(y) <= 1.3 for _, y in places]


WAGON = NARROW_WAGON.model_copy(update={"width_m": 3.2})


@pytest.fixture
def footprint(vehicle: Vehicle, implement) -> Footprint:
    return footprint_of(vehicle, implement)


@pytest.fixture
def pulling(vehicle: Vehicle) -> Footprint:
    return footprint_of(vehicle, WAGON)


def test_footprint_of_vehicle(vehicle: Vehicle, footprint: Footprint, pulling: Footprint) -> None:
    machine, parts = Rectangle(-1.0, 3.5, 2.3), parts_of(vehicle)
    assert footprint_of(vehicle, None) == Footprint((machine,), None, None, 2.9, parts=parts)
    assert footprint == Footprint((machine, Rectangle(-2.4, -1.1, 6.1)), None, None, 2.9, 0.95 + 0.6, parts=parts)
    assert pulling == Footprint((machine,), Rectangle(-5.5, 0.0, 3.2), Drawbar(-1.2, 4.0), 2.9, parts=parts)
    assert footprint.tops_m == (2.9, 0.95 + 0.6)
    assert pulling.tops_m == (2.9, 2.9)
    assert footprint_of(vehicle, None).tops_m == (2.9,)


def test_leading_edges(footprint: Footprint, pulling: Footprint) -> None:
    for one, direction, foremost, leads in (
        (footprint, 1, 3.5, (0.0, 4.6)), (footprint, -1, -2.4, (1.4, 0.0)),
        (pulling, 1, 3.5, (0.0, 4.7)), (pulling, -1, -6.7, (5.7, 0.0)),
    ):  # fmt: skip
        assert one.foremost_m(direction) == pytest.approx(foremost)
        assert one.leads_m(direction) == pytest.approx(leads)


def test_is_inside_margin() -> None:
    body = Rectangle(-1.0, 3.0, 4.0)
    for margin in (0.0, 0.5):
        for x, y in ((-1.0 - margin, 0.0), (3.0 + margin, 0.0), (0.0, 2.0 + margin), (0.0, -2.0 - margin)):
            for further in (0.0, 0.01):
                point = np.array([x, y]) + further * np.sign([x, y])
                assert is_inside(body, point[:1], point[1:], margin)[0] == (further == 0.0), (margin, point)
    assert not is_inside(body, np.array([9.0]), np.array([9.0]), 0.0)[0]


def test_outline_points_of_rectangle() -> None:
    expected = {(-1.0, -2.0), (-1.0, 0.0), (-1.0, 2.0), (1.0, -2.0), (1.0, 2.0), (3.0, -2.0), (3.0, 0.0), (3.0, 2.0)}
    found = outline(Rectangle(-1.0, 3.0, 4.0))
    assert set(map(tuple, found.tolist())) == expected
    assert len(found) == 8


@pytest.mark.parametrize("curvature", [-0.2, -0.05, 0.0, 0.05, 0.2])
def test_steady_angle(curvature: float) -> None:
    drawbar = Drawbar(-1.2, 4.0)
    angle = steady_angle(drawbar, curvature)
    ahead = np.array([math.cos(angle), math.sin(angle)])
    axle = np.array([-1.2, 0.0]) - 4.0 * ahead
    assert abs(angle) < math.pi / 2
    assert curvature * float(axle @ ahead) - float(ahead[1]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_steady_angle_saturation(side: int) -> None:
    expected = side * (math.atan(-1.2 * 2.0) - math.pi / 2)
    assert steady_angle(Drawbar(-1.2, 4.0), side * 2.0) == pytest.approx(expected)


def test_trailer_poses() -> None:
    poses = np.array([[0.0, 0.0, 0.3], [0.5, 0.3, 0.5], [0.8, 0.9, 0.9], [0.7, 1.4, 1.4]])
    found = trailer_poses(Drawbar(-1.2, 4.0), poses, -0.4)
    hitch = [to_frame(pose, np.array([[-1.2, 0.0]]))[0] for pose in poses]
    assert found[:, :2] == pytest.approx(np.array(hitch))
    assert found[0, 2] == pytest.approx(0.3 - 0.4)
    for before, after in pairwise(found):
        # the axle rolls along the implement: many small steps of the hitch
        yaw = before[2]
        dx, dy = (after[:2] - before[:2]) / 2000.0
        for _ in range(2000):
            yaw += (dy * math.cos(yaw) - dx * math.sin(yaw)) / 4.0
        assert after[2] == pytest.approx(yaw, abs=1e-5)


def test_carriers(footprint: Footprint, pulling: Footprint) -> None:
    poses = arc_poses(0.1, 1, np.arange(0.0, 3.0, 0.5))
    assert carriers(footprint, poses, 0.1) == ((footprint.rigid[0], poses), (footprint.rigid[1], poses))
    (machine, own), (wagon, hitch) = carriers(pulling, poses, 0.1)
    assert (machine, wagon) == (pulling.rigid[0], pulling.trailed)
    assert own is poses
    drawbar = Drawbar(-1.2, 4.0)
    assert hitch == pytest.approx(trailer_poses(drawbar, poses, steady_angle(drawbar, 0.1)))
    known = carriers(replace(pulling, hitch_rad=(-0.3, 0.5)), poses, 0.1)[1:]  # one of each angle that can be
    assert [places[0, 2] for _, places in known] == pytest.approx(np.linspace(-0.3, 0.5, len(known)))
    assert len(known) == 1 + math.ceil(0.8 / math.radians(4.0))
    assert all(places == pytest.approx(trailer_poses(drawbar, poses, places[0, 2])) for _, places in known)

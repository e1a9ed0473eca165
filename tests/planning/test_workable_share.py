"""The share of a field that any plan can work, against shapes of which it is known."""

import math

import numpy as np
import pytest
import shapely
from shapely.affinity import affine_transform, rotate
from shapely.geometry import Polygon, box

from benchmarks.planning_bound import workable_share
from configs.vehicle import MountedImplement, Vehicle

MARGIN_M = 0.1


@pytest.fixture
def narrow(harrow: MountedImplement) -> MountedImplement:
    return harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})


@pytest.mark.parametrize("angle", [0.0, 0.3456])
def test_all_of_a_rectangle_but_what_lies_behind_the_implement(
    angle: float, vehicle: Vehicle, narrow: MountedImplement
) -> None:
    """Between working line and rear end 0.7 m stay bare at the edge behind, which other headings work."""
    field = rotate(box(0, 0, 30, 20), angle, (0, 0), use_radians=True)
    share = workable_share(field, MARGIN_M, vehicle, narrow)
    inner = field.buffer(-MARGIN_M, join_style="mitre").area / field.area
    assert share <= inner + 1e-9
    assert share > inner - 4 * 0.7**2 / field.area


def test_a_tail_narrower_than_the_rig_is_not_workable(vehicle: Vehicle, narrow: MountedImplement) -> None:
    field = shapely.union_all([box(0, 0, 30, 20), box(30, 5, 40, 7.8)])
    share = workable_share(field, MARGIN_M, vehicle, narrow)
    assert share * field.area == pytest.approx(29.8 * 19.8, abs=6.0)


@pytest.mark.parametrize(("gap_m", "both"), [(2.2, False), (2.7, True)])
def test_a_part_behind_a_passage_counts_where_the_folded_rig_goes(
    gap_m: float, both: bool, vehicle: Vehicle, narrow: MountedImplement
) -> None:
    field = shapely.union_all([box(0, 0, 30, 20), box(30, 5, 32, 5 + gap_m), box(32, 0, 52, 20)])
    share = workable_share(field, MARGIN_M, vehicle, narrow)
    expected = (1000.0 if both else 600.0) / field.area
    assert share == pytest.approx(expected, abs=0.03)


def test_never_below_what_a_rig_works_at_random_poses(vehicle: Vehicle, harrow: MountedImplement) -> None:
    """Also at headings between those that are tried; in a convex field the rig is free between two poses in a line."""
    field = Polygon([(0, 0), (40, 5), (43, 18), (35, 31), (20, 30), (3, 24)])
    share = workable_share(field, MARGIN_M, vehicle, harrow)
    inner, b, h = field.buffer(-MARGIN_M), vehicle.body, harrow.width_m / 2
    along_m, x_m, work_h = 3.0, harrow.working_point_m, harrow.working_width_m / 2
    machine = box(-b.rear_m, -b.width_m / 2, b.front_m + along_m, b.width_m / 2)
    behind = box(harrow.rear_end_m, -h, harrow.front_end_m + along_m, h)
    rng, strips = np.random.default_rng(1), []
    for _ in range(2000):
        x, y, angle = rng.uniform((0, 0, 0), (43, 31, 2 * math.pi))
        c, s = math.cos(angle), math.sin(angle)
        if all(inner.covers(affine_transform(body, [c, -s, s, c, x, y])) for body in (machine, behind)):
            strip = box(x_m, -work_h, x_m + along_m, work_h)
            strips.append(affine_transform(strip, [c, -s, s, c, x, y]))
    found = shapely.union_all(strips).area / field.area
    assert found > 0.85
    assert share >= found
    assert share < inner.area / field.area

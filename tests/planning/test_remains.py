"""Swaths over what stays bare, and fills of headland passes that are driven as planned."""

import math

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate
from shapely.geometry import LineString, Polygon, box

from configs.mission import Mission
from configs.site import Site
from configs.vehicle import MountedImplement, Vehicle
from geometry.arrays import Float64
from planning.config import PlanningConfig
from planning.coverage.headland import pass_coverage
from planning.coverage.remains import Worth, swaths_over_remains
from planning.coverage.swath import Swath
from planning.plan import plan_field
from planning.rig import Rig, rig_of
from planning.turns.free_space import FreeSpace

ANGLE_RAD = 0.2345
WORTH = Worth(2.0, 0.08, 30.0)


@pytest.fixture
def rig(vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Rig:
    work = mission.work
    assert work is not None
    return rig_of(vehicle, harrow, work.model_copy(update={"turns": "reverse"}), planning.planner)


def turned(shape: Polygon) -> Polygon:
    found = rotate(shape, ANGLE_RAD, origin=(0, 0), use_radians=True)
    assert isinstance(found, Polygon)
    return found


def ends_of(swath: Swath) -> Float64:
    ends = swath.onwards_m if swath.onwards_m is not None else swath.back_m
    assert ends is not None
    return ends


def test_remains_beside_an_edge_get_a_swath_parallel_to_it_and_then_the_next_best(rig: Rig) -> None:
    space = FreeSpace(turned(box(0, 0, 80, 60)), rig.bodies, rig.radius_m, rig.config.smoothing_m)
    bare = turned(Polygon([(30, 0.01), (38, 0.02), (37.5, 1.5), (31, 1.3)]))  # no side is parallel to the edge
    offered = list[tuple[Swath, float]]()

    def take_third(swath: Swath, most_s: float) -> bool:
        offered.append((swath, most_s))
        return len(offered) == 3

    (taken,) = swaths_over_remains(bare, rig, space, WORTH, take_third)
    assert taken is offered[2][0]
    along = np.diff(ends_of(offered[0][0]), axis=0)[0]
    assert math.atan2(along[1], along[0]) % math.pi == pytest.approx(ANGLE_RAD, abs=1e-9)
    times = [most_s for _, most_s in offered]
    assert times[0] == pytest.approx(30.0 * bare.area, rel=0.05)
    assert times[0] > times[2]
    assert len({tuple(ends_of(s).ravel().round(3)) for s, _ in offered}) == 3


def test_each_direction_that_is_offered_works_what_it_is_worth(rig: Rig) -> None:
    """In a dead end the direction into it ends a machine's length before its end, and is not offered with the other."""
    space = FreeSpace(box(0, 0, 40, 8), rig.bodies, rig.radius_m, rig.config.smoothing_m)
    bare, offered = box(0.1, 0.5, 7.0, 7.5), list[tuple[Swath, float]]()
    swaths_over_remains(bare, rig, space, WORTH, lambda swath, most_s: offered.append((swath, most_s)) is not None)
    ways = [(swath, most_s / WORTH.most_s_per_m2) for swath, most_s in offered]
    assert any((s.onwards_m is None) != (s.back_m is None) for s, _ in ways)
    for swath, gain_m2 in ways:
        for ends in (swath.onwards_m, swath.back_m):
            strip = None if ends is None else LineString(ends).buffer(0.5 * rig.working_width_m, cap_style="flat")
            assert strip is None or bare.intersection(strip).area > 0.9 * gain_m2


def test_remains_that_are_not_taken_get_no_swath(rig: Rig) -> None:
    space = FreeSpace(box(0, 0, 80, 60), rig.bodies, rig.radius_m, rig.config.smoothing_m)
    assert swaths_over_remains(box(30, 20, 40, 21.5), rig, space, WORTH, lambda _, __: False) == []


def test_passes_are_worked_with_all_their_fills_and_turns(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    boundary = ((0, 0), (77, 0), (77, 37), (58, 37), (58, 47), (0, 47))  # two fills begin at the same place
    assert mission.work is not None
    work = mission.work.model_copy(update={"turns": "reverse"})
    other = site.model_copy(update={"boundary_m": boundary, "no_go": ()})
    plan = plan_field(other, vehicle, harrow, work, planning.planner, 0)
    passes = [p for p in plan.headland_passes if p.fills or p.turns]
    assert any(p.fills for p in passes)
    assert any(p.turns for p in passes)
    expected = shapely.union_all([pass_coverage(p, plan.rig) for p in passes]).intersection(plan.drivable.free)
    assert expected.difference(plan.planned_area.buffer(0.05)).area < 0.1

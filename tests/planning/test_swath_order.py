"""Order of swaths that the mission sets: first swath next to a point, number left out between two."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
from pydantic import ValidationError
from shapely.geometry import LineString, Point, Polygon, box

from benchmarks.planning_check import check
from configs.mission import Mission, Work
from configs.site import DatumConfig
from configs.vehicle import MountedImplement, Vehicle
from planning.config import PlanningConfig
from planning.coverage.swath import Swath
from planning.coverage.swath_order import moved, skipping
from planning.field.field import FieldOutline
from planning.field.site_generation import site_within
from planning.plan import Plan, plan_field

DATUM = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
RECTANGLE = box(0.0, 0.0, 110.0, 80.0)
L_SHAPE = Polygon([(0, 0), (150, 0), (150, 50), (50, 50), (50, 140), (0, 140)])
POND = RECTANGLE.difference(box(45.0, 30.0, 65.0, 50.0))
Make = Callable[..., Plan]


@pytest.fixture(scope="module")
def planned(vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Make:
    known: dict[str, Plan] = {}
    assert mission.work is not None
    base = mission.work

    def make(field: Polygon, **changes: Any) -> Plan:
        key = f"{field.wkt} {changes}"
        if key not in known:
            work = Work.model_validate(base.model_dump() | {"turns": "reverse"} | changes)
            site = site_within(FieldOutline("order", DATUM, field), vehicle, harrow, work)
            known[key] = plan_field(site, vehicle, harrow, work, planning.planner, 1)
        return known[key]

    return make


def middle(swath: Any) -> LineString:
    ends = swath.onwards_m if swath.onwards_m is not None else swath.back_m
    return LineString(ends)


def rows_of(plan: Plan) -> list[int]:
    """Rank of the row of each swath of the largest block, in driving order; remains lie in other blocks."""
    swaths = [s for s in plan.swaths if isinstance(s, Swath) and s.length_m > 20.0]
    rows = sorted({s.row for s in swaths})
    return [rows.index(s.row) for s in swaths]


@pytest.mark.parametrize(
    ("count", "step", "expected"),
    [
        (8, 1, [0, 1, 2, 3, 4, 5, 6, 7]), (8, 2, [0, 2, 4, 6, 7, 5, 3, 1]), (7, 2, [0, 2, 4, 6, 5, 3, 1]),
        (9, 4, [0, 4, 8, 5, 1, 2, 6, 7, 3]), (5, 10, [0, 2, 4, 3, 1]), (1, 4, [0]), (0, 3, []),
    ],
)  # fmt: skip
def test_rows_left_out_are_worked_on_the_way_back(count: int, step: int, expected: list[int]) -> None:
    assert skipping(range(count), step) == expected


def test_lines_out_of_the_planned_order_are_counted(mission: Mission) -> None:
    assert mission.work is not None
    planned, skip = [(2, False), (0, True), (1, False)], mission.work.model_copy(update={"swath_skip": 1})
    assert moved(planned, [2, 0, 1], skip) == 0
    assert moved(planned, [2, 1], skip) == 0  # one that is not reached is not moved
    assert moved(planned, [2, 1, 0], skip) == 2
    first = mission.work.model_copy(update={"swaths_from_m": (0.0, 0.0)})
    assert moved(planned, [2, 1, 0], first) == 0
    assert moved(planned, [0, 2, 1], first) == 1


@pytest.mark.parametrize("turns", ["forward", "reverse"])
@pytest.mark.parametrize("skip", [0, 1, 3, 9])
def test_pattern_on_a_rectangle(skip: int, turns: str, planned: Make) -> None:
    plan, free = planned(RECTANGLE, swath_skip=skip, turns=turns), planned(RECTANGLE, turns=turns)
    rows = [r for k, r in enumerate(rows_of(plan)) if r not in rows_of(plan)[:k]]
    assert rows in (skipping(range(len(rows)), skip + 1), skipping(range(len(rows))[::-1], skip + 1))
    assert plan.moved_swaths == 0
    assert plan.planned_share > free.planned_share - 0.001


@pytest.mark.parametrize("turns", ["forward", "reverse"])
@pytest.mark.parametrize("point", [(55.0, -30.0), (55.0, 95.0), (2.0, 3.0), (108.0, 79.0)])
def test_first_swath_is_next_to_the_point(point: tuple[float, float], turns: str, planned: Make) -> None:
    """Also outside of the field."""
    plan, free = planned(RECTANGLE, swaths_from_m=point, turns=turns), planned(RECTANGLE, turns=turns)
    long = [s for s in plan.swaths if isinstance(s, Swath) and s.length_m > 20.0]
    gaps = [middle(s).distance(Point(point)) for s in long]
    assert gaps[0] == min(gaps)
    assert plan.moved_swaths == 0
    assert plan.planned_share > free.planned_share - 0.001


@pytest.mark.parametrize(("point", "skip"), [((25.0, 150.0), None), ((25.0, 150.0), 1), ((160.0, 20.0), 1)])
def test_block_next_to_the_point_is_first(point: tuple[float, float], skip: int | None, planned: Make) -> None:
    plan = planned(L_SHAPE, swaths_from_m=point, swath_skip=skip, headland_passes=1)
    blocks = [s.block for s in plan.swaths if isinstance(s, Swath) and s.length_m > 20.0]
    assert len(set(blocks)) == 2
    lines = {b: shapely.union_all([middle(s) for s in plan.swaths if s.block == b]) for b in blocks}
    assert min(lines, key=lambda b: lines[b].distance(Point(point))) == blocks[0]
    if skip is not None:
        assert sum(a != b for a, b in pairwise(blocks)) == 1  # one block after the other
    assert plan.planned_share > planned(L_SHAPE, headland_passes=1).planned_share - 0.002


def test_sides_of_a_pond_are_cells_of_their_own(planned: Make) -> None:
    plan = planned(POND, swath_skip=1, headland_passes=1, swath_direction_deg=0.0)
    beside = [s for s in plan.swaths if 35.0 < middle(s).centroid.y < 45.0 and s.length_m > 10.0]
    is_left = [middle(s).centroid.x < 55.0 for s in beside]
    assert sum(a != b for a, b in pairwise(is_left)) == 1
    assert plan.planned_share > planned(POND, headland_passes=1, swath_direction_deg=0.0).planned_share - 0.002


def test_along_a_curve_lines_are_left_out(planned: Make) -> None:
    x = np.linspace(-10.0, 120.0, 40)
    curve = tuple((float(a), float(40.0 + 6.0 * np.sin(a / 20.0))) for a in x)
    plan, free = planned(RECTANGLE, swath_curve_m=curve, swath_skip=1), planned(RECTANGLE, swath_curve_m=curve)
    rows = [s.row for s in plan.swaths if not isinstance(s, Swath)]
    found = sorted(set(rows))
    ranks = list(dict.fromkeys(found.index(r) for r in rows))
    assert ranks in (skipping(range(len(found)), 2), skipping(range(len(found))[::-1], 2))
    assert plan.planned_share > free.planned_share - 0.002


@pytest.mark.parametrize("headland", ["last", "none"])
def test_with_another_order_of_the_headland(headland: str, planned: Make) -> None:
    """Without passes other remains at the ends of the swaths are reached; what is not is reported with its reason."""
    plan, free = planned(RECTANGLE, swath_skip=2, headland=headland), planned(RECTANGLE, headland=headland)
    assert plan.planned_share > free.planned_share - (0.02 if headland == "none" else 0.002)
    bare = sum(plan.uncovered_m2.values()) / plan.field_area_m2
    assert bare == pytest.approx(1.0 - plan.planned_share, abs=0.002)


def test_by_an_independent_sweep(planned: Make, vehicle: Vehicle, harrow: MountedImplement) -> None:
    plan = planned(RECTANGLE, swath_skip=3, turns="reverse")
    found = check(plan.paths, RECTANGLE, RECTANGLE.buffer(-0.1), vehicle, harrow)
    assert found.outside_m == 0.0
    assert found.coverage == pytest.approx(plan.planned_share, abs=0.002)


@pytest.mark.parametrize(
    "changes", [{"swath_skip": -1}, {"swath_skip": 10}, {"swath_skip": 1.5}, {"swaths_from_m": [1]}]
)
def test_wrong_values_are_refused(changes: dict[str, Any], mission: Mission) -> None:
    assert mission.work is not None
    with pytest.raises(ValidationError, match=next(iter(changes))):
        Work.model_validate(mission.work.model_dump() | changes)

"""Larger margins along parts of the outline."""

from typing import Any

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, box

from configs.mission import EdgeMargin, Mission, Work
from configs.site import DatumConfig, Site
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.footprint import footprints
from messages.errors import FieldError
from planning.config import PlanningConfig
from planning.field.drivable_area import drivable_area_of
from planning.field.field import FieldOutline
from planning.field.site_generation import site_of, site_within
from planning.plan import EDGE_MARGIN, Plan, check_within, plan_field

FIELD = box(0.0, 0.0, 110.0, 70.0)
DATUM = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
DITCH = EdgeMargin(from_m=(110.0, 71.0), to_m=(0.0, 70.0), margin_m=3.0, reason="ditch")
CORNER = EdgeMargin(from_m=(20.0, -2.0), to_m=(-1.0, 30.0), margin_m=1.5, reason="hedge")  # around the first vertex
PARTS = (LineString([(0, 70), (110, 70)]), LineString([(20, 0), (0, 0), (0, 30)]))


@pytest.fixture(scope="module")
def planned(vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Any:
    def make(turns: str, margins: tuple[EdgeMargin, ...]) -> tuple[Plan, Work, Site]:
        assert mission.work is not None
        work = mission.work.model_copy(update={"turns": turns, "margins": margins})
        site = site_within(FieldOutline("margins", DATUM, FIELD), vehicle, harrow, work)
        return plan_field(site, vehicle, harrow, work, planning.planner, 1), work, site

    return make


def bodies(plan: Plan) -> Any:
    return np.concatenate([footprints(plan.rig.bodies, p.p_map_m[::3], p.heading_rad[::3]).ravel() for p in plan.paths])


@pytest.mark.parametrize("turns", ["forward", "reverse"])
def test_each_part_keeps_its_margin(turns: str, planned: Any) -> None:
    plan, work, _ = planned(turns, (DITCH, CORNER))
    swept = bodies(plan)
    for part, margin_m in zip(PARTS, (3.0, 1.5), strict=True):
        assert shapely.distance(swept, part).min() == pytest.approx(margin_m, abs=0.03)
    elsewhere = LineString([(40, 0), (110, 0), (110, 60)])
    assert shapely.distance(swept, elsewhere).min() == pytest.approx(work.boundary_margin_m, abs=0.03)


def test_strip_is_reported_as_bare(planned: Any) -> None:
    (plan, _, _), (plain, _, _) = planned("reverse", (DITCH,)), planned("reverse", ())
    assert plan.field_area_m2 == plain.field_area_m2 == pytest.approx(FIELD.area)
    strip_m2 = 110.0 * (3.0 - plain.drivable.margin_m)
    assert plan.uncovered_m2[EDGE_MARGIN] - plain.uncovered_m2[EDGE_MARGIN] == pytest.approx(strip_m2, rel=0.1)
    assert plain.planned_share - plan.planned_share == pytest.approx(strip_m2 / FIELD.area, rel=0.15)


def test_a_plan_without_the_margin_fails_its_check(planned: Any) -> None:
    plan, work, site = planned("reverse", ())
    with pytest.raises(FieldError, match="leaves the field"):
        check_within(plan, site, work.model_copy(update={"margins": (DITCH,)}))


def test_a_smaller_margin_changes_nothing(planned: Any) -> None:
    _, work, site = planned("reverse", ())
    small = DITCH.model_copy(update={"margin_m": 0.0})
    areas = [drivable_area_of(site, work.boundary_margin_m, edges) for edges in ((), (small,))]
    assert areas[0].allowed.equals(areas[1].allowed)


def test_a_part_without_length_is_refused(planned: Any) -> None:
    _, work, site = planned("reverse", ())
    point = DITCH.model_copy(update={"to_m": DITCH.from_m})
    with pytest.raises(FieldError, match=r"margin 'ditch': from .* are at the same place"):
        drivable_area_of(site, work.boundary_margin_m, (point,))


@pytest.mark.parametrize(("margin_m", "name"), [(7.0, "harrow"), (30.0, "harrow"), (7.0, "disc_harrow")])
def test_the_lane_leads_through_a_wide_margin(
    margin_m: float, name: str, vehicle: Vehicle, mission: Mission, planning: PlanningConfig,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    """Along the edge of the gate: the lane ends beyond it, and nothing is worked within."""
    assert mission.work is not None
    edge = EdgeMargin(from_m=(0.0, 0.0), to_m=(110.0, 0.0), margin_m=margin_m, reason="water")
    work, implement = mission.work.model_copy(update={"margins": (edge,)}), request.getfixturevalue(name)
    site = site_of(FieldOutline("margins", DATUM, FIELD), vehicle, implement, work)
    assert site.gates[0].posts_m[0][1] == pytest.approx(-0.5)
    assert site.lanes[0].center_m[-1][1] == pytest.approx(margin_m + 6.0, abs=0.2)
    plan = plan_field(site, vehicle, implement, work, planning.planner, 1)
    assert plan.planned_area.bounds[1] > margin_m - 0.03
    assert plan.planned_area.area > 0.93 * (70.0 - margin_m) * 110.0
    check_within(plan, site, work)


def test_a_lane_that_ends_within_a_margin_is_refused(
    vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    assert mission.work is not None
    site = site_of(FieldOutline("margins", DATUM, FIELD), vehicle, harrow, mission.work)
    edge = EdgeMargin(from_m=(0.0, 0.0), to_m=(110.0, 0.0), margin_m=9.0, reason="water")
    work = mission.work.model_copy(update={"margins": (edge,)})
    with pytest.raises(FieldError, match=r"the lane ends at x 55\.0 m, y 6\.0 m .* within a margin"):
        plan_field(site, vehicle, harrow, work, planning.planner, 1)


def test_a_trailed_implement_starts_a_margin_away_from_the_end_of_the_yard(
    vehicle: Vehicle, disc_harrow: TrailedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    assert mission.work is not None
    work = mission.work.model_copy(update={"boundary_margin_m": 5.0})
    site = site_of(FieldOutline("margins", DATUM, FIELD), vehicle, disc_harrow, work)
    plan = plan_field(site, vehicle, disc_harrow, work, planning.planner, 1)
    assert plan.planned_area.area > 0.9 * 60.0 * 100.0
    check_within(plan, site, work)

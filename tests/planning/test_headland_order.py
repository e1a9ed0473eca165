"""Headland passes before the swaths, after them, or none."""

from typing import Any
from unittest.mock import Mock

import pytest
from shapely.geometry import Polygon, box

from benchmarks.planning_check import check
from configs.mission import Mission
from configs.site import DatumConfig, Site
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from messages.plan import PathSectionType
from planning.config import PlanningConfig
from planning.coverage import route
from planning.field.field import FieldOutline
from planning.field.site_generation import site_within
from planning.plan import Plan, plan_field

FIELD = box(0.0, 0.0, 100.0, 70.0)
DATUM = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)


@pytest.fixture(scope="module")
def planned(vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Any:
    assert mission.work is not None
    work = mission.work

    def make(headland: str, turns: str, site: Site | None = None) -> Plan:
        changed = work.model_copy(update={"headland": headland, "turns": turns})
        where = site or site_within(FieldOutline("order", DATUM, FIELD), vehicle, harrow, changed)
        return plan_field(where, vehicle, harrow, changed, planning.planner, 1)

    return make


def order_of(plan: Plan) -> list[PathSectionType]:
    """Headland passes and swaths in driving order, each once."""
    types = [s.section_type for path in plan.paths for s in path.sections]
    lines = [t for t in types if t in (PathSectionType.HEADLAND, PathSectionType.SWATH)]
    return [t for k, t in enumerate(lines) if k == 0 or t is not lines[k - 1]]


@pytest.mark.parametrize("turns", ["forward", "reverse"])
@pytest.mark.parametrize("headland", ["last", "none"])
def test_by_an_independent_sweep(
    headland: str, turns: str, planned: Any, vehicle: Vehicle, harrow: MountedImplement, mission: Mission
) -> None:
    plan = planned(headland, turns)
    found = check(plan.paths, FIELD, FIELD.buffer(-mission.work.boundary_margin_m), vehicle, harrow)  # type: ignore[union-attr]
    assert found.outside_m == 0.0
    assert found.curvature_radpm < plan.rig.max_curvature_radpm
    assert found.coverage == pytest.approx(plan.planned_share, abs=0.002)
    least = {("last", "reverse"): 0.98, ("none", "reverse"): 0.95, ("last", "forward"): 0.7, ("none", "forward"): 0.45}
    assert found.coverage > least[headland, turns]
    bare = sum(plan.uncovered_m2.values()) / plan.field_area_m2
    assert bare == pytest.approx(1.0 - plan.planned_share, abs=0.002)


@pytest.mark.parametrize("turns", ["forward", "reverse"])
def test_order(turns: str, planned: Any) -> None:
    swath, headland = PathSectionType.SWATH, PathSectionType.HEADLAND
    assert order_of(planned("first", turns))[:2] == [headland, swath]
    assert order_of(planned("last", turns)) == [swath, headland]
    assert order_of(planned("none", turns)) == [swath]
    assert not planned("none", turns).headland_passes


def test_last_with_a_lane_leads_home(planned: Any, site: Site) -> None:
    plan = planned("last", "reverse", site)
    assert order_of(plan) == [PathSectionType.SWATH, PathSectionType.HEADLAND]
    assert plan.planned_share > 0.97
    last = plan.paths[-1].sections[-1]
    assert last.section_type is PathSectionType.LANE


@pytest.mark.parametrize("turns", ["forward", "reverse"])
def test_open_passes_follow_all_swaths(
    turns: str, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """In an arm too narrow for a closed pass."""
    assert mission.work is not None
    field = Polygon([(0, 0), (100, 0), (100, 30), (150, 30), (150, 39), (100, 39), (100, 60), (0, 60)])
    work = mission.work.model_copy(update={"headland": "last", "turns": turns, "overlap_m": 0.0})
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    site = site_within(FieldOutline("arm", DATUM, field), vehicle, narrow, work)
    plan = plan_field(site, vehicle, narrow, work, planning.planner, 1)
    assert order_of(plan) == [PathSectionType.SWATH, PathSectionType.HEADLAND]
    assert plan.planned_share > {"forward": 0.75, "reverse": 0.97}[turns]


@pytest.mark.slow
def test_last_with_a_trailed_implement(
    vehicle: Vehicle, disc_harrow: TrailedImplement, mission: Mission, planning: PlanningConfig,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """All passes are driven outwards of the swaths, and few tours are searched for it."""
    assert mission.work is not None
    tours = Mock(wraps=route.drive_lines)
    monkeypatch.setattr(route, "drive_lines", tours)
    field = Polygon([(0, 0), (110, 0), (110, 60), (70, 60), (70, 90), (0, 90)])
    work = mission.work.model_copy(update={"headland": "last", "overlap_m": 0.0})
    site = site_within(FieldOutline("L", DATUM, field), vehicle, disc_harrow, work)
    plan = plan_field(site, vehicle, disc_harrow, work, planning.planner, 1)
    assert order_of(plan) == [PathSectionType.SWATH, PathSectionType.HEADLAND]
    assert plan.planned_share > 0.9
    assert tours.call_count <= 3

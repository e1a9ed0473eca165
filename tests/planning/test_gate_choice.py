"""The gate of a surveyed site with several."""

import pytest

from configs.mission import Mission
from configs.site import Gate, Lane, Site
from configs.vehicle import MountedImplement, Vehicle
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.config import PlanningConfig
from planning.field.gate_choice import with_gate
from planning.plan import plan_field

EAST = Gate(name="east gate", posts_m=((58.0, -0.8), (66.0, -0.8)))
TO_EAST = (
    Lane(name="east 1", center_m=((20.0, -31.0), (20.0, -16.0), (40.0, -16.0)), width_m=16.0),
    Lane(name="east 2", center_m=((40.0, -16.0), (62.0, -16.0), (62.0, 6.0)), width_m=16.0),
)


@pytest.fixture(scope="module")
def two(site: Site) -> Site:
    """The demo site with a second gate, to which two lanes lead one after the other."""
    return site.model_copy(update={"gates": (*site.gates, EAST), "lanes": (*TO_EAST, *site.lanes)})


def test_shortest_way_or_gate_next_to_the_point(two: Site, site: Site) -> None:
    assert with_gate(two, None).lanes == site.lanes
    assert with_gate(two, (60.0, 5.0)).lanes == TO_EAST
    assert with_gate(two, (25.0, 0.0)).lanes == site.lanes
    assert with_gate(site, (25.0, 0.0)) == with_gate(site, None) == site


def test_a_gate_without_lane_and_a_site_without_gate_are_refused(two: Site, site: Site) -> None:
    with pytest.raises(FieldError, match=r"gate_m: no lane of site .* leads through 'east gate'"):
        with_gate(two.model_copy(update={"lanes": site.lanes}), (60.0, 0.0))
    with pytest.raises(FieldError, match=r"gate_m: site .* has no gate"):
        with_gate(site.model_copy(update={"gates": ()}), (60.0, 0.0))


def test_the_tour_begins_and_ends_at_the_chosen_gate(
    two: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    assert mission.work is not None
    plan = plan_field(with_gate(two, (62.0, 0.0)), vehicle, harrow, mission.work, planning.planner, 1)
    sections = [(path, s) for path in plan.paths for s in path.sections]
    assert sections[0][1].section_type is sections[-1][1].section_type is PathSectionType.LANE
    ways = [path.p_map_m[s.first : s.last + 1] for path, s in sections if s.section_type is PathSectionType.LANE]
    at_edge = [float(p[abs(p[:, 1]).argmin(), 0]) for p in ways if p[:, 1].min() < -2.0 < 2.0 < p[:, 1].max()]
    assert len(at_edge) == 2
    assert at_edge == pytest.approx([62.0, 62.0], abs=0.3)

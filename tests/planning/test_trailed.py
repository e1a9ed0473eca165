"""Plans with a trailed implement, checked by an integration of its own (`benchmarks/planning_check.py`); refusals."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.affinity import affine_transform
from shapely.geometry import Polygon, box

from benchmarks.planning_check import check
from configs.mission import Leg, Line, Mission, Work
from configs.site import DatumConfig, PoseConfig, Site
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.drawbar import Drawbar, Trailer, hitch_poses
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.config import PlanningConfig
from planning.field.field import FieldOutline
from planning.field.site_generation import site_of
from planning.plan import Plan, plan_field, plan_mission
from planning.rig import Rig, rig_of
from planning.turns.free_space import FreeSpace
from planning.turns.search import ConnectionRequest, find_turn

WORK = Work(
    headland_passes=7, overlap_m=0.0, work_speed_kmh=10, turn_speed_kmh=5, lane_speed_kmh=10, boundary_margin_m=0.1
)
FIELDS = {
    "rectangle": Polygon([(0, 0), (120, 0), (120, 80), (0, 80)]),
    "L": Polygon([(0, 0), (140, 0), (140, 65), (75, 65), (75, 120), (0, 120)]),
    "trapezoid": Polygon([(0, 0), (150, 0), (125, 80), (20, 80)]),
    "pond": Polygon([(0, 0), (160, 0), (160, 120), (0, 120)], [[(70, 50), (95, 48), (98, 66), (80, 74), (68, 64)]]),
}
LEAST_COVERAGE = {"rectangle": 0.96, "L": 0.95, "trapezoid": 0.96, "pond": 0.95}


@pytest.fixture(scope="module")
def rig(vehicle: Vehicle, disc_harrow: TrailedImplement, planning: PlanningConfig) -> Rig:
    return rig_of(vehicle, disc_harrow, WORK, planning.planner)


def site_around(polygon: Polygon, vehicle: Vehicle, implement: MountedImplement | TrailedImplement) -> Site:
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    return site_of(FieldOutline("test", datum, polygon), vehicle, implement, WORK)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("L", "pond")]


@pytest.fixture(scope="module", params=["rectangle", "trapezoid", *SLOW])
def planned(
    request: pytest.FixtureRequest, vehicle: Vehicle, disc_harrow: TrailedImplement, planning: PlanningConfig
) -> tuple[str, Plan]:
    site = site_around(FIELDS[request.param], vehicle, disc_harrow)
    return request.param, plan_field(site, vehicle, disc_harrow, WORK, planning.planner, 1)


def test_plan_against_its_own_integration(
    planned: tuple[str, Plan], vehicle: Vehicle, disc_harrow: TrailedImplement, planning: PlanningConfig
) -> None:
    name, plan = planned
    polygon = FIELDS[name]
    free = plan.drivable.allowed.union(polygon.buffer(-WORK.boundary_margin_m))
    found = check(plan.paths, polygon, free, vehicle, disc_harrow)
    assert found.outside_m == 0.0
    assert found.coverage > LEAST_COVERAGE[name]
    assert found.coverage == pytest.approx(plan.planned_share, abs=0.001)
    assert math.radians(45.0) < found.hitch_rad < math.radians(disc_harrow.max_hitch_deg)
    assert 0.01 < found.off_line_m <= planning.planner.line_tolerance_m + 0.001
    assert found.reverse_m == 0.0
    assert found.cusps == 0


def test_working_line_passes_both_ends_of_every_swath(planned: tuple[str, Plan]) -> None:
    _, plan = planned
    ends = {s.number: [e for e in (s.onwards_m, s.back_m) if e is not None] for s in plan.swaths}
    found, hitch_rad = 0, 0.0
    for path in plan.paths:
        p, heading = plan.rig.carriers(path.p_map_m, path.heading_rad, hitch_rad)
        left, right = plan.rig.working_edges(p, heading)
        middle = 0.5 * (left + right)
        for section in path.sections:
            if section.section_type is PathSectionType.SWATH:
                a, b = middle[section.first - 1], middle[section.last + 1]
                misses = [np.hypot(*(a - e[0])) + np.hypot(*(b - e[1])) for e in ends[section.line]]
                assert min(misses) < 0.35  # two steps, and the tolerance across
                found += 1
        hitch_rad = float(plan.rig.hitch_angles(path.p_map_m, path.heading_rad, hitch_rad)[-1])
    assert found == len(plan.swaths)


def test_check_finds_what_a_mounted_plan_would_do_wrong(
    vehicle: Vehicle, harrow: MountedImplement, disc_harrow: TrailedImplement, planning: PlanningConfig
) -> None:
    mounted = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0, "fold": None})
    site = site_around(FIELDS["L"], vehicle, mounted)
    plan = plan_field(site, vehicle, mounted, WORK, planning.planner, 1)
    free = plan.drivable.allowed.union(FIELDS["L"].buffer(-WORK.boundary_margin_m))
    assert check(plan.paths, FIELDS["L"], free, vehicle, mounted).outside_m == 0.0
    wrong = check(plan.paths, FIELDS["L"], free, vehicle, disc_harrow)
    assert wrong.off_line_m > 0.3
    assert wrong.outside_m > 0.02


def test_curvature_keeps_the_hitch_angle(vehicle: Vehicle, disc_harrow: TrailedImplement, rig: Rig) -> None:
    assert rig.radius_m > 1.0 / vehicle.drivetrain.max_curvature_radpm
    assert rig.max_curvature_radpm < vehicle.drivetrain.max_curvature_radpm
    assert rig.width_m == disc_harrow.width_m
    assert rig.rear_m == pytest.approx(disc_harrow.hitch_m - disc_harrow.total_length_m)
    assert rig.line_up_m > 10.0
    assert rig.min_swath_m > 5.0


@pytest.mark.parametrize("seed", range(4))
def test_trailed_clearance_against_shapely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    area = Polygon(
        [(0, 0), (80, 3), (95, 40), (60, 35), (52, 70), (20, 62), (-8, 30)], [[(30, 25), (40, 24), (42, 33)]]
    )
    machine, body = Rectangle(-1.0, 3.5, 2.3), Rectangle(-5.0, 0.0, 3.0)
    space = FreeSpace(area, (machine,), 5.0, 1.8, Trailer(body, Drawbar(-1.1, 3.7)))
    curvature = np.repeat(rng.uniform(-0.19, 0.19, 40), 25)
    heading = rng.uniform(0.0, 6.0) + np.cumsum(0.1 * curvature)
    p = np.array([25.0, 40.0]) + np.cumsum(0.1 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    hitch_rad = float(rng.uniform(-0.8, 0.8))
    shapes = [box(machine.rear_m, -1.15, machine.front_m, 1.15), box(body.rear_m, -1.5, body.front_m, 1.5)]
    poses = np.column_stack([p, heading]), hitch_poses(Drawbar(-1.1, 3.7), p, heading, hitch_rad)
    placed = [
        [affine_transform(shape, [math.cos(h), -math.sin(h), math.sin(h), math.cos(h), x, y]) for x, y, h in carried]
        for shape, carried in zip(shapes, poses, strict=True)
    ]
    is_out = ~np.array(shapely.covers(area, placed)).all(axis=0)
    is_near = shapely.distance(area.boundary, placed).min(axis=0) < 0.002
    found = space.touching(p, heading, hitch_rad)
    crossing = shapely.intersects(area.boundary, placed).any(axis=0)
    assert found[crossing & ~is_near].all()
    assert is_out.any()
    first = int(np.argmax(is_out))
    assert not found[:first][~is_near[:first]].any()
    assert space.is_free(p[:first], heading[:first], hitch_rad) == (not found[:first].any())


def test_turn_ends_with_the_implement_in_line(rig: Rig) -> None:
    space = rig.space(box(0.0, 0.0, 120.0, 60.0))
    goal, start = Pose2(60.0, 20.0, math.pi), Pose2(60.0, 40.0, 0.0)
    request = ConnectionRequest(start, goal, 1.0, rig.line_up_m, most_hitch_rad=rig.tolerance_rad)
    turn = find_turn(request, space, rig.turn_times)
    loose = find_turn(replace(request, most_hitch_rad=math.inf), space, rig.turn_times)
    assert turn is not None
    assert loose is not None
    assert abs(turn.hitch_rad) <= rig.tolerance_rad < abs(loose.hitch_rad)
    assert loose.time_s < turn.time_s
    for angle in (0.0, 0.6, -0.6):  # the angle at the start is known, and counts
        found = find_turn(replace(request, hitch_rad=angle), space, rig.turn_times)
        assert found is not None
        assert space.is_free(found.legs[0].p_map_m, found.legs[0].heading_rad, angle)
    beside = replace(request, start=Pose2(60.0, 58.4, 0.0))
    assert find_turn(beside, space, rig.turn_times) is not None
    assert find_turn(replace(beside, hitch_rad=-0.3), space, rig.turn_times) is None  # its end is outside


def test_lane_whose_bends_the_implement_cuts(
    vehicle: Vehicle, disc_harrow: TrailedImplement, planning: PlanningConfig
) -> None:
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    outline = FieldOutline("lane", datum, FIELDS["rectangle"])
    work = WORK.model_copy(update={"lane_m": ((60.0, 0.0), (60.0, -25.0), (85.0, -33.0), (85.0, -60.0))})
    site = site_of(outline, vehicle, disc_harrow, work)
    with pytest.raises(FieldError, match=r"does not fit on the lane .* the trailed implement cuts them"):
        plan_field(site, vehicle, disc_harrow, work, planning.planner, 1)


def test_refusals(
    mission: Mission, site: Site, vehicle: Vehicle, disc_harrow: TrailedImplement, planning: PlanningConfig
) -> None:
    start = site.start
    with pytest.raises(FieldError, match=r"'disc harrow 3 m' is trailed and does not reverse: into bay 'wide'"):
        plan_mission(mission, site, vehicle, disc_harrow, planning, start, 1)
    reverse = WORK.model_copy(update={"turns": "reverse"})
    open_mission = mission.model_copy(update={"bay": None, "work": reverse})
    with pytest.raises(FieldError, match="is trailed and does not reverse: set turns: forward"):
        plan_mission(open_mission, site, vehicle, disc_harrow, planning, start, 1)
    curved = WORK.model_copy(update={"turns": "forward", "swath_curve_m": ((0.0, 0.0), (20.0, 4.0), (40.0, 0.0))})
    for work in (curved, WORK.model_copy(update={"turns": "forward", "headland": "none"})):
        with pytest.raises(FieldError, match="is trailed: straight swaths with headland passes only"):
            plan_field(site, vehicle, disc_harrow, work, planning.planner, 1)
    within = PoseConfig(x_m=40.0, y_m=30.0, heading_deg=0.0)
    back = Line(speed_kmh=5.0, legs=(Leg(length_m=10.0), Leg(length_m=5.0, is_reverse=True)))
    names = {"name": "line", "site": "demo", "machine": "tractor_e", "implement": "disc_harrow_3m"}
    line_mission = Mission(**names, line=back, start=within)
    with pytest.raises(FieldError, match="leave out the reverse legs"):
        plan_mission(line_mission, site, vehicle, disc_harrow, planning, start, 1)
    tight = Line(speed_kmh=5.0, legs=(Leg(length_m=6.0), Leg(length_m=12.0, curvature_radpm=0.215)))
    narrow = disc_harrow.model_copy(update={"max_hitch_deg": 40.0})
    with pytest.raises(FieldError, match=r"would turn by \d+° against the machine .* max_hitch_deg is 40"):
        plan_mission(line_mission.model_copy(update={"line": tight}), site, vehicle, narrow, planning, within, 1)

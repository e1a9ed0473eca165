"""Plans of fields of several shapes, verified by an independent check, and refusals."""

import math
from itertools import pairwise
from pathlib import Path as FilePath

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, Polygon, box

from configs.mission import Mission, Work
from configs.site import Area, DatumConfig, Gate, Site
from configs.vehicle import MountedImplement, Vehicle
from geometry.polygon import as_polygon
from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import Path, PathSectionType
from planning.config import PlanningConfig
from planning.coverage.insertion import Stop, Tour
from planning.coverage.swath import Swath
from planning.coverage.work_line import WorkLine
from planning.drawing import draw_plan
from planning.export.geojson import plan_to_geojson
from planning.field.field import FieldOutline, with_no_go
from planning.field.site_generation import site_of, site_within
from planning.plan import NARROW_PART, NARROW_PASSAGE, Plan, plan_field, worked_area, working_inside
from planning.turns.free_space import FreeSpace
from planning.turns.sampling import sampled_connection
from planning.turns.search import Connection, ConnectionRequest, straight
from planning.turns.turn import is_free

SHAPES: dict[str, tuple[tuple[tuple[float, float], ...], tuple[Area, ...]]] = {
    "L": (((0, 0), (80, 0), (80, 40), (45, 40), (45, 70), (0, 70)), ()),
    "trapezoid": (((0, 0), (80, 0), (66, 45), (10, 45)), ()),
    "pond": (
        ((0, 0), (90, 0), (90, 70), (0, 70)),
        (Area(name="pond", outline_m=((46, 38), (52, 37), (53, 42), (47, 43))),),
    ),
    "narrow about a pond": (  # the pass around it ends where no turn is possible
        ((0, 0), (80, 0), (80, 58), (0, 58)),
        (Area(name="pond", outline_m=((38, 26), (47, 25), (48, 31), (43, 35), (37, 32))),),
    ),
}
REVERSE = {"demo, reverse": "demo", "L, reverse": "L"}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("pond", "narrow about a pond")]


@pytest.fixture(scope="module", params=["demo", "L", "trapezoid", *REVERSE, *SLOW])
def shaped(
    request: pytest.FixtureRequest,
    plan: Plan,
    site: Site,
    vehicle: Vehicle,
    harrow: MountedImplement,
    mission: Mission,
    planning: PlanningConfig,
) -> tuple[Site, Plan]:
    if request.param == "demo":
        return site, plan
    name, work = request.param, mission.work
    if name in REVERSE:
        name, work = REVERSE[name], work.model_copy(update={"turns": "reverse"})
    boundary, no_go = SHAPES.get(name, (site.boundary_m, ()))
    other = site.model_copy(update={"boundary_m": boundary, "no_go": no_go})
    return other, plan_field(other, vehicle, harrow, work, planning.planner, 0)


def body_shapes(vehicle: Vehicle, harrow: MountedImplement, path: Path) -> list[shapely.Polygon]:
    """All bodies at all points, by affine transforms of shapely, independent of the planner."""
    from shapely.affinity import affine_transform

    b, half = vehicle.body, harrow.width_m / 2
    machine = box(-b.rear_m, -b.width_m / 2, b.front_m, b.width_m / 2)
    base = [machine, box(harrow.rear_end_m, -half, harrow.front_end_m, half)]
    found = []
    for (x, y), h in zip(path.p_map_m, path.heading_rad, strict=True):
        c, s = math.cos(h), math.sin(h)
        found += [affine_transform(shape, [c, -s, s, c, x, y]) for shape in base]
    return found


def test_bodies_inside_drivable_area(shaped: tuple[Site, Plan], vehicle: Vehicle, harrow: MountedImplement) -> None:
    site, plan = shaped
    field = Polygon(site.boundary_m)
    lanes = [LineString(lane.center_m).buffer(lane.width_m / 2, cap_style="flat") for lane in site.lanes]
    drivable = shapely.union_all([field, Polygon(site.yard.outline_m), *lanes])
    drivable = drivable.difference(shapely.union_all([Polygon(a.outline_m) for a in site.no_go]))
    gate = LineString(site.gates[0].posts_m).buffer(1.5, cap_style="flat")
    fence = field.exterior.difference(gate)
    shapely.prepare(drivable)
    bodies = np.array([shape for path in plan.paths for shape in body_shapes(vehicle, harrow, path)])
    assert shapely.covers(drivable, bodies).all()
    posts = shapely.MultiPoint(site.gates[0].posts_m)
    assert shapely.distance(bodies, fence.union(posts)).min() > 0.09


def test_path_consistency(shaped: tuple[Site, Plan]) -> None:
    site, plan = shaped
    for path in plan.paths:
        gaps = np.hypot(*np.diff(path.p_map_m, axis=0).T)
        assert gaps.max() < 0.105
        assert gaps.min() > 0.08
        assert np.diff(path.s_m) == pytest.approx(gaps)
        heading = np.unwrap(path.heading_rad)
        travel = np.arctan2(*(path.direction * np.diff(path.p_map_m, axis=0)).T[::-1])
        assert np.abs(np.angle(np.exp(1j * (travel - heading[:-1])))).max() < 0.02
        assert np.abs(path.curvature_radpm).max() < 1 / 4.6
        assert np.abs(np.diff(path.curvature_radpm)).max() < 0.03
        assert path.speed_mps[-1] == 0
        assert path.speed_mps[:-1].min() > 0
        v2 = np.diff(path.speed_mps**2) / (2 * gaps)
        assert v2.max() < 0.61
        assert v2.min() > -0.51
    assert plan.paths[0].p_map_m[0] == pytest.approx([site.start.x_m, site.start.y_m])
    assert Polygon(site.yard.outline_m).contains(shapely.Point(plan.paths[-1].p_map_m[-1]))
    assert [path.is_last for path in plan.paths] == [False] * (len(plan.paths) - 1) + [True]


def test_paths_join_at_standstill_and_work_forward(shaped: tuple[Site, Plan]) -> None:
    paths = shaped[1].paths
    for a, b in pairwise(paths):
        assert a.direction == -b.direction
        assert a.p_map_m[-1] == pytest.approx(b.p_map_m[0], abs=0.01)
        assert math.remainder(a.heading_rad[-1] - b.heading_rad[0], 2 * math.pi) == pytest.approx(0.0, abs=0.01)
    assert not any(path.is_working.any() for path in paths if path.direction < 0)


def test_sections_cover_path(shaped: tuple[Site, Plan]) -> None:
    for path in shaped[1].paths:
        assert path.sections[0].first == 0
        assert path.sections[-1].last == len(path.s_m) - 1
        for k, (a, b) in enumerate(zip(path.sections[:-1], path.sections[1:], strict=True)):
            assert b.first == a.last + 1
            assert (path.section_index[a.first : a.last + 1] == k).all()
        work = path.is_working.astype(bool)
        section_types = np.array([path.sections[k].section_type for k in path.section_index])
        is_line = np.isin(section_types, [PathSectionType.SWATH, PathSectionType.HEADLAND])
        assert (is_line <= work).all()
        assert (work & ~is_line).sum() <= 2 * len(path.sections)


def test_straight_line_up_before_swath(shaped: tuple[Site, Plan]) -> None:
    for path in shaped[1].paths:
        for t in path.sections:
            if t.section_type is PathSectionType.SWATH:
                before = slice(max(0, t.first - 15), t.last - 8)
                assert np.abs(path.curvature_radpm[before]).max() < 0.01


def test_planned_and_uncovered_area(shaped: tuple[Site, Plan]) -> None:
    site, plan = shaped
    free = Polygon(site.boundary_m).area - sum(Polygon(a.outline_m).area for a in site.no_go)
    assert plan.field_area_m2 == pytest.approx(free)
    assert plan.planned_share > 0.94
    listed = sum(u.area_m2 for u in plan.uncovered)
    assert sum(plan.uncovered_m2.values()) == pytest.approx(listed)
    assert plan.planned_area.area + listed == pytest.approx(free, rel=0.003)
    assert plan.length_m == pytest.approx(sum(float(path.s_m[-1]) for path in plan.paths))


def test_demo_coverage(plan: Plan) -> None:
    assert plan.planned_share >= 0.95
    assert len(plan.headland_passes) == 2
    assert plan.length_m < 1050


def test_plan_determinism(
    plan: Plan, site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    again = plan_field(site, vehicle, harrow, mission.work, planning.planner, 0).paths[0]
    for name in ("p_map_m", "heading_rad", "curvature_radpm", "s_m", "speed_mps", "is_working", "section_index"):
        assert getattr(again, name).tobytes() == getattr(plan.paths[0], name).tobytes()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"boundary_m": ((0, 0), (15, 0), (15, 15), (0, 15))}, "does not fit on the lane"),
        ({"boundary_m": ((19, 0), (21, 0), (21, 2), (19, 2))}, "too small for this"),
        ({"boundary_m": ((0, 0), (80, 0), (0, 50), (80, 50))}, "Self-intersection"),
        ({"gates": (Gate(name="narrow", posts_m=((17.5, 0), (22.5, 0))),)}, "widen gate"),
        ({"lanes": ()}, "no lane"),
        ({"yard": Area(name="yard", outline_m=((16, -31), (24, -31), (24, -25), (16, -25)))}, "lane|yard"),
    ],
)
def test_plan_refusals(
    change: dict[str, object], words: str, site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission,
    planning: PlanningConfig,
) -> None:  # fmt: skip
    with pytest.raises(FieldError, match=words):
        plan_field(site.model_copy(update=change), vehicle, harrow, mission.work, planning.planner, 0)


def test_given_swath_direction(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    work = Work(**{**mission.work.model_dump(), "swath_direction_deg": 90.0, "headland_passes": 2})
    plan = plan_field(site, vehicle, harrow, work, planning.planner, 0)
    ends = [e for s in plan.swaths for e in (s.onwards_m, s.back_m) if e is not None]
    assert all(abs(a[0] - b[0]) < 1e-6 for a, b in ends)
    assert len(plan.swaths) > 8


@pytest.mark.parametrize(("low", "high"), [(49, 58), (30, 41)])
def test_part_beyond_a_neck(
    low: float, high: float, site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission,
    planning: PlanningConfig,
) -> None:  # fmt: skip
    """The headland passes beyond a neck, too narrow for a closed pass, are reached."""
    boundary = (
        (0, 0), (70, 0), (70, low), (95, low), (95, 0), (150, 0), (150, 60), (95, 60), (95, high), (70, high),
        (70, 60), (0, 60),
    )  # fmt: skip
    work = mission.work.model_copy(update={"turns": "reverse"})
    divided = site.model_copy(update={"boundary_m": boundary})
    plan = plan_field(divided, vehicle, harrow, work, planning.planner, 0)
    beyond = box(96, 1, 149, 59)
    assert plan.planned_area.intersection(beyond).area > 0.95 * beyond.area


def test_no_margin(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    work = mission.work.model_copy(update={"boundary_margin_m": 0.0})
    assert plan_field(site, vehicle, harrow, work, planning.planner, 0).planned_share > 0.95


def test_nothing_is_worked_outside_of_an_area(plan: Plan) -> None:
    """As on the lane in the gate, where machine and implement may be."""
    low_x, low_y, high_x, high_y = plan.drivable.inner.bounds
    half = plan.drivable.inner.intersection(box(low_x, low_y, 0.5 * (low_x + high_x), high_y))
    before, after = (worked_area(paths, plan.rig) for paths in (plan.paths, working_inside(plan.paths, plan.rig, half)))
    assert before.difference(half).area > 0.3 * before.area
    assert after.difference(half.buffer(0.06)).area < 0.1
    assert after.intersection(half).area > 0.9 * before.intersection(half).area


def test_dead_end(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """An arm of the field too narrow to turn in is worked, and left in reverse."""
    boundary = ((0, 0), (60, 0), (60, 20), (95, 20), (95, 29), (60, 29), (60, 45), (0, 45))
    work = mission.work.model_copy(update={"turns": "reverse"})
    dead_end = site.model_copy(update={"boundary_m": boundary})
    plan = plan_field(dead_end, vehicle, harrow, work, planning.planner, 0)
    arm = box(62, 20, 95, 29)
    assert plan.planned_area.intersection(arm).area > 0.7 * arm.area


@pytest.mark.parametrize(("headland", "share"), [("first", 0.98), ("none", 0.45)])
def test_headland_too_shallow_for_turns_forwards(
    headland: str, share: float, site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission,
    planning: PlanningConfig,
) -> None:  # fmt: skip
    """Two passes of 3 m leave no room for turns of 5 m at the ends of swaths: there are as many as it needs."""
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    work = mission.work.model_copy(update={"headland": headland})
    outline = FieldOutline("rectangle", site.datum, box(0, 0, 100, 60))
    plan = plan_field(site_within(outline, vehicle, narrow, work), vehicle, narrow, work, planning.planner, 0)
    assert plan.rig.headland_passes(work) == 4 > work.headland_passes
    assert plan.planned_share > share


def test_swaths_forwards_end_where_there_is_room_to_turn(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """A strip has room for two passes, half as deep as a turn: its swaths reached to them, and none was reached."""
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    outline = FieldOutline("strip", site.datum, box(0, 0, 150, 23))
    work = mission.work.model_copy(update={"turns": "forward"})
    plan = plan_field(site_within(outline, vehicle, narrow, work), vehicle, narrow, work, planning.planner, 0)
    assert plan.planned_share > 0.85


def test_no_pass_around_a_small_part(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """A strip too narrow for a second pass, with a wider place: a circle there would cut all swaths of the strip."""
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    field = as_polygon(box(0, 0, 120, 18).union(Point(60, 9).buffer(11)))
    work = mission.work.model_copy(update={"turns": "reverse", "headland_passes": 3})
    outline = FieldOutline("strip", site.datum, field)
    plan = plan_field(site_within(outline, vehicle, narrow, work), vehicle, narrow, work, planning.planner, 0)
    assert plan.planned_share > 0.97
    assert [p.number for p in plan.headland_passes if p.is_closed] == [0]


def test_bent_strip_too_narrow_for_a_closed_pass(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """Open passes follow both sides, which swaths would leave bare beside the bends."""
    middle = LineString([(60, 20), (20, 20), (-40, 28), (-95, 45), (-140, 70)])
    boundary = tuple(shapely.get_coordinates(middle.buffer(6.5, cap_style="flat").exterior)[:-1].tolist())
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    work = mission.work.model_copy(update={"turns": "reverse"})
    outline = FieldOutline("strip", site.datum, Polygon(boundary))
    plan = plan_field(site_within(outline, vehicle, narrow, work), vehicle, narrow, work, planning.planner, 0)
    assert plan.planned_share > 0.94
    open_passes = [p for p in plan.headland_passes if p.is_two_way]
    assert sum(len(p.points_m) for p in open_passes) > 2000


def test_tail_narrower_than_the_rig(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    tail = box(60, 20, 80, 24.5)
    field = as_polygon(shapely.union_all([box(0, 0, 60, 45), tail]))
    plan = plan_field(
        site_within(FieldOutline("tail", site.datum, field), vehicle, harrow, mission.work), vehicle, harrow,
        mission.work, planning.planner, 0,
    )  # fmt: skip
    assert plan.uncovered_m2[NARROW_PART] == pytest.approx(tail.area, rel=0.1)


def test_two_parts_joined_by_a_narrow_way(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """The inner passes and swaths of both parts are driven, wherever the first passes end."""
    boundary = ((0, 0), (60, 0), (60, 62), (110, 62), (110, 0), (170, 0), (170, 72), (0, 72))
    work = mission.work.model_copy(update={"turns": "reverse"})
    joined = site.model_copy(update={"boundary_m": boundary})
    plan = plan_field(joined, vehicle, harrow, work, planning.planner, 0)
    assert plan.planned_share > 0.96
    driven = {s.line for p in plan.paths for s in p.sections if s.section_type is PathSectionType.SWATH}
    assert driven == {s.number for s in plan.swaths}


@pytest.mark.parametrize("is_inwards", [False, True])
def test_excursion_ends_where_it_began(is_inwards: bool) -> None:
    """Works and reverses out, or reverses in and works out, along the same way."""
    start, near, far = (Pose2(x, 0, math.pi if is_inwards else 0.0) for x in (0, 8, 20))
    way = Connection((straight(near, start) if is_inwards else straight(start, near),), 5.0)
    leg = straight(far, near) if is_inwards else straight(near, far)
    line = WorkLine(PathSectionType.SWATH, 3, (leg, None), Swath(3, None, None))
    tour = Tour(start, [Stop(line, False, way, is_excursion=True, is_inwards=is_inwards)])
    legs = [piece.leg for piece in tour.pieces]
    assert [leg.direction for leg in legs] == ([-1, -1, 1, 1] if is_inwards else [1, 1, -1, -1])
    assert [piece.is_working for piece in tour.pieces] == [False, not is_inwards, is_inwards, False]
    assert legs[-1].pose(-1) == legs[0].pose(0) == tour.place(1)[0]
    for a, b in pairwise(legs):
        assert a.pose(-1) == pytest.approx(b.pose(0))


def test_figure_and_geojson(plan: Plan, site: Site, tmp_path: FilePath) -> None:
    draw_plan(plan, site, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").read_bytes()[:4] == b"\x89PNG"
    content = plan_to_geojson(plan, site)
    lon, lat = content["features"][0]["geometry"]["coordinates"][0][0]
    assert abs(lon - site.datum.longitude_deg) < 0.002
    assert abs(lat - site.datum.latitude_deg) < 0.002
    assert sum(f["properties"].get("section_type") == "swath" for f in content["features"]) == len(plan.swaths)


CORNER = Polygon([(0, 0), (89.4, 0), (89.4, 100), (44.7, 100), (44.7, 55.6), (0, 55.6)])


@pytest.mark.parametrize(
    ("no_go", "gate", "share"),
    [
        (box(37.81, 20.23, 54.49, 36.97), (44.7, 87.1), 0.88),
        (box(51.27, -2.87, 56.46, 8.61), (85.2, 100.0), 0.94),
        (box(41.26, 33.97, 58.63, 39.7), (50.1, 100.0), 0.9),
    ],
)
def test_pass_that_cannot_be_left_is_driven_elsewhere(
    no_go: Polygon, gate: tuple[float, float], share: float, vehicle: Vehicle, harrow: MountedImplement,
    mission: Mission, planning: PlanningConfig,
) -> None:  # fmt: skip
    """Where the last pass ended beside the edge no line was reached from it, and the field was refused."""
    assert mission.work is not None
    outline = FieldOutline("corner", DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0), CORNER)
    outline = with_no_go(outline, [tuple((float(x), float(y)) for x, y in no_go.exterior.coords[:-1])])
    work = mission.work.model_copy(update={"gate_m": gate})
    plan = plan_field(site_of(outline, vehicle, harrow, work), vehicle, harrow, work, planning.planner, 0)
    assert plan.planned_share > share


def test_sampling_determinism(plan: Plan) -> None:
    ell = Polygon([(0, 0), (60, 0), (60, 28), (28, 28), (28, 60), (0, 60)])
    space = FreeSpace(ell, plan.rig.bodies, plan.rig.radius_m, plan.rig.config.smoothing_m)
    request = ConnectionRequest(Pose2(50, 14, math.pi), Pose2(14, 48, math.pi / 2), 1.0, 2.0)
    connection, again = (sampled_connection(request, space, 7, 8000) for _ in range(2))
    assert connection is not None
    assert again is not None
    assert connection.tobytes() == again.tobytes()
    assert is_free(connection, space)
    assert sampled_connection(ConnectionRequest(Pose2(50, 11, 0), Pose2(12, 80, 0), 1.0, 1.0), space, 7, 200) is None


SMALL, LARGE = box(0.0, 0.0, 60.0, 50.0), box(90.0, 0.0, 170.0, 60.0)


def field_of_two_parts(passage_m: float) -> FieldOutline:
    field = shapely.union_all([SMALL, box(60.0, 20.0, 90.0, 20.0 + passage_m), LARGE])
    return FieldOutline("two", DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0), as_polygon(field))


@pytest.mark.parametrize(("passage_m", "has_fold"), [(4.0, False), (2.4, True)])
def test_part_behind_a_passage_that_is_too_narrow(
    passage_m: float, has_fold: bool, vehicle: Vehicle, harrow: MountedImplement, mission: Mission,
    planning: PlanningConfig,
) -> None:  # fmt: skip
    outline, work = field_of_two_parts(passage_m), mission.work
    assert work is not None
    mounted = harrow if has_fold else harrow.model_copy(update={"fold": None})
    start = site_within(outline, vehicle, mounted, work).start
    assert LARGE.contains(Point(start.x_m, start.y_m))
    plan = plan_field(site_of(outline, vehicle, mounted, work), vehicle, mounted, work, planning.planner, 0)
    assert plan.planned_area.intersection(SMALL).area == 0.0
    assert plan.planned_area.intersection(LARGE).area > 0.9 * LARGE.area
    assert plan.uncovered_m2[NARROW_PASSAGE] == pytest.approx(SMALL.area, rel=0.05)
    assert not any(path.is_transport for path in plan.paths)


@pytest.mark.parametrize(("passage_m", "has_fold"), [(4.0, True), (7.0, False)])
def test_part_behind_a_passage_is_reached(
    passage_m: float, has_fold: bool, vehicle: Vehicle, harrow: MountedImplement, mission: Mission,
    planning: PlanningConfig,
) -> None:  # fmt: skip
    """Of a rig of 6.1 m: its sweep stays inside, where it folds with the folded one on the ways there and back."""
    assert mission.work is not None
    outline, work = field_of_two_parts(passage_m), mission.work.model_copy(update={"turns": "reverse"})
    mounted = harrow if has_fold else harrow.model_copy(update={"fold": None})
    plan = plan_field(site_of(outline, vehicle, mounted, work), vehicle, mounted, work, planning.planner, 0)
    for part in (SMALL, LARGE):
        assert plan.planned_area.intersection(part).area > 0.9 * part.area
    folded = [path.is_transport for path in plan.paths]
    assert sum(a and not b for a, b in pairwise(folded)) == 2
    assert not any(path.is_working.any() for path in plan.paths if path.is_transport)
    allowed = plan.drivable.allowed
    shapely.prepare(allowed)
    for path in plan.paths:
        bodies = body_shapes(vehicle, mounted.folded if path.is_transport else mounted, path)
        assert shapely.covers(allowed, np.array(bodies)).all()
    for a, b in pairwise(plan.paths):
        assert a.p_map_m[-1] == pytest.approx(b.p_map_m[0], abs=0.01)
        assert math.remainder(a.heading_rad[-1] - b.heading_rad[0], 2 * math.pi) == pytest.approx(0.0, abs=0.01)
    driven = {s.line for p in plan.paths for s in p.sections if s.section_type is PathSectionType.SWATH}
    assert sorted(driven) == sorted(s.number for s in plan.swaths)


def test_dead_end_behind_a_passage_is_left_backwards(
    vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """A strip in which a rig of 6.1 m works and cannot turn round, behind a neck that it passes folded."""
    assert mission.work is not None
    strip, neck = box(67.0, 20.0, 127.0, 27.5), box(60.0, 20.0, 67.0, 24.0)
    field = as_polygon(shapely.union_all([SMALL, neck, strip]))
    outline = FieldOutline("tail", DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0), field)
    work = mission.work.model_copy(update={"turns": "reverse"})
    plan = plan_field(site_of(outline, vehicle, harrow, work), vehicle, harrow, work, planning.planner, 0)
    assert plan.planned_area.intersection(strip).area > 0.8 * strip.area
    folded = [path for path in plan.paths if path.is_transport and strip.contains(Point(*path.p_map_m[0]))]
    assert any(path.direction < 0 for path in folded)


@pytest.mark.parametrize("name", ["rectangle", "round", "pond"])
def test_pass_along_the_edge_is_left_forwards(
    name: str, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """By a departure: in a turn the tail would swing over the edge."""
    assert mission.work is not None
    polygon = {
        "rectangle": box(0.0, 0.0, 200.0, 100.0),
        "round": Point(0, 0).buffer(40.0, quad_segs=24),
        "pond": box(0.0, 0.0, 240.0, 150.0) - Point(120, 75).buffer(25),
    }
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0, "fold": None})
    work = mission.work.model_copy(update={"turns": "forward", "headland_passes": 4})
    outline = FieldOutline(name, datum, as_polygon(polygon[name]))
    plan = plan_field(site_within(outline, vehicle, narrow, work), vehicle, narrow, work, planning.planner, 0)
    assert 0 in {p.number for p in plan.headland_passes if p.is_closed}
    assert plan.planned_share > 0.98

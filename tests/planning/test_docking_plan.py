"""Docking plans: Reeds-Shepp paths, curvature ramps, clearance, and refusals with position."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path as FilePath

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import affine_transform
from shapely.geometry import LineString, Point, Polygon, box

from configs.mission import Mission
from configs.site import PoseConfig, Site
from configs.vehicle import MountedImplement, Vehicle
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from messages.errors import FieldError
from messages.plan import Path, PathSectionType
from planning.config import PlanningConfig
from planning.docking.clearance import Bounds, clearance_m
from planning.docking.curvature_ramps import runs_of, solve_endpoint
from planning.docking.dock import Docking, end_of, plan_docking, plan_undocking
from planning.docking.reeds_shepp import Segment, cusps, length_m, reeds_shepp_paths
from planning.drawing import draw_plan
from planning.export.geojson import plan_to_geojson
from planning.plan import plan_mission
from planning.rig import rig_of

POSES = st.builds(Pose2, st.floats(-20, 20), st.floats(-20, 20), st.floats(-7, 7))
LANE_END = Pose2(20.0, -30.0, -math.pi / 2)


@pytest.fixture(params=["narrow", "wide"])
def docking(
    request: pytest.FixtureRequest, site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig
) -> Docking:
    return docking_in(request.param, site, vehicle, harrow, planning)


def docking_in(
    bay: str, site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig
) -> Docking:  # fmt: skip
    rig = rig_of(vehicle, harrow.folded, None, planning.planner)
    return Docking(site, rig, site.bay(bay), planning.docking, 0)


def starts(count: int) -> list[Pose2]:
    """Poses within 3 m and 20 degrees of the end of the lane."""
    drawn = np.random.default_rng(7).uniform(size=(count, 3))
    return [
        Pose2(
            20.0 + 3.0 * math.sqrt(r) * math.cos(6.2832 * a), -30.0 + 3.0 * math.sqrt(r) * math.sin(6.2832 * a),
            math.radians(-110.0 + 40.0 * h),
        )
        for r, a, h in drawn
    ]  # fmt: skip


# Reeds-Shepp paths


@settings(derandomize=True, max_examples=150, deadline=None)
@given(POSES, POSES, st.floats(3.0, 8.0))
def test_reeds_shepp_paths_end_at_goal(start: Pose2, goal: Pose2, radius: float) -> None:
    found = reeds_shepp_paths(start, goal, radius)
    assert np.diff([length_m(w) for w in found]).min(initial=0.0) > -1e-8
    for word in found:
        end = driven(word, start)
        assert math.hypot(end.x_m - goal.x_m, end.y_m - goal.y_m) < 1e-5
        assert abs(math.remainder(end.yaw_rad - goal.yaw_rad, 2 * math.pi)) < 1e-6


def driven(word: tuple[Segment, ...], pose: Pose2) -> Pose2:
    for length, k in word:
        h = pose.yaw_rad + k * length
        if k == 0.0:
            pose = pose.ahead(length)
            continue
        x = pose.x_m + (math.sin(h) - math.sin(pose.yaw_rad)) / k
        pose = Pose2(x, pose.y_m - (math.cos(h) - math.cos(pose.yaw_rad)) / k, h)
    return pose


@settings(derandomize=True, max_examples=100, deadline=None)
@given(POSES, POSES)
def test_shortest_reeds_shepp_path_against_ompl(start: Pose2, goal: Pose2) -> None:
    from ompl import base

    states = base.ReedsSheppStateSpace(5.0)
    a, b = states.allocState(), states.allocState()
    for state, pose in ((a, start), (b, goal)):
        state.setX(pose.x_m)
        state.setY(pose.y_m)
        state.setYaw(math.remainder(pose.yaw_rad, 2 * math.pi))
    assert length_m(reeds_shepp_paths(start, goal, 5.0)[0]) == pytest.approx(states.distance(a, b), abs=1e-4)


@pytest.mark.parametrize(("lengths", "changes"), [((1, 2), 0), ((1, -2), 1), ((-1, 2, -3), 2), ((-1,), 0)])
def test_cusp_count(lengths: tuple[float, ...], changes: int) -> None:
    assert cusps(tuple(Segment(u, 0.1) for u in lengths)) == changes


# curvature


@settings(derandomize=True, max_examples=60, deadline=None)
@given(POSES, POSES)
def test_ramped_path_ends_at_goal(start: Pose2, goal: Pose2) -> None:
    for word in reeds_shepp_paths(start, goal, 5.0)[:4]:
        solved = solve_endpoint(word, start, goal, 1.2) if word else None
        if solved is None:
            continue
        runs = runs_of(solved, start, 1.2)
        end = runs[-1]
        assert end.p_map_m[-1] == pytest.approx([goal.x_m, goal.y_m], abs=1e-4)
        assert abs(math.remainder(end.heading_rad[-1] - goal.yaw_rad, 2 * math.pi)) < 1e-5
        for a, b in pairwise(runs):
            assert b.p_map_m[0] == pytest.approx(a.p_map_m[-1])
            assert b.heading_rad[0] == pytest.approx(a.heading_rad[-1])
            assert a.direction == -b.direction
        for run in runs:
            steepest = np.abs(np.diff(run.curvature_radpm)).max() / (run.s_m[1] - run.s_m[0])
            assert steepest <= 2 * 0.2 / 1.2 + 1e-6


# clearance


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4))
def test_clearance_against_shapely(x: float, y: float, heading: float) -> None:
    first, last = np.array([[3.0, -1.0], [-2.0, 4.0], [0.5, -5.0]]), np.array([[3.0, 6.0], [-2.0, 4.0], [7.0, -4.0]])
    bounds = Bounds(first, last, np.array([0.05, 0.12, 0.0]))
    bodies = (Rectangle(-1.0, 3.5, 2.3), Rectangle(-2.4, -1.1, 2.55))
    found = float(clearance_m(bounds, bodies, np.array([[x, y]]), np.array([heading]))[0])
    c, s = math.cos(heading), math.sin(heading)
    shapes = [affine_transform(box(b.rear_m, -b.width_m / 2, b.front_m, b.width_m / 2), [c, -s, s, c, x, y])
              for b in bodies]  # fmt: skip
    edges = [LineString([a, b]) for a, b in zip(first, last, strict=True)]
    real = min(o.distance(e) - t for o in shapes for e, t in zip(edges, bounds.thickness_m, strict=True))
    if real > 0.0:  # crossings are not covered
        assert found == pytest.approx(real, abs=1e-9)


def min_clearances(docking: Docking, paths: tuple[Path, ...], others: tuple[Polygon, ...] = ()) -> tuple[float, float]:
    """Minimum clearance before and in the bay by shapely; asserts that the machine stays in yard, lane and shed."""
    site, shed = docking.site, docking.site.shed
    assert shed is not None
    posts = [Point(p.at_m).buffer(p.radius_m, quad_segs=64) for p in shed.posts]
    walls = [LineString(w).buffer(shed.wall_thickness_m / 2) for w in shed.walls_m]
    hard = shapely.union_all([*posts, *walls, *others])
    lanes = [LineString(lane.center_m).buffer(lane.width_m / 2, cap_style="flat") for lane in site.lanes]
    drivable = shapely.union_all([Polygon(site.yard.outline_m), Polygon(shed.outline_m), *lanes])
    found = []
    for path in paths:
        for (x, y), h in zip(path.p_map_m, path.heading_rad, strict=True):
            c, s = math.cos(h), math.sin(h)
            shapes = [box(b.rear_m, -b.width_m / 2, b.front_m, b.width_m / 2) for b in docking.rig.bodies]
            body = shapely.union_all([affine_transform(o, [c, -s, s, c, x, y]) for o in shapes])
            assert drivable.covers(body)
            is_in = abs(y - docking.bay.dock.y_m) < 1e-3 and x < 7.0
            found.append((is_in, min(hard.distance(body), np.inf if is_in else drivable.exterior.distance(body))))
    return min(g for i, g in found if not i), min(g for i, g in found if i)


# paths into the bay


def test_docking_end_pose_and_clearance(docking: Docking) -> None:
    for start in starts(6):
        paths = plan_docking(start, docking, 5)
        first, last = paths[0], paths[-1]
        assert first.p_map_m[0] == pytest.approx([start.x_m, start.y_m])
        assert (last.direction, last.is_last, [p.is_last for p in paths[:-1]]) == (-1, True, [False] * (len(paths) - 1))
        assert [p.path_id for p in paths] == list(range(5, 5 + len(paths)))
        dock, end = docking.bay.dock.pose, end_of(last)
        assert math.hypot(end.x_m - dock.x_m, end.y_m - dock.y_m) < 1e-3
        assert abs(math.remainder(end.yaw_rad - dock.yaw_rad, 2 * math.pi)) < 1e-4
        before, within = min_clearances(docking, paths)
        assert before >= docking.config.clearance_m - 0.01
        assert within >= docking.config.bay_clearance_m


def test_docking_path_consistency(docking: Docking) -> None:
    for start in starts(6):
        paths = plan_docking(start, docking, 1)
        for path in paths:
            assert path.is_transport
            assert path.sections[0].section_type is PathSectionType.DOCK
            assert docking.site.shed is not None
            roof = Polygon(docking.site.shed.outline_m)
            is_slow = shapely.distance(roof, shapely.points(path.p_map_m)) <= 9.0
            assert (path.speed_mps <= np.where(is_slow, 1.8, 5.0 if path.direction > 0 else 3.0) / 3.6 + 1e-9).all()
            assert path.speed_mps[-1] == 0.0
            assert np.abs(path.curvature_radpm).max() < 1 / 4.6
            assert np.diff(path.s_m).max() <= 0.1 + 1e-9
            assert path.s_m[-1] >= docking.config.min_run_m - docking.config.ramp_m / 2
            travel = np.arctan2(*np.diff(path.p_map_m, axis=0).T[::-1]) - (0.0 if path.direction > 0 else math.pi)
            assert np.abs(np.angle(np.exp(1j * (travel - path.heading_rad[:-1])))).max() < 0.02
        straight = paths[-1].s_m > paths[-1].s_m[-1] - 11.0
        assert np.abs(paths[-1].curvature_radpm[straight]).max() == 0.0


def test_undocking(docking: Docking) -> None:
    paths = plan_undocking(docking, 1)
    assert [p.direction for p in paths] == [1]
    start, end = docking.site.start, end_of(paths[-1])
    assert (end.x_m, end.y_m) == pytest.approx((start.x_m, start.y_m))
    assert math.degrees(end.yaw_rad) == pytest.approx(start.heading_deg)
    assert paths[0].p_map_m[0] == pytest.approx([docking.bay.dock.x_m, docking.bay.dock.y_m], abs=1e-3)
    assert np.diff(paths[0].s_m).min() > 0.0
    before, within = min_clearances(docking, paths)
    assert before >= docking.config.clearance_m - 0.01
    assert within >= docking.config.bay_clearance_m


def test_docking_determinism(docking: Docking) -> None:
    first, again = (plan_docking(LANE_END, docking, 1) for _ in range(2))
    assert [p.p_map_m.tobytes() for p in first] == [p.p_map_m.tobytes() for p in again]


@pytest.mark.parametrize(("x", "y", "deg"), [(20, -26, -85), (30, -30, 180), (12, -48, 90), (1, -40, 0), (20, -33, 90)])
def test_docking_from_other_starts(
    x: float, y: float, deg: float, site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig
) -> None:
    docking = docking_in("wide", site, vehicle, harrow, planning)
    paths = plan_docking(Pose2(x, y, math.radians(deg)), docking, 1)
    assert end_of(paths[-1]).x_m == pytest.approx(docking.bay.dock.x_m, abs=1e-3)


def test_docking_around_obstacle(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig
) -> None:
    docking = docking_in("wide", site, vehicle, harrow, planning)
    plain = plan_docking(LANE_END, docking, 1)
    k = len(plain[-1].s_m) // 3
    p = Point(plain[-1].p_map_m[k]).buffer(0.4)
    before, _ = min_clearances(docking, plan_docking(LANE_END, docking, 1, (p,)), (p,))
    assert before >= docking.config.clearance_m - 0.01


def test_docking_by_sampling(site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig) -> None:
    docking = docking_in("wide", site, vehicle, harrow, planning)
    obstacles = (box(12, -45, 14, -38), box(18, -40, 19, -38))
    first, again = (plan_docking(LANE_END, docking, 1, obstacles) for _ in range(2))
    assert sum(a.direction != b.direction for a, b in pairwise(first)) > 1
    assert [p.p_map_m.tobytes() for p in first] == [p.p_map_m.tobytes() for p in again]
    before, _ = min_clearances(docking, first, obstacles)
    assert before >= docking.config.clearance_m - 0.01


def test_docking_refusals(site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig) -> None:
    docking = docking_in("narrow", site, vehicle, harrow, planning)
    wide = replace(docking, rig=rig_of(vehicle, harrow, None, planning.planner))
    with pytest.raises(FieldError, match=r"bay 'narrow' leaves 0\.00 m beside a rig 6\.1 m wide at x 0\.\d m"):
        plan_docking(LANE_END, wide, 1)
    with pytest.raises(FieldError, match=r"stands only 0\.1\d m from .* x 38\.0 m"):
        plan_docking(Pose2(34.38, -40.0, 0.0), docking, 1)
    with pytest.raises(FieldError, match="stands not within the bounds"):
        plan_docking(Pose2(35.0, -40.0, 0.0), docking, 1)
    with pytest.raises(FieldError, match=r"bay 'narrow' leaves 0\.00 m"):
        plan_docking(LANE_END, docking, 1, (box(4, -44, 5, -43),))
    ring = tuple(box(*b) for b in ((14, -34, 15, -24), (25, -36, 26, -24), (14, -39, 26, -38)))
    with pytest.raises(FieldError, match=r"no path into bay 'narrow' from x 20\.0 m, y -30\.0 m"):
        plan_docking(LANE_END, docking, 1, ring)


@pytest.mark.parametrize("width", [3.0, 2.94, 2.9])
def test_minimum_bay_width(
    width: float, site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig
) -> None:
    """0.2 m on each side of 2.55 m need 2.95 m between the posts."""
    shed = site.shed
    assert shed is not None
    y = site.bay("narrow").dock.y_m
    apart = width / 2 + 0.12
    posts = tuple(
        p
        if abs(p.at_m[1] - y) > 2.0
        else p.model_copy(update={"at_m": (p.at_m[0], y + math.copysign(apart, p.at_m[1] - y))})
        for p in shed.posts
    )
    other = site.model_copy(update={"shed": shed.model_copy(update={"posts": posts})})
    docking = docking_in("narrow", other, vehicle, harrow, planning)
    if width > 2.95:
        assert plan_docking(LANE_END, docking, 1)
    else:
        with pytest.raises(FieldError, match=r"leaves 0\.1"):
            plan_docking(LANE_END, docking, 1)


# the mission


def test_docking_only_mission(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig, tmp_path: FilePath
) -> None:
    start = PoseConfig(x_m=20.0, y_m=-30.0, heading_deg=-90.0)
    mission = Mission(name="dock", site="demo", machine="m", implement="i", bay="wide", start=start)
    plan = plan_mission(mission, site, vehicle, harrow, planning, start, 0)
    assert plan.fixed_paths == ()
    assert plan.paths == plan.docking_paths
    assert plan.paths[0].p_map_m[0] == pytest.approx([20.0, -30.0])
    assert plan.planned_share == 0.0
    draw_plan(plan, site, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    paths = [f["properties"] for f in plan_to_geojson(plan, site)["features"] if f["properties"]["kind"] == "path"]
    section_types = {p["section_type"] for p in paths}
    assert section_types == {"dock"}


@pytest.mark.parametrize("missing", [{"bay": None}, {"start": None}])
def test_empty_mission_refused(missing: dict[str, None]) -> None:
    start = PoseConfig(x_m=20.0, y_m=-30.0, heading_deg=-90.0)
    values = {"name": "x", "site": "s", "machine": "m", "implement": "i", "bay": "wide", "start": start} | missing
    with pytest.raises(ValueError, match="needs a bay"):
        Mission(**values)

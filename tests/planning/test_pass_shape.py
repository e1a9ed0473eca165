"""Headland passes as near to every edge as the bodies allow, checked by shapely alone; the textbook rectangle."""

import math

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Polygon, box

from benchmarks.planning_check import check
from benchmarks.planning_fields import random_fields
from configs.mission import Mission, Work
from configs.site import DatumConfig
from configs.vehicle import MountedImplement, Vehicle
from geometry.footprint import footprints
from geometry.polygon import as_polygon
from geometry.polyline import arc_length, curvatures, headings, resample, smooth
from geometry.rectangle import Rectangle
from planning.config import PlanningConfig
from planning.coverage.pass_shape import displaced, is_undrivable
from planning.field.field import FieldOutline
from planning.field.site_generation import site_within
from planning.plan import PROOF_SLACK_M, plan_field
from planning.turns.free_space import FreeSpace

RADIUS_M, RAMP_M, SLACK_M = 5.0, 1.8, 0.005
POND = Polygon([(50, 40), (56, 39), (57, 44), (51, 45)])
AREAS: dict[str, Polygon] = {
    "rectangle": box(0, 0, 120, 80),
    "acute": Polygon([(0, 0), (150, 0), (40, 90)]),
    "L": Polygon([(0, 0), (120, 0), (120, 45), (60, 45), (60, 100), (0, 100)]),
    "stairs": as_polygon(shapely.union_all([box(0, 0, 90 - 2 * k, 60 + 2 * k) for k in range(12)])),
    **{f"random {n}": p.polygon for n, p in zip(range(1, 9), random_fields(8), strict=True)},
}  # fmt: skip


def bodies_of(width_m: float) -> tuple[Rectangle, ...]:
    return Rectangle(-1.0, 3.5, 2.3), Rectangle(-2.4, -1.1, width_m)


def line_of(area: Polygon, width_m: float) -> np.ndarray:
    """Outline moved in by half the width, corners rounded, interior to its left."""
    inner = area.buffer(-width_m / 2 - SLACK_M).buffer(RADIUS_M).buffer(-2 * RADIUS_M).buffer(RADIUS_M)
    ring = shapely.geometry.polygon.orient(max(shapely.get_parts(inner), key=lambda p: p.area), 1.0)
    points = resample(np.asarray(ring.exterior.coords), 0.1)
    return np.asarray(smooth(points, RAMP_M, is_closed=True))


@pytest.mark.parametrize("width_m", [3.0, 6.0])
@pytest.mark.parametrize("name", AREAS)
def test_no_body_leaves_the_area(name: str, width_m: float) -> None:
    area, bodies = AREAS[name], bodies_of(width_m)
    points, heading = displaced(line_of(area, width_m), FreeSpace(area, bodies, RADIUS_M, RAMP_M))
    assert points[0] == pytest.approx(points[-1])
    assert shapely.covers(area, footprints(bodies, points, heading)).all()
    bend = curvatures(heading, arc_length(points))
    assert np.abs(bend).max() < 1.0 / 4.6
    assert np.abs(np.diff(bend)).max() < 0.03
    assert np.hypot(*np.diff(points, axis=0).T).max() < 0.2
    travel = np.arctan2(*np.diff(points, axis=0).T[::-1])
    assert np.abs(np.angle(np.exp(1j * (travel - heading[:-1])))).max() < 0.02


def test_straight_edges_are_followed_at_half_the_width() -> None:
    """A pass stays where the body just fits, and leaves the edge before a corner no sooner than it has to."""
    area, bodies = AREAS["rectangle"], bodies_of(3.0)
    points, _ = displaced(line_of(area, 3.0), FreeSpace(area, bodies, RADIUS_M, RAMP_M))
    low = points[(points[:, 1] < 3.0) & (points[:, 0] > 12.0) & (points[:, 0] < 100.0)]
    assert low[:, 1] == pytest.approx(1.5 + SLACK_M, abs=1e-6)
    # the tail, 2.4 m behind, bounds the way out of the edge: y' ≤ y / 2.4 from SLACK_M to the tail swing of the corner
    swing_m = math.hypot(RADIUS_M + 1.5, 2.4) - RADIUS_M - 1.5
    longest_m = 2.4 * math.log(swing_m / SLACK_M) + RADIUS_M + 1.5
    left_edge = points[(points[:, 1] < 3.0) & (points[:, 1] > 1.5 + 2 * SLACK_M) & (points[:, 0] > 60.0)]
    assert 120.0 - left_edge[:, 0].min() < longest_m + 4.0


def test_pass_around_a_small_obstacle() -> None:
    """The complete pass is one window."""
    area = box(0, 0, 100, 90).difference(POND)
    inner = POND.buffer(3.05 + SLACK_M).buffer(RADIUS_M).buffer(-RADIUS_M)
    ring = shapely.geometry.polygon.orient(inner, -1.0)
    line = smooth(resample(np.asarray(ring.exterior.coords), 0.1), RAMP_M, is_closed=True)
    space = FreeSpace(area, bodies_of(6.1), RADIUS_M, RAMP_M)
    assert is_undrivable(line, headings(line, is_closed=True), space).any()
    points, heading = displaced(line, space)
    assert shapely.covers(area, footprints(space.bodies, points, heading)).all()
    assert Polygon(points).area < 1.4 * Polygon(line).area


def test_open_pass_leaves_the_edge_at_both_ends() -> None:
    middle = LineString([(0, 0), (50, 0), (95, 8), (140, 30)])
    area, bodies = as_polygon(middle.buffer(6.5, cap_style="flat")), bodies_of(3.0)
    line = np.asarray(resample(np.asarray(middle.offset_curve(-5.0 + SLACK_M, join_style="mitre").coords), 0.1))
    line = smooth(line, RAMP_M)[60:-60]
    points, heading = displaced(line, FreeSpace(area, bodies, RADIUS_M, RAMP_M), 0.4)
    shapes = footprints(bodies, points, heading)
    assert shapely.covers(area, shapes).all()
    distance = shapely.distance(area.exterior, shapes).min(axis=1)
    assert distance[[0, -1]].min() > 0.38
    assert np.median(distance) < 0.02


def test_rectangle_with_corners_filled(vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig) -> None:
    field = box(0, 0, 200, 100)
    implement = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    work = Work(
        headland_passes=4, overlap_m=0.0, work_speed_kmh=10.0, turn_speed_kmh=5.0, lane_speed_kmh=10.0,
        boundary_margin_m=0.1, turns="reverse",
    )  # fmt: skip
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    site = site_within(FieldOutline("rectangle", datum, field), vehicle, implement, work)
    plan = plan_field(site, vehicle, implement, work, planning.planner, 1)
    free = plan.drivable.allowed.union(field.buffer(-work.boundary_margin_m))
    found = check(plan.paths, field, free, vehicle, implement)
    assert found.outside_m == 0.0
    assert found.coverage > 0.995
    assert found.curvature_radpm < 1.0 / 4.6
    depth = work.boundary_margin_m + PROOF_SLACK_M + planning.planner.edge_slack_m
    straight = plan.planned_area.intersection(box(60, 0, 140, 1))
    assert straight.bounds[1] == pytest.approx(depth, abs=0.002)


def test_start_of_a_field_of_short_edges(vehicle: Vehicle, harrow: MountedImplement, mission: Mission) -> None:
    """Stairs of 2.5 m all around: no edge has place for the machine, which starts furthest from all of them."""
    cells = [(x, y) for x in range(-8, 9) for y in range(-8, 9) if abs(x) + abs(y) <= 8]
    field = as_polygon(shapely.union_all([box(2.5 * x, 2.5 * y, 2.5 * x + 2.5, 2.5 * y + 2.5) for x, y in cells]))
    outline = FieldOutline("stairs", DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0), field)
    assert mission.work is not None
    site = site_within(outline, vehicle, harrow, mission.work)
    yard = Polygon(site.yard.outline_m)
    assert field.buffer(-mission.work.boundary_margin_m).covers(yard)
    assert math.hypot(site.start.x_m - 1.25, site.start.y_m - 1.25) < 2.0

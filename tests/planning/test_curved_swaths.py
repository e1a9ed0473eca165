"""Swaths along an adaptive curve or a circle: distances, curvature, an independent sweep, export, detour."""

import math
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate, translate
from shapely.geometry import LineString, Point, Polygon, box

from benchmarks.planning_check import check
from configs.mission import Mission, Work
from configs.site import DatumConfig
from configs.vehicle import MountedImplement, Vehicle
from geometry.footprint import is_inside
from geometry.polyline import arc_length
from messages.errors import FieldError
from messages.perception import ObstacleClass
from messages.plan import MissionState, PathSectionType
from planning.config import PlanningConfig
from planning.coverage.curved_swath import CurvedSwath
from planning.export.geojson import plan_to_geojson
from planning.export.isoxml import write_isoxml
from planning.export.kml import write_kml
from planning.field.field import FieldOutline, read_field
from planning.field.site_generation import site_within
from planning.guidance.line import Circle, Curve
from planning.guidance.offset_lines import OffsetLine, lines_over
from planning.guidance.recorded import line_in_map
from planning.mission import MissionNode
from planning.plan import GUIDANCE_BEND, Plan, plan_field
from tests.planning.ideal import SUPERVISOR_GAP_M, Ideal

RADIUS_M, SMOOTHING_M, PITCH_M = 5.0, 1.8, 6.0
FIELD = box(0.0, 0.0, 110.0, 80.0)
DATUM = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
X = np.linspace(5.0, 105.0, 60)
WAVE = np.column_stack([X, 40.0 + 4.0 * np.sin(X / 14.0)])
BEND = np.array([[10.0, 20.0], [60.0, 25.0], [66.0, 70.0]])
S_CURVE = np.column_stack([X, 40.0 + 16.0 * np.tanh((X - 55.0) / 16.0)])
HAIRPIN = np.array([[10.0, 30.0], [70.0, 30.0], [76.0, 38.0], [70.0, 46.0], [10.0, 56.0]])
RING = np.array([[40.0, 25.0], [72.0, 28.0], [76.0, 55.0], [45.0, 58.0], [40.0, 25.0]])
LINES: dict[str, dict[str, Any]] = {
    "wave": {"swath_curve_m": tuple(map(tuple, WAVE.tolist()))},
    "bend": {"swath_curve_m": tuple(map(tuple, BEND.tolist()))},
    "S": {"swath_curve_m": tuple(map(tuple, S_CURVE.tolist()))},
    "hairpin": {"swath_curve_m": tuple(map(tuple, HAIRPIN.tolist()))},
    "ring": {"swath_curve_m": tuple(map(tuple, RING.tolist()))},
    "pivot": {"swath_circle_m": (55.0, 40.0, 24.0)},
}
CASES = [("wave", "forward"), ("bend", "reverse"), ("pivot", "forward")]
CASES += [pytest.param(n, t, marks=pytest.mark.slow) for n in LINES for t in ("forward", "reverse")]  # type: ignore[misc]


def lines(guide: Curve | Circle, pitch_m: float = PITCH_M) -> list[OffsetLine]:
    return list(lines_over(FIELD, guide, pitch_m, RADIUS_M, SMOOTHING_M))


@pytest.mark.parametrize("points", [WAVE, BEND, S_CURVE, HAIRPIN, RING], ids=["wave", "bend", "S", "hairpin", "ring"])
@pytest.mark.parametrize("pitch_m", [3.0, 6.0, 12.0])
def test_lines_have_no_loops_and_turn_gently(points: Any, pitch_m: float) -> None:
    found = lines(Curve(points), pitch_m)
    assert len(found) > 50.0 / pitch_m
    for line in found:
        shape = LineString(line.points_m)
        assert shape.is_simple
        assert np.hypot(*np.diff(line.points_m, axis=0).T).max() < 0.11
    whole = [line for line in found if not _has_a_cusp(line)]
    assert max(np.abs(line.curvature_radpm).max() for line in whole) < 1.02 / RADIUS_M
    assert len(whole) > 0.6 * len(found)


def _has_a_cusp(line: OffsetLine) -> bool:
    """Lines between the legs of a hairpin meet at a corner, where they are cut."""
    return bool((np.abs(line.curvature_radpm) > 1.07 / RADIUS_M).any())


def test_line_n_lies_n_spacings_from_a_gentle_curve() -> None:
    noise = np.random.default_rng(5).normal(0.0, 0.02, WAVE.shape)
    for points, most_m in ((WAVE, 0.03), (WAVE + noise, 0.06)):
        base = LineString(points)
        for line in lines(Curve(points)):
            inside = [p for p in line.points_m if 15.0 < p[0] < 95.0 and 0.0 < p[1] < 80.0]
            if abs(line.number) <= 3:
                assert len(inside) > 700
                away = shapely.distance(shapely.points(np.array(inside)), base)
                assert np.abs(away - abs(line.number) * PITCH_M).max() < most_m
                middle = line.points_m[len(line.points_m) // 2]
                assert (
                    np.sign(middle[1] - 40.0 - 4.0 * math.sin(middle[0] / 14.0)) == np.sign(line.number)
                    or not line.number
                )


def test_lines_go_on_straight_along_the_tangent_over_the_field() -> None:
    (line,) = (one for one in lines(Curve(BEND)) if one.number == 0)
    for end, corner, along in (
        (line.points_m[0], BEND[0], BEND[0] - BEND[1]),
        (line.points_m[-1], BEND[-1], BEND[2] - BEND[1]),
    ):
        assert not FIELD.contains(Point(end))
        off = end - corner
        assert abs(along[0] * off[1] - along[1] * off[0]) / np.hypot(*along) < 0.01
    assert (line.points_m[-1] - line.points_m[0]) @ (BEND[-1] - BEND[0]) > 0.0


def test_circles_have_exact_radii_and_none_below_the_turning_radius() -> None:
    found = lines(Circle((55.0, 40.0), 24.0))
    radii = [float(np.hypot(*(line.points_m[0] - [55.0, 40.0]))) for line in found]
    assert radii == pytest.approx([24.0 + PITCH_M * line.number for line in found])
    assert min(radii) == pytest.approx(6.0)
    assert max(radii) > math.hypot(55.0, 40.0) - PITCH_M


@pytest.mark.parametrize("turn", [1.6, 1.9])
def test_a_curve_that_crosses_itself_is_refused(turn: float) -> None:
    t = np.linspace(0.0, turn * 2.0 * math.pi, 200)
    loop = np.column_stack([55.0 + 20.0 * np.cos(t) + 3.0 * t, 40.0 + 20.0 * np.sin(t)])
    with pytest.raises(FieldError, match="crosses itself"):
        lines(Curve(loop))


@pytest.fixture(scope="module")
def curved(vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Any:
    known: dict[tuple[str, str], Plan] = {}

    def make(name: str, turns: str) -> Plan:
        if (name, turns) not in known:
            work = mission.work.model_copy(update={**LINES[name], "turns": turns, "headland_passes": 2})  # type: ignore[union-attr]
            site = site_within(FieldOutline("curved", DATUM, FIELD), vehicle, harrow, work)
            known[name, turns] = plan_field(site, vehicle, harrow, work, planning.planner, 1)
        return known[name, turns]

    return make


@pytest.mark.parametrize(("name", "turns"), CASES)
def test_plan_by_an_independent_sweep(
    name: str, turns: str, curved: Any, vehicle: Vehicle, harrow: MountedImplement, mission: Mission
) -> None:
    plan: Plan = curved(name, turns)
    assert isinstance(mission.work, Work)
    free = FIELD.buffer(-mission.work.boundary_margin_m)
    found = check(plan.paths, FIELD, free, vehicle, harrow)
    assert found.outside_m == 0.0
    assert found.gap_m < 1e-3
    assert found.curvature_radpm < plan.rig.max_curvature_radpm
    assert found.coverage > (0.97 if turns == "reverse" else 0.88)
    assert found.coverage == pytest.approx(plan.planned_share, abs=0.002)
    assert max(np.abs(np.diff(p.curvature_radpm)).max() for p in plan.paths) < 0.03
    assert sum(isinstance(s, CurvedSwath) for s in plan.swaths) >= 6
    driven = {s.line for p in plan.paths for s in p.sections if s.section_type is PathSectionType.SWATH}
    assert driven == {s.number for s in plan.swaths}


@pytest.mark.parametrize("name", ["wave", "pivot"])
def test_base_follows_the_lines(name: str, curved: Any, mission: Mission) -> None:
    plan: Plan = curved(name, "forward")
    pitch_m = plan.rig.working_width_m - mission.work.overlap_m  # type: ignore[union-attr]
    guide = Circle((55.0, 40.0), 24.0) if name == "pivot" else Curve(WAVE)
    known = [LineString(line.points_m) for line in lines(guide, pitch_m)]
    bent_m = 0.0
    for path in plan.paths:
        for section in path.sections:
            if section.section_type is not PathSectionType.SWATH:
                continue
            points = path.p_map_m[section.first + 30 : section.last - 30]
            if len(points) > 100:
                away = shapely.distance(np.asarray(known)[:, None], shapely.points(points)[None])
                assert away.min(axis=0).max() < 0.03
                bent_m += float(arc_length(points)[-1]) * bool(
                    np.abs(path.curvature_radpm[section.first :]).max() > 0.01
                )
    assert bent_m > 300.0


def test_a_pivot_is_worked_in_rings_and_arcs(curved: Any) -> None:
    plan: Plan = curved("pivot", "forward")
    gaps = [np.hypot(*(s.longer.p_map_m[0] - s.longer.p_map_m[-1])) for s in plan.swaths]
    lengths = [float(arc_length(s.longer.p_map_m)[-1]) for s in plan.swaths]
    rings = [length for gap, length in zip(gaps, lengths, strict=True) if gap < 1.0]
    assert len(rings) >= 4
    assert len(plan.swaths) > len(rings)
    centre = Point(55.0, 40.0)
    assert plan.uncovered_m2[GUIDANCE_BEND] > 5.0
    assert any(u.reason == GUIDANCE_BEND and u.outline.distance(centre) < 1.0 for u in plan.uncovered)


def test_what_a_tight_bend_leaves_bare_is_reported(curved: Any) -> None:
    plan: Plan = curved("bend", "reverse")
    inside = FIELD.difference(plan.planned_area)
    reported = shapely.union_all([u.outline for u in plan.uncovered])
    assert inside.difference(reported.buffer(0.01)).area < 10.0  # parts below 0.25 m² are not listed
    assert plan.uncovered_m2[GUIDANCE_BEND] > 0.25


@pytest.mark.parametrize("form", ["kml", "isoxml"])
def test_curved_swaths_are_exported_as_curves(form: str, curved: Any, vehicle: Vehicle, tmp_path: FilePath) -> None:
    plan: Plan = curved("wave", "forward")
    site = plan.drivable.site
    if form == "kml":
        write_kml(plan, site, tmp_path / "plan.kml")
        outline = read_field(tmp_path / "plan.kml", site.name)
    else:
        write_isoxml(plan, site, tmp_path / "TASKDATA", "1.2.3")
        outline = read_field(tmp_path / "TASKDATA")
    named = {line.name: line for line in outline.lines}
    assert len([n for n in named if not n.startswith("path")]) == len(plan.swaths) + len(plan.headland_passes)
    for swath in plan.swaths:
        found = line_in_map(named[f"swath {swath.number + 1}"], site.datum.datum)
        assert isinstance(swath, CurvedSwath)
        if isinstance(found, Curve):
            line = LineString(swath.longer.p_map_m)
            assert shapely.hausdorff_distance(LineString(found.points_m), line) < 0.01
    kinds = {f["properties"].get("section_type") for f in plan_to_geojson(plan, site)["features"]}
    assert "swath" in kinds


@pytest.mark.parametrize("at", [0.3, pytest.param(0.55, marks=pytest.mark.slow)])
def test_detour_on_a_curved_swath(at: float, curved: Any, planning: PlanningConfig) -> None:
    plan: Plan = curved("wave", "forward")
    swath = sorted(plan.swaths, key=lambda s: abs(float(s.longer.p_map_m[:, 1].mean()) - 40.0))[0].longer
    k = round(at * len(swath.p_map_m))
    (x, y), degrees = swath.p_map_m[k], math.degrees(swath.heading_rad[k])
    outline = translate(rotate(Polygon(box(-2.2, -0.9, 2.2, 0.9)), degrees), float(x), float(y))
    drive = Ideal(plan, MissionNode(plan, planning.mission, 0), {1: (ObstacleClass.VEHICLE, outline)})
    drive.run(3000)
    assert drive.status is not None
    assert drive.status.state is MissionState.FINISHED
    assert drive.least_gap_m > SUPERVISOR_GAP_M
    assert any(s.section_type is PathSectionType.DETOUR for p in drive.paths for s in p.sections)
    poses = np.array(drive.trail)
    assert is_inside(plan.rig.bodies, poses[:, :2], poses[:, 2], plan.drivable.allowed.buffer(0.05)).all()
    assert sum(u.area_m2 for u in drive.status.uncovered_areas) < 6.0 * 20.0


def test_one_guidance_line_only(mission: Mission) -> None:
    assert mission.work is not None
    values = mission.work.model_dump() | LINES["wave"] | LINES["pivot"]
    with pytest.raises(ValueError, match="swath_curve_m, swath_circle_m: give one of them"):
        Work.model_validate(values)
    with pytest.raises(ValueError, match="swath_curve_m: has two points at least"):
        Work.model_validate(mission.work.model_dump() | {"swath_curve_m": ((0.0, 0.0),)})

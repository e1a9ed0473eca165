"""Fields from GeoJSON: valid ones are read, invalid ones are refused with value or position."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import LineString, Point, Polygon, box

from configs.mission import Mission, Work
from configs.site import DatumConfig
from configs.strict import find, load, parse
from configs.vehicle import ImplementFile, MountedImplement, Vehicle
from messages.errors import ConfigError, FieldError
from planning.config import PlanningConfig
from planning.field.field import FieldOutline, read_field
from planning.field.site_generation import site_around, site_of, site_within
from planning.plan import plan_field
from tests.recordings import DATA, needs

M = 1e-5  # degrees of latitude: about 1.1 m
SQUARE = [[6.0, 51.0], [6.0 + 100 * M, 51.0], [6.0 + 100 * M, 51.0 + 70 * M], [6.0, 51.0 + 70 * M], [6.0, 51.0]]


def write(folder: Path, content: Any) -> Path:
    path = folder / "field.geojson"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def polygon(*rings: Any) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": list(rings)}


@pytest.mark.parametrize(
    "wrap",
    [
        lambda g: g,
        lambda g: {"type": "Feature", "properties": None, "geometry": g},
        lambda g: {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": g}]},
        lambda g: {"type": "MultiPolygon", "coordinates": [g["coordinates"]]},
        lambda g: {"type": "GeometryCollection", "geometries": [g]},
    ],
)
def test_geojson_wrappings(tmp_path: Path, wrap: Any) -> None:
    outline = read_field(write(tmp_path, wrap(polygon(SQUARE))))
    assert outline.polygon.area == pytest.approx(70.2 * 77.9, rel=0.01)
    assert outline.datum.latitude_deg == pytest.approx(51.0)


def test_hole_as_no_go_area(tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission) -> None:
    hole = [[6.0 + a * M, 51.0 + b * M] for a, b in ((40, 30), (60, 30), (60, 40), (40, 40), (40, 30))]
    outline = read_field(write(tmp_path, polygon(SQUARE, hole)))
    site = site_around(outline, vehicle, harrow, mission.work)
    assert len(site.no_go) == 1
    assert Polygon(site.no_go[0].outline_m).area == pytest.approx(14.0 * 11.1, rel=0.02)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "not valid JSON"),
        ("", "the file is empty"),
        ("[]", "list where a Polygon"),
        ("null", "NoneType where a Polygon"),
        ({"type": "Point", "coordinates": [6.0, 51.0]}, "no polygon"),
        ({"type": "LineString", "coordinates": SQUARE}, "no polygon, but 1 line"),
        ({"type": "FeatureCollection", "features": []}, "no polygon"),
        ({"type": "FeatureCollection"}, "None where a list"),
        (polygon(), "empty"),
        (polygon([]), "empty"),
        (polygon(SQUARE[:-1]), "not closed"),
        (polygon(SQUARE[:2] + SQUARE[:1]), "3 points have no area"),
        (polygon([SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3], SQUARE[0]]), "crosses itself at longitude 6.0"),
        (polygon([*SQUARE[:2], [6.0, 90.001], SQUARE[0]]), "latitude 90.001 is beyond"),
        (polygon([*SQUARE[:2], [6.0, -91], SQUARE[0]]), "latitude -91 is beyond"),
        (polygon([*SQUARE[:2], [180.1, 51.0], SQUARE[0]]), "longitude 180.1 is beyond"),
        (polygon([*SQUARE[:2], [float("nan"), 51.0], SQUARE[0]]), "not a finite number"),
        (polygon([*SQUARE[:2], [float("inf"), 51.0], SQUARE[0]]), "not a finite number"),
        (polygon([*SQUARE[:2], ["6", 51.0], SQUARE[0]]), "is not [longitude, latitude]"),
        (polygon([*SQUARE[:2], [True, 51.0], SQUARE[0]]), "is not [longitude, latitude]"),
        (polygon([*SQUARE[:2], [6.0], SQUARE[0]]), "is not [longitude, latitude]"),
        (polygon([*SQUARE[:2], 6.0, SQUARE[0]]), "is not [longitude, latitude]"),
        (polygon([*SQUARE[:2], [10**400, 51.0], SQUARE[0]]), "not a finite number"),
        (polygon([[6.0, 51.0], [6.00001, 51.0], [6.0, 51.00001], [6.0, 51.0]]), "too small"),
        (polygon([[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]), "wider than 5 km"),
        ({"type": "MultiPolygon", "coordinates": [[SQUARE], [SQUARE]]}, "2 fields"),
    ],
)
def test_invalid_field_refused(tmp_path: Path, content: Any, words: str) -> None:
    with pytest.raises(FieldError) as refused:
        read_field(write(tmp_path, content))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_round_field_starts_within(
    tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """No edge is long enough for a gate."""
    assert mission.work is not None
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    ring = np.round(np.column_stack([6.0 + 100 * M * np.cos(angle), 51.0 + 70 * M * np.sin(angle)]), 9)
    ring[-1] = ring[0]
    outline = read_field(write(tmp_path, polygon(ring.tolist())))
    assert site_around(outline, vehicle, harrow, mission.work) is None
    site = site_of(outline, vehicle, harrow, mission.work)
    assert (site.gates, site.lanes) == ((), ())
    assert np.hypot(site.start.x_m - 70.2, site.start.y_m - 77.9) < 5.0
    plan = plan_field(site, vehicle, harrow, mission.work, planning.planner, 0)
    assert plan.planned_share > 0.8
    assert plan.paths[0].p_map_m[0] == pytest.approx([site.start.x_m, site.start.y_m])


def test_gate_away_from_a_no_go_area(
    tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission
) -> None:
    """A pond of the file, across the middle of the edge where the gate would be."""
    assert mission.work is not None
    outline = read_field(write(tmp_path, polygon(SQUARE)))
    free = site_around(outline, vehicle, harrow, mission.work)
    assert free is not None
    posts = np.array(free.gates[0].posts_m)
    pond = Point(posts.mean(axis=0)).buffer(3.0)
    moved = site_around(replace(outline, no_go=(("water", pond),)), vehicle, harrow, mission.work)
    assert moved is not None
    assert pond.distance(LineString(moved.lanes[0].center_m)) >= moved.lanes[0].width_m / 2.0


ELLIPSE = affinity.scale(Point(0.0, 0.0).buffer(1.0, quad_segs=45), 70.0, 50.0)
BENT = Polygon([(0, 0), (90, 0), (90, 60), (45, 60), (45, 90), (0, 90)])  # its reflex corner has no room for a yard


@pytest.mark.parametrize(
    ("field", "point_m", "off_m"),
    [
        (box(0.0, 0.0, 90.0, 60.0), (0.0, 0.0), 2.5), (box(0.0, 0.0, 90.0, 60.0), (88.0, 61.0), 2.5),
        (ELLIPSE, (0.0, 50.0), 1.0), (ELLIPSE, (60.0, 25.0), 2.0), (BENT, (60.0, 60.0), 20.0),
    ],
)  # fmt: skip
def test_a_gate_anywhere_on_the_outline(
    field: Polygon, point_m: tuple[float, float], off_m: float, vehicle: Vehicle, harrow: MountedImplement,
    mission: Mission, planning: PlanningConfig,
) -> None:  # fmt: skip
    """Also in a corner, and where no edge is as long as a gate is wide; else the next place along the outline."""
    assert mission.work is not None
    work = mission.work.model_copy(update={"gate_m": point_m, "turns": "reverse"})
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    site = site_of(FieldOutline("gate", datum, field), vehicle, harrow, work)
    gate = LineString(site.gates[0].posts_m)
    assert gate.distance(Point(point_m)) < off_m
    assert not field.intersects(gate)
    assert not field.intersects(Polygon(site.yard.outline_m))
    plan = plan_field(site, vehicle, harrow, work, planning.planner, 0)
    assert plan.planned_share > 0.9


def test_no_gate_where_the_machine_has_no_room_behind_it(
    vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """The edge opposite is nearer than the front of the machine at the end of the lane."""
    assert mission.work is not None
    work = mission.work.model_copy(update={"turns": "reverse"})
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    site = site_of(FieldOutline("strip", datum, box(0.0, 0.0, 90.0, 9.0)), vehicle, harrow, work)
    assert site.lanes == ()
    assert plan_field(site, vehicle, harrow, work, planning.planner, 0).planned_share > 0.8


LANE = ((35.0, 0.0), (35.0, -22.0), (62.0, -40.0))  # from the lower edge, then to the right


def with_lane(mission: Mission, lane_m: tuple[tuple[float, float], ...]) -> Work:
    assert mission.work is not None
    return mission.work.model_copy(update={"lane_m": lane_m})


def test_gate_lane_and_yard_are_where_a_lane_is_drawn(
    tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """The gate is at its begin, the yard and the start at its end; the machine comes by it and leaves by it."""
    outline = read_field(write(tmp_path, polygon(SQUARE)))
    site = site_of(outline, vehicle, harrow, with_lane(mission, LANE))
    assert np.mean(site.gates[0].posts_m, axis=0) == pytest.approx((35.0, -0.5), abs=0.01)
    assert site.lanes[0].center_m[0] == (62.0, -40.0)
    assert site.lanes[0].center_m[-1] == pytest.approx((35.0, 6.0), abs=0.01)
    assert Polygon(site.yard.outline_m).contains(Point(site.start.x_m, site.start.y_m))
    assert site.start.heading_deg == pytest.approx(np.degrees(np.arctan2(18.0, -27.0)))  # towards the field
    plan = plan_field(site, vehicle, harrow, with_lane(mission, LANE), planning.planner, 0)
    way = np.vstack([path.p_map_m for path in plan.paths])
    for corner, off_m in (((62.0, -40.0), 0.1), ((35.0, -10.0), 0.1), ((35.0, -22.0), 2.0)):
        assert np.hypot(*(way - corner).T).min() < off_m
    assert plan.planned_share > 0.8
    assert site_of(outline, vehicle, harrow, with_lane(mission, LANE[::-1])) == site


@pytest.mark.parametrize(
    "lane",
    [
        ((35.0, 0.0), (35.0, -20.0), (90.0, -20.0), (60.0, 40.0)),  # comes back over the field
        ((35.0, 0.0), (60.0, -14.0), (90.0, -6.0), (75.0, 10.0)),  # the yard meets it
    ],
)
def test_a_lane_without_room_is_refused_with_its_place(
    tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, lane: tuple[tuple[float, float], ...]
) -> None:
    outline = read_field(write(tmp_path, polygon(SQUARE)))
    with pytest.raises(FieldError, match=r"no room for gate, lane and yard from x \d"):
        site_of(outline, vehicle, harrow, with_lane(mission, lane))


def test_a_lane_too_sharp_for_the_rig_is_refused(
    tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    work = with_lane(mission, ((35.0, 0.0), (35.0, -30.0), (40.0, -18.0), (48.0, -60.0)))
    site = site_of(read_field(write(tmp_path, polygon(SQUARE))), vehicle, harrow, work)
    with pytest.raises(FieldError, match=r"radius of [\d.]+ m at x \d+.*the rig needs 5.0 m"):
        plan_field(site, vehicle, harrow, work, planning.planner, 0)


@pytest.mark.parametrize(
    "more", [{"lane_m": [[35.0, 0.0]]}, {"lane_m": [[35.0, 0.0], [35.0, -9.0]], "gate_m": [1.0, 0.0]}]
)
def test_a_lane_has_two_points_and_its_own_gate(mission: Mission, more: dict[str, Any]) -> None:
    assert mission.work is not None
    with pytest.raises(ConfigError, match="lane_m"):
        parse(Work, mission.work.model_dump(mode="json") | more, "work")


@pytest.mark.parametrize("latitude", [89.9999, 90.0, -90.0])
def test_latitude_limit(tmp_path: Path, latitude: float) -> None:
    """± 90° is a valid latitude: the shape is refused, not the number."""
    bad = polygon([[0, latitude - 1e-3], [1e-3, latitude - 1e-3], [0, latitude], [0, latitude - 1e-3]])
    if latitude < 0:
        bad = polygon([[0, latitude + 1e-3], [1e-3, latitude + 1e-3], [0, latitude], [0, latitude + 1e-3]])
    with pytest.raises(FieldError) as refused:
        read_field(write(tmp_path, bad))
    assert "beyond" not in str(refused.value)


def test_missing_file_refused(tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="cannot be read"):
        read_field(tmp_path / "none.geojson")


@needs("fields2cover")
class TestRealParcels:
    folder = DATA / "fields2cover" / "data"

    def test_site_of_parcel(self, vehicle: Vehicle, harrow: MountedImplement, mission: Mission) -> None:
        outline = read_field(self.folder / "test.json")
        assert outline.name == "test parcel"
        assert outline.polygon.area == pytest.approx(35955, abs=5)
        site = site_around(outline, vehicle, harrow, mission.work)
        field, yard = Polygon(site.boundary_m), Polygon(site.yard.outline_m)
        assert not field.intersects(yard)
        posts = np.array(site.gates[0].posts_m)
        assert np.hypot(*(posts[1] - posts[0])) > harrow.width_m + 2 * mission.work.boundary_margin_m
        assert field.exterior.distance(Point(posts.mean(axis=0))) == pytest.approx(0.5, abs=0.01)

    @pytest.mark.slow
    def test_plan_with_12_m_implement(self, vehicle: Vehicle, mission: Mission, planning: PlanningConfig) -> None:
        wide = load(ImplementFile, find("implements", "harrow_12m")).implement
        site = site_around(read_field(self.folder / "test.json"), vehicle, wide, mission.work)
        plan = plan_field(site, vehicle, wide, mission.work, planning.planner, 0)
        assert plan.planned_share > 0.985
        assert plan.length_m < 4000

    @pytest.mark.parametrize("name", ["strips.geojson", "swaths.geojson", "test_ring.json", "test_2_cell.json"])
    def test_other_files_refused(self, name: str) -> None:
        with pytest.raises(FieldError) as refused:
            read_field(self.folder / name)
        assert name in str(refused.value)


@pytest.mark.parametrize("headland", ["first", "last", "none"])
def test_a_field_without_room_for_turns_names_the_end_of_its_lane(
    headland: str, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig, mission: Mission
) -> None:
    assert mission.work is not None
    work = mission.work.model_copy(update={"headland": headland, "turns": "forward"})
    datum = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
    site = site_of(FieldOutline("strip", datum, box(0.0, 0.0, 120.0, 16.0)), vehicle, harrow, work)
    with pytest.raises(FieldError, match=r"no line .* the end of the lane at x 60.0 m, y 6.0 m .*, or set turns: rev"):
        plan_field(site, vehicle, harrow, work, planning.planner, 1)


def test_a_start_beside_an_edge_has_room_to_turn_off_it(
    vehicle: Vehicle, harrow: MountedImplement, mission: Mission
) -> None:
    """The longest edges of an outline of steps are those at its ends, with a step before and behind them."""
    down = [(4.5 + 3.0 * (k // 2), 18.0 - 2.0 * (k // 2 + k % 2)) for k in range(18)]
    right = [*down, *((x, -y) for x, y in reversed(down[:-1]))]
    field = Polygon([*right, *((-x, y) for x, y in reversed(right))])
    assert mission.work is not None
    outline = FieldOutline("steps", DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0), field)
    narrow = harrow.model_copy(update={"working_width_m": 3.0, "width_m": 3.0})
    site = site_within(outline, vehicle, narrow, mission.work)
    heading, radius_m = np.radians(site.start.heading_deg), 1.0 / vehicle.drivetrain.max_curvature_radpm
    centre = site.start.x_m - radius_m * np.sin(heading), site.start.y_m + radius_m * np.cos(heading)
    assert all(field.covers(affinity.rotate(Polygon(site.yard.outline_m), a, centre)) for a in range(0, 91, 10))

"""The planning desk: loads, draws, plans, stores; refuses while the planner works; cancels."""

import asyncio
import json
import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from configs.mission import Refill
from configs.site import DatumConfig
from hmi.page_state import PageState
from hmi.plan_view.desk import PlanDesk
from hmi.plan_view.mission_store import MISSION, PLAN
from hmi.plan_view.options import choices, default_options, default_work, options_of, read_mission
from hmi.refusal import Refused
from messages.errors import ConfigError, HeadlandError
from messages.message import Envelope
from tests.hmi.drive_messages import NOW_NS, demo_scene, map_pose, odometry
from tests.hmi.planned import PLANNER, corner_field, desk_in, geojson
from tests.recordings import ROOT

PLANNING = """
import asyncio, sys
from pathlib import Path
from tests.hmi.planned import L_SHAPE, PLANNER, desk_in, geojson

async def plan():
    desk = desk_in(Path(sys.argv[1]), PLANNER)
    await desk.load({"a.geojson": geojson(tuple((9.0 * x, 9.0 * y) for x, y in L_SHAPE))})
    planning = asyncio.create_task(desk.make_plan())
    while desk.job is None or desk.job.stage != "route":
        await asyncio.sleep(0.05)
    print(desk.job._process.pid, flush=True)
    await planning

asyncio.run(plan())
"""

DATUM = DatumConfig(latitude_deg=48.0, longitude_deg=11.0, height_m=0.0)


def test_a_field_is_read_planned_stored_and_opened_again(tmp_path: Path) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path)
        await desk.load({"a.kml": b"ok"})
        assert (desk.name, desk.notes, desk.error) == ("north", ["a note"], "")
        with pytest.raises(Refused, match="no_plan"):
            desk.store_mission("x", "anna")
        desk.set_option("vegetation_cm", "30", "anna")
        await desk.load({"a.kml": b"ok"})
        assert desk.options.consent is None  # that for another field
        desk.set_option("headland_passes", "3", "anna")
        await desk.make_plan()
        assert desk.plan is not None
        stored = desk.store_mission(" my <b>mission</b> ", "anna")
        assert stored.about is not None
        assert stored.about.name == "my <b>mission</b>"
        desk.draw("outline")
        assert desk.outline is desk.plan is None
        desk.set_option("headland_passes", "1", "anna")
        desk.reopen(stored.id)
        assert desk.options.headland_passes == 3
        assert desk.stored == stored
        assert desk.plan is not None
        assert desk.outline is not None
        assert desk.outline["boundary"] == desk.plan.map["boundary"]
        desk.set_option("turns", "reverse", "anna")
        assert desk.plan is desk.stored is None
        assert stored.folder.is_dir()

    asyncio.run(drive())


def test_the_same_planner_as_that_of_the_command_line(tmp_path: Path) -> None:
    """The figures are those of `headland plan` with the stored mission file, the lines those of its paths."""

    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        desk.set_option("implement", "harrow_6m", "anna")
        await desk.load({"corner.geojson": geojson()})
        assert desk.error == ""
        assert desk.outline is not None
        assert shapely.Polygon(desk.outline["boundary"]).area == pytest.approx(6950.0, rel=0.02)
        await desk.make_plan()
        assert desk.error == ""
        assert desk.plan is not None

    asyncio.run(drive())
    (draft,) = (tmp_path / "missions").iterdir()
    shown: dict[str, Any] = json.loads((draft / PLAN).read_text())
    from runtime.setup import load_setup

    plan = load_setup(str(draft / MISSION), None, None, str(draft / "field" / "corner.geojson"), 1).plan
    assert shown["length_m"] == pytest.approx(plan.length_m, abs=0.1)
    assert shown["planned_share"] == pytest.approx(plan.planned_share, abs=1e-4)
    assert 0.9 < shown["planned_share"] < 1.0
    lengths = [shapely.LineString(points).length for _, points in shown["map"]["sections"]]
    assert sum(lengths) == pytest.approx(plan.length_m, rel=0.01)
    top_mps, least_mps = 10.0 / 3.6, 1.0
    assert plan.length_m / top_mps < shown["time_s"] < plan.length_m / least_mps


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", "empty"), (b"\x89PNG", "no known field format"), (b'{"type": "Point", "coordinates": [1, 2]}', "polygon"),
        (geojson(((0.0, 0.0), (1e-3, 1e-3), (1e-3, 0.0), (0.0, 1e-3), (0.0, 0.0))), "crosses itself"),
        (geojson(((0.0, 0.0), (1e-5, 0.0), (1e-5, 1e-5), (0.0, 0.0))), "too small"),
        (b"[" * 300_000, "not valid JSON"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_in_words_without_the_path_of_the_folder(
    tmp_path: Path, content: bytes, named: str
) -> None:
    desk = desk_in(tmp_path, PLANNER)
    asyncio.run(desk.load({"a.geojson": content}))
    assert named in desk.error
    assert str(tmp_path) not in desk.error
    assert desk.outline is None
    with pytest.raises(Refused, match="no_field"):
        asyncio.run(desk.make_plan())


def test_one_of_several_fields_is_chosen(tmp_path: Path) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path)
        await desk.load({"a.kml": b"two"})
        assert desk.features == [("1", "north"), ("2", "south")]
        assert desk.outline is None
        for wrong in ("3", "", "../x", "--help"):
            with pytest.raises(Refused, match="no_feature"):
                await desk.choose(wrong)
        await desk.choose("2")
        assert desk.outline is not None

    asyncio.run(drive())


def test_drawn_corners_become_a_field_at_the_same_place(tmp_path: Path) -> None:
    corners = [(100.0, 50.0), (200.0, 50.0), (200.0, 130.0), (100.0, 130.0)]

    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        desk.draw("outline")
        for corner in corners[:2]:
            desk.add_point(*corner)
        desk.add_point(0.0, 0.0)
        desk.remove_point()
        with pytest.raises(Refused, match="few_corners"):
            await desk.close_drawing(DATUM, "drawn")
        for corner in corners[2:]:
            desk.add_point(*corner)
        await desk.close_drawing(DATUM, "drawn")
        assert (desk.error, desk.name, desk.drawing.kind) == ("", "drawn", "")
        assert desk.outline is not None
        shape = shapely.Polygon(desk.outline["boundary"])
        assert shape.area == pytest.approx(8000.0, rel=1e-4)
        assert shape.bounds == pytest.approx((0.0, 0.0, 100.0, 80.0), abs=0.2)
        assert desk.draft is not None
        ring = json.loads((desk.draft / "field" / "drawn.geojson").read_text())["geometry"]["coordinates"][0]
        assert DATUM.datum.to_map(math.radians(ring[0][1]), math.radians(ring[0][0]), 0.0)[:2] == pytest.approx(
            corners[0], abs=0.01
        )

    asyncio.run(drive())


def test_a_lane_is_drawn_from_the_gate_to_the_yard(tmp_path: Path) -> None:
    """It takes the place of a gate, is planned, stored and opened again; one with a single point is none."""
    lane = ((80.0, 0.0), (80.0, -25.0), (110.0, -45.0))

    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        await desk.load({"a.geojson": geojson(corner_field(160.0))})
        desk.draw("gate")
        desk.add_point(40.0, -3.0)
        desk.draw("lane")
        desk.add_point(*lane[0])
        with pytest.raises(Refused, match="few_corners"):
            await desk.close_drawing(DATUM, "not a field")
        for point in lane[1:]:
            desk.add_point(*point)
        await desk.close_drawing(DATUM, "not a field")
        assert (desk.lane_m, desk.gate_m, desk.drawing.kind) == (lane, None, "")
        shown = desk.shown_outline
        assert shown is not None
        assert shown["lanes"] == [lane]
        await desk.make_plan()
        assert desk.error == ""
        assert desk.plan is not None
        ((*_, end),) = desk.plan.map["lanes"]
        assert end == pytest.approx([80.0, 6.0], abs=0.6)
        stored = desk.store_mission("with lane", "anna")
        desk.remove_areas()
        assert desk.lane_m == ()
        desk.reopen(stored.id)
        assert desk.lane_m == lane
        desk.draw("gate")
        desk.add_point(40.0, -3.0)
        assert (desk.lane_m, desk.gate_m) == ((), (40.0, -3.0))

    asyncio.run(drive())


def test_no_go_areas_and_gate_belong_to_the_mission(tmp_path: Path) -> None:
    """They are drawn on the field of a file, planned, stored and opened again; a change makes the plan void."""
    area = ((40.0, 60.0), (55.0, 60.0), (55.0, 75.0), (40.0, 75.0))

    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        with pytest.raises(Refused, match="no_field"):
            desk.draw("no_go")
        await desk.load({"a.geojson": geojson(corner_field(160.0))})
        desk.draw("no_go")
        for corner in area:
            desk.add_point(*corner)
        await desk.close_drawing(DATUM, "not a field")
        desk.draw("gate")
        desk.add_point(80.0, -3.0)
        assert (desk.no_go_m, desk.gate_m, desk.drawing.kind) == ((area,), (80.0, -3.0), "")
        shown = desk.shown_outline
        assert shown is not None
        assert shown["no_go"] == [area]
        await desk.make_plan()
        assert desk.error == ""
        assert desk.plan is not None
        swept = shapely.MultiLineString([line for _, line in desk.plan.map["sections"]])
        assert swept.distance(shapely.Polygon(area).centroid) > 7.5
        (gate,) = desk.plan.map["gates"]
        assert [sum(p[k] for p in gate) / 2.0 for k in range(2)] == pytest.approx([80.0, -0.5], abs=0.6)
        stored = desk.store_mission("with areas", "anna")
        desk.remove_areas()
        assert desk.plan is None
        assert desk.outline is not None
        assert desk.shown_outline == desk.outline | {"guide": None}
        desk.reopen(stored.id)
        assert (desk.no_go_m, desk.gate_m) == ((area,), (80.0, -3.0))
        shown = desk.shown_outline
        assert shown is not None
        assert len(shown["no_go"]) == 1

    asyncio.run(drive())


def test_side_margin_and_refill_belong_to_the_mission(tmp_path: Path) -> None:
    """They are set by clicks, planned, stored and opened again; another field has none."""

    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        await desk.load({"a.geojson": geojson(corner_field(160.0))})
        desk.draw("swaths_from")
        desk.add_point(80.0, 165.0)
        desk.draw_place("margin", "3 deep ditch")
        desk.add_point(10.0, 0.0)
        assert desk.options.margins == ()
        desk.add_point(150.0, 0.0)
        desk.draw_place("refill", "9000 seed")
        desk.add_point(40.0, -2.0)
        desk.set_option("swath_skip", "1", "anna")
        options = desk.options
        assert desk.drawing.kind == ""
        assert options.swaths_from_m == (80.0, 165.0)
        assert [(m.margin_m, m.reason) for m in options.margins] == [(3.0, "deep ditch")]
        assert options.refill == Refill(at_m=(40.0, -2.0), every_m2=9000.0, reason="seed")
        shown = desk.shown_outline
        assert shown is not None
        assert shown["labels"] == [[[80.0, 165.0], "1"], [[40.0, -2.0], "R"]]
        assert shown["margins"] == [[(10.0, 0.0), (150.0, 0.0)]]
        await desk.make_plan()
        assert desk.error == ""
        assert desk.plan is not None
        assert len(desk.plan.refills) >= 1
        assert all(0.0 < worked_m2 <= 9000.0 < 9000.0 + driven_m for worked_m2, driven_m in desk.plan.refills)
        assert desk.plan.map["labels"]
        stored = desk.store_mission("with places", "anna")
        desk.remove_places()
        assert desk.options == options.without_places() != options
        desk.reopen(stored.id)
        assert desk.options == options
        await desk.load({"a.geojson": geojson(corner_field(160.0))})
        assert desk.options.refill is None
        assert desk.options.swath_skip == 1

    asyncio.run(drive())


@pytest.mark.parametrize("text", ["", "3", "ditch 3", "-1 ditch", "nan ditch", "3  "])
def test_an_amount_without_number_or_reason_is_refused(tmp_path: Path, text: str) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path)
        await desk.load({"a.kml": b"ok"})
        with pytest.raises(Refused, match="amount"):
            desk.draw_place("margin", text)
        desk.draw_place("refill", "0 seed")
        with pytest.raises(ConfigError, match="every_m2"):
            desk.add_point(1.0, 1.0)
        assert desk.options.refill is None
        assert desk.drawing.kind == ""

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("ring", "words"),
    [
        (((0.0, 0.0), (50.0, 50.0), (50.0, 0.0), (0.0, 50.0)), "no-go area 1 crosses itself"),
        (((-90.0, 0.0), (-80.0, 0.0), (-80.0, 9.0)), "outside the field"),
        (((-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)), "leave 0.0 m² of the field"),
    ],
)
def test_a_no_go_area_that_is_none_is_refused_in_words(
    tmp_path: Path, ring: tuple[tuple[float, float], ...], words: str
) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        await desk.load({"a.geojson": geojson(corner_field(160.0))})
        desk.draw("no_go")
        for corner in ring:
            desk.add_point(*corner)
        await desk.close_drawing(DATUM, "")
        await desk.make_plan()
        assert words in desk.error
        desk.remove_areas()
        assert desk.error == "" or desk.plan is None

    asyncio.run(drive())


def drive_to(state: PageState, x_m: float, y_m: float, yaw_rad: float, level_m: float = 0.2) -> PageState:
    position = replace(map_pose(x_m, y_m, yaw_rad), protection_level_m=level_m)
    messages = (("map_pose", position), ("odom", odometry(0.0, 0.0)))
    state.take(NOW_NS, [Envelope(topic, 0, NOW_NS, message) for topic, message in messages])
    return state


@pytest.mark.parametrize(("side", "away_m"), [("left", -1.0), ("right", 1.0), ("middle", 0.0)])
def test_a_field_is_recorded_along_its_edge(tmp_path: Path, side: str, away_m: float) -> None:
    """The outer end of the implement follows the edge; straight sides need few points, and jumps of 0.1 m none."""
    desk = desk_in(tmp_path, PLANNER)
    desk.draw("driven", side)
    desk.add_point(5.0, 5.0)  # a click is no point of the edge
    curvature, step_m = ((100.0, 0.0), (0.5 * math.pi * 12.0, 1.0 / 12.0), (60.0, 0.0)), 0.2  # length and curvature
    state = PageState(demo_scene(), 5.0)
    x = y = yaw = 0.0
    driven = []
    for length_m, bend_radpm in (*curvature[:2], curvature[2], curvature[1]) * 2:
        for _ in range(round(length_m / step_m)):
            yaw += step_m * bend_radpm
            x, y = x + step_m * math.cos(yaw), y + step_m * math.sin(yaw)
            driven.append((x, y))
            desk.follow(drive_to(state, x, y, yaw))
            desk.follow(drive_to(state, 500.0, 500.0, 0.0, 0.6))  # a position that is too uncertain
    half_m = 0.5 * demo_scene().implement.width_m
    shape, path = shapely.Polygon(desk.drawing.points_m), shapely.Polygon(driven)
    distances = [path.exterior.distance(shapely.Point(p)) for p in desk.drawing.points_m]
    assert shape.is_valid
    assert len(desk.drawing.points_m) < 90
    assert np.median(distances) == pytest.approx(abs(away_m) * half_m, abs=0.2)
    assert (shape.area - path.area) / path.length == pytest.approx(away_m * half_m, abs=0.3)


def test_corners_of_a_crossing_outline_can_be_corrected(tmp_path: Path) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER)
        desk.draw("outline")
        for corner in ((0.0, 0.0), (100.0, 100.0), (100.0, 0.0), (0.0, 100.0)):
            desk.add_point(*corner)
        await desk.close_drawing(DATUM, "drawn")
        assert "crosses itself" in desk.error
        assert desk.drawing.kind == "outline"
        assert len(desk.drawing.points_m) == 4

    asyncio.run(drive())


@pytest.mark.parametrize("corner", [(math.nan, 0.0), (0.0, math.inf), (1e9, 0.0)])
def test_a_corner_outside_the_map_is_refused(tmp_path: Path, corner: tuple[float, float]) -> None:
    desk = desk_in(tmp_path)
    desk.draw("outline")
    with pytest.raises(Refused, match="outside_map"):
        desk.add_point(*corner)
    assert desk.drawing.points_m == []


def test_corners_are_limited(tmp_path: Path) -> None:
    desk = desk_in(tmp_path)
    desk.draw("outline")
    for k in range(1000):
        desk.add_point(float(k), 0.0)
    assert len(desk.drawing.points_m) == 500


def test_while_the_planner_works_nothing_changes_but_it_can_be_cancelled(tmp_path: Path) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path)
        loading = asyncio.create_task(desk.load({"a.kml": b"slow"}))
        while desk.job is None or desk.job.stage != "route":
            await asyncio.sleep(0.02)
        process = desk.job._process
        assert process is not None
        for change in (
            lambda: desk.draw("outline"),
            lambda: desk.set_option("turns", "reverse", "anna"),
            lambda: desk.reopen("x"),
        ):
            with pytest.raises(Refused, match="busy"):
                change()
        for later in (desk.load({"b.kml": b"ok"}), desk.make_plan(), desk.choose("1")):
            with pytest.raises(Refused, match="busy"):
                await later
        desk.cancel()
        await loading
        assert desk.job is None
        assert (desk.error, desk.outline) == ("", None)
        with pytest.raises(ProcessLookupError):
            os.killpg(process.pid, 0)
        await desk.load({"b.kml": b"ok"})
        assert desk.outline is not None

    asyncio.run(drive())


def test_a_planner_that_dies_or_takes_too_long_is_an_error_in_words(tmp_path: Path) -> None:
    dying, slow = desk_in(tmp_path / "a"), desk_in(tmp_path / "b", limit_s=0.5)
    asyncio.run(dying.load({"a.kml": b"dies"}))
    assert dying.error == "the planner has died"
    asyncio.run(slow.load({"a.kml": b"slow"}))
    assert slow.error == "no result within 0 s"
    assert slow.job is None


@pytest.mark.slow
def test_the_planner_ends_with_a_killed_page(tmp_path: Path) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    page = subprocess.Popen([sys.executable, "-c", PLANNING, str(tmp_path)], env=env, stdout=subprocess.PIPE, text=True)
    assert page.stdout is not None
    planner = int(page.stdout.readline())
    assert Path(f"/proc/{planner}").exists()
    page.kill()
    page.wait()
    until_s = time.monotonic() + 20.0
    while Path(f"/proc/{planner}").exists() and time.monotonic() < until_s:
        time.sleep(0.05)
    assert not Path(f"/proc/{planner}").exists()


def test_another_field_removes_the_draft_of_the_first(tmp_path: Path) -> None:
    desk = desk_in(tmp_path)
    for name in ("a.kml", "b.kml", "c.kml"):
        asyncio.run(desk.load({name: b"ok"}))
    (draft,) = (tmp_path / "missions").iterdir()
    assert [path.name for path in (draft / "field").iterdir()] == ["c.kml"]


def test_files_that_become_the_same_name_are_refused(tmp_path: Path) -> None:
    desk = desk_in(tmp_path)
    for files in ({}, {"x/a.shp": b"1", "y/a.shp": b"2"}):
        with pytest.raises(Refused, match=r"no_file|same_name"):
            asyncio.run(desk.load(files))


def test_a_stored_mission_whose_plan_is_damaged_is_refused(tmp_path: Path) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path)
        await desk.load({"a.kml": b"ok"})
        await desk.make_plan()
        stored = desk.store_mission("x", "anna")
        (stored.folder / PLAN).write_text("{")
        with pytest.raises(HeadlandError, match="damaged"):
            desk.reopen(stored.id)
        assert desk.plan is not None  # what was shown before

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("name", "value"),
    [("machine", "../../etc"), ("implement", ""), ("turns", "jump"), ("headland_passes", "0"), ("headland_passes", "x"),
     ("heading_deg", "360"), ("heading_deg", "-1"), ("heading_deg", "²"), ("_FOLDERS", "a"), ("__class__", "x"),
     ("vegetation_cm", "36"), ("vegetation_cm", "9")],
)  # fmt: skip
def test_an_option_that_does_not_exist_names_the_value(tmp_path: Path, name: str, value: str) -> None:
    desk = desk_in(tmp_path)
    before = desk.options
    with pytest.raises(ConfigError, match=name):
        desk.set_option(name, value, "anna")
    assert desk.options == before


@pytest.mark.parametrize("heading", ["", "0", "45", "90", "175"])
def test_options_come_back_from_their_mission_file(tmp_path: Path, heading: str) -> None:
    from hmi.plan_view.options import write_mission

    desk = desk_in(tmp_path)
    desk.set_option("heading_deg", heading, "anna")
    desk.set_option("vegetation_cm", "30" if heading else "", "anna")
    for name in ("machine", "implement", "turns"):
        desk.set_option(name, choices()[name][-1], "anna")
    write_mission(desk.options.mission("name: [x", default_work()), tmp_path / "m.yaml")
    assert options_of(*read_mission(tmp_path / "m.yaml")) == desk.options


def test_a_guidance_line_comes_back_from_its_mission_file(tmp_path: Path) -> None:
    from hmi.plan_view.options import write_mission

    options = desk_in(tmp_path).options
    for chosen in (options.with_line((12.34, -5.6), 217.125), options.with_guidance("2")):
        write_mission(chosen.mission("x", default_work()), tmp_path / "m.yaml")
        assert options_of(*read_mission(tmp_path / "m.yaml")) == chosen


def test_rows_lie_along_the_guidance_line_of_the_file_or_a_drawn_one(tmp_path: Path) -> None:
    """Rows are parallel to the line, at whole widths from it; a curve that crosses itself is named and not offered."""
    field = json.loads(geojson())
    names = {"A": [[11.0002, 48.0001], [11.0009, 48.0004]], "bend": [[11.0, 48.0], [11.0004, 48.0], [11.0004, 48.0004]]}
    names["loop"] = [[11.0, 48.0], [11.0008, 48.0], [11.0008, 48.0004], [11.0004, 48.0004], [11.0004, 47.9996]]
    lines = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "LineString", "coordinates": points}}
        for name, points in names.items()
    ]
    text = json.dumps({"type": "FeatureCollection", "features": [field, *lines]}).encode()
    work = default_work()

    def check(desk: PlanDesk, a_m: tuple[float, float], angle: float, width_m: float) -> None:
        assert desk.error == ""
        assert desk.plan is not None
        (x0, y0), (x1, y1) = desk.plan.map["guide"]
        assert math.sin(math.atan2(y1 - y0, x1 - x0) - angle) == pytest.approx(0.0, abs=1e-4)
        rows = [points for kind, points in desk.plan.map["sections"] if kind == "swath"]
        assert len(rows) > 5
        for (ax, ay), *_, (bx, by) in rows:
            assert math.sin(math.atan2(by - ay, bx - ax) - angle) == pytest.approx(0.0, abs=2e-3)
            aside_m = (ay - a_m[1]) * math.cos(angle) - (ax - a_m[0]) * math.sin(angle)
            assert aside_m / width_m == pytest.approx(round(aside_m / width_m), abs=0.02)

    async def drive() -> None:
        desk = desk_in(tmp_path, PLANNER, 600.0)
        desk.set_option("implement", "harrow_6m", "anna")
        await desk.load({"lines.geojson": text})
        assert [(line.number, line.name) for line in desk.lines] == [("1", "1 A"), ("2", "2 bend")]
        assert any("'loop': the curve crosses itself" in note for note in desk.notes)
        with pytest.raises(Refused, match="no_line"):
            desk.choose_line("3")
        desk.choose_line("2")
        assert len(desk.guide or ()) > 2
        desk.choose_line("1")
        assert desk.guide == desk.lines[0].points_m
        await desk.make_plan()
        (x0, y0), (x1, y1) = desk.lines[0].points_m
        width_m = 6.0 - work.overlap_m
        check(desk, ((x0 + x1) / 2.0, (y0 + y1) / 2.0), math.atan2(y1 - y0, x1 - x0), width_m)
        desk.draw("ab")
        desk.add_point(20.0, 10.0)
        assert desk.options.guidance == "1"  # until B
        desk.add_point(60.0, 90.0)
        assert (desk.drawing.kind, desk.plan, desk.options.guidance) == ("", None, None)
        assert desk.options.heading_deg == pytest.approx(math.degrees(math.atan2(40.0, 80.0)), abs=1e-3)
        await desk.make_plan()
        check(desk, (20.0, 10.0), math.atan2(80.0, 40.0), width_m)
        await desk.load({"lines.geojson": text})  # a line lies in the map of its field
        assert desk.guide is desk.options.heading_deg is desk.options.through_m is None

    asyncio.run(drive())


def test_a_plus_line_has_a_heading_and_a_point(tmp_path: Path) -> None:
    async def drive() -> None:
        desk = desk_in(tmp_path)
        with pytest.raises(Refused, match="no_field"):
            desk.draw("ab")
        await desk.load({"a.kml": b"ok"})
        for heading in ("", "x", "-1", "361", "nan", "1e9"):
            with pytest.raises(Refused, match="heading"):
                desk.draw_a_plus(heading)
        desk.draw_a_plus("37.25")
        desk.add_point(3.0, 4.0)
        assert (desk.options.heading_deg, desk.options.through_m, desk.drawing.kind) == (37.25, (3.0, 4.0), "")
        assert desk.guide is not None
        desk.draw("ab")
        desk.add_point(1.0, 1.0)
        with pytest.raises(Refused, match="short_line"):
            desk.add_point(1.5, 1.0)
        assert desk.drawing.points_m == [(1.0, 1.0)]
        desk.remove_line()
        assert desk.guide is desk.options.heading_deg is None
        assert desk.shown_outline is not None
        assert desk.shown_outline["guide"] is None

    asyncio.run(drive())


def test_direction_is_a_compass_heading(tmp_path: Path) -> None:
    desk = desk_in(tmp_path)
    for heading, yaw in (("0", 90.0), ("90", 0.0), ("45", 45.0), ("135", -45.0)):
        desk.set_option("heading_deg", heading, "anna")
        work = desk.options.mission("x", default_work()).work
        assert work is not None
        assert work.swath_direction_deg == pytest.approx(yaw)


def test_a_plan_begins_with_an_implement_that_is_driven() -> None:
    assert default_options("unknown", "unknown").implement == "harrow_12m"
    assert default_options("unknown", "disc harrow 3 m").implement == "disc_harrow_3m"

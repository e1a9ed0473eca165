"""Guidance lines of field files: in `map`, by name or number, and as the place of swaths."""

import math
from pathlib import Path

import numpy as np
import pytest

from configs.mission import Mission, Work
from configs.site import Site
from configs.vehicle import MountedImplement, Vehicle
from messages.errors import ConfigError, FieldError
from planning.config import PlanningConfig
from planning.field.field import FieldOutline, read_field
from planning.guidance.line import Circle, Curve, Straight
from planning.guidance.recorded import choose_line, line_in_map, work_along
from planning.plan import plan_field
from runtime.setup import load_setup
from tests.planning.field_samples import (
    AB,
    SQUARE,
    M,
    geojson,
    isoxml,
    isoxml_area,
    isoxml_line,
    kml,
    placemark,
    text_of,
)

CENTRE = (6.001, 51.0004)


def pattern(name: str, kind: int, line: str, more: str = "") -> str:
    return f'<GGP A="GGP1" B="g"><GPN A="GPN1" B="{name}" C="{kind}" {more}>{line}</GPN></GGP>'


@pytest.fixture(scope="module")
def task_data(tmp_path_factory: pytest.TempPathFactory) -> FieldOutline:
    path = tmp_path_factory.mktemp("task") / "TASKDATA.XML"
    curve = [(6.0 + k * 10 * M, 51.0 + k * k * M) for k in range(9)]
    path.write_text(
        isoxml(
            isoxml_area([SQUARE])
            + pattern("AB", 1, isoxml_line(AB, 5, (6, 7), ' C="3000"'))
            + pattern("back", 1, isoxml_line(AB[::-1], 5, (7, 6)))
            + pattern("A+", 2, isoxml_line(AB[:1], 5, (6,)), 'G="30.0"')
            + pattern("curve", 3, isoxml_line(curve, 5, (6, *[9] * 7, 7)))
            + pattern("pivot", 4, isoxml_line([CENTRE], 5, (8,)), 'H="25000" D="1"')
            + pattern("rim", 4, isoxml_line([CENTRE, (CENTRE[0], CENTRE[1] + 20 * M)], 5, (8, 6)))
            + pattern("spiral", 5, isoxml_line(curve, 5, (6, *[9] * 7, 7)))
            + isoxml_line(AB, 5, more=' B="old"')
        )
    )
    return read_field(path)


def test_all_types_of_isoxml(task_data: FieldOutline) -> None:
    datum = task_data.datum.datum
    found = {line.name: line_in_map(line, datum) for line in task_data.lines}
    assert list(found) == ["AB", "back", "A+", "curve", "pivot", "rim", "old"]
    a, b = (np.array(datum.to_map(*np.radians(p[::-1]), 0.0)[:2]) for p in AB)
    for name in ("AB", "back", "old"):
        line = found[name]
        assert isinstance(line, Straight)
        assert np.abs(line.line(0, 3.0) - np.array([a, b])).max() < 0.002
    plus, pivot, rim = found["A+"], found["pivot"], found["rim"]
    assert isinstance(plus, Straight)
    assert math.degrees(plus.heading_rad) == pytest.approx(60.0)
    assert isinstance(found["curve"], Curve)
    assert isinstance(pivot, Circle)
    assert (pivot.radius_m, pivot.is_clockwise) == (25.0, True)
    assert isinstance(rim, Circle)
    assert rim.radius_m == pytest.approx(20 * M * 111_240, rel=0.003)


def test_choice_of_a_line(task_data: FieldOutline) -> None:
    assert choose_line(task_data.lines, "A+").kind == "a_plus"
    assert choose_line(task_data.lines, "4").name == "curve"
    with pytest.raises(FieldError, match="no guidance line '9'; the field has: 1 'AB'"):
        choose_line(task_data.lines, "9")
    with pytest.raises(FieldError, match="2 guidance lines are named 'AB'"):
        choose_line([*task_data.lines, task_data.lines[0]], "AB")
    with pytest.raises(FieldError, match="no guidance line 'x'; the field has: none"):
        choose_line([], "x")


def test_work_along_each_kind_of_line(task_data: FieldOutline, mission: Mission) -> None:
    assert mission.work is not None
    work, datum = mission.work, task_data.datum.datum
    for line in task_data.lines:  # from one to the next: nothing of the one before is left
        work = work_along(work, line, datum)
        is_straight = line.kind in ("ab", "a_plus")
        given = (work.swath_direction_deg is not None, work.swath_through_m is not None)
        assert given == (is_straight, is_straight)
        assert (len(work.swath_curve_m) > 0) == (line.kind == "curve")
        assert (work.swath_circle_m is not None) == (line.kind == "pivot")
        Work.model_validate(work.model_dump())
    circle = work_along(work, choose_line(task_data.lines, "pivot"), datum).swath_circle_m
    assert circle is not None
    assert circle[2] == 25.0


def test_points_at_one_place_are_no_line(tmp_path: Path) -> None:
    path = tmp_path / "f.json"
    path.write_text(geojson([("F", "Polygon", [SQUARE]), ("AB", "LineString", [AB[0], AB[0]])]))
    outline = read_field(path)
    with pytest.raises(FieldError, match=r"guidance line 'AB': A and B are 0\.00 m apart"):
        line_in_map(outline.lines[0], outline.datum.datum)


@pytest.mark.parametrize("suffix", ["json", "kml"])
def test_drawn_lines(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"f.{suffix}"
    curve = [*AB, (6.0015, 51.0008)]
    if suffix == "json":
        drawn = [("AB", "LineString", AB), ("C", "MultiLineString", [curve, AB])]
        path.write_text(geojson([("F", "Polygon", [SQUARE]), *drawn]))
    else:
        lines = [("AB", AB), ("C", curve), ("C", AB)]
        body = "".join(
            placemark(n, f"<LineString><coordinates>{text_of(p)}</coordinates></LineString>") for n, p in lines
        )
        ring = f"<LinearRing><coordinates>{text_of(SQUARE)}</coordinates></LinearRing>"
        path.write_text(kml(body + placemark("F", ring)))
    found = [(line.name, line.kind, len(line.points)) for line in read_field(path).lines]
    assert found == [("AB", "ab", 2), ("C", "curve", 3), ("C", "ab", 2)]


@pytest.mark.parametrize(("heading_deg", "through_m"), [(0.0, (0.0, 12.3)), (37.0, (11.0, 5.0)), (90.0, (300.0, 0.0))])
def test_swaths_at_whole_widths_from_the_line(
    heading_deg: float, through_m: tuple[float, float],
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig,
) -> None:  # fmt: skip
    assert mission.work is not None
    work = mission.work.model_copy(update={"swath_direction_deg": heading_deg, "swath_through_m": through_m})
    plan = plan_field(site, vehicle, harrow, work, planning.planner, 0)
    pitch = harrow.working_width_m - work.overlap_m
    along = np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])
    assert len(plan.swaths) >= 3
    for swath in plan.swaths:
        for ends in (swath.onwards_m, swath.back_m):
            if ends is not None:
                aside = (ends - through_m) @ np.array([-along[1], along[0]])
                assert np.abs(aside / pitch - np.round(aside / pitch)).max() < 1e-6
    assert plan.planned_share > 0.88


def test_guidance_of_a_mission_needs_a_field_file() -> None:
    with pytest.raises(ConfigError, match="guidance 'AB': is a line of a field file"):
        load_setup("yard", None, None, None, 1, guidance="AB")


def test_guidance_excludes_a_direction(mission: Mission) -> None:
    assert mission.work is not None
    values = mission.work.model_dump() | {"guidance": "AB", "swath_direction_deg": 3.0}
    with pytest.raises(ValueError, match="leave out swath_direction_deg"):
        Work.model_validate(values)

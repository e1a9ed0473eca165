"""Exported plans are read again: field, no-go areas and guidance lines within 1 cm."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely
from pyogrio.raw import read
from shapely.geometry import Polygon

from configs.site import Area, Site
from planning.export.geojson import write_geojson
from planning.export.isoxml import write_isoxml
from planning.export.kml import write_kml
from planning.field.field import FieldOutline, read_field
from planning.guidance.line import Straight
from planning.guidance.recorded import line_in_map
from planning.plan import Plan
from tests.planning.field_samples import in_datum

WITHIN_M = 0.01
OUTLINE = ((0.0, 0.0), (90.0, 0.0), (90.0, 44.0), (55.0, 44.0), (55.0, 30.0), (0.0, 30.0))
POND = ((20.0, 10.0), (30.0, 10.0), (30.0, 20.0), (20.0, 20.0))
SHED = ((50.0, 25.0), (60.0, 25.0), (60.0, 50.0), (50.0, 50.0))  # crosses the outline


def as_geojson(plan: Plan, site: Site, folder: Path) -> FieldOutline:
    write_geojson(plan, site, folder / "plan.geojson")
    return read_field(folder / "plan.geojson", site.name)


def as_kml(plan: Plan, site: Site, folder: Path) -> FieldOutline:
    write_kml(plan, site, folder / "plan.kml")
    return read_field(folder / "plan.kml", site.name)


def as_isoxml(plan: Plan, site: Site, folder: Path) -> FieldOutline:
    write_isoxml(plan, site, folder / "TASKDATA", "1.2.3")
    return read_field(folder / "TASKDATA")


FORMATS = (as_geojson, as_kml, as_isoxml)


@pytest.fixture(scope="module")
def holed(site: Site) -> Site:
    no_go = (Area(name="pond", outline_m=POND), Area(name="shed", outline_m=SHED))
    return site.model_copy(update={"name": 'Feld <1> & "Süd" \u2603', "boundary_m": OUTLINE, "no_go": no_go})


@pytest.mark.parametrize("export", FORMATS)
def test_field_round_trip(export: Callable[..., FieldOutline], plan: Plan, holed: Site, tmp_path: Path) -> None:
    found = export(plan, holed, tmp_path)
    assert found.name == holed.name
    assert shapely.hausdorff_distance(in_datum(found, holed.datum), Polygon(OUTLINE, [POND])) < WITHIN_M


@pytest.mark.parametrize(
    ("write", "name", "layer"), [(write_kml, "plan.kml", "Field"), (write_geojson, "plan.geojson", 0)]
)
def test_field_as_gdal_reads_it(
    write: Callable[..., None], name: str, layer: str | int, plan: Plan, holed: Site, tmp_path: Path
) -> None:
    write(plan, holed, tmp_path / name)
    meta, _, geometries, columns = read(tmp_path / name, layer=layer, force_2d=True)
    names = dict(zip([f.lower() for f in meta["fields"]], columns, strict=True))["name"]
    assert names[0] == holed.name
    datum = holed.datum.datum
    found = shapely.transform(shapely.from_wkb(geometries)[0], datum.points_to_map)
    assert shapely.hausdorff_distance(found, Polygon(OUTLINE, [POND])) < WITHIN_M


def test_no_go_area_across_the_outline_in_isoxml(plan: Plan, holed: Site, tmp_path: Path) -> None:
    ((name, _),) = as_isoxml(plan, holed, tmp_path).no_go
    assert name == "obstacle shed"


@pytest.mark.parametrize("export", [as_kml, as_isoxml])
def test_guidance_line_round_trip(export: Callable[..., FieldOutline], plan: Plan, site: Site, tmp_path: Path) -> None:
    lines = {line.name: line for line in export(plan, site, tmp_path).lines}
    for swath in plan.swaths:
        line = line_in_map(lines[f"swath {swath.number + 1}"], site.datum.datum)
        assert isinstance(line, Straight)
        ends = swath.onwards_m if swath.onwards_m is not None else swath.back_m
        assert ends is not None
        if swath.onwards_m is not None and swath.back_m is not None and swath.length_m > np.hypot(*(ends[1] - ends[0])):
            ends = swath.back_m
        assert np.abs(line.line(0, 6.0) - ends).max() < WITHIN_M
    for number, ring in enumerate(plan.headland_passes, 1):
        curve = line_in_map(lines[f"headland {number}"], site.datum.datum).line(0, 6.0)
        distance = shapely.hausdorff_distance(shapely.LineString(curve), shapely.LineString(ring.points_m))
        assert distance < WITHIN_M


def test_widths_in_isoxml(plan: Plan, site: Site, tmp_path: Path) -> None:
    lines = as_isoxml(plan, site, tmp_path).lines
    assert len(lines) == len(plan.swaths) + len(plan.headland_passes)
    assert {line.width_m for line in lines} == {plan.rig.working_width_m}

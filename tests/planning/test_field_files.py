"""Field files of all formats: the same field from each, features, coordinate systems, simplification."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.geometry import Polygon

from configs.mission import Mission
from configs.site import Site
from configs.vehicle import MountedImplement, Vehicle
from messages.errors import FieldError
from planning.field.drivable_area import drivable_area_of
from planning.field.field import FieldOutline, read_field
from planning.field.formats.contents import Ring
from planning.field.formats.known_formats import known_formats, read_file
from planning.field.simplification import simplified_inwards
from planning.field.site_generation import site_around, site_of_original
from planning.plan import Plan, check_within
from tests.planning.field_samples import (
    AB,
    POND,
    SQUARE,
    M,
    gaos,
    geojson,
    in_datum,
    isoxml,
    isoxml_area,
    isoxml_line,
    kml,
    kml_polygon,
    moved,
    placemark,
    shapefile,
    zipped,
)
from tests.recordings import DATA, needs

RINGS = [SQUARE, POND]
Make = Callable[[Path], Path]


def made(name: str, content: str | bytes) -> Make:
    def make(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


def folder_of_task_data(folder: Path) -> Path:
    target = folder / "card" / "TASKDATA"
    target.mkdir(parents=True)
    reference = isoxml().replace("</ISO", '<XFR A="PFD00001" B="1"/></ISO')
    (target / "TASKDATA.XML").write_text(reference)
    (target / "PFD00001.XML").write_text(f'<XFC><PFD A="PFD1" C="F">{isoxml_area(RINGS)}</PFD></XFC>')
    return folder / "card"


def zipped_shapefile(folder: Path) -> Path:
    path = shapefile(folder, {"F": RINGS})
    return zipped(folder / "f.zip", {f"a/{p.name.upper()}": p.read_bytes() for p in folder.glob(f"{path.stem}.*")})


NESTED = "<Folder><name>A</name><Folder>" + placemark("F", kml_polygon(RINGS)) + "</Folder></Folder>"
SAME: dict[str, Make] = {
    "geojson": made("f.geojson", geojson([("F", "Polygon", RINGS)])),
    "geojson 3-D": made("f.json", geojson([("F", "Polygon", [[[*p, 31.0] for p in r] for r in RINGS])])),
    "geojson UTF-16": made("f.json", geojson([("F", "Polygon", RINGS)]).encode("utf-16")),
    "geojson byte order mark": made("f.json", b"\xef\xbb\xbf" + geojson([("F", "Polygon", RINGS)]).encode()),
    "geojson in a zip": lambda f: zipped(f / "f.zip", {"f.geojson": geojson([("F", "Polygon", RINGS)])}),
    "geojson under another suffix": made("f.kml", geojson([("F", "Polygon", RINGS)])),
    "kml in folders": made("f.kml", kml(NESTED)),
    "kml without heights": made("f.kml", kml(placemark("F", kml_polygon(RINGS, "")))),
    "kml UTF-16": made("f.kml", kml(NESTED).replace("UTF-8", "UTF-16").encode("utf-16")),
    "kml with prefixes": made("f.kml", kml(NESTED).replace("<Pol", "<k:Pol").replace("</Pol", "</k:Pol")),
    "kml with spaces at commas": made("f.kml", kml(NESTED).replace(",51", " ,  51")),
    "kml with an undeclared encoding": made("f.kml", kml(NESTED.replace(">A<", ">Süd<")).encode("iso-8859-1")),
    "kml UTF-8 called UTF-16": made("f.kml", kml(NESTED).replace("UTF-8", "UTF-16")),
    "kml UTF-16 called UTF-8": made("f.kml", kml(NESTED).encode("utf-16")),
    "kml geometry in a collection": made(
        "f.kml", kml(placemark("F", f"<MultiGeometry>{kml_polygon(RINGS)}</MultiGeometry>"))
    ),
    "kmz": lambda f: zipped(f / "f.kmz", {"doc.kml": kml(NESTED), "files/icon.png": b"\x89PNG"}),
    "kmz with links to its files": lambda f: zipped(
        f / "f.kmz",
        {
            "doc.kml": kml("<NetworkLink><Link><href>layers/f.kml</href></Link></NetworkLink>"),
            "layers/f.kml": kml(NESTED),
        },
    ),
    "shapefile": lambda f: shapefile(f, {"F": RINGS}),
    "shapefile UTM": lambda f: shapefile(f, {"F": RINGS}, "EPSG:32631"),
    "shapefile in a zip": zipped_shapefile,
    "isoxml 3": made("TASKDATA.XML", isoxml(isoxml_area(RINGS), version=3)),
    "isoxml 4": made("TASKDATA.XML", isoxml(isoxml_area(RINGS))),
    "isoxml open rings": made("TASKDATA.XML", isoxml(isoxml_area([r[:-1] for r in RINGS]))),
    "isoxml with a treatment zone": made(
        "TASKDATA.XML", isoxml(f'{isoxml_area(RINGS)}<TZN A="1">{isoxml_area([SQUARE], 2)}</TZN>')
    ),
    "isoxml folder with parts": folder_of_task_data,
    "isoxml zip": lambda f: zipped(f / "t.zip", {"TASKDATA/TASKDATA.XML": isoxml(isoxml_area(RINGS))}),
    "gaos": made("f.xml", gaos(RINGS)),
}


@pytest.mark.parametrize("name", SAME)
def test_same_field_from_every_format(name: str, tmp_path: Path) -> None:
    expected = read_field(made("expected.json", geojson([("F", "Polygon", RINGS)]))(tmp_path))
    outline = read_field(SAME[name](tmp_path))
    assert outline.datum == expected.datum
    assert shapely.hausdorff_distance(outline.polygon, expected.polygon) < 0.002
    assert len(outline.polygon.interiors) == 1
    assert expected.polygon.area == pytest.approx(200 * 0.702 * 90 * 1.1124 - 20 * 0.702 * 20 * 1.1124, rel=0.01)


def test_format_names_are_unique() -> None:
    names = [known.NAME for known in known_formats()]
    assert sorted(set(names)) == ["GAOS", "GeoJSON", "ISOXML", "KML", "Shapefile"]
    assert len(names) == 5


SEVERAL = geojson(
    [
        ("North", "Polygon", [SQUARE]),
        ("gate", "Point", [6.0, 51.0]),
        ("2", "MultiPolygon", [[moved(SQUARE, 0.01)], [moved(SQUARE, 0.02)]]),
        ("north", "Polygon", [moved(SQUARE, 0.03)]),
        ("AB 1", "LineString", AB),
        ("", "Polygon", [SQUARE[:3]]),
    ]
)


@pytest.mark.parametrize(
    ("wanted", "name", "west"),
    [("North", "North", 6.0), ("1", "North", 6.0), ("north", "north", 6.03), ("3", "north", 6.03),
     ("2.1", "2.1", 6.01), ("2.2", "2.2", 6.02), (" 1.1 ", "North", 6.0)],
)  # fmt: skip
def test_feature_by_name_number_and_part(wanted: str, name: str, west: float, tmp_path: Path) -> None:
    outline = read_field(made("f.json", SEVERAL)(tmp_path), wanted)
    assert (outline.name, outline.datum.longitude_deg) == (name, pytest.approx(west))
    assert outline.notes == ("ignored: 1 point",)
    assert [line.name for line in outline.lines] == ["AB 1"]


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        (None, "holds 4 fields; choose one by --feature: 1 'North' (1.40 ha), 2 '2' (2.80 ha in 2 parts), 3 'north'"),
        ("2", "has 2 fields; choose one by --feature: 2.1 (1.40 ha), 2.2 (1.40 ha)"),
        ("2.3", "has 2 parts, not a part 3"),
        ("2.0", "has 2 parts, not a part 0"),
        ("4", "feature 4: not closed: longitude 6"),
        ("NORTH", "2 features are named 'NORTH'; choose one by its number: 1, 3"),
        ("5", "no feature '5'; there is: 1 'North'"),
        ("0", "no feature '0'"),
        ("-1", "no feature '-1'"),
        ("x", "no feature 'x'"),
        ("9" * 5000, "no feature '999"),
        ("²", "no feature '²'"),
    ],
)
def test_feature_that_is_not_there(wanted: str | None, words: str, tmp_path: Path) -> None:
    with pytest.raises(FieldError) as refused:
        read_field(made("f.json", SEVERAL)(tmp_path), wanted)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_slivers_beside_a_field_are_no_fields(tmp_path: Path) -> None:
    sliver = [(6.1, 51.0), (6.1 + M, 51.0), (6.1 + M, 51.0 + M), (6.1, 51.0)]
    outline = read_field(made("f.json", geojson([("F", "MultiPolygon", [[sliver], RINGS])]))(tmp_path))
    assert (outline.name, len(outline.polygon.interiors)) == ("F.2", 1)


@pytest.mark.parametrize("code", [25831, 32631, 28992, 3035, 3857, 4258])
def test_projected_system_is_transformed(code: int, tmp_path: Path) -> None:
    plain = read_field(made("f.json", geojson([("F", "Polygon", RINGS)]))(tmp_path))
    projected = read_field(shapefile(tmp_path, {"F": RINGS}, f"EPSG:{code}"))
    assert shapely.hausdorff_distance(in_datum(projected, plain.datum), plain.polygon) < 0.01


@pytest.mark.parametrize("name", ["urn:ogc:def:crs:EPSG::32631", "EPSG:32631"])
def test_crs_member_of_geojson(name: str, tmp_path: Path) -> None:
    ring = [[500000.0 + x, 5700000.0 + y] for x, y in ((0, 0), (200, 0), (200, 100), (0, 100), (0, 0))]
    content = geojson([("F", "Polygon", [ring])], crs={"type": "name", "properties": {"name": name}})
    outline = read_field(made("f.json", content)(tmp_path))
    assert outline.polygon.area == pytest.approx(20000 / 0.9996**2, rel=1e-4)
    assert outline.datum.longitude_deg == pytest.approx(3.0, abs=1e-4)


def test_field_on_both_sides_of_180_degrees(tmp_path: Path) -> None:
    ring = [(180.0 - 100 * M, -17.0), (-180.0 + 100 * M, -17.0), (-180.0 + 100 * M, -16.999), (180.0 - 100 * M, -17.0)]
    outline = read_field(made("f.json", geojson([("F", "Polygon", [ring])]))(tmp_path))
    assert outline.polygon.area == pytest.approx(0.5 * 200 * M * 111_320 * math.cos(math.radians(17)) * 110.7, rel=0.01)


def test_no_go_areas_of_isoxml(tmp_path: Path, vehicle: Vehicle, harrow: MountedImplement, mission: Mission) -> None:
    beyond = moved(POND, 0.0012)  # partly outside the field
    far = moved(POND, 0.01)
    areas = isoxml_area([SQUARE]) + isoxml_area([POND], 6, "pylon") + isoxml_area([beyond], 4) + isoxml_area([far], 3)
    lines = isoxml_line([(6.0002, 51.0002), (6.0003, 51.0003)], 9) + '<PNT A="5" B="pole" C="51.0001" D="6.0001"/>'
    outline = read_field(made("TASKDATA.XML", isoxml(areas + lines))(tmp_path))
    assert [name for name, _ in outline.no_go] == ["obstacle pylon", "building", "obstacle", "obstacle pole"]
    assert outline.no_go[3][1].area == pytest.approx(math.pi, rel=0.05)
    assert outline.no_go[2][1].length == pytest.approx(2 * 13.15 + 2 * math.pi, rel=0.02)
    site = site_around(outline, vehicle, harrow, mission.work)
    drivable = drivable_area_of(site, 0.1)
    assert not any(drivable.free.intersection(area).area > 0.01 for _, area in outline.no_go)
    assert drivable.free.area < outline.polygon.area - 300.0


@pytest.mark.parametrize("ring", [POND[:1] * 4, [*POND[:2], POND[0], POND[0]], [POND[k] for k in (0, 2, 1, 3, 0)]])
def test_no_go_area_without_a_valid_outline(ring: Ring, tmp_path: Path) -> None:
    path = made("TASKDATA.XML", isoxml(isoxml_area([SQUARE]) + isoxml_area([ring], 6)))(tmp_path)
    ((_, area),) = read_field(path).no_go
    assert area.is_valid
    assert area.area > 3.0


def test_unreadable_lines_are_noted(tmp_path: Path) -> None:
    group = f'<GGP A="G"><GPN A="P" C="2" G="north">{isoxml_line(POND[:1], 5)}</GPN></GGP>'
    task_data = read_field(made("TASKDATA.XML", isoxml(isoxml_area([SQUARE]) + group))(tmp_path))
    assert task_data.notes == ("ignored: guidance patterns ('north' is not a number)",)
    line = placemark("L", "<LineString><coordinates>x</coordinates></LineString>")
    drawn = read_field(made("f.kml", kml(placemark("F", kml_polygon([SQUARE])) + line))(tmp_path))
    assert drawn.notes == ("ignored: line 'L' (coordinates 'x' are not longitude,latitude,height in degrees)",)


def test_several_outlines_in_a_partfield(tmp_path: Path) -> None:
    lines = "".join(isoxml_line(r, k) for r, k in ((SQUARE, 1), (moved(SQUARE, 0.01), 1), (moved(POND, 0.01), 2)))
    path = made("TASKDATA.XML", isoxml(f'<PLN A="1">{lines}</PLN>'))(tmp_path)
    assert [len(read_field(path, f"1.{k}").polygon.interiors) for k in (1, 2)] == [0, 1]


def _wavy(count: int) -> Polygon:
    """A disc of 100 m with waves of 1 cm on its outline and a hole of the same kind."""
    angle = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    radius = 0.01 * np.sin(angle * count / 7.0)
    return Polygon((100.0 + radius)[:, None] * unit, [(20.0 + radius)[:, None] * unit])


@pytest.mark.parametrize("count", [200, 3000, 20000])
def test_simplification_stays_inside(count: int) -> None:
    polygon = _wavy(count)
    found = simplified_inwards(polygon)
    assert found.is_valid
    assert len(shapely.get_coordinates(found)) < min(2.02 * count, 2000)
    assert found.difference(polygon).area < 1e-6
    assert polygon.difference(found).area < 0.11 * polygon.length
    assert shapely.hausdorff_distance(found, polygon) < 2.0 * math.pi * 100.0 / 40


@pytest.mark.parametrize("seed", range(20))
def test_simplification_of_random_outlines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, 400))
    radius = rng.uniform(0.3, 1.0) * 100.0 + rng.normal(0.0, 10.0 ** rng.uniform(-3, 0.5), 400)
    polygon = Polygon(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    found = simplified_inwards(polygon)
    assert found.is_valid
    assert found.difference(polygon.buffer(1e-6)).area == 0.0
    assert polygon.area - found.area < 0.02 * polygon.length


def test_exact_rectangle_is_kept() -> None:
    rectangle = shapely.box(0.0, 0.0, 100.0, 50.0)
    assert simplified_inwards(rectangle).equals(rectangle)


def test_large_outline_is_simplified_with_a_note(tmp_path: Path) -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 50_000)
    ring = [[6.0 + 1e-3 * math.cos(a), 51.0 + 6e-4 * math.sin(a)] for a in angle]
    ring[-1] = ring[0]
    outline = read_field(made("f.json", json.dumps({"type": "Polygon", "coordinates": [ring]}))(tmp_path))
    assert outline.original is not None
    assert len(outline.polygon.exterior.coords) < 300
    assert "simplified inwards" in outline.notes[0]
    assert outline.original.buffer(1e-6).covers(outline.polygon)


@needs("isoxml-py")
class TestRealFiles:
    tasks = DATA / "isoxml-py/tests/resources/isoxml"

    @pytest.mark.parametrize(
        ("name", "area_ha", "lines"),
        [("v4/geobird/guidance_v4-4/TASKDATA.XML", 6.528, 1), ("v3/geobird/guidance_v3-3/TASKDATA.XML", 6.528, 1),
         ("v4/cnh_export/TASKDATA.XML", 0.363, 6), ("v4/deutz_export", 2.136, 0),
         ("v4/deutz_export/PFD00000.XML", 2.136, 0), ("v3/grid_type_2/grid_type_2.zip", 1.747, 0),
         ("v3/onesoil_demo/TASKDATA.XML", 57.27, 0), ("v4/farmdoc/fertilizer_map_1/TASKDATA.XML", 1.715, 0)],
    )  # fmt: skip
    def test_task_data(self, name: str, area_ha: float, lines: int) -> None:
        outline = read_field(self.tasks / name)
        assert outline.polygon.area / 1e4 == pytest.approx(area_ha, abs=0.001)
        assert len(outline.lines) == lines

    def test_shapefile(self) -> None:
        outline = read_field(DATA / "isoxml-py/examples/input/big/boundary/Boundary.shp")
        assert outline.polygon.area / 1e4 == pytest.approx(76.80, abs=0.01)
        assert len(outline.polygon.interiors) == 1


@needs("fields2cover")
@pytest.mark.parametrize("name", ["test1.xml", "Envelope.xml", "envelope1.xml"])
def test_gaos_parcel(name: str) -> None:
    assert read_field(DATA / "fields2cover/data" / name).polygon.area / 1e4 == pytest.approx(17.258, abs=0.005)


@needs("devices/fields")
@pytest.mark.parametrize("name", ["at", "lv", "ch"])
def test_register(name: str) -> None:
    """Area as the register's sample states it."""
    path = DATA / f"devices/fields/fiboa-cli/{name}.geojson"
    stated = [f["properties"]["area_ha"] for f in json.loads(path.read_text())["features"]]
    features = read_file(path).features
    found = [read_field(path, str(k + 1)).polygon.area / 1e4 for k, f in enumerate(features) if len(f.parts) == 1]
    expected = [a for a, f in zip(stated, features, strict=True) if len(f.parts) == 1]
    assert len(found) > 70
    assert found == pytest.approx(expected, rel=0.003, abs=0.0005)


def test_plan_is_checked_against_the_original(plan: Plan, site: Site, mission: Mission) -> None:
    assert mission.work is not None
    outline = FieldOutline("f", site.datum, Polygon(site.boundary_m), Polygon(site.boundary_m))
    check_within(plan, site_of_original(site, outline), mission.work)
    narrower = replace(outline, original=Polygon(site.boundary_m).buffer(-0.1, join_style="mitre"))
    with pytest.raises(FieldError, match="leaves the field"):
        check_within(plan, site_of_original(site, narrower), mission.work)

"""Bad field files of every format: one line that names file and value, within 2 s, exit code 2."""

import io
import json
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from messages.errors import FieldError
from runtime.commands.checks import check_field
from runtime.commands.options import ROOT, parse_arguments
from tests.planning.field_samples import (
    POND,
    SQUARE,
    M,
    gaos,
    geojson,
    isoxml,
    isoxml_area,
    kml,
    kml_polygon,
    moved,
    placemark,
    shapefile,
    text_of,
    zipped,
)
from tests.recordings import DATA, needs

Content = str | bytes | Callable[[Path], Path]
BOW = [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3], SQUARE[0]]
POLYGON = geojson([("F", "Polygon", [SQUARE])])
UTM_RING = [[500000.0 + x, 5700000.0 + y] for x, y in ((0, 0), (200, 0), (200, 100), (0, 100), (0, 0))]
SWAPPED = [(41.469 + y - 51.0, -90.134 + x - 6.0) for x, y in SQUARE]
ENTITIES = '<!DOCTYPE kml [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
EXTERNAL = '<!DOCTYPE kml [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
FIELD_KML = kml(placemark("F", kml_polygon([SQUARE])))


def gj(*features: tuple[str, str, object], **members: object) -> str:
    return geojson(list(features), **members)


def crs(name: object) -> dict[str, object]:
    return {"crs": {"type": "name", "properties": {"name": name}}}


def only_shp(folder: Path) -> Path:
    path = shapefile(folder, {"F": [SQUARE]})
    for end in (".shx", ".dbf", ".cpg"):
        path.with_suffix(end).unlink(missing_ok=True)
    return path


def without(end: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = shapefile(folder, {"F": [SQUARE]})
        path.with_suffix(end).unlink()
        return path

    return make


def with_bytes(change: Callable[[bytes], bytes], end: str = ".shp") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = shapefile(folder, {"F": [SQUARE], "G": [moved(SQUARE, 0.01)]})
        part = path.with_suffix(end)
        part.write_bytes(change(part.read_bytes()))
        return path

    return make


def bomb(folder: Path) -> Path:
    return zipped(folder / "bomb.kmz", {"doc.kml": b"<kml>" + b" " * 300_000_000})


def encrypted(folder: Path) -> Path:
    path = zipped(folder / "f.kmz", {"doc.kml": FIELD_KML})
    data = bytearray(path.read_bytes())
    for magic, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(magic) + at] |= 1
    path.write_bytes(data)
    return path


def nested_zip(folder: Path) -> Path:
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as archive:
        archive.writestr("doc.kml", FIELD_KML)
    return zipped(folder / "f.zip", {"inner.zip": inner.getvalue()})


def damaged_zip(folder: Path) -> Path:
    path = zipped(folder / "f.kmz", {"doc.kml": FIELD_KML * 20})
    data = bytearray(path.read_bytes())
    data[60:90] = bytes(30)
    path.write_bytes(data)
    return path


def empty_folder(folder: Path) -> Path:
    (folder / "empty").mkdir()
    return folder / "empty"


BAD: dict[str, tuple[Content, str]] = {
    "empty file": ("", "the file is empty"),
    "text": ("longitude;latitude\n6;51\n", "no known field format (GAOS, GeoJSON, ISOXML, KML, Shapefile)"),
    "picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "it begins with b'\\x89PNG"),
    "web page": ("<!DOCTYPE html><html><body><p>Login</body></html>", "not valid XML"),
    "other XML": ("<gpx><trk/></gpx>", "XML with the root <gpx>"),
    "empty folder": (empty_folder, "an empty folder"),
    "json cut off": (POLYGON[:-30], "not valid JSON"),
    "json number": ("[1, 2, 3]", "list where a Polygon is needed"),
    "json too deep": ("[" * 100_000, "not valid JSON"),
    "json nested collections": (
        '{"type": "GeometryCollection", "geometries": [' * 900 + '{"type": "Point"}' + "]}" * 900,
        "; export the field as GeoJSON",
    ),
    "json of another kind": ('{"type": "Topology", "arcs": []}', "Topology where a Polygon is needed"),
    "json type is a list": ('{"type": ["Polygon"]}', "where a Polygon is needed"),
    "json features is a number": ('{"type": "FeatureCollection", "features": 5}', "5 where a list is needed"),
    "no features": ('{"type": "FeatureCollection", "features": []}', "no polygon"),
    "feature without geometry": ('{"type": "Feature", "properties": {}, "geometry": null}', "no polygon"),
    "only lines": (gj(("L", "LineString", SQUARE[:2])), "no polygon, but 1 line"),
    "empty polygon": (gj(("F", "Polygon", [])), "the polygon is empty"),
    "empty multipolygon": (gj(("F", "MultiPolygon", [])), "the polygon is empty"),
    "not closed": (gj(("F", "Polygon", [SQUARE[:-1]])), "not closed: longitude 6, latitude 51"),
    "two corners": (gj(("F", "Polygon", [[SQUARE[0], SQUARE[1], SQUARE[0]]])), "3 points have no area"),
    "one place": (gj(("F", "Polygon", [[SQUARE[0]] * 5])), "less than three corners at longitude 6"),
    "crossing": (gj(("F", "Polygon", [BOW])), "crosses itself at longitude 6.001, latitude 51.00045"),
    "hole outside": (gj(("F", "Polygon", [SQUARE, moved(POND, 0.01)])), "hole lies outside shell at longitude 6.0108"),
    "hole across": (gj(("F", "Polygon", [SQUARE, moved(POND, 0.0011)])), "crosses itself"),
    "empty hole": (gj(("F", "Polygon", [SQUARE, []])), "0 points have no area"),
    "NaN": (POLYGON.replace("51.0009", "NaN", 1), "is not a finite number"),
    "infinity": (POLYGON.replace("51.0009", "1e999", 1), "is not a finite number"),
    "huge number": (POLYGON.replace("51.0009", "1" + "0" * 400, 1), "is not a finite number"),
    "number of 5000 digits": (POLYGON.replace("51.0009", "1" * 5000, 1), "not valid JSON"),
    "text as number": (POLYGON.replace("51.0009", '"51,0009"', 1), "is not [longitude, latitude]"),
    "swapped": (gj(("F", "Polygon", [SWAPPED])), "latitude -90.134 is beyond ±90°; points are [longitude, latitude]"),
    "metres": (gj(("F", "Polygon", [UTM_RING])), "500000, 5700000 are no degrees but metres of a projected system"),
    "unknown crs": (gj(("F", "Polygon", [UTM_RING]), **crs("EPSG:99999")), "unknown coordinate system 'EPSG:99999'"),
    "crs that is a link": (gj(("F", "Polygon", [UTM_RING]), crs={"type": "link"}), "has no name; export"),
    "local crs": (
        gj(("F", "Polygon", [UTM_RING]), **crs('LOCAL_CS["field grid",UNIT["metre",1]]')),
        "no transformation from 'field grid'",
    ),
    "degrees called UTM": (gj(("F", "Polygon", [SQUARE]), **crs("EPSG:32631")), "too small"),
    "inaccurate crs": (
        gj(("F", "Polygon", [[[500000 + x, 4200000 + y] for x, y in ((0, 0), (200, 0), (0, 200), (0, 0))]]),
           **crs("EPSG:26710")),
        "'NAD27 / UTM zone 10N' can be transformed within 7 m only",
    ),
    "too wide": (gj(("F", "Polygon", [[[0, 0], [10, 0], [10, 10], [0, 0]]])), "wider than 5 km"),
    "too small": (gj(("F", "Polygon", [[[6, 51], [6 + M, 51], [6, 51 + M], [6, 51]]])), "too small for a field"),
    "several": (gj(("A", "Polygon", [SQUARE]), ("B", "Polygon", [POND])), "2 fields; choose one by --feature: 1 'A'"),
    "larger than 20 MB": (POLYGON.encode() + b" " * 21_000_000, "larger than 20 MB"),
    "kml cut off": (FIELD_KML[:-20], "not valid XML (unclosed token"),
    "kml entity": (FIELD_KML.replace("<kml", ENTITIES + "<kml").replace(">F<", ">&b;<"), "declares the XML entity 'a'"),
    "kml external entity": (FIELD_KML.replace("<kml", EXTERNAL + "<kml"), "declares the XML entity 'x'"),
    "kml undefined entity": (FIELD_KML.replace(">F<", ">&nbsp;<"), "undefined entity"),
    "kml nested too deep": ("<kml>" + "<Folder>" * 5000, "more than 200 levels"),
    "kml of an unknown encoding": (FIELD_KML.replace("UTF-8", "klingon"), "unreadable XML"),
    "kml without placemarks": (kml("<Folder/>"), "no polygon"),
    "kml without coordinates": (kml(placemark("F", kml_polygon([[]]))), "the polygon is empty"),
    "kml decimal comma": (FIELD_KML.replace("51.0009", "51,0009"), "are not longitude,latitude,height in degrees"),
    "kml words": (FIELD_KML.replace("51.0009", "north"), "are not longitude,latitude,height in degrees"),
    "kml NaN": (FIELD_KML.replace("51.0009", "nan"), "is not a finite number"),
    "kml swapped": (kml(placemark("F", kml_polygon([SWAPPED]))), "latitude -90.134 is beyond ±90°"),
    "kml two outlines": (FIELD_KML.replace("</Polygon>", "<outerBoundaryIs><LinearRing><coordinates>"
                         f"{text_of(POND)}</coordinates></LinearRing></outerBoundaryIs></Polygon>"), "2 outlines"),
    "kmz bomb": (bomb, "doc.kml is larger than 20 MB"),
    "kmz with a password": (encrypted, "encrypted"),
    "kmz damaged": (damaged_zip, "damaged or unreadable archive"),
    "zip cut off": (b"PK\x03\x04" + bytes(50), "damaged or unreadable archive"),
    "zip of a zip": (nested_zip, "no known field format (GAOS, GeoJSON, ISOXML, KML, Shapefile); it holds inner.zip"),
    "empty zip": (lambda f: zipped(f / "f.zip", {}), "the archive is empty"),
    "shapefile without .prj": (without(".prj"), "has no .prj file, its coordinate system is unknown"),
    "shapefile without .shx": (without(".shx"), "has no .shx file, it cannot be read"),
    "shapefile alone": (only_shp, "has no .shx file"),
    "part of a shapefile": (lambda f: shapefile(f, {"F": [SQUARE]}).with_suffix(".dbf"), "name that file"),
    "shapefile cut off": (with_bytes(lambda d: d[:80]), "cut off in its header"),
    "shapefile without records": (with_bytes(lambda d: d[:100], ".shp"), ""),
    "shapefile index of zeros": (with_bytes(lambda d: d[:100] + bytes(len(d) - 100), ".shx"), ""),
    "shapefile of noise": (with_bytes(lambda d: d[:32] + bytes(range(200)) * 3), ""),
    "shapefile table cut off": (with_bytes(lambda d: d[:20], ".dbf"), ""),
    "shapefile of an unknown system": (with_bytes(lambda _: b"PROJCS[nonsense", ".prj"), "unknown coordinate system"),
    "shapefile with an empty .prj": (with_bytes(lambda _: b"", ".prj"), "has no .prj file"),
    "isoxml cut off": (isoxml(isoxml_area([SQUARE]))[:-60], "not valid XML"),
    "isoxml without partfields": (isoxml(), "no polygon"),
    "isoxml without boundary": (isoxml("<PLN A='2'/>"), "no polygon"),
    "isoxml boundary without outline": (isoxml('<PLN A="1"/>'), "the boundary has no outline"),
    "isoxml point without place": (isoxml('<PLN A="1"><LSG A="1"><PNT A="2"/></LSG></PLN>'), "without latitude"),
    "isoxml words": (isoxml(isoxml_area([SQUARE])).replace("51.0009", "51,0009"), "is no longitude and latitude"),
    "isoxml swapped": (isoxml(isoxml_area([SWAPPED])), "latitude -90.134 is beyond ±90°; points are latitude in C"),
    "isoxml crossing": (isoxml(isoxml_area([BOW])), "crosses itself"),
    "isoxml missing part": (isoxml().replace("</ISO", '<XFR A="PFD00007" B="1"/></ISO'), "'PFD00007.XML' with"),
    "isoxml part elsewhere": (isoxml().replace("</ISO", '<XFR A="PFD/../../x"/></ISO'), "is missing beside it"),
    "isoxml no-go area over all": (isoxml(isoxml_area([SQUARE]) + isoxml_area([SQUARE], 6)), "no-go areas leave 0.0"),
    "gaos without field": ("<GAOS_parcel/>", "no Field with a polygon"),
    "gaos words": (gaos([SQUARE]).replace("51.0009", "x"), "are no pairs of numbers"),
    "gaos unknown system": (gaos([SQUARE], "EPSG:1"), "unknown coordinate system 'EPSG:1'"),
    "gaos without outline": (gaos([SQUARE]).replace("outerBoundaryIs", "boundary"), "0 outlines"),
}  # fmt: skip


def written(content: Content, folder: Path) -> Path:
    if callable(content):
        return content(folder)
    path = folder / "field.dat"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_at_least_60() -> None:
    assert len(BAD) >= 60


@pytest.mark.parametrize("name", BAD)
def test_refused_with_one_line(name: str, tmp_path: Path) -> None:
    content, words = BAD[name]
    path = written(content, tmp_path)
    arguments = parse_arguments(["plan", str(path)])
    began_s = time.process_time()
    with pytest.raises(FieldError) as refused:
        check_field(arguments)
    assert time.process_time() - began_s < 2.0
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(path))
    assert len(str(refused.value).splitlines()) == 1
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize("name", ["text", "crossing", "kmz bomb", "shapefile of noise", "isoxml missing part"])
def test_command_ends_with_2(name: str, tmp_path: Path) -> None:
    """Processor time of the whole command, imports included."""
    path = written(BAD[name][0], tmp_path)
    clock = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run([sys.executable, '-m', 'runtime', *sys.argv[1:]], capture_output=True, text=True)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(done.returncode, used.ru_utime + used.ru_stime)\n"
        "sys.stderr.write(done.stderr)\n"
    )
    words = [sys.executable, "-c", clock, "plan", str(path), "--out", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=True)
    code, used_s = done.stdout.split()
    assert code == "2"
    assert float(used_s) < 2.0
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@needs("fields2cover")
@pytest.mark.parametrize("name", ["strips.geojson", "swaths.geojson", "test_ring.json", "test_2_cell.json"])
def test_published_files(name: str) -> None:
    with pytest.raises(FieldError) as refused:
        check_field(parse_arguments(["plan", str(DATA / "fields2cover/data" / name)]))
    assert len(str(refused.value).splitlines()) == 1


@needs("devices/fields")
def test_invalid_register_parcels_name_the_place() -> None:
    path = DATA / "devices/fields/fiboa-cli/it_1.geojson"
    reasons = []
    for number, _ in enumerate(json.loads(path.read_text())["features"], 1):
        try:
            check_field(parse_arguments(["plan", str(path), "--feature", str(number)]))
        except FieldError as error:
            reasons.append(str(error))
    assert len(reasons) == 1
    assert "outline crosses itself at longitude 11.85946, latitude 43.47585" in reasons[0]

"""Field files of every format, made from rings in longitude and latitude."""

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyogrio.raw import write as write_layer
from pyproj import Transformer
from shapely.geometry import Polygon

from configs.site import DatumConfig
from planning.field.field import FieldOutline
from planning.field.formats.contents import Ring

M = 1e-5  # degrees of latitude: about 1.1 m
SQUARE: Ring = [(6.0, 51.0), (6.0 + 200 * M, 51.0), (6.0 + 200 * M, 51.0 + 90 * M), (6.0, 51.0 + 90 * M), (6.0, 51.0)]
POND: Ring = [(6.0 + a * M, 51.0 + b * M) for a, b in ((80, 30), (100, 30), (100, 50), (80, 50), (80, 30))]
AB: Ring = [(6.0002, 51.0002), (6.0012, 51.0006)]
KML_HEAD = '<?xml version="1.0" encoding="UTF-8"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
ISOXML_HEAD = '<?xml version="1.0" encoding="UTF-8"?><ISO11783_TaskData VersionMajor="{}" DataTransferOrigin="1">'


def moved(ring: Ring, east: float, north: float = 0.0) -> Ring:
    """Ring moved by degrees."""
    return [(x + east, y + north) for x, y in ring]


def geojson(features: Sequence[tuple[str, str, Any]], **members: Any) -> str:
    """Collection of features (name, geometry type, coordinates)."""
    found = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": kind, "coordinates": coordinates}}
        for name, kind, coordinates in features
    ]
    return json.dumps({"type": "FeatureCollection", "features": found} | members)


def text_of(ring: Ring, height: str = ",12.5") -> str:
    """Coordinates of KML."""
    return " ".join(f"{x!r},{y!r}{height}" for x, y in ring)


def kml_polygon(rings: Sequence[Ring], height: str = ",12.5") -> str:
    """Polygon element of KML."""
    tags = ["outerBoundaryIs"] + ["innerBoundaryIs"] * (len(rings) - 1)
    boundaries = "".join(
        f"<{tag}><LinearRing><coordinates>\n{text_of(ring, height)}\n</coordinates></LinearRing></{tag}>"
        for tag, ring in zip(tags, rings, strict=True)
    )
    return f"<Polygon>{boundaries}</Polygon>"


def kml(body: str) -> str:
    """Document of KML."""
    return f"{KML_HEAD}{body}</Document></kml>"


def placemark(name: str, geometry: str) -> str:
    """Placemark of KML."""
    return f"<Placemark><name>{name}</name>{geometry}</Placemark>"


def isoxml_line(ring: Ring, kind: int, point_kinds: Sequence[int] = (), more: str = "") -> str:
    """LSG of ISOXML."""
    kinds = point_kinds or [2] * len(ring)
    points = "".join(f'<PNT A="{k}" C="{y!r}" D="{x!r}"/>' for k, (x, y) in zip(kinds, ring, strict=True))
    return f'<LSG A="{kind}"{more}>{points}</LSG>'


def isoxml_area(rings: Sequence[Ring], kind: int = 1, name: str = "") -> str:
    """PLN of ISOXML: the first ring is the outline, the others are holes."""
    lines = "".join(isoxml_line(ring, 1 if k == 0 else 2) for k, ring in enumerate(rings))
    return f'<PLN A="{kind}" B="{name}">{lines}</PLN>'


def isoxml(*partfields: str, version: int = 4) -> str:
    """Task data with partfields, given by their content."""
    found = "".join(f'<PFD A="PFD{k + 1}" C="Field {k + 1}" D="1">{body}</PFD>' for k, body in enumerate(partfields))
    return f"{ISOXML_HEAD.format(version)}{found}</ISO11783_TaskData>"


def gaos(rings: Sequence[Ring], srs: str = "EPSG:4258") -> str:
    """GAOS parcel."""
    tags = ["outerBoundaryIs"] + ["innerBoundaryIs"] * (len(rings) - 1)
    boundaries = "".join(
        f"<gml:{tag}><LinearRing><gml:coordinates>{text_of(ring, '')}</gml:coordinates></LinearRing></gml:{tag}>"
        for tag, ring in zip(tags, rings, strict=True)
    )
    polygon = f'<gml:Polygon srsName="{srs}">{boundaries}</gml:Polygon>'
    head = '<GAOS_parcel xmlns:gml="http://www.opengis.net/gml" id="1">'
    return f'{head}<Field id="boundary"><geometry>{polygon}</geometry></Field></GAOS_parcel>'


def shapefile(folder: Path, fields: dict[str, Sequence[Ring]], crs: str = "EPSG:4326") -> Path:
    """Shapefile with polygons by name, in a coordinate system."""
    to = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    shapes = [Polygon(r[0], r[1:]) for r in fields.values()]
    projected = [shapely.transform(s, lambda p: np.column_stack(to.transform(p[:, 0], p[:, 1]))) for s in shapes]
    path = folder / "fields.shp"
    names = np.array(list(fields), object)
    write_layer(path, shapely.to_wkb(projected), [names], ["Name"], crs=crs, geometry_type="Polygon")  # type: ignore[arg-type]
    return path


def zipped(path: Path, files: dict[str, bytes | str]) -> Path:
    """ZIP archive."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def in_datum(outline: FieldOutline, datum: DatumConfig) -> Polygon:
    """Polygon of a field, as in its file, in `map` about another datum."""

    def to_other(points: np.ndarray) -> np.ndarray:
        found = [outline.datum.datum.to_ellipsoid(float(x), float(y), 0.0)[:2] for x, y in points]
        return np.array([datum.datum.to_map(lat, lon, 0.0)[:2] for lat, lon in found])

    return shapely.transform(outline.original or outline.polygon, to_other)

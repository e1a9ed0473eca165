"""Fields of the planning benchmark: textbook shapes, Fields2Cover's parcels, random polygons, parcels of registers."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import Polygon, shape
from shapely.geometry.base import BaseGeometry

from geometry.geodesy import Datum
from geometry.polygon import as_polygon, parts

MIN_AREA_M2 = 3000.0
MIN_WIDTHS = 4.0  # diameter of the largest inscribed circle, in working widths
LARGE_M2 = 200_000.0  # above it only the widest implement
TEXTBOOK: dict[str, tuple[list[tuple[float, float]], list[list[tuple[float, float]]]]] = {
    "rectangle": ([(0, 0), (200, 0), (200, 100), (0, 100)], []),
    "trapezoid": ([(0, 0), (230, 0), (200, 100), (30, 100)], []),
    "L": ([(0, 0), (200, 0), (200, 60), (100, 60), (100, 150), (0, 150)], []),
    "U": ([(0, 0), (200, 0), (200, 150), (140, 150), (140, 45), (60, 45), (60, 150), (0, 150)], []),
    "pond": (
        [(0, 0), (240, 0), (240, 150), (0, 150)],
        [[(100, 60), (130, 50), (150, 75), (125, 100), (95, 90)]],
    ),
}


@dataclass(frozen=True)
class Parcel:
    """A field in metres with its set and its name."""

    group: str
    name: str
    polygon: Polygon

    @property
    def min_width_m(self) -> float:
        """Diameter of the largest inscribed circle."""
        return 2.0 * float(shapely.maximum_inscribed_circle(self.polygon, 0.05).length)


def textbook(data: Path) -> Iterator[Parcel]:
    """Five shapes, and the two parcels of Fields2Cover where the data are."""
    for name, (outline, holes) in TEXTBOOK.items():
        yield Parcel("textbook", name, Polygon(outline, holes))
    folder = data / "fields2cover/data"
    if (folder / "test.json").is_file():
        content = json.loads((folder / "test.json").read_text(encoding="utf-8"))
        (parcel,) = parts(shape(content["features"][0]["geometry"]))
        yield Parcel("textbook", "test.json", in_metres(parcel))
        text = re.search(r"<gml:coordinates>([^<]+)<", (folder / "test1.xml").read_text(encoding="utf-8"))
        assert text is not None
        ring = [tuple(map(float, pair.split(","))) for pair in text[1].split()]
        yield Parcel("textbook", "test1", in_metres(Polygon(ring)))


def registers(data: Path) -> Iterator[Parcel]:
    """Every valid part of at least 0.3 ha of the parcels of the national registers."""
    for file in sorted((data / "devices/fields/fiboa-cli").glob("*.geojson")):
        for number, feature in enumerate(json.loads(file.read_text(encoding="utf-8"))["features"]):
            for k, part in enumerate(parts(shape(feature["geometry"]))):
                polygon = in_metres(part)
                if polygon.is_valid and polygon.area >= MIN_AREA_M2:
                    yield Parcel("registers", f"{file.stem}/{number}.{k}", polygon)


def random_fields(count: int = 40) -> Iterator[Parcel]:
    """Star-shaped polygons of 0.3 to 20 ha with 0 to 3 holes."""
    for seed in range(1, count + 1):
        yield Parcel("random", f"seed {seed}", _random(np.random.default_rng(seed)))


def _random(rng: np.random.Generator) -> Polygon:
    while True:
        area_m2 = 3000.0 * (200_000.0 / 3000.0) ** rng.uniform()
        count = int(rng.integers(5, 16))
        angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, count))
        radius = rng.uniform(0.55, 1.0, count)
        ring = np.column_stack([radius * np.cos(angle), rng.uniform(0.4, 1.0) * radius * np.sin(angle)])
        outline = Polygon(ring)
        if not outline.is_valid or outline.area < 0.1:
            continue
        outline = Polygon(math.sqrt(area_m2 / outline.area) * ring)
        holes: BaseGeometry = Polygon()
        inner = outline.buffer(-25.0)
        for _ in range(int(rng.integers(0, 4)) if not inner.is_empty else 0):
            x0, y0, x1, y1 = inner.bounds
            p = rng.uniform((x0, y0), (x1, y1))
            corners = p + rng.uniform(2.0, 12.0, (6, 1)) * np.column_stack(
                [np.cos(np.arange(6) * math.pi / 3), np.sin(np.arange(6) * math.pi / 3)]
            )
            hole = Polygon(corners)
            if inner.contains(hole) and (holes.is_empty or hole.distance(holes) > 30.0):
                holes = holes.union(hole)
        found = outline.difference(holes)
        if isinstance(found, Polygon) and found.is_valid:
            return found


def in_metres(polygon: Polygon) -> Polygon:
    """A polygon of longitude and latitude in `map` about its south-west corner."""
    west, south, _, _ = polygon.bounds
    datum = Datum(math.radians(south), math.radians(west), 0.0)

    def to_map(points: np.ndarray) -> np.ndarray:
        return np.array([datum.to_map(math.radians(y), math.radians(x), 0.0)[:2] for x, y in points])

    return as_polygon(shapely.transform(shapely.force_2d(polygon), to_map).normalize())

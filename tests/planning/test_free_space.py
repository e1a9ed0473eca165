"""The compiled clearance test against shapely."""

import numpy as np
import pytest
import shapely
from shapely.geometry import Polygon

from geometry.footprint import footprints
from geometry.rectangle import Rectangle
from planning.turns.free_space import FreeSpace

BODIES = (Rectangle(-1.0, 3.5, 2.3), Rectangle(-2.4, -1.1, 6.1))
RING = [(0, 0), (80, 3), (95, 40), (60, 35), (52, 70), (20, 62), (-8, 30)]
AREAS = {
    "concave": Polygon(RING),
    "hole": Polygon(RING, [[(30, 25), (40, 24), (42, 33), (33, 36)], [(15, 40), (15.2, 40), (15.2, 40.2)]]),
    "arcs": Polygon(RING).buffer(-4.0, quad_segs=32).buffer(4.0, quad_segs=32),
    "two parts": Polygon(RING).difference(Polygon([(45, -5), (46, -5), (50, 80), (49, 80)])),
}


@pytest.mark.parametrize("name", AREAS)
def test_touching_against_shapely(name: str) -> None:
    area = AREAS[name]
    rng = np.random.default_rng(len(name))
    p, heading = rng.uniform((-15.0, -5.0), (100.0, 75.0), (4000, 2)), rng.uniform(-4.0, 4.0, 4000)
    space = FreeSpace(area, BODIES, 5.0, 1.8)
    bodies = footprints(BODIES, p, heading)
    is_outside = ~shapely.covers(area, bodies).all(axis=1)
    is_near = shapely.distance(area.boundary, bodies).min(axis=1) < 0.002  # edges are simplified by 1 mm
    found = space.touching(p, heading)
    assert 500 < is_outside.sum() < 3900
    assert (found == is_outside)[~is_near | (shapely.intersects(area.boundary, bodies).any(axis=1))].all()


def test_is_free_along_a_path() -> None:
    space = FreeSpace(AREAS["concave"], BODIES, 5.0, 1.8)
    p, heading = np.column_stack([np.linspace(10.0, 60.0, 500), np.full(500, 20.0)]), np.zeros(500)
    assert space.is_free(p, heading)
    assert not space.is_free(p + np.array([30.0, 0.0]), heading)
    assert not space.is_free(p + np.array([200.0, 0.0]), heading)

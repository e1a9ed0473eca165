"""Slabs of meshes and distances of prisms against closed forms."""

import math

import numpy as np
import pytest
import shapely

from geometry.prism import Prism, Solids, nearest, slabs_of
from simulation.environment.meshes import box, limb


def volume(prisms):
    return sum(shapely.Polygon(p.outline_m).area * (p.high_m - p.low_m) for p in prisms)


def test_slabs_of_a_box_are_the_box():
    mesh = box((0.0, 0.0, 0.1), (2.0, 1.0, 1.0))
    slabs = slabs_of("box", mesh.vertices_m, mesh.triangles, 0.3)
    assert len(slabs) == 3
    assert volume(slabs) == pytest.approx(1.8, abs=1e-5)


def test_slabs_of_a_lying_cylinder_follow_its_round_section():
    """A wheel on its tread: narrow near the ground, widest at the axle."""
    mesh = limb((0.0, 0.2, 0.8), (0.0, -0.2, 0.8), 0.8, 32)
    slabs = slabs_of("wheel", mesh.vertices_m, mesh.triangles, 0.2)
    lengths = [np.ptp(p.outline_m[:, 0]) for p in slabs]
    assert lengths[0] == pytest.approx(2.0 * math.sqrt(0.8**2 - 0.6**2), abs=0.03)
    assert max(lengths) == pytest.approx(1.6, abs=0.02)
    assert math.pi * 0.8**2 * 0.4 < volume(slabs) < 1.15 * math.pi * 0.8**2 * 0.4


def test_a_mesh_without_area_gets_a_width():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.2], [0.0, 0.0, 0.2]], np.float32)
    (slab,) = slabs_of("board", vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    assert 0.0 < shapely.Polygon(slab.outline_m).area < 0.01


def prism(name, x, y, low, high, half=0.5):
    ring = np.array([[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])
    return Prism(name, ring, low, high)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (prism("b", 3.0, 0.0, 0.0, 1.0), 2.0),  # beside
        (prism("b", 0.0, 0.0, 1.5, 2.0), 0.5),  # above
        (prism("b", 4.0, 0.0, 5.0, 6.0), 5.0),  # 3 beside and 4 above
        (prism("b", 0.9, 0.9, 0.5, 2.0), 0.0),  # overlap
        (prism("b", 1.0, 0.0, 1.0, 2.0), 0.0),  # a common edge
    ],
)
def test_distance(other, expected):
    found = nearest(Solids.of([prism("a", 0.0, 0.0, 0.0, 1.0)]), Solids.of([other]))
    assert found.distance_m == pytest.approx(expected, abs=1e-9)
    assert found.part == "a"


def test_place_of_a_contact_is_the_middle_of_all_touching_faces():
    a = Solids.of([prism("left", 0.0, 0.5, 0.0, 1.0), prism("right", 0.0, -0.5, 0.0, 1.0)])
    found = nearest(a, Solids.of([prism("b", 1.0, 0.0, 0.0, 1.0)]))
    assert found.distance_m == pytest.approx(0.0, abs=1e-9)
    assert found.point_m == pytest.approx((0.5, 0.0, 0.5), abs=0.02)


def test_no_solids_are_infinitely_far():
    assert nearest(Solids.of([]), Solids.of([prism("b", 0.0, 0.0, 0.0, 1.0)])).distance_m == math.inf

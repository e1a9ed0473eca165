"""Reference: smoothing without shift, and position without jumps."""

import math

import numpy as np
import pytest

from control.reference import Reference
from tests.control.plant import path_along


def along(path, reference, offset_m=0.0):
    """Positions found along the path at `offset_m` left of it, with their true arc length and index."""
    near, found = 0, []
    for k in range(0, len(path.s_m), 2):
        (x, y), h = path.p_map_m[k], path.heading_rad[k]
        position, near = reference.locate(x - offset_m * math.sin(h), y + offset_m * math.cos(h), h, near)
        found.append((position, path.s_m[k], near))
    return found


@pytest.mark.parametrize("curvature", [0.0, 0.05, -0.1, 0.2])
@pytest.mark.parametrize("offset_m", [-0.5, -0.02, 0.0, 0.02, 0.5])
def test_straights_and_circles_unchanged(curvature, offset_m):
    path = path_along(np.full(200, curvature))
    reference = Reference(path, 1.5)
    for position, s_m, near in along(path, reference, offset_m):
        assert position.s_m == pytest.approx(s_m, abs=3e-3)
        assert position.offset_m == pytest.approx(offset_m, abs=1e-3)
        assert reference.deviation_m(near) == pytest.approx(0.0, abs=1e-3)
        assert position.heading_error_rad == pytest.approx(0.0, abs=2e-3)
        assert position.curvature_radpm == pytest.approx(curvature, abs=2e-3)


def test_curvature_step_smoothing():
    path = path_along(np.concatenate([np.zeros(150), np.full(150, 0.2), np.zeros(150)]))
    reference = Reference(path, 1.5)
    deviations = [abs(reference.deviation_m(k)) for k in range(451)]
    assert max(deviations) < 0.02
    assert max(deviations[:100] + deviations[-100:]) < 1e-3
    _, rates = reference.steering_rates(2.55)
    assert rates.max() < 0.5


def test_frenet_coordinates_in_reverse():
    path = path_along(np.zeros(100), direction=-1)
    position, _ = Reference(path, 1.5).locate(-5.0, -0.3, math.pi, 40)
    assert position.s_m == pytest.approx(5.0, abs=1e-3)
    assert position.offset_m == pytest.approx(0.3, abs=1e-3)
    assert position.heading_error_rad == pytest.approx(0.0, abs=1e-3)


def test_position_at_path_crossing():
    """A figure of eight: at the crossing the other branch may be nearer."""
    lobe = np.full(int(2 * math.pi * 50), 0.2)
    path = path_along(np.concatenate([lobe, -lobe]))
    for offset_m in (-0.4, 0.4):
        positions = [position.s_m for position, _, _ in along(path, Reference(path, 1.5), offset_m)]
        assert np.all(np.diff(positions) > 0.0)
        assert positions[-1] == pytest.approx(path.s_m[-1], abs=0.3)


def test_start_index():
    path = path_along(np.zeros(300))
    reference = Reference(path, 1.5)
    assert reference.start_index(3.04, 0.5, 0.1, 10.0) == 30
    assert reference.start_index(20.0, 0.0, 0.0, 10.0) == 99
    assert reference.start_index(3.0, 0.5, math.pi, 10.0) == 0  # opposite heading


@pytest.mark.parametrize("points", [1, 2, 3, 5])
def test_short_paths(points):
    path = path_along(np.zeros(points))
    position, _ = Reference(path, 1.5).locate(0.05, 0.01, 0.0, 0)
    assert position.s_m == pytest.approx(0.05, abs=1e-3)
    assert position.offset_m == pytest.approx(0.01, abs=1e-3)

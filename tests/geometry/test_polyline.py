"""Polylines, polygons and footprints."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon, box

from geometry.footprint import Rectangle, footprints, is_inside, place, sweep, worked
from geometry.polygon import close_by, edge_angles, open_by, parts, ring_points
from geometry.polyline import (
    arc_length,
    at_length,
    curvatures,
    extend,
    headings,
    polyline,
    project,
    resample,
    smooth,
    without_repeats,
)

POINTS = st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=12)


def usable(points: list[tuple[float, float]]) -> np.ndarray | None:
    line = without_repeats(np.array(points, np.float64), 0.05)
    return line if len(line) > 1 else None


@settings(derandomize=True, max_examples=100, deadline=None)
@given(POINTS, st.floats(0.05, 5.0))
def test_resample_ends_and_spacing(points: list[tuple[float, float]], step: float) -> None:
    line = usable(points)
    if line is None:
        return
    fine = resample(line, step)
    assert fine[0] == pytest.approx(line[0])
    assert fine[-1] == pytest.approx(line[-1], abs=1e-9)
    assert np.diff(arc_length(fine)).max() <= step + 1e-9
    assert arc_length(fine)[-1] <= arc_length(line)[-1] + 1e-9


@settings(derandomize=True, max_examples=100, deadline=None)
@given(POINTS, st.floats(0.0, 1.0))
def test_projection_of_point_on_line(points: list[tuple[float, float]], share: float) -> None:
    line = usable(points)
    if line is None:
        return
    p = at_length(line, np.array([share * arc_length(line)[-1]]))[0]
    s, aside = project(line, p)
    assert abs(aside) < 1e-6
    assert at_length(line, np.array([s]))[0] == pytest.approx(p, abs=1e-6)


@pytest.mark.parametrize(("p", "s", "aside"), [((3, 2), 3, 2), ((3, -2), 3, -2), ((-1, 0), 0, 1), ((12, 0), 10, 2)])
def test_projection_sign(p: tuple[float, float], s: float, aside: float) -> None:
    found = project(np.array([[0.0, 0.0], [10.0, 0.0]]), np.array(p, float))
    assert found[0] == pytest.approx(s)
    assert abs(found[1]) == pytest.approx(abs(aside))
    if p[1]:
        assert math.copysign(1, found[1]) == math.copysign(1, aside)


def test_smooth_ends_straights_and_curvature_rate() -> None:
    s = np.linspace(0, np.pi / 2 * 5, 79)
    bend = np.column_stack([10 + 5 * np.sin(s / 5), 5 - 5 * np.cos(s / 5)])
    line = resample(np.vstack([[[0, 0]], bend, [[15, 15]]]), 0.1)
    soft = smooth(line, 1.8)
    assert soft[0] == pytest.approx(line[0])
    assert soft[-1] == pytest.approx(line[-1])
    assert np.abs(soft[:80, 1]).max() < 1e-9
    k = curvatures(headings(soft), arc_length(soft))
    assert k.max() == pytest.approx(0.2, rel=0.04)
    assert np.abs(np.diff(k)).max() / 0.1 < 0.2 / 1.8 * 1.3
    assert np.hypot(*(soft - line).T).max() < 0.08


def test_smooth_closed_ring() -> None:
    angle = np.linspace(0, 2 * np.pi, 400)
    ring = 8 * np.column_stack([np.cos(angle), np.sin(angle)])
    soft = smooth(ring, 1.8, is_closed=True)
    assert np.hypot(*soft.T) == pytest.approx(np.hypot(*soft[0]), abs=1e-9)
    assert np.hypot(*soft[0]) == pytest.approx(8 - 1.8**2 / (12 * 8), abs=0.01)


@pytest.mark.parametrize("bad", [[[0, 0]], [[0, 0], [0, 0]], [[0, 0], [np.nan, 1]], [0, 1, 2], [[0, 0, 0], [1, 1, 1]]])
def test_invalid_polyline(bad: list[object]) -> None:
    with pytest.raises(ValueError, match="polyline"):
        polyline(bad)  # type: ignore[arg-type]


def test_extend() -> None:
    longer = extend(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), 2.0, 3.0)
    assert longer[0] == pytest.approx([-2, 0])
    assert longer[-1] == pytest.approx([1, 4])


def test_opening_and_closing() -> None:
    ell = Polygon([(0, 0), (40, 0), (40, 20), (20, 20), (20, 40), (0, 40)])
    corner = (1 - math.pi / 4) * 25
    assert open_by(ell, 5).area == pytest.approx(ell.area - 5 * corner, rel=1e-3)
    assert close_by(ell, 5).area == pytest.approx(ell.area + corner, rel=1e-3)


def test_ring_orientation_and_part_order() -> None:
    with_hole = Polygon([(0, 0), (0, 9), (9, 9), (9, 0)], [[(3, 3), (6, 3), (6, 6), (3, 6)]])
    outline, hole = ring_points(with_hole)
    assert Polygon(outline).exterior.is_ccw
    assert not Polygon(hole).exterior.is_ccw
    both = box(5, 0, 6, 1).union(box(0, 0, 1, 1))
    assert [p.bounds[0] for p in parts(both)] == [0, 5]
    assert parts(both, 1.0) == []
    assert edge_angles(box(0, 0, 4, 2))[0] == pytest.approx((math.pi, 4)) or edge_angles(box(0, 0, 4, 2))[0][1] == 4


BODIES = (Rectangle(-1.0, 3.5, 2.3), Rectangle(-2.4, -1.1, 6.1))


@pytest.mark.parametrize(("gap", "inside"), [(0.001, True), (-0.001, False), (0.0, True)])
def test_is_inside_at_edge(gap: float, inside: bool) -> None:
    room = box(-2.4 - gap, -3.05 - gap, 3.5 + gap, 3.05 + gap)
    assert bool(is_inside(BODIES, np.zeros((1, 2)), np.zeros(1), room)[0]) is inside


def test_intrusion_between_corners() -> None:
    """A wedge into the side of the implement, with all corners of the implement inside."""
    room = box(-20, -20, 20, 20).difference(Polygon([(-1.75, 2.9), (-1.5, 10), (-2.0, 10)]))
    assert not is_inside(BODIES, np.zeros((1, 2)), np.zeros(1), room)[0]


@settings(derandomize=True, max_examples=30, deadline=None)
@given(st.floats(-3, 3), st.floats(-0.15, 0.15))
def test_sweep_contains_footprints(heading: float, curvature: float) -> None:
    s = np.arange(0, 8, 0.5)
    turn = heading + curvature * s
    p = np.column_stack([np.cumsum(np.cos(turn) * 0.5), np.cumsum(np.sin(turn) * 0.5)])
    swept = sweep(BODIES, p, turn).buffer(1e-6)
    assert all(swept.covers(f) for row in footprints(BODIES, p, turn) for f in row)


def test_worked_area_of_strip_and_pivot() -> None:
    left = np.array([[0.0, 3.0], [10.0, 3.0]])
    assert worked(left, left - [0, 6]).area == pytest.approx(60)
    angle = np.linspace(0, np.pi / 2, 50)
    outer = 6 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert worked(np.zeros((50, 2)), outer).area == pytest.approx(np.pi * 9, rel=1e-3)


def test_place() -> None:
    moved = place(np.array([[1.0, 0.0]]), np.array([[5.0, 5.0]]), np.array([np.pi / 2]))
    assert moved[0, 0] == pytest.approx([5, 6])

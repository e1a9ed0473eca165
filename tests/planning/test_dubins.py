"""Dubins paths, swath order, guidance lines."""

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.polyline import arc_length, headings
from geometry.pose2 import Pose2
from messages.errors import FieldError
from planning.coverage.order import order
from planning.guidance.line import Circle, Curve, a_plus, ab
from planning.turns.dubins import dubins_paths, points_of

POSES = st.builds(Pose2, st.floats(-40, 40), st.floats(-40, 40), st.floats(-7, 7))


@settings(derandomize=True, max_examples=150, deadline=None)
@given(POSES, POSES, st.floats(2.0, 12.0))
def test_dubins_paths_end_at_goal(start: Pose2, goal: Pose2, radius: float) -> None:
    curves = dubins_paths(start, goal, radius)
    assert [c.length_m for c in curves] == sorted(c.length_m for c in curves)
    straight = math.hypot(goal.x_m - start.x_m, goal.y_m - start.y_m)
    for curve in curves:
        points = points_of(curve, 0.05)
        assert points[-1] == pytest.approx([goal.x_m, goal.y_m], abs=1e-5)
        assert curve.length_m >= straight - 1e-6
        if curve.length_m > 1.0:
            turn = math.atan2(*(points[-1] - points[-2])[::-1]) - goal.yaw_rad
            assert abs(math.remainder(turn, 2 * math.pi)) < 0.05


@settings(derandomize=True, max_examples=60, deadline=None)
@given(POSES, POSES)
def test_shortest_dubins_path_against_ompl(start: Pose2, goal: Pose2) -> None:
    from ompl import base

    states = base.DubinsStateSpace(5.0)
    a, b = states.allocState(), states.allocState()
    for state, pose in ((a, start), (b, goal)):
        state.setX(pose.x_m)
        state.setY(pose.y_m)
        state.setYaw(math.remainder(pose.yaw_rad, 2 * math.pi))
    assert dubins_paths(start, goal, 5.0)[0].length_m == pytest.approx(states.distance(a, b), abs=1e-4)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4])
def test_swath_order_against_all_tours(count: int) -> None:
    cost = np.random.default_rng(count).uniform(1.0, 20.0, (2 * count + 1, 2 * count + 1))
    turned = np.arange(2 * count) ^ 1  # a tour between lines costs the same in both directions
    cost[:-1, :-1] = np.maximum(cost[:-1, :-1], cost[:-1, :-1].T[np.ix_(turned, turned)])

    def length(visits: list[int]) -> float:
        stops = [2 * count, *visits, 2 * count]
        return float(sum(cost[a, b] for a, b in itertools.pairwise(stops)))

    tours = [
        [2 * k + r for k, r in zip(p, flips, strict=True)]
        for p in itertools.permutations(range(count))
        for flips in itertools.product((0, 1), repeat=count)
    ]
    found = [2 * k + r for k, r in order(cost)]
    assert sorted(v // 2 for v in found) == list(range(count))
    if count:
        assert length(found) <= min(map(length, tours)) * 1.05 + 1e-9


NUMBERS, WIDTHS = st.integers(-30, 30), st.floats(0.5, 12.0)


@settings(derandomize=True, max_examples=80, deadline=None)
@given(st.floats(-3.1, 3.1), NUMBERS, WIDTHS)
def test_straight_line_distance(heading: float, number: int, width: float) -> None:
    line = a_plus((3.0, -2.0), heading, 80.0)
    base, other = line.line(0, width), line.line(number, width)
    normal = np.array([-math.sin(heading), math.cos(heading)])
    assert (other - base) @ normal == pytest.approx([number * width] * 2, abs=1e-9)
    assert np.hypot(*(other[1] - other[0])) == pytest.approx(80.0)


def test_ab_line() -> None:
    assert ab((1.0, 2.0), (11.0, 2.0)).line(0, 6.0) == pytest.approx(np.array([[1.0, 2.0], [11.0, 2.0]]))
    assert ab((1.0, 2.0), (11.0, 2.0)).line(1, 6.0)[0] == pytest.approx([1.0, 8.0])
    assert ab((0.0, 0.0), (0.1001, 0.0)).length_m > 0.1
    with pytest.raises(FieldError, match=r"0\.09 m apart"):
        ab((0.0, 0.0), (0.09, 0.0))


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.floats(5.0, 60.0), st.integers(-8, 8), WIDTHS, st.booleans())
def test_circle_distance(radius: float, number: int, width: float, is_clockwise: bool) -> None:
    circle = Circle((4.0, 5.0), radius, is_clockwise)
    request = radius + (number if is_clockwise else -number) * width
    if request < 0.1:
        with pytest.raises(FieldError, match="radius"):
            circle.line(number, width)
        return
    line = circle.line(number, width)
    assert np.hypot(*(line - [4.0, 5.0]).T) == pytest.approx(request, abs=1e-9)
    assert line[0] == pytest.approx(line[-1], abs=1e-12)
    turn = headings(line, is_closed=True)
    assert bool(turn[-2] < turn[0]) is is_clockwise


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.floats(0.5, 4.0), st.floats(40.0, 80.0), st.integers(-3, 3).filter(bool))
def test_curve_distance(height: float, wave: float, number: int) -> None:
    x = np.arange(0.0, 120.0, 0.5)
    curve = Curve(np.column_stack([x, height * np.sin(2 * np.pi * x / wave)]))
    base, other = curve.line(0, 3.0), curve.line(number, 3.0)
    gaps = shapely.distance(shapely.points(other), shapely.LineString(base))
    assert np.max(np.abs(gaps - 3.0 * abs(number))) < 0.01
    assert np.sign(other[len(other) // 2, 1] - base[len(base) // 2, 1]) == np.sign(number)
    assert float((other[-1] - other[0]) @ (base[-1] - base[0])) > 0
    assert np.diff(arc_length(other)).max() < 0.11

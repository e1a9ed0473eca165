"""Compiled turns: words, ramped curves, search among obstacles, ways along a pass."""

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from geometry.footprint import footprints, worked
from geometry.polyline import arc_length, curvatures, headings, resample, smooth
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from planning.turns.curve import MAX_SEGMENTS, _slopes, solve, trace
from planning.turns.departure import along, arrival_along, departure_of, straightened
from planning.turns.free_space import FreeSpace
from planning.turns.search import (
    MIN_RUN_M,
    Connection,
    ConnectionRequest,
    Leg,
    TurnTimes,
    _free_ends,
    bounds_s,
    find_turn,
    straight,
)
from planning.turns.transit import along_passes, both_ways
from planning.turns.words import MAX_WORDS, SEGMENTS, end_of, words

RADIUS_M, RAMP_M = 5.0, 1.8
BODIES = (Rectangle(-1.0, 3.5, 2.3), Rectangle(-2.4, -1.1, 6.1))
SLIM_BODIES = tuple(Rectangle(b.rear_m + 0.005, b.front_m - 0.005, b.width_m - 0.01) for b in BODIES)
GAP_M = 0.4
FORWARD, REVERSE = TurnTimes(1.4, 0.8, 8.0, GAP_M, False), TurnTimes(1.4, 0.8, 8.0, GAP_M, True)
FIELD = Polygon([(0, 0), (70, 0), (70, 40), (40, 40), (40, 60), (0, 60)], [[(20, 20), (26, 19), (27, 26), (21, 27)]])
POSES = st.builds(Pose2, st.floats(-40, 40), st.floats(-40, 40), st.floats(-7, 7))


def all_words(start: Pose2, goal: Pose2, has_reverse: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    lengths, sides = np.empty((MAX_WORDS, SEGMENTS)), np.empty((MAX_WORDS, SEGMENTS))
    c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    dx, dy = goal.x_m - start.x_m, goal.y_m - start.y_m
    x, y = (c * dx + s * dy) / RADIUS_M, (c * dy - s * dx) / RADIUS_M
    count = words(x, y, goal.yaw_rad - start.yaw_rad, has_reverse, lengths, sides)
    for k in range(count):
        end = end_of(lengths[k], sides[k])
        assert end[:2] == pytest.approx((x, y), abs=1e-6)
        assert math.remainder(end[2] - goal.yaw_rad + start.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)
    return [(lengths[k].copy(), sides[k].copy()) for k in range(count)]


@settings(derandomize=True, max_examples=200, deadline=None)
@given(POSES, POSES, st.booleans())
def test_shortest_word_against_ompl(start: Pose2, goal: Pose2, has_reverse: bool) -> None:
    from ompl import base

    states = (base.ReedsSheppStateSpace if has_reverse else base.DubinsStateSpace)(RADIUS_M)
    a, b = states.allocState(), states.allocState()
    for state, pose in ((a, start), (b, goal)):
        state.setX(pose.x_m)
        state.setY(pose.y_m)
        state.setYaw(math.remainder(pose.yaw_rad, 2 * math.pi))
    found = all_words(start, goal, has_reverse)
    assert has_reverse or all((lengths >= 0.0).all() for lengths, _ in found)
    shortest = min(RADIUS_M * float(np.abs(lengths).sum()) for lengths, _ in found)
    assert shortest == pytest.approx(states.distance(a, b), abs=1e-4)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(POSES, POSES, st.booleans())
def test_ramped_curve(start: Pose2, goal: Pose2, has_reverse: bool) -> None:
    poses = np.empty((6000, 5))
    first, last = np.array(start, np.float64), np.array(goal, np.float64)
    for lengths, sides in all_words(start, goal, has_reverse)[:12]:
        row, bend = np.zeros(MAX_SEGMENTS), np.zeros(MAX_SEGMENTS)
        row[1:-1], bend[1:-1] = lengths * RADIUS_M, sides / RADIUS_M
        if not solve(row, bend, first, last, RAMP_M, 0.1, poses):
            continue
        count = trace(row, bend, first, RAMP_M, 0.1, poses)
        p = poses[:count]
        assert p[0, :3] == pytest.approx(first)
        assert p[-1, :2] == pytest.approx(last[:2], abs=2e-4)
        assert math.remainder(p[-1, 2] - last[2], 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
        assert np.abs(p[:, 3]).max() <= 1 / RADIUS_M + 1e-9
        for run in np.split(p, np.flatnonzero(np.diff(p[:, 4])) + 1):
            s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(run[:, :2], axis=0).T))])
            assert np.abs(np.diff(run[:, 3])).max() <= 2 / RADIUS_M / RAMP_M * 0.101
            driven = np.diff(run[:, 2]) * run[0, 4]
            assert driven == pytest.approx(0.5 * (run[1:, 3] + run[:-1, 3]) * np.diff(s), abs=2e-3)


def check(found: Connection, request: ConnectionRequest, times: TurnTimes, area: Polygon) -> None:
    """Continuity, curvature, straight ends, directions, and clearance by shapely alone."""
    legs = found.legs
    assert legs[0].p_map_m[0] == pytest.approx(request.start[:2], abs=1e-6)
    assert legs[-1].p_map_m[-1] == pytest.approx(request.goal[:2], abs=2e-3)
    assert math.remainder(legs[-1].heading_rad[-1] - request.goal.yaw_rad, 2 * math.pi) == pytest.approx(0, abs=1e-3)
    assert times.has_reverse or all(leg.direction > 0 for leg in legs)
    for a, b in pairwise(legs):
        assert a.p_map_m[-1] == pytest.approx(b.p_map_m[0], abs=2e-3)
        heading = a.heading_rad[-1:]
        ahead = a.p_map_m[-1:] + a.direction * GAP_M * np.array([[math.cos(heading[0]), math.sin(heading[0])]])
        assert shapely.covers(area.buffer(2e-3), footprints(BODIES, ahead, heading)).all()
    for leg in legs:
        gaps = np.hypot(*np.diff(leg.p_map_m, axis=0).T)
        assert gaps.max() < 0.105
        assert gaps.sum() >= MIN_RUN_M - 0.1
        assert np.abs(leg.curvature_radpm).max() <= 1 / RADIUS_M + 1e-6
        travel = np.arctan2(*np.diff(leg.p_map_m, axis=0).T[::-1]) + (0.0 if leg.direction > 0 else math.pi)
        moved = gaps > 0.01
        assert np.abs(np.angle(np.exp(1j * (travel - leg.heading_rad[:-1])))[moved]).max() < 0.02
        bodies = footprints(BODIES, leg.p_map_m, leg.heading_rad)
        assert shapely.covers(area.buffer(2e-3), bodies).all()


@pytest.mark.parametrize("times", [FORWARD, REVERSE], ids=["forward", "reverse"])
def test_turns_among_edges(times: TurnTimes) -> None:
    space, rng = FreeSpace(FIELD, BODIES, RADIUS_M, RAMP_M), np.random.default_rng(5)
    counts = {True: 0, False: 0}
    for _ in range(120):
        poses = [Pose2(*map(float, rng.uniform((3, 3, -3.2), (67, 57, 3.2)))) for _ in range(2)]
        request = ConnectionRequest(poses[0], poses[1], 1.0, 3.5)
        found = find_turn(request, space, times)
        counts[found is not None] += 1
        if found is None:
            continue
        check(found, request, times, FIELD)
        bound = bounds_s([poses[0]], [poses[1]], 1.0, 3.5, RADIUS_M, times)[0, 0]
        if not times.has_reverse and math.hypot(poses[0].x_m - poses[1].x_m, poses[0].y_m - poses[1].y_m) < 40.0:
            assert found.time_s >= bound - 1e-6
        if found.legs[0].direction > 0:
            assert np.abs(found.legs[0].curvature_radpm[: int((1.0 - RAMP_M / 2) / 0.1) + 1]).max() < 0.01
    assert counts[True] > (30 if times.has_reverse else 12)
    assert counts[False] > 10


def test_reverse_is_found_where_forward_is_not() -> None:
    dead_end = Polygon([(0, 0), (60, 0), (60, 16), (0, 16)])
    request = ConnectionRequest(Pose2(30.0, 5.3, 0.0), Pose2(30.0, 10.7, math.pi), 1.0, 1.0)
    space = FreeSpace(dead_end, BODIES, RADIUS_M, RAMP_M)
    assert find_turn(request, space, FORWARD) is None
    found = find_turn(request, space, REVERSE)
    assert found is not None
    assert any(leg.direction < 0 for leg in found.legs)
    check(found, request, REVERSE, dead_end)


def test_way_along_a_pass() -> None:
    """A lake: no turn leads from one bank to the other, the pass around it does."""
    area = Polygon([(0, 0), (90, 0), (90, 70), (0, 70)], [[(18, 18), (72, 18), (72, 52), (18, 52)]])
    ring = smooth(
        resample(np.asarray(Polygon([(9, 9), (81, 9), (81, 61), (9, 61)]).buffer(-6).buffer(6).exterior.coords), 0.1),
        RAMP_M, is_closed=True,
    )  # fmt: skip
    heading = headings(ring, is_closed=True)
    tracks = both_ways(ring, heading, curvatures(heading, arc_length(ring)), True)
    space = FreeSpace(area, BODIES, RADIUS_M, RAMP_M)
    request = ConnectionRequest(Pose2(30.0, 7.0, 0.0), Pose2(60.0, 62.0, math.pi), 1.0, 3.5)
    assert find_turn(request, space, FORWARD) is None
    found = along_passes(request, space, FORWARD, tracks)
    assert found is not None
    check(found, request, FORWARD, area)
    assert 90.0 < sum(float(arc_length(leg.p_map_m)[-1]) for leg in found.legs) < 200.0
    blocked = FreeSpace(area.difference(Polygon([(72, 30), (90, 30), (90, 31), (72, 31)])), BODIES, RADIUS_M, RAMP_M)
    around = along_passes(request, blocked, FORWARD, tracks)
    assert around is None or all(leg.p_map_m[:, 0].max() < 81.0 or leg.p_map_m[:, 1].max() < 30 for leg in around.legs)


@pytest.mark.parametrize(("tail_m", "slack_m"), [(2.4, 0.005), (4.0, 0.02)])
def test_tail_stays_inside_on_a_departure(tail_m: float, slack_m: float) -> None:
    start = Pose2(3.0, -2.0, 0.7)
    leg = along(departure_of(tail_m, slack_m), straight(start, start.ahead(40.0)))
    p, heading = leg.p_map_m - np.array([3.0, -2.0]), leg.heading_rad - 0.7
    away_m = p @ np.array([-math.sin(0.7), math.cos(0.7)])
    assert (away_m - tail_m * np.sin(heading)).min() > -slack_m
    assert heading[-1] > 0.4
    assert (np.diff(leg.curvature_radpm) > 0.0).all()
    assert np.diff(leg.curvature_radpm).max() < 0.03
    travel = np.arctan2(*np.diff(leg.p_map_m, axis=0).T[::-1])
    assert travel == pytest.approx(0.5 * (leg.heading_rad[1:] + leg.heading_rad[:-1]), abs=1e-3)


@pytest.mark.parametrize("bend_radpm", [0.0, 1.0 / 40.0, -1.0 / 30.0])
def test_departure_and_arrival_follow_a_bent_line(bend_radpm: float) -> None:
    curve, s = straightened(departure_of(2.4, 0.005), RAMP_M), np.arange(0.0, 30.0, 0.1)
    heading = 0.7 + bend_radpm * s
    middle = heading[:-1] + 0.05 * bend_radpm
    p = np.vstack([[0.0, 0.0], np.cumsum(0.1 * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)])
    line = Leg(1, p, heading, np.full(len(s), bend_radpm))
    leaving, coming = along(curve, line), arrival_along(curve, line)
    assert leaving.pose(0)[:2] == pytest.approx(p[0], abs=1e-6)
    assert coming.pose(-1)[:2] == pytest.approx(p[-1], abs=1e-6)
    for leg, end in ((leaving, -1), (coming, 0)):
        travel = np.arctan2(*np.diff(leg.p_map_m, axis=0).T[::-1])
        turned = travel - 0.5 * (leg.heading_rad[1:] + leg.heading_rad[:-1])
        assert np.abs(np.angle(np.exp(1j * turned))).max() < 5e-3
        assert np.hypot(*np.diff(leg.p_map_m, axis=0).T).max() < 0.12
        away_m = np.hypot(*(leg.p_map_m[end] - p[:, None, :]).reshape(-1, 2).T).min()
        assert 1.5 < away_m < 3.0
        assert leg.curvature_radpm[end] == pytest.approx(bend_radpm, abs=0.02)


def test_slopes_of_a_curve_are_those_of_its_end() -> None:
    lengths = np.array([4.0, 6.0, 0.0, 5.0, -7.0, -3.0, 0.0])
    bends = np.array([0.0, 0.2, 0.0, -0.2, -0.2, 0.0, 0.0])
    start, poses, slopes = np.array([3.0, -2.0, 0.7]), np.empty((4000, 5)), np.empty((3, MAX_SEGMENTS))

    def end_of_curve(lengths_m: np.ndarray) -> np.ndarray:
        return poses[trace(lengths_m, bends, start, RAMP_M, 0.01, poses) - 1, :3].copy()

    end = end_of_curve(lengths)
    _slopes(lengths, bends, end[0], end[1], 0.01, 1.0, poses, slopes)
    for k in np.flatnonzero(lengths):
        moved = [end_of_curve(lengths + by * np.eye(MAX_SEGMENTS)[k]) for by in (-0.1, 0.1)]
        assert slopes[:, k] == pytest.approx((moved[1] - moved[0]) / 0.2, abs=0.02)


def test_straight_ends_of_turns_are_those_that_are_free() -> None:
    space = FreeSpace(FIELD, BODIES, RADIUS_M, RAMP_M)
    pose, lengths = np.array([60.0, 20.0, 0.0]), np.array([3.0, 6.0, 9.0, -3.0, -12.0, -40.0])
    ends = _free_ends(pose, 1.0, lengths, RAMP_M, space.boxes_m, *space.grid)
    assert ends.tolist() == [
        3.0,
        6.0,
        -3.0,
        -12.0,
    ]  # the wall is 6.5 m before the front, the pond 30.6 m behind the rear
    ends = _free_ends(pose, -1.0, lengths, RAMP_M, space.boxes_m, *space.grid)  # before a goal
    assert ends.tolist() == [3.0, 6.0, 9.0, -3.0]


@pytest.mark.parametrize(("radius_m", "width_m"), [(5.0, 3.0), (5.0, 12.0), (80.0, 6.0)])
def test_area_between_edge_lines_is_the_union_of_its_steps(radius_m: float, width_m: float) -> None:
    heading = np.cumsum(np.sin(np.arange(200) / 30.0)) * 0.4 / radius_m
    along = np.column_stack([np.cos(heading), np.sin(heading)])
    middle, left = np.cumsum(0.4 * along, axis=0) - 1.5 * along, np.column_stack([-along[:, 1], along[:, 0]])
    a, b = middle + 0.5 * width_m * left, middle - 0.5 * width_m * left
    steps = [shapely.convex_hull(shapely.MultiPoint([a[k], a[k + 1], b[k + 1], b[k]])) for k in range(199)]
    assert worked(a, b).symmetric_difference(shapely.union_all(steps)).area < 1e-6


def test_turns_are_free_between_their_poses() -> None:
    """A corner of the implement passes thin posts also between two poses, which a path has at other places."""
    rng = np.random.default_rng(5)
    posts = [[(x, y), (x + 0.01, y), (x, y + 0.01)] for x, y in rng.uniform(5.0, 55.0, (40, 2))]
    area = Polygon([(0, 0), (60, 0), (60, 60), (0, 60)], posts)
    space, slim = (FreeSpace(area, bodies, RADIUS_M, RAMP_M) for bodies in (BODIES, SLIM_BODIES))
    found = 0
    for _ in range(400):
        (ax, ay, a), (bx, by, b) = rng.uniform((8.0, 8.0, -3.0), (52.0, 52.0, 3.0), (2, 3))
        turn = find_turn(ConnectionRequest(Pose2(ax, ay, a), Pose2(bx, by, b), 1.0, 3.5), space, REVERSE)
        for leg in () if turn is None else turn.legs:
            fine = np.linspace(0, len(leg.p_map_m) - 1, 20 * len(leg.p_map_m))
            columns = (*leg.p_map_m.T, leg.heading_rad)
            x, y, heading = (np.interp(fine, np.arange(len(leg.p_map_m)), column) for column in columns)
            assert not slim.touching(np.column_stack([x, y]), heading).any()
            found += 1
    assert found > 20

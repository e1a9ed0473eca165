"""The lookout by itself: when it looks again, what each part is asked, and how its gaps shrink between looks."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.transforms import planar
from messages.command import ControlCommand
from messages.motion import MapPose, Odometry, PositionSource
from messages.perception import ObstacleClass, Track, Tracks
from messages.plan import PathSection, PathSectionType
from safety.collision_monitor import Lookout, Seen, class_at, pose_in_map, stamps_of
from safety.config import SafetyConfig
from safety.obstacle_sources import Measurements
from safety.pose_history import to_frame
from safety.sources.ground_filter import Box
from safety.stopping_distance import stopping_distance, stopping_time
from safety.zones.footprint_by_fold import Shapes, shapes_of
from safety.zones.geofence import Fence
from safety.zones.protective_field import Gap, Place, Way
from safety.zones.tracked_obstacles import NO_THREAT, Threat
from tests.safety.safety_world import START_NS, straight_path

POSE_ODOM, T_MAP_ODOM = (5.0, -3.0, 0.7), planar(2.0, 1.0, 0.3)
NOTHING = Measurements({}, {}, {})
SIGMA_M = 0.02


class Spy:
    """Answers always the same, and keeps what it was asked."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer
        self.calls: list[tuple[Any, ...]] = []

    def __call__(self, *args: Any) -> Any:
        self.calls.append(args)
        return self.answer

    @property
    def asked(self) -> tuple[Any, ...]:
        return self.calls[-1]


def sweep(direction: int = 1, step_m: float = 0.4) -> Any:
    """Ten metres by one, whatever its part."""
    found: Any = SimpleNamespace(direction=direction, step_m=step_m, box=Box((0.0, 10.0), (-0.5, 0.5)))
    found.until = Spy(found)
    return found


def odometry(stamp_ns: int = START_NS, x: float = 5.0, y: float = -3.0) -> Odometry:
    return Odometry(stamp_ns, planar(x, y, 0.7), 3.0, 0.0, 0.0, 0.2, 0.1, np.eye(6))


def pose(**changes: Any) -> MapPose:
    covariance = SIGMA_M**2 * np.eye(6)
    found = MapPose(START_NS, T_MAP_ODOM, np.eye(4), covariance, PositionSource.RTK_FIXED, 0.1, 0.1, True)
    return replace(found, **changes)


def docking_path() -> Any:
    path = straight_path(7)
    return replace(path, stamp_ns=START_NS + 1, sections=(PathSection(PathSectionType.DOCK, -1, 0, len(path.s_m) - 1),))


CONTROL_COMMAND = ControlCommand(START_NS, 2.0, 0.0, 0.0, True, True, 7, 3.0, 0.0, 0.0, False)
SEEN = Seen(odometry(), pose(), CONTROL_COMMAND, straight_path(7), Tracks(START_NS, ()), 0.0, NOTHING, {})
DOCKING = replace(SEEN, fold=1.0, path=docking_path())
POSE_MAP = np.array([*to_frame(np.array([2.0, 1.0, 0.3]), np.array([POSE_ODOM[:2]]))[0], 1.0])


@pytest.fixture
def shapes(full: Vehicle, implement) -> Shapes:
    return shapes_of(full, implement)


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What the lookout asks, each a spy."""
    found = SimpleNamespace(
        way_ahead=Spy(Way(sweep(), sweep(), True)), look_ahead_m=Spy(17.0), arc_length_m=Spy(8.0),
        threat_in=Spy(Threat(9.0, ObstacleClass.PERSON, 4)),
    )  # fmt: skip
    for name, spy in vars(found).items():
        monkeypatch.setattr(f"safety.collision_monitor.{name}", spy)
    return found


@pytest.fixture
def survey() -> Any:
    return SimpleNamespace(is_near=Spy(True), is_under_roof=Spy(True), clear_m=Spy(6.0), away_m=Spy(np.zeros(1)))


@pytest.fixture
def make(full: Vehicle, shapes: Shapes, config: SafetyConfig, parts: Any, survey: Any) -> Callable[..., Any]:
    """A lookout with senses of its own, which have looked and found a gap of 7 m."""

    def made(**what: Any) -> Any:
        around = (what.get("fence"), what.get("survey", survey), config)
        lookout: Any = Lookout(shapes, full.sensors, *around, *what.get("arc", ()))
        lookout.senses = SimpleNamespace(
            hear=Spy(False), fresh=Spy([]), wear=Spy(None), scan=Spy(None),
            gap=Spy(Gap(7.0, 3.0, np.array([(7.0, 0.0, 1.0)]))),
        )  # fmt: skip
        return lookout

    return made


def look(lookout: Any, config: SafetyConfig, seen: Seen = SEEN, direction: int = 1, speed_mps: float = 2.0) -> None:
    lookout.look(seen, direction, speed_mps, config.braking.flat, 2.1)


def looks(lookout: Any) -> int:
    return len(lookout.senses.gap.calls)


def test_a_lookout_begins_with_nothing(full: Vehicle, shapes: Shapes, config: SafetyConfig, fence: Fence) -> None:
    lookout = Lookout(shapes, full.sensors, fence, None, config)
    assert (lookout.way, lookout.gap(), lookout.threat(), lookout.fence_m()) == (None, None, NO_THREAT, None)
    assert (lookout.survey_m(), lookout.is_docking, lookout.is_under_roof) == (math.inf, False, False)
    assert lookout.config is config
    assert lookout.senses._shape is shapes.wide
    assert lookout.senses._config is config
    assert [eye.name for eye in lookout.senses.eyes] == ["front", "rear"]
    assert Lookout(shapes, full.sensors, None, None, config).fence_m() == math.inf


def test_without_odometry_nothing_is_taken(make: Any, config: SafetyConfig) -> None:
    lookout = make()
    look(lookout, config, replace(SEEN, odom=None, fold=1.0))
    assert (looks(lookout), lookout.way, lookout.senses.hear.calls, lookout.senses.wear.calls) == (0, None, [], [])


def test_it_looks_when_something_came(make: Any, config: SafetyConfig) -> None:
    lookout = make()
    counts = []

    def count(seen: Seen = SEEN) -> None:
        look(lookout, config, seen)
        counts.append(looks(lookout))

    count()
    count()
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    lookout.senses.hear.answer = True
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    lookout.senses.hear.answer = False
    lookout.senses.fresh.answer = [object()]
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    lookout.senses.fresh.answer = []
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1), fold=1.0))
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1), fold=1.0))
    assert counts == [1, 1, 2, 3, 4, 4, 5, 5]


def test_what_came_is_heard_and_scanned(make: Any, config: SafetyConfig) -> None:
    lookout, eyes = make(), [object()]
    lookout.senses.fresh.answer = eyes
    look(lookout, config)
    assert lookout.senses.hear.asked == (NOTHING, lookout.trail, SEEN.odom)
    assert lookout.senses.fresh.asked == (NOTHING,)
    assert lookout.trail.pose_at(START_NS) == pytest.approx(POSE_ODOM)
    came, fresh, trail, odom, box, is_other_way = lookout.senses.scan.asked
    assert (came, fresh, trail, odom, is_other_way) == (NOTHING, eyes, lookout.trail, SEEN.odom, True)
    assert box == Box((-3.0, 13.0), (-3.5, 3.5))


def test_another_way_is_another_path_direction_plan_or_outline(make: Any, config: SafetyConfig, parts: Any) -> None:
    lookout = make()
    lookout.senses.fresh.answer = [object()]
    others = []

    def step(path: Any, direction: int, is_planned: bool, fold: float) -> None:
        parts.way_ahead.answer = Way(sweep(direction), None, is_planned)
        look(lookout, config, replace(SEEN, path=path, fold=fold))
        others.append(lookout.senses.scan.asked[-1])

    steps: list[tuple[Any, int, bool, float]] = [
        (straight_path(7), 1, True, 0.0), (straight_path(8), 1, True, 0.0), (straight_path(8), -1, True, 0.0),
        (straight_path(8), -1, False, 0.0), (straight_path(8), -1, False, 1.0), (None, -1, False, 1.0),
    ]  # fmt: skip
    for one in steps:
        step(*one)
        step(*one)
    assert others == [True, False] * 6
    step(straight_path(1), -1, False, 1.0)
    assert others[-1]
    step(straight_path(0), -1, False, 1.0)
    step(None, -1, False, 1.0)
    assert others[-2:] == [True, True]


def test_the_first_way_is_another(make: Any, config: SafetyConfig, parts: Any) -> None:
    for direction in (1, -1):
        lookout, parts.way_ahead.answer = make(), Way(sweep(direction), None, False)
        look(lookout, config, replace(SEEN, path=None))
        assert lookout.senses.scan.asked[-1]


def test_the_outline_at_a_fold_is_worn(make: Any, config: SafetyConfig, parts: Any, shapes: Shapes) -> None:
    lookout = make()
    for fold, count in ((0.0, 0), (1.0, 1), (1.0, 1), (None, 2), (0.0, 2)):
        look(lookout, config, replace(SEEN, fold=fold))
        assert len(lookout.senses.wear.calls) == count
        shape = shapes.narrow if fold == 1.0 else shapes.wide
        assert parts.way_ahead.asked[6] is shape
        assert parts.threat_in.asked[1] is shape
        assert count == 0 or lookout.senses.wear.asked[0] is shape


def test_the_way_is_laid_along_the_plan_in_its_direction(make: Any, config: SafetyConfig, parts: Any) -> None:
    lookout, flat = make(), config.braking.flat
    look(lookout, config)
    assert lookout.way is parts.way_ahead.answer
    place, pose_map, *rest = parts.way_ahead.asked
    assert place == Place(SEEN.path, 3.0)
    assert pose_map == pytest.approx(POSE_MAP)
    assert rest == [0.1, 1, 17.0, 8.0, lookout._shapes.wide, config.field]
    assert parts.look_ahead_m.asked == (2.0, flat, config.field, 2.1)
    assert parts.arc_length_m.asked == (2.0, flat, config.field)
    lookout = make()
    look(lookout, config, direction=-1)
    assert parts.way_ahead.asked[0] is None
    assert parts.way_ahead.asked[3] == -1
    lookout = make()
    look(lookout, config, replace(SEEN, path=None, map_pose=None))
    assert parts.way_ahead.asked[:2] == (None, None)


def test_the_arc_beside_a_plan_may_be_left_out(make: Any, config: SafetyConfig, parts: Any) -> None:
    planned, arc_alone = parts.way_ahead.answer, Way(sweep(), None, False)
    for arc, answer, expected in (
        ((), planned, planned), ((True,), planned, planned), ((False,), planned, Way(planned.main, None, True)),
        ((False,), arc_alone, arc_alone),
    ):  # fmt: skip
        parts.way_ahead.answer = answer
        lookout = make(arc=arc)
        look(lookout, config)
        assert lookout.way == expected


def test_gaps_and_threats_are_measured_on_that_way(make: Any, config: SafetyConfig, parts: Any) -> None:
    lookout = make()
    look(lookout, config)
    way, pose_odom, speed_mps, is_explained, tracks = lookout.senses.gap.asked
    assert (way, speed_mps, is_explained, tracks) == (lookout.way, 2.0, None, SEEN.tracks)
    assert pose_odom == pytest.approx(POSE_ODOM)
    main, shape, tracks, pose_odom, curvature, stop_s, tracked, is_explained = parts.threat_in.asked
    assert (main, shape, tracks) == (lookout.way.main, lookout._shapes.wide, SEEN.tracks)
    assert (curvature, tracked, is_explained) == (0.1, config.tracked, None)
    assert pose_odom == pytest.approx(POSE_ODOM)
    assert stop_s == stopping_time(2.0, config.braking.flat)


def test_between_looks_the_gaps_shrink_by_the_way_driven(make: Any, config: SafetyConfig, parts: Any) -> None:
    edge = np.array([(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)])
    lookout = make(fence=Fence((edge,)))
    look(lookout, config, DOCKING)
    lookout._fence_m = 8.0

    def left() -> tuple[float, ...]:
        gap = lookout.gap()
        assert gap.triggering_points_base_m.tolist() == [[7.0, 0.0, 1.0]]
        threat = lookout.threat()
        assert (threat.label, threat.id) == (ObstacleClass.PERSON, 4)
        return gap.main_m, gap.arc_m, threat.clearance_m, lookout.fence_m(), lookout.survey_m()

    assert left() == (7.0, 3.0, 9.0, 8.0, 6.0)
    for k, (driven, expected) in enumerate((
        (2.5, (4.5, 0.5, 6.5, 5.5, 3.5)), (3.5, (3.5, 0.0, 5.5, 4.5, 2.5)), (20.0, (0.0, 0.0, 0.0, 0.0, 0.0)),
    )):  # fmt: skip
        look(lookout, config, replace(DOCKING, odom=odometry(START_NS + k + 1, 5.0 + driven)))
        assert left() == pytest.approx(expected)
        assert looks(lookout) == 1
    for fence_m, expected_m in ((0.5, 0.0), (0.0, 0.0), (None, None), (-1.0, -1.0)):
        lookout._fence_m = fence_m
        assert lookout.fence_m() == expected_m
    look(lookout, config, replace(DOCKING, odom=odometry(START_NS + 9, 25.0), tracks=None))
    assert (*left()[:3], left()[4]) == (7.0, 3.0, 9.0, 6.0)


def test_the_docking_field_counts_on_the_way_to_a_bay_at_the_shed_and_narrow(
    make: Any, config: SafetyConfig, parts: Any, survey: Any
) -> None:
    lookout = make()
    look(lookout, config, DOCKING)
    assert lookout.is_docking
    assert lookout.config == config.docked != config
    assert parts.way_ahead.asked[7] == config.docked.field
    assert parts.look_ahead_m.asked[2] == parts.arc_length_m.asked[2] == config.docked.field
    pose_map, near_m = survey.is_near.calls[0]
    assert (near_m, tuple(pose_map)) == (8.0, pytest.approx(POSE_MAP))
    for seen in (replace(DOCKING, fold=0.0), replace(DOCKING, path=SEEN.path), replace(DOCKING, path=None),
                 replace(DOCKING, map_pose=None)):  # fmt: skip
        look(lookout, config, DOCKING)
        assert lookout.is_docking
        look(lookout, config, seen)
        assert not lookout.is_docking
        assert lookout.config is config
    survey.is_near.answer = False
    look(lookout, config, DOCKING)
    assert not lookout.is_docking
    bare = make(survey=None)
    look(bare, config, DOCKING)
    assert not bare.is_docking
    assert (bare.survey_m(), bare.is_under_roof) == (math.inf, False)


def test_surveyed_walls_explain_what_is_near_them_in_docking(
    make: Any, config: SafetyConfig, parts: Any, survey: Any
) -> None:
    lookout = make()
    look(lookout, config, DOCKING)
    is_explained = lookout.senses.gap.asked[3]
    assert parts.threat_in.asked[7] is is_explained
    points = np.array([(6.0, 1.0), (2.0, 9.0)])
    tolerance_m = config.docking.explained_m + 3.0 * SIGMA_M
    survey.away_m.answer = np.array([tolerance_m, tolerance_m + 1e-9])
    assert is_explained(points).tolist() == [True, False]
    assert survey.away_m.asked[0] == pytest.approx(to_frame(np.array([2.0, 1.0, 0.3]), points))


def test_the_way_clear_of_the_survey_is_the_least_of_all_sweeps(
    make: Any, config: SafetyConfig, parts: Any, survey: Any
) -> None:
    lookout, way = make(), parts.way_ahead.answer
    look(lookout, config, DOCKING)
    assert (lookout.survey_m(), lookout.is_under_roof) == (6.0, True)
    assert [args[0] for args in survey.clear_m.calls] == [way.main, way.arc]
    for _, pose_map, clearance_m in survey.clear_m.calls:
        assert clearance_m == pytest.approx(config.docking.clearance_m + 3.0 * SIGMA_M)
        assert pose_map == pytest.approx(POSE_MAP)
    assert survey.is_under_roof.asked[0] is way.main
    assert survey.is_under_roof.asked[1] == pytest.approx(POSE_MAP)
    assert survey.is_near.asked[1] == 8.0
    assert survey.is_near.asked[0] == pytest.approx(POSE_MAP)
    survey.clear_m = lambda one, *_: 4.0 if one is way.arc else 5.0
    look(lookout, config, replace(DOCKING, tracks=None))
    assert lookout.survey_m() == 4.0
    parts.way_ahead.answer = Way(way.main, None, True)
    look(lookout, config, DOCKING)
    assert lookout.survey_m() == 5.0
    look(lookout, config, replace(DOCKING, path=SEEN.path, tracks=None))
    assert (lookout.survey_m(), lookout.is_under_roof) == (math.inf, True)
    look(lookout, config, DOCKING)
    survey.is_near.answer = False
    look(lookout, config, replace(DOCKING, tracks=None))
    assert (lookout.survey_m(), lookout.is_under_roof) == (math.inf, False)
    survey.is_near.answer = True
    look(lookout, config, DOCKING)
    look(lookout, config, replace(DOCKING, map_pose=None))
    assert (lookout.survey_m(), lookout.is_under_roof) == (math.inf, False)


def test_the_fence_is_asked_over_the_stopping_distance_a_margin_and_a_metre(
    make: Any, config: SafetyConfig, parts: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    fence: Any = SimpleNamespace(holds_box=Spy(False))
    outlines, inside = Spy((np.array([(3.0, 4.0)]), np.array([2.0]))), Spy(6.5)
    monkeypatch.setattr("safety.collision_monitor.corners_along", outlines)
    monkeypatch.setattr("safety.collision_monitor.way_inside_m", inside)
    main, arc = sweep(step_m=0.4), sweep(step_m=0.05)
    lookout, flat = make(fence=fence, survey=None), config.braking.flat
    parts.way_ahead.answer = Way(main, arc, True)
    look(lookout, config)
    assert lookout.fence_m() == 6.5
    for one in (main, arc):
        assert one.until.asked == (pytest.approx(stopping_distance(2.0, flat) + 0.05 + 1.0),)
    assert fence.holds_box.asked[0].x_m == pytest.approx(main.box.seen_from(POSE_MAP).x_m)
    assert outlines.calls == [(main, 0.1), (arc, 0.1)]
    for (asked, points, ways, spacing_m), spacing in zip(inside.calls, (0.4, 0.1), strict=True):
        assert (asked, spacing_m, ways.tolist()) == (fence, spacing, [2.0])
        assert points == pytest.approx(to_frame(POSE_MAP, np.array([(3.0, 4.0)])))
    look(lookout, config, replace(SEEN, tracks=None), speed_mps=40.0)
    assert main.until.asked == (pytest.approx(61.05),)
    monkeypatch.setattr("safety.collision_monitor.way_inside_m", lambda *args: 3.0 if args[3] > 0.3 else 5.0)
    look(lookout, config)
    assert lookout.fence_m() == 3.0
    fence.holds_box = lambda box: bool(box == fence.first)
    fence.first = main.box.seen_from(POSE_MAP)
    arc.box = Box((0.0, 3.0), (-0.5, 0.5))
    look(lookout, config, replace(SEEN, tracks=None))
    assert lookout.fence_m() == 5.0
    parts.way_ahead.answer = Way(main, None, True)
    look(lookout, config)
    assert lookout.fence_m() == math.inf
    look(lookout, config, replace(SEEN, map_pose=None))
    assert lookout.fence_m() is None


def track(x: float, y: float, label: ObstacleClass, is_confirmed: bool = True) -> Track:
    return Track(1, label, 0.9, np.array([x, y, 0.5]), np.zeros(3), np.eye(4), np.array([1.2, 1.6, 3.0]), 0.7, 0, 1,
                 is_confirmed, ("lidar_front",))  # fmt: skip


def test_the_cause_is_the_track_at_the_hits_or_else_the_threat(make: Any, config: SafetyConfig) -> None:
    lookout = make()
    odom = odometry()
    x, y = to_frame(np.array(POSE_ODOM), np.array([(7.0, 0.0)]))[0]
    tracks = Tracks(START_NS, (track(x, y, ObstacleClass.ANIMAL),))
    assert lookout.cause(odom, tracks) is ObstacleClass.UNKNOWN
    look(lookout, config)
    assert lookout.cause(odom, tracks) is ObstacleClass.ANIMAL
    for one, some in ((None, tracks), (odom, None), (odom, Tracks(START_NS, ()))):
        assert lookout.cause(one, some) is ObstacleClass.PERSON
    lookout._gap = Gap(math.inf, math.inf, np.empty((0, 3)))
    assert lookout.cause(odom, tracks) is ObstacleClass.PERSON


def test_the_class_is_that_of_the_nearest_confirmed_track_within_a_metre() -> None:
    points = np.array([(0.0, 0.0), (30.0, 0.0)])
    for away, label in ((1.99, ObstacleClass.POLE), (2.0, ObstacleClass.UNKNOWN)):
        found = class_at(points, Tracks(START_NS, (track(0.0, away, ObstacleClass.POLE),)))
        assert found is label, away
    near, far = track(0.0, 0.6, ObstacleClass.PERSON), track(0.0, 0.9, ObstacleClass.POLE)
    for some in ((near, far), (far, near)):
        assert class_at(points, Tracks(START_NS, some)) is ObstacleClass.PERSON
    unsure = track(0.0, 0.1, ObstacleClass.ANIMAL, is_confirmed=False)
    assert class_at(points, Tracks(START_NS, (unsure, far))) is ObstacleClass.POLE


def test_the_place_in_map_goes_by_link_and_odometry() -> None:
    assert pose_in_map(pose(), odometry()) == pytest.approx(POSE_MAP)
    assert pose_in_map(pose(is_initialized=False), odometry()) is None
    assert pose_in_map(None, odometry()) is None


def test_a_look_depends_on_pose_path_and_tracks() -> None:
    seen = replace(SEEN, map_pose=pose(stamp_ns=3), path=replace(straight_path(), stamp_ns=4), tracks=Tracks(5, ()))
    assert stamps_of(seen) == (3, 4, 5)
    assert stamps_of(replace(seen, path=None)) == (3, -1, 5)

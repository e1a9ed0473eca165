"""The collision monitor with spied parts: when it updates, with which arguments, and distances between updates."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.pose2 import to_frame
from geometry.transforms import planar
from messages.command import ControlCommand
from messages.motion import MapPose, Odometry, PositionSource
from messages.perception import ObstacleClass, Track, Tracks
from messages.plan import PathSection, PathSectionType
from safety.collision_monitor import CollisionMonitor, MonitorInputs, class_at, pose_in_map, stamps_of
from safety.config import SafetyConfig
from safety.obstacle_sources import SourceData
from safety.stopping_distance import stopping_distance, stopping_time
from safety.zones.footprint import (
    Box,
    FootprintSet,
    footprints_of,
)
from safety.zones.geofence import Geofence
from safety.zones.protective_field import FREE, Clearance, PathPosition, SweptField
from safety.zones.tracked_obstacles import NO_CRITICAL_OBJECT, CriticalObject, horizon_s
from tests.safety.safety_world import START_NS, straight_path

POSE_ODOM, T_MAP_ODOM = (5.0, -3.0, 0.7), planar(2.0, 1.0, 0.3)

NOTHING = SourceData({}, {}, {})

SIGMA_M = 0.02


class Spy:
    """Callable with a fixed answer that records its calls."""

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
    """Swept area of ten metres by one, the same for each part of it."""
    found: Any = SimpleNamespace(direction=direction, step_m=step_m, box=Box((0.0, 10.0), (-0.5, 0.5)))
    found.up_to = Spy(found)
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

SEEN = MonitorInputs(odometry(), pose(), CONTROL_COMMAND, straight_path(7), Tracks(START_NS, ()), 0.0, 1.0, NOTHING, {})

NO_POSTS = np.empty((0, 2))

DOCKING = replace(SEEN, fold=1.0, path=docking_path())

POSE_MAP = np.array([*to_frame(np.array([2.0, 1.0, 0.3]), np.array([POSE_ODOM[:2]]))[0], 1.0])


@pytest.fixture
def footprints(full: Vehicle, implement) -> FootprintSet:
    return footprints_of(full, implement)


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Spies for the functions that the collision monitor calls."""
    found = SimpleNamespace(
        sweep_field=Spy(SweptField(sweep(), sweep(), True)), look_ahead_m=Spy(17.0), arc_length_m=Spy(8.0),
        nearest_critical_object=Spy(CriticalObject(9.0, ObstacleClass.PERSON, 4)), tracks_near=Spy([]),
    )  # fmt: skip
    for name, spy in vars(found).items():
        monkeypatch.setattr(f"safety.collision_monitor.{name}", spy)
    return found


@pytest.fixture
def known_structure() -> Any:
    return SimpleNamespace(
        is_near=Spy(True), is_under_roof=Spy(True), clear_distance_m=Spy(6.0), distance_m=Spy(np.zeros(1))
    )


@pytest.fixture
def make(
    full: Vehicle, footprints: FootprintSet, config: SafetyConfig, parts: Any, known_structure: Any
) -> Callable[..., Any]:
    """A collision monitor with spied sources that report a clearance of 7 m."""

    def made(**what: Any) -> Any:
        around = (what.get("geofence"), what.get("known_structure", known_structure), config)
        collision_monitor: Any = CollisionMonitor(footprints, full.sensors, *around)
        collision_monitor.sources = SimpleNamespace(
            update=Spy(False), with_new_scan=Spy([]), set_footprint=Spy(None), set_hitch=Spy(None),
            update_lidars=Spy(None), clearance=Spy(Clearance(7.0, 3.0, np.array([(7.0, 0.0, 1.0)]))),
            lidar_hits_odom_m=np.array([(8.0, 2.0)]), holes_odom_m=np.empty((0, 2)), forget_held=Spy(None),
            cover_m=0.0,
        )  # fmt: skip
        collision_monitor.departure = SimpleNamespace(is_kept=False, update=Spy(None), forget=Spy(None))
        collision_monitor.standing_bodies = SimpleNamespace(
            update=Spy(None), hidden=NO_CRITICAL_OBJECT, forget_hidden=Spy(None)
        )
        collision_monitor.bystanders.note_returns = Spy(None)
        return collision_monitor

    return made


def look(
    collision_monitor: Any, config: SafetyConfig, seen: MonitorInputs = SEEN, direction: int = 1, speed_mps: float = 2.0
) -> None:
    collision_monitor.update(seen, direction, speed_mps, config.braking.flat, 2.1)


def covers(collision_monitor: Any) -> int:
    return len(collision_monitor.sources.clearance.calls)


def test_initial_state(full: Vehicle, footprints: FootprintSet, config: SafetyConfig, geofence: Geofence) -> None:
    collision_monitor = CollisionMonitor(footprints, full.sensors, geofence, None, config)
    assert (
        collision_monitor.swept_field,
        collision_monitor.clearance(),
        collision_monitor.critical_object(),
        collision_monitor.geofence_distance_m(),
    ) == (None, None, NO_CRITICAL_OBJECT, None)
    assert (collision_monitor.wall_distance_m(), collision_monitor.is_docking, collision_monitor.is_under_roof) == (
        math.inf,
        False,
        False,
    )
    assert collision_monitor.config is config
    assert collision_monitor.sources._footprint is footprints.working
    assert collision_monitor.sources._config is config
    assert [source.name for source in collision_monitor.sources.lidars] == ["front", "rear"]
    assert CollisionMonitor(footprints, full.sensors, None, None, config).geofence_distance_m() == math.inf


def test_missing_odometry(make: Any, config: SafetyConfig) -> None:
    collision_monitor = make()
    look(collision_monitor, config, replace(SEEN, odom=None, fold=1.0))
    assert (
        covers(collision_monitor),
        collision_monitor.swept_field,
        collision_monitor.sources.update.calls,
        collision_monitor.sources.set_footprint.calls,
    ) == (0, None, [], [])


def test_update_on_new_data(make: Any, config: SafetyConfig) -> None:
    collision_monitor = make()
    counts = []

    def count(seen: MonitorInputs = SEEN) -> None:
        look(collision_monitor, config, seen)
        counts.append(covers(collision_monitor))

    count()
    count()
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    collision_monitor.sources.update.answer = True
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    collision_monitor.sources.update.answer = False
    collision_monitor.sources.with_new_scan.answer = [object()]
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    collision_monitor.sources.with_new_scan.answer = []
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1)))
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1), fold=1.0))
    count(replace(SEEN, map_pose=pose(stamp_ns=START_NS + 1), fold=1.0))
    assert counts == [1, 1, 2, 3, 4, 4, 5, 5]


def test_source_data_passed_to_sources(make: Any, config: SafetyConfig) -> None:
    collision_monitor, lidars = make(), [object()]
    collision_monitor.sources.with_new_scan.answer = lidars
    look(collision_monitor, config)
    assert collision_monitor.sources.update.asked == (NOTHING, collision_monitor.pose_history, SEEN.odom)
    assert collision_monitor.sources.with_new_scan.asked == (NOTHING,)
    assert collision_monitor.pose_history.pose_at(START_NS) == pytest.approx(POSE_ODOM)
    came, fresh, pose_history, odom, box, is_new_field = collision_monitor.sources.update_lidars.asked
    assert (came, fresh, pose_history, odom, is_new_field) == (
        NOTHING,
        lidars,
        collision_monitor.pose_history,
        SEEN.odom,
        True,
    )
    assert box == Box((-3.0, 13.0), (-3.5, 3.5))


def test_new_field_conditions(make: Any, config: SafetyConfig, parts: Any) -> None:
    collision_monitor = make()
    collision_monitor.sources.with_new_scan.answer = [object()]
    others = []

    def step(path: Any, direction: int, is_planned: bool, fold: float) -> None:
        parts.sweep_field.answer = SweptField(sweep(direction), None, is_planned)
        look(collision_monitor, config, replace(SEEN, path=path, fold=fold))
        others.append(collision_monitor.sources.update_lidars.asked[-1])

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


def test_first_field_is_new(make: Any, config: SafetyConfig, parts: Any) -> None:
    for direction in (1, -1):
        collision_monitor, parts.sweep_field.answer = make(), SweptField(sweep(direction), None, False)
        look(collision_monitor, config, replace(SEEN, path=None))
        assert collision_monitor.sources.update_lidars.asked[-1]


def test_footprint_by_fold(make: Any, config: SafetyConfig, parts: Any, footprints: FootprintSet) -> None:
    collision_monitor = make()
    for fold, count in ((0.0, 0), (1.0, 1), (1.0, 1), (None, 2), (0.0, 2)):
        look(collision_monitor, config, replace(SEEN, fold=fold))
        assert len(collision_monitor.sources.set_footprint.calls) == count
        footprint = footprints.transport if fold == 1.0 else footprints.working
        assert parts.sweep_field.asked[6] is footprint
        assert count == 0 or collision_monitor.sources.set_footprint.asked[0] is footprint


def test_hitch_position_is_passed_to_the_sources(make: Any, config: SafetyConfig) -> None:
    collision_monitor = make()
    look(collision_monitor, config, replace(SEEN, hitch=0.3))
    assert collision_monitor.sources.set_hitch.asked == (0.3,)


def test_field_along_plan_in_its_direction(make: Any, config: SafetyConfig, parts: Any) -> None:
    collision_monitor, flat = make(), config.braking.flat
    look(collision_monitor, config)
    assert collision_monitor.swept_field is parts.sweep_field.answer
    place, pose_map, *rest = parts.sweep_field.asked
    assert place == PathPosition(SEEN.path, 3.0)
    assert pose_map == pytest.approx(POSE_MAP)
    assert rest == [0.1, 1, 17.0, 8.0, collision_monitor._footprints.working, config.field]
    assert parts.look_ahead_m.asked == (2.0, flat, config.field, 2.1)
    assert parts.arc_length_m.asked == (2.0, flat, config.field)
    collision_monitor = make()
    look(collision_monitor, config, direction=-1)
    assert parts.sweep_field.asked[0] is None
    assert parts.sweep_field.asked[3] == -1
    collision_monitor = make()
    look(collision_monitor, config, replace(SEEN, path=None, map_pose=None))
    assert parts.sweep_field.asked[:2] == (None, None)


def test_clearance_and_critical_object_on_swept_field(make: Any, config: SafetyConfig, parts: Any) -> None:
    collision_monitor = make()
    look(collision_monitor, config)
    swept_field, pose_odom, speed_mps, is_known, tracks = collision_monitor.sources.clearance.asked
    assert (swept_field, speed_mps, is_known, tracks) == (collision_monitor.swept_field, 2.0, None, SEEN.tracks)
    assert pose_odom == pytest.approx(POSE_ODOM)
    main, tracks, pose_odom, predicted_s, tracked, is_known = parts.tracks_near.asked
    assert (main, tracks) == (collision_monitor.swept_field.main, SEEN.tracks)
    assert (tracked, is_known) == (config.tracked, None)
    assert pose_odom == pytest.approx(POSE_ODOM)
    assert predicted_s == horizon_s(stopping_time(2.0, config.braking.flat), config.tracked)
    assert parts.nearest_critical_object.asked[0] is main
    assert parts.nearest_critical_object.asked[1:] == ([], pose_odom, predicted_s, config.tracked)


def person(number: int, x: float) -> Track:
    at = to_frame(POSE_ODOM, np.array([(x, 6.0)]))[0]
    return Track(number, ObstacleClass.PERSON, 0.9, np.array([*at, 0.8]), np.zeros(3), np.eye(4),
                 np.array([0.5, 0.5, 1.7]), 0.0, 0, 1, True, ())  # fmt: skip


def test_bystander_comes_before_what_is_ahead(make: Any, config: SafetyConfig, parts: Any) -> None:
    ahead, beside, stands = person(1, 9.0), person(2, -1.5), person(3, -1.5)
    collision_monitor = make()
    parts.tracks_near.answer = [(ahead, True), (beside, True), (stands, False)]
    coming = CriticalObject(0.0, ObstacleClass.PERSON, 2)
    collision_monitor.bystanders = SimpleNamespace(
        update=Spy(None), note_close=Spy(None), note_returns=Spy(None), coming=coming
    )
    look(collision_monitor, config)
    moving, machine, _ = collision_monitor.bystanders.note_close.asked
    assert (moving, machine.area) == ([ahead, beside], collision_monitor.swept_field.main)
    assert (machine.speed_mps, machine.yaw_rate_radps) == (2.0, odometry().yaw_rate_radps)
    assert machine.braking == config.braking.flat
    moving, approaching, near, tracks, _, predicted_s = collision_monitor.bystanders.update.asked
    assert (moving, approaching, near, tracks) == ([beside], [ahead], [], SEEN.tracks)
    assert predicted_s == parts.tracks_near.asked[3]
    (returns, *_), hits = collision_monitor.bystanders.note_returns.asked, collision_monitor.sources.lidar_hits_odom_m
    assert len(returns) == 0
    assert collision_monitor.critical_object() == coming
    collision_monitor.bystanders.coming = None
    look(collision_monitor, config, replace(SEEN, tracks=Tracks(START_NS + 1, ())), speed_mps=0.0)
    assert collision_monitor.bystanders.update.asked[2] == [ahead, beside, stands]  # at rest
    assert collision_monitor.bystanders.note_returns.asked[0].tolist() == hits.tolist()
    assert collision_monitor.critical_object().id == 4
    assert parts.nearest_critical_object.asked[1] == [(ahead, True)]


def test_static_tracks_at_gate_posts_are_left_to_the_raw_field(make: Any, config: SafetyConfig, parts: Any) -> None:
    """Where the position in map is known: the post of a gate has the size of a person."""
    post, other = to_frame(POSE_MAP, np.array([(9.0, 6.0), (20.0, 6.0)])), person(2, 12.0)
    parts.tracks_near.answer = [(person(1, 9.2), False), (other, False)]
    geofence = SimpleNamespace(contains=Spy(np.ones(1, bool)), contains_box=Spy(True), posts=post)
    collision_monitor = make(geofence=geofence)
    look(collision_monitor, config)
    assert parts.nearest_critical_object.asked[1] == [(other, False)]
    assert collision_monitor.standing_bodies.update.asked[0] == [(other, False)]
    look(collision_monitor, config, replace(SEEN, map_pose=None, tracks=Tracks(START_NS + 1, ())))
    assert parts.nearest_critical_object.asked[1] == parts.tracks_near.answer


def test_standing_bodies_are_sought_inside_the_geofence(make: Any, config: SafetyConfig, parts: Any) -> None:
    base = np.array([(-40.0, 6.0), (-40.0, -40.0), (40.0, -40.0), (40.0, 6.0)])
    inside = Geofence((to_frame(POSE_MAP, base),)).contains
    collision_monitor = make(geofence=SimpleNamespace(contains=inside, contains_box=Spy(True), posts=NO_POSTS))
    look(collision_monitor, config)
    near, area, pose_odom, braking, now_ns, is_inside, cover = collision_monitor.standing_bodies.update.asked
    assert cover is None
    assert (near, area) == ([], collision_monitor.swept_field.main)
    assert pose_odom == pytest.approx(POSE_ODOM)
    assert (braking, now_ns) == (config.braking.flat, START_NS)
    assert is_inside(to_frame(POSE_ODOM, np.array([(1.0, 5.9), (1.0, 6.1)]))).tolist() == [True, False]
    unknown = make(geofence=None)
    look(unknown, config)
    assert unknown.standing_bodies.update.asked[-2] is None


def test_who_is_lost_in_cover_is_a_critical_object(make: Any, config: SafetyConfig, parts: Any) -> None:
    collision_monitor = make()
    collision_monitor.sources.cover_m = 0.3
    collision_monitor.standing_bodies.hidden = CriticalObject(2.0, ObstacleClass.PERSON, 7)
    for nearest_m in (1.99, 2.0, 2.01):
        parts.nearest_critical_object.answer = CriticalObject(nearest_m, ObstacleClass.VEHICLE, 3)
        look(collision_monitor, config, replace(SEEN, tracks=Tracks(START_NS + round(1e6 * nearest_m), ())))
        cover = collision_monitor.standing_bodies.update.asked[-1]
        assert (cover.height_m, cover.tracks) == (0.3, ())
        assert cover.T_base_odom @ SEEN.odom.T_odom_base == pytest.approx(np.eye(4))
        assert collision_monitor.critical_object().id == (3 if nearest_m <= 2.0 else 7), nearest_m
    look(collision_monitor, config, replace(SEEN, tracks=None))
    assert collision_monitor.standing_bodies.update.asked[-1].tracks == ()  # they hide who lies there without any too


def test_distances_shrink_by_distance_driven(make: Any, config: SafetyConfig, parts: Any) -> None:
    edge = np.array([(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)])
    collision_monitor = make(geofence=Geofence((edge,)))
    look(collision_monitor, config, DOCKING)
    collision_monitor._geofence_distance_m = 8.0

    def left() -> tuple[float, ...]:
        clearance = collision_monitor.clearance()
        assert clearance.triggering_points_base_m.tolist() == [[7.0, 0.0, 1.0]]
        critical_object = collision_monitor.critical_object()
        assert (critical_object.label, critical_object.id) == (ObstacleClass.PERSON, 4)
        return (
            clearance.main_m,
            clearance.arc_m,
            critical_object.clearance_m,
            collision_monitor.geofence_distance_m(),
            collision_monitor.wall_distance_m(),
        )

    assert left() == (7.0, 3.0, 9.0, 8.0, 6.0)
    for k, (driven, expected) in enumerate((
        (2.5, (4.5, 0.5, 6.5, 5.5, 3.5)), (3.5, (3.5, 0.0, 5.5, 4.5, 2.5)), (20.0, (0.0, 0.0, 0.0, 0.0, 0.0)),
    )):  # fmt: skip
        look(collision_monitor, config, replace(DOCKING, odom=odometry(START_NS + k + 1, 5.0 + driven)))
        assert left() == pytest.approx(expected)
        assert covers(collision_monitor) == 1
    for geofence_distance_m, expected_m in ((0.5, 0.0), (0.0, 0.0), (None, None), (-1.0, -1.0)):
        collision_monitor._geofence_distance_m = geofence_distance_m
        assert collision_monitor.geofence_distance_m() == expected_m
    look(collision_monitor, config, replace(DOCKING, odom=odometry(START_NS + 9, 25.0), tracks=None))
    assert (*left()[:3], left()[4]) == (7.0, 3.0, 9.0, 6.0)


def test_docking_field_conditions(make: Any, config: SafetyConfig, parts: Any, known_structure: Any) -> None:
    collision_monitor = make()
    look(collision_monitor, config, DOCKING)
    assert collision_monitor.is_docking
    assert collision_monitor.config == config.docked != config
    assert parts.sweep_field.asked[7] == config.docked.field
    assert parts.look_ahead_m.asked[2] == parts.arc_length_m.asked[2] == config.docked.field
    pose_map, near_m = known_structure.is_near.calls[0]
    assert (near_m, tuple(pose_map)) == (8.0, pytest.approx(POSE_MAP))
    for seen in (replace(DOCKING, fold=0.0), replace(DOCKING, path=SEEN.path), replace(DOCKING, path=None),
                 replace(DOCKING, map_pose=None)):  # fmt: skip
        look(collision_monitor, config, DOCKING)
        assert collision_monitor.is_docking
        look(collision_monitor, config, seen)
        assert not collision_monitor.is_docking
        assert collision_monitor.config is config
    known_structure.is_near.answer = False
    look(collision_monitor, config, DOCKING)
    assert not collision_monitor.is_docking
    bare = make(known_structure=None)
    look(bare, config, DOCKING)
    assert not bare.is_docking
    assert (bare.wall_distance_m(), bare.is_under_roof) == (math.inf, False)


def test_known_structure_filter_in_docking(make: Any, config: SafetyConfig, parts: Any, known_structure: Any) -> None:
    collision_monitor = make()
    look(collision_monitor, config, DOCKING)
    is_known = collision_monitor.sources.clearance.asked[3]
    assert parts.tracks_near.asked[5] is is_known
    points = np.array([(6.0, 1.0), (2.0, 9.0)])
    tolerance_m = config.docking.known_structure_tolerance_m + 3.0 * SIGMA_M
    known_structure.distance_m.answer = np.array([tolerance_m, tolerance_m + 1e-9])
    assert is_known(points).tolist() == [True, False]
    assert known_structure.distance_m.asked[0] == pytest.approx(to_frame(np.array([2.0, 1.0, 0.3]), points))


def test_wall_distance_is_minimum_of_swept_areas(
    make: Any, config: SafetyConfig, parts: Any, known_structure: Any
) -> None:
    collision_monitor, swept_field = make(), parts.sweep_field.answer
    look(collision_monitor, config, DOCKING)
    assert (collision_monitor.wall_distance_m(), collision_monitor.is_under_roof) == (6.0, True)
    assert [args[0] for args in known_structure.clear_distance_m.calls] == [swept_field.main, swept_field.arc]
    for _, pose_map, clearance_m in known_structure.clear_distance_m.calls:
        assert clearance_m == pytest.approx(config.docking.clearance_m + 3.0 * SIGMA_M)
        assert pose_map == pytest.approx(POSE_MAP)
    assert known_structure.is_under_roof.asked[0] is swept_field.main
    assert known_structure.is_under_roof.asked[1] == pytest.approx(POSE_MAP)
    assert known_structure.is_near.asked[1] == 8.0
    assert known_structure.is_near.asked[0] == pytest.approx(POSE_MAP)
    known_structure.clear_distance_m = lambda one, *_: 4.0 if one is swept_field.arc else 5.0
    look(collision_monitor, config, replace(DOCKING, tracks=None))
    assert collision_monitor.wall_distance_m() == 4.0
    parts.sweep_field.answer = SweptField(swept_field.main, None, True)
    look(collision_monitor, config, DOCKING)
    assert collision_monitor.wall_distance_m() == 5.0
    look(collision_monitor, config, replace(DOCKING, path=SEEN.path, tracks=None))
    assert (collision_monitor.wall_distance_m(), collision_monitor.is_under_roof) == (math.inf, True)
    look(collision_monitor, config, DOCKING)
    known_structure.is_near.answer = False
    look(collision_monitor, config, replace(DOCKING, tracks=None))
    assert (collision_monitor.wall_distance_m(), collision_monitor.is_under_roof) == (math.inf, False)
    known_structure.is_near.answer = True
    look(collision_monitor, config, DOCKING)
    look(collision_monitor, config, replace(DOCKING, map_pose=None))
    assert (collision_monitor.wall_distance_m(), collision_monitor.is_under_roof) == (math.inf, False)


def test_departure_is_followed_while_blocked_or_unresolved(
    make: Any, config: SafetyConfig, parts: Any, known_structure: Any
) -> None:
    collision_monitor = make()
    look(collision_monitor, config)
    hits, area, pose_odom, now_ns = collision_monitor.departure.update.asked
    assert hits.tolist() == [[8.0, 2.0]]
    assert area is parts.sweep_field.answer.main
    assert pose_odom == pytest.approx(POSE_ODOM)
    assert now_ns > 0
    look(collision_monitor, config, DOCKING)  # known structure does not leave
    assert len(collision_monitor.departure.update.asked[0]) == 0
    collision_monitor.sources.lidar_hits_odom_m = np.empty((0, 2))
    look(collision_monitor, config, replace(DOCKING, tracks=None))
    assert len(collision_monitor.departure.update.asked[0]) == 0
    count = len(collision_monitor.departure.update.calls)
    for clearance in (FREE, None):
        collision_monitor.sources.clearance.answer = clearance
        look(collision_monitor, config, replace(SEEN, tracks=None if clearance is None else SEEN.tracks))
        assert len(collision_monitor.departure.update.calls) == count
    collision_monitor.departure.is_kept = True
    look(collision_monitor, config)
    assert len(collision_monitor.departure.update.calls) == count + 1
    collision_monitor.bystanders = SimpleNamespace(forget_unseen=Spy(None))
    collision_monitor.confirm_clear()
    assert len(collision_monitor.bystanders.forget_unseen.calls) == 1
    assert len(collision_monitor.standing_bodies.forget_hidden.calls) == 1
    assert len(collision_monitor.departure.forget.calls) == len(collision_monitor.sources.forget_held.calls) == 1


def test_geofence_reach(make: Any, config: SafetyConfig, parts: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    geofence: Any = SimpleNamespace(contains_box=Spy(False), posts=NO_POSTS)
    outlines, inside = Spy((np.array([(3.0, 4.0)]), np.array([2.0]))), Spy(6.5)
    monkeypatch.setattr("safety.collision_monitor.outline_points", outlines)
    monkeypatch.setattr("safety.collision_monitor.distance_inside_m", inside)
    main, arc = sweep(step_m=0.4), sweep(step_m=0.05)
    collision_monitor, flat = make(geofence=geofence, known_structure=None), config.braking.flat
    parts.sweep_field.answer = SweptField(main, arc, True)
    look(collision_monitor, config)
    assert collision_monitor.geofence_distance_m() == 6.5
    for one in (main, arc):
        assert one.up_to.asked == (pytest.approx(stopping_distance(2.0, flat) + 0.05 + 1.0),)
    assert geofence.contains_box.asked[0].x_m == pytest.approx(main.box.in_parent(POSE_MAP).x_m)
    assert outlines.calls == [(main, 0.1), (arc, 0.1)]
    for (asked, points, ways, spacing_m), spacing in zip(inside.calls, (0.4, 0.1), strict=True):
        assert (asked, spacing_m, ways.tolist()) == (geofence, spacing, [2.0])
        assert points == pytest.approx(to_frame(POSE_MAP, np.array([(3.0, 4.0)])))
    look(collision_monitor, config, replace(SEEN, tracks=None), speed_mps=40.0)
    assert main.up_to.asked == (pytest.approx(61.05),)
    monkeypatch.setattr("safety.collision_monitor.distance_inside_m", lambda *args: 3.0 if args[3] > 0.3 else 5.0)
    look(collision_monitor, config)
    assert collision_monitor.geofence_distance_m() == 3.0
    geofence.contains_box = lambda box: bool(box == geofence.first)
    geofence.first = main.box.in_parent(POSE_MAP)
    arc.box = Box((0.0, 3.0), (-0.5, 0.5))
    look(collision_monitor, config, replace(SEEN, tracks=None))
    assert collision_monitor.geofence_distance_m() == 5.0
    parts.sweep_field.answer = SweptField(main, None, True)
    look(collision_monitor, config)
    assert collision_monitor.geofence_distance_m() == math.inf
    look(collision_monitor, config, replace(SEEN, map_pose=None))
    assert collision_monitor.geofence_distance_m() is None


def track(x: float, y: float, label: ObstacleClass, is_confirmed: bool = True) -> Track:
    return Track(1, label, 0.9, np.array([x, y, 0.5]), np.zeros(3), np.eye(4), np.array([1.2, 1.6, 3.0]), 0.7, 0, 1,
                 is_confirmed, ("lidar_front",))  # fmt: skip


def test_obstacle_class_source(make: Any, config: SafetyConfig) -> None:
    collision_monitor = make()
    odom = odometry()
    x, y = to_frame(np.array(POSE_ODOM), np.array([(7.0, 0.0)]))[0]
    tracks = Tracks(START_NS, (track(x, y, ObstacleClass.ANIMAL),))
    assert collision_monitor.obstacle_class(odom, tracks) is ObstacleClass.UNKNOWN
    look(collision_monitor, config)
    assert collision_monitor.obstacle_class(odom, tracks) is ObstacleClass.ANIMAL
    for one, some in ((None, tracks), (odom, None), (odom, Tracks(START_NS, ()))):
        assert collision_monitor.obstacle_class(one, some) is ObstacleClass.PERSON
    collision_monitor.sources.holes_odom_m = np.array([(x, y)])
    assert collision_monitor.obstacle_class(odom, tracks) is ObstacleClass.ANIMAL
    assert collision_monitor.obstacle_class(odom, Tracks(START_NS, ())) is ObstacleClass.DITCH
    collision_monitor.sources.holes_odom_m = np.array([(x, y + 1.5)])
    assert collision_monitor.obstacle_class(odom, Tracks(START_NS, ())) is ObstacleClass.PERSON
    collision_monitor._clearance = Clearance(math.inf, math.inf, np.empty((0, 3)))
    assert collision_monitor.obstacle_class(odom, tracks) is ObstacleClass.PERSON


def test_class_of_nearest_confirmed_track() -> None:
    points = np.array([(0.0, 0.0), (30.0, 0.0)])
    for away, label in ((1.99, ObstacleClass.POLE), (2.0, ObstacleClass.UNKNOWN)):
        found = class_at(points, Tracks(START_NS, (track(0.0, away, ObstacleClass.POLE),)))
        assert found is label, away
    near, far = track(0.0, 0.6, ObstacleClass.PERSON), track(0.0, 0.9, ObstacleClass.POLE)
    for some in ((near, far), (far, near)):
        assert class_at(points, Tracks(START_NS, some)) is ObstacleClass.PERSON
    unsure = track(0.0, 0.1, ObstacleClass.ANIMAL, is_confirmed=False)
    assert class_at(points, Tracks(START_NS, (unsure, far))) is ObstacleClass.POLE


def test_pose_in_map() -> None:
    assert pose_in_map(pose(), odometry()) == pytest.approx(POSE_MAP)
    assert pose_in_map(pose(is_initialized=False), odometry()) is None
    assert pose_in_map(None, odometry()) is None


def test_stamps_of_inputs() -> None:
    seen = replace(SEEN, map_pose=pose(stamp_ns=3), path=replace(straight_path(), stamp_ns=4), tracks=Tracks(5, ()))
    assert stamps_of(seen) == (3, 4, 5)
    assert stamps_of(replace(seen, path=None)) == (3, -1, 5)


def track_at(x: float, y: float, vx: float = 0.0, vy: float = 0.0, sigma: float = 0.1, label=ObstacleClass.PERSON,
          size=(0.5, 0.5, 1.7), is_confirmed: bool = True) -> Track:  # fmt: skip
    covariance = np.diag([0.01, 0.01, sigma**2, sigma**2])
    return Track(1, label, 0.9, np.array([x, y, 0.8]), np.array([vx, vy, 0.0]), covariance, np.array(size), 0.0,
                 START_NS - 10**9, START_NS, is_confirmed, ("lidar/front",))  # fmt: skip


def test_class_at_triggering_points() -> None:
    tracks = Tracks(START_NS, (track_at(9.0, 0.0, label=ObstacleClass.ANIMAL), track_at(5.0, 0.0, is_confirmed=False)))
    assert class_at(np.array([[8.8, 0.1]]), tracks) is ObstacleClass.ANIMAL
    assert class_at(np.array([[5.0, 0.1]]), tracks) is ObstacleClass.UNKNOWN

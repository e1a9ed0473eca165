"""One lidar by itself, and all sensors of the raw channel together: what counts, is kept, and is asked for again."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Lidar, Mount, TrailedImplement, Vehicle
from geometry.pose2 import from_frame, to_frame
from geometry.rectangle import Rectangle
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import LidarScan, RadarScan, UltrasonicRange
from safety.config import SafetyConfig
from safety.obstacle_sources import ObstacleSources, SourceData, is_newer, reachable_box
from safety.pose_history import PoseHistory
from safety.sources.detection_range import nominal_range_m
from safety.sources.ground_filter import Motion, deskew
from safety.sources.lidar import LidarSource, is_same
from safety.zones.footprint import Box, Footprint, footprint_of
from safety.zones.protective_field import SweptField, sweep_field
from tests.safety.safety_world import NO_BYTES, START_NS, healthy

AREA = Box((-12.0, 15.0), (-8.0, 8.0))
STILL = Motion(0.0, 0.0)
SMALL = Footprint((Rectangle(-0.1, 0.1, 0.2),), None, None, 2.9)
POSE = np.array([5.0, -3.0, 0.7])
NOWHERE = np.zeros(3)


@pytest.fixture
def lidar(vehicle: Vehicle) -> Lidar:
    """2 m above base, whose lowest ring falls by 45 degrees."""
    front = vehicle.sensors.lidar["front"]
    return front.model_copy(update={"mount": Mount(xyz_m=(0.0, 0.0, 2.0))})


@pytest.fixture
def source(lidar: Lidar, config: SafetyConfig) -> LidarSource:
    return LidarSource("front", lidar, SMALL, config)


def scan(*base: tuple[float, float, float], stamp_ns: int = START_NS, offset_s: float = 0.0) -> LidarScan:
    """Four returns about each place in base."""
    some = np.array([(x + dx, y, z + dz - 2.0) for x, y, z in base for dx in (0.0, 0.01) for dz in (0.0, 0.01)])
    offsets = np.full(len(some), offset_s, np.float32)
    nothing = np.empty((0, 0), np.uint16)
    return LidarScan(
        stamp_ns, nothing, np.empty(0), np.empty(0), some.reshape(-1, 3).astype(np.float32), NO_BYTES, offsets
    )


def take(
    source: LidarSource, seen: LidarScan, pose: np.ndarray = NOWHERE, motion: Motion = STILL, curvature: float = 0.0
) -> int:
    source.update(seen, pose, motion, curvature, AREA)
    return len(source.hits_odom_m)


def few(seen: LidarScan, stamp_ns: int, count: int) -> LidarScan:
    return LidarScan(stamp_ns, seen.ranges_mm, seen.elevation_rad, seen.azimuth_rad, seen.xyz_m[:count], NO_BYTES,
                     seen.offset_s[:count])  # fmt: skip


def test_an_eye_begins_with_nothing(source: LidarSource, lidar: Lidar, config: SafetyConfig) -> None:
    assert (source.name, source.stamp_ns, source.scan, source.hits_odom_m.shape) == ("front", None, None, (0, 3))
    assert source.nominal_range_m == nominal_range_m(lidar, config.field, config.detection_range) > 0.0
    assert (source.is_frozen, source.detection_range_m(1), source.covers(1), source.covers(-1)) == (
        False,
        0.0,
        False,
        False,
    )
    seen = scan((8.1, 0.1, 1.5))
    take(source, seen)
    assert (source.scan, source.stamp_ns) == (seen, START_NS)


def test_hits_lie_in_odom_as_at_the_stamp(source: LidarSource) -> None:
    seen, motion = scan((8.1, 1.1, 1.5), offset_s=-0.1), Motion(3.0, 0.2)
    assert take(source, seen, POSE, motion) == 4
    base = deskew(np.add(seen.xyz_m, (0.0, 0.0, 2.0)).T.astype(np.float32), seen.offset_s, motion)
    expected = np.column_stack([to_frame(POSE, base[:2].T), base[2]])
    assert source.hits_odom_m == pytest.approx(expected, abs=1e-5)


def test_returns_count_in_the_box_above_the_ground_and_below_the_top(source: LidarSource) -> None:
    for place, counts in (
        ((8.1, 0.1, 3.18), 4), ((8.1, 0.1, 3.205), 0), ((14.98, 0.1, 1.6), 4), ((15.1, 0.1, 1.6), 0),
        ((8.1, 0.1, 0.3), 0), ((0.2, 0.0, 1.6), 0), ((0.3, 0.1, 1.6), 4),
    ):  # fmt: skip
        assert take(source, scan(place)) == counts, place


def test_a_cell_with_few_returns_counts_the_second_time_and_not_of_the_same_scan(source: LidarSource) -> None:
    whole = scan((8.1, 0.1, 1.6))
    first, second, third = (few(whole, START_NS + k, 2) for k in range(3))
    assert [take(source, one) for one in (first, second, second, third)] == [0, 2, 0, 2]
    assert [take(source, few(whole, 9, count)) for count in (3, 1, 3, 3)] == [3, 0, 0, 3]


def test_the_own_trailer_is_masked_by_the_bend_it_is_in(lidar: Lidar, vehicle: Vehicle, config: SafetyConfig) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    for curvature, count in ((0.0, 0), (0.2, 4)):
        source = LidarSource("rear", lidar, footprint_of(vehicle, wagon), config)
        assert take(source, scan((-6.3, 0.2, 1.5)), curvature=curvature) == count, curvature


def test_equal_scans_are_counted_from_the_second_on(source: LidarSource, config: SafetyConfig) -> None:
    whole = scan((8.1, 0.1, 1.6))
    scans = [few(whole, START_NS + k, 3) for k in range(3)]
    states = []
    for one in (scans[0], scans[0], scans[0], scans[1], scans[1], scans[2], few(whole, 9, 2)):
        take(source, one)
        states.append(source.is_frozen)
    assert states == [False] * 5 + [True, False]


def test_a_scan_is_the_same_when_ranges_and_places_are() -> None:
    listed, other = scan((8.0, 0.0, 1.0)), scan((8.1, 0.0, 1.0))
    assert is_same(listed, scan((8.0, 0.0, 1.0), stamp_ns=7))
    assert not is_same(listed, other)
    assert not is_same(listed, None)
    ranges = np.ones((1, 2), np.uint16)
    image, more = (LidarScan(1, one, np.zeros(1), np.zeros(2), np.empty((0, 3), np.float32), NO_BYTES,
                             np.empty(0, np.float32)) for one in (ranges, 2 * ranges))  # fmt: skip
    assert is_same(image, image)
    assert not is_same(image, more)
    assert not is_same(few(listed, 1, 0), few(listed, 2, 0))


@pytest.mark.parametrize(("x", "later_ns", "count"), [
    (4.0, 9_999_999_999, 4), (4.0, 10_000_000_000, 0), (3.85, 1, 0), (3.95, 1, 4), (4.7, 1, 4), (4.8, 1, 0),
])  # fmt: skip
def test_what_went_into_the_hole_is_kept_for_a_time(source: LidarSource, x: float, later_ns: int, count: int) -> None:
    at = np.array([0.0, 0.0, 0.3])
    assert take(source, scan((5.0, 0.0, 0.9)), at) == 4
    hits = source.hits_odom_m
    there = np.array([*to_frame(at, np.array([[x, 0.0]]))[0], 0.3])
    assert take(source, scan(stamp_ns=START_NS + later_ns), there) == count
    assert source.hits_odom_m.tolist() == hits[:count].tolist()


def test_what_is_kept_keeps_its_age_beside_what_is_new(source: LidarSource) -> None:
    take(source, scan((5.0, 0.0, 0.9)))
    old = source.hits_odom_m
    there = np.array([4.0, 0.0, 0.0])
    assert take(source, scan((6.0, 0.0, 1.6), stamp_ns=START_NS + 5_000_000_000), there) == 8
    assert source.hits_odom_m[4:].tolist() == old.tolist()
    assert take(source, scan(stamp_ns=START_NS + 9_000_000_000), there) == 4
    assert take(source, scan(stamp_ns=START_NS + 10_000_000_000), there) == 0


# ---- all together


@pytest.fixture
def sources(full: Vehicle, implement, config: SafetyConfig) -> ObstacleSources:
    return ObstacleSources(full.sensors, footprint_of(full, implement), config)


def odometry(stamp_ns: int = START_NS) -> Odometry:
    return Odometry(stamp_ns, np.eye(4), 3.0, 0.0, 0.0, 0.2, 0.1, np.eye(6))


@pytest.fixture
def pose_history() -> PoseHistory:
    found = PoseHistory()
    found.add(odometry())
    return found


def came(**what: Any) -> SourceData:
    return SourceData(what.get("scans", {}), what.get("radars", {}), what.get("echoes", {}))


def test_there_is_one_sense_each_sensor(sources: ObstacleSources) -> None:
    assert [source.name for source in sources.lidars] == ["front", "rear"]
    assert [radar.name for radar in sources.radars] == ["front"]
    assert [source.name for source in sources.ultrasonics] == ["left", "right", "rear"]
    assert (sources.radars[0]._low_m, sources.radars[0]._high_m, sources.radars[0]._mask_m) == pytest.approx(
        (0.25, 3.2, 0.15)
    )
    sources.set_footprint(SMALL)
    assert all(source.footprint is SMALL for source in sources.lidars)
    assert sources._footprint is SMALL


def test_newer_is_after_the_last() -> None:
    assert [is_newer(5, taken) for taken in (None, 4, 5, 6)] == [True, True, False, False]


def radar_scan(stamp_ns: int, *ranges: float) -> RadarScan:
    some = np.array(ranges)
    return RadarScan(stamp_ns, some, 0 * some, 0 * some, 0 * some - 3.0, 0 * some + 5.0)


def test_what_is_heard_is_news_while_it_is_or_was_in_the_way(
    sources: ObstacleSources, pose_history: PoseHistory
) -> None:
    def update(k: int, radar: tuple[float, ...] | None = None, echo: float | None = None) -> bool:
        stamp_ns = START_NS + k * 50_000_000
        radars = {"front": None if radar is None else radar_scan(stamp_ns, *radar)}
        echoes = {"left": None, "rear": None if echo is None else UltrasonicRange(stamp_ns, echo)}
        return sources.update(came(radars=radars, echoes=echoes), pose_history, odometry())

    assert [update(k, (8.0,)) for k in range(6)] == [False] * 4 + [True] * 2
    assert not update(5, (8.0,))  # not newer
    assert [update(6 + k, ()) for k in range(9)] == [True] * 4 + [False] * 5  # eight cycles are remembered
    assert [update(20 + k, None, 0.3 + 0.15 * k) for k in range(4)] == [False] * 2 + [True] * 2
    assert not update(23, None, 0.3)
    assert update(24, None, math.nan)
    assert not update(23)


def test_news_of_one_is_not_undone_by_another(full: Vehicle, config: SafetyConfig, pose_history: PoseHistory) -> None:
    radar = full.sensors.radar["front"]
    sensors = full.sensors.model_copy(update={"radar": {"front": radar, "rear": radar}})
    for is_radar in (True, False):
        sources = ObstacleSources(sensors, SMALL, config)
        sources.radars[0].hits = np.zeros((5 * is_radar, 4))
        sources.ultrasonics[0].echo_arc_odom_m = np.zeros((7 * (not is_radar), 2))
        radars = {name: radar_scan(START_NS) for name in ("front", "rear")}
        echoes = {name: UltrasonicRange(START_NS, math.nan) for name in ("left", "right")}
        assert sources.update(came(radars=radars, echoes=echoes), pose_history, odometry()), is_radar


def test_what_is_heard_lies_where_the_machine_was(sources: ObstacleSources, pose_history: PoseHistory) -> None:
    asked: list[int] = []
    where: Any = SimpleNamespace(pose_at=lambda stamp_ns: asked.append(stamp_ns) or POSE)
    for k in range(5):
        stamp_ns = START_NS + k
        sources.update(came(radars={"front": radar_scan(stamp_ns, 8.0)},
                         echoes={"left": UltrasonicRange(stamp_ns, 2.0)}), where, odometry())  # fmt: skip
    assert asked == [START_NS + k for k in range(5) for _ in range(2)]
    assert sources.radars[0].hits[0, :2] == pytest.approx(to_frame(POSE, np.array([[11.5, 0.0]]))[0])
    assert sources.ultrasonics[0].echo_arc_odom_m[3] == pytest.approx(to_frame(POSE, np.array([[5.5, 0.6]]))[0])


def test_fresh_are_those_with_a_newer_scan(sources: ObstacleSources) -> None:
    front, rear = sources.lidars
    scans = {"front": scan(), "rear": None}
    assert sources.with_new_scan(came(scans=scans)) == [front]
    front.stamp_ns, rear.stamp_ns = START_NS, START_NS - 1
    assert sources.with_new_scan(came(scans=scans)) == []
    assert sources.with_new_scan(came(scans={"front": scan(), "rear": scan()})) == [rear]


def test_for_another_way_the_last_scan_is_taken_again(sources: ObstacleSources) -> None:
    taken: list[Any] = []
    where: Any = SimpleNamespace(pose_at=lambda stamp_ns: stamp_ns)
    for source in sources.lidars:
        one: Any = source
        one.update = lambda *args, name=source.name: taken.append((name, *args))
    front, rear = sources.lidars
    fresh, last = scan(stamp_ns=7), scan(stamp_ns=6)
    rear.scan = last
    rest = (Motion(3.0, 0.2), 0.1, AREA)
    for is_new_field, expected in ((False, []), (True, [("rear", last, 6, *rest)])):
        taken.clear()
        sources.update_lidars(
            came(scans={"front": fresh, "rear": None}), [front], where, odometry(), AREA, is_new_field
        )
        assert taken == [("front", fresh, 7, *rest), *expected]
    rear.scan = None
    taken.clear()
    sources.update_lidars(came(scans={"front": None, "rear": None}), [], where, odometry(), AREA, True)
    assert taken == []


@pytest.fixture
def way(full: Vehicle, implement, config: SafetyConfig) -> SweptField:
    return sweep_field(None, None, 0.0, 1, 20.0, 8.0, footprint_of(full, implement), config.field)


def odom_of(*base: tuple[float, ...]) -> np.ndarray:
    some = np.array(base)
    return np.column_stack([to_frame(POSE, some[:, :2]), some[:, 2:]])


def gap_of(sources: ObstacleSources, way: SweptField, speed_mps: float = 1.0, **how: Any) -> Any:
    return sources.clearance(way, POSE, speed_mps, how.get("is_known"), how.get("tracks"))


def test_before_any_lidar_has_looked_no_gap_is_known(sources: ObstacleSources, way: SweptField) -> None:
    assert gap_of(sources, way) is None
    sources.lidars[1].stamp_ns = START_NS
    found = gap_of(sources, way)
    assert (found.main_m, found.arc_m, found.triggering_points_base_m.shape) == (math.inf, math.inf, (0, 3))


def test_hits_of_lidars_and_radars_make_one_gap(sources: ObstacleSources, way: SweptField) -> None:
    front, rear = sources.lidars
    front.stamp_ns = START_NS
    front.hits_odom_m, rear.hits_odom_m = odom_of((12.0, 1.0, 1.5), (12.0, 30.0, 1.0)), odom_of((14.0, 0.0, 0.5))
    found = gap_of(sources, way)
    assert found.main_m == pytest.approx(8.5)
    assert sorted(found.triggering_points_base_m[:, 2].tolist()) == [0.5, 1.5]
    sources.radars[0].hits = odom_of((10.0, 0.0, 0.7, 0.1))
    assert gap_of(sources, way).main_m == pytest.approx(6.5)
    for y in (3.35 - 0.2 - 0.01, 3.35 - 0.2 + 0.01):  # a bearing of 0.1 m, twice
        sources.radars[0].hits = odom_of((6.0, y, 0.7, 0.1))
        assert (gap_of(sources, way).main_m < 8.0) == (y < 3.15), y

    def is_known(points: np.ndarray) -> np.ndarray:
        return from_frame(POSE, points)[:, 0] < 13.0

    sources.radars[0].hits = odom_of((10.0, 0.0, 0.7, 0.1))
    assert gap_of(sources, way, is_known=is_known).main_m == pytest.approx(10.5)
    assert gap_of(sources, way, is_known=lambda points: np.ones(len(points), bool)).main_m == math.inf


def test_points_in_one_square_are_thinned(sources: ObstacleSources, way: SweptField) -> None:
    sources.lidars[0].stamp_ns = START_NS
    x, y = 0.05 * 400 + 0.01, 0.01
    sources.lidars[0].hits_odom_m = np.array([(x, y, 1.0), (x + 0.02, y, 2.0), (x + 0.05, y, 3.0)])
    found = sources.clearance(way, np.array([10.0, 0.0, 0.0]), 9.0, None, None)
    assert found is not None
    assert found.triggering_points_base_m[:, 2].tolist() == [1.0, 3.0]


def arc(*base: tuple[float, float]) -> np.ndarray:
    return to_frame(POSE, np.array(base))


IN_WAY = [(7.0, 0.1 * k) for k in range(10)]


def test_an_arc_counts_when_four_fifths_of_it_lie_in_the_way(sources: ObstacleSources, way: SweptField) -> None:
    sources.lidars[0].stamp_ns = START_NS
    source = sources.ultrasonics[0]
    for beside, main_m in ((0, 3.5), (2, 3.5), (3, math.inf), (10, math.inf)):
        source.echo_arc_odom_m = arc(*IN_WAY[beside:], *[(7.0, 4.0)] * beside)
        found = gap_of(sources, way)
        assert found.main_m == pytest.approx(main_m), beside
        assert set(found.triggering_points_base_m[:, 2].tolist()) == ({0.25} if main_m < 9.0 else set())
        assert len(found.triggering_points_base_m) == (10 - beside if main_m < 9.0 else 0)
    source.echo_arc_odom_m = arc(*[(60.0, 0.0)] * 10)
    assert gap_of(sources, way).main_m == math.inf


def test_an_arc_counts_while_slow_unexplained_and_unanswered(
    sources: ObstacleSources, way: SweptField, config: SafetyConfig
) -> None:
    sources.lidars[0].stamp_ns = START_NS
    sources.ultrasonics[2].echo_arc_odom_m = arc(*IN_WAY)
    most_mps = config.ultrasonic.max_speed_kmh / 3.6
    assert gap_of(sources, way, most_mps).main_m == pytest.approx(3.5)
    assert gap_of(sources, way, most_mps + 1e-6).main_m == math.inf

    def explained(count: int) -> Any:
        return lambda points: np.arange(len(points)) < count

    assert gap_of(sources, way, is_known=explained(0)).main_m == pytest.approx(3.5)
    assert gap_of(sources, way, is_known=explained(1)).main_m == math.inf
    for away, main_m in ((0.29, math.inf), (0.31, 3.5)):
        place = np.array([*to_frame(POSE, np.array([[7.0, -0.05 - away]]))[0], 0.5])
        post = Track(1, ObstacleClass.POLE, 0.9, place, np.zeros(3), np.eye(4), np.array([0.1, 0.1, 1.0]), 0.7, 0, 1,
                     True, ("lidar_front",))  # fmt: skip
        assert gap_of(sources, way, tracks=Tracks(START_NS, (post,))).main_m == pytest.approx(main_m), away
    sources.ultrasonics[0].echo_arc_odom_m = arc(*[(6.0, 0.1 * k) for k in range(7)])
    assert gap_of(sources, way).main_m == pytest.approx(2.5)


def test_lidars_that_look_there_and_are_not_silent_prove(sources: ObstacleSources) -> None:
    front, rear = sources.lidars
    front._detection_range_m, rear._detection_range_m = {1: 40.0}, {-1: 20.0}
    now_ns = START_NS + 10_000_000_000
    assert sources.detection_range_m(now_ns, 1, {}) == {}
    front.stamp_ns = rear.stamp_ns = now_ns
    assert sources.detection_range_m(now_ns, 1, {}) == {"lidar/front": 40.0}
    assert sources.detection_range_m(now_ns, -1, {}) == {"lidar/rear": 20.0}
    half = math.radians(30.0)
    for edge, detection_range in ((half - 0.01, 0.0), (half + 0.01, 30.0)):
        said = SimpleNamespace(
            sector_edges_rad=np.array([-math.pi, edge, 3.0]), detection_range_m=np.array([30.0, 0.0])
        )
        health: Any = {"lidar_front": said, "lidar_rear": healthy(now_ns, "lidar_rear")}
        assert sources.detection_range_m(now_ns, 1, health) == {"lidar/front": detection_range}, edge
    for age_ns, proves in ((350_000_000, True), (350_000_001, False)):
        front.stamp_ns = now_ns - age_ns
        assert (sources.detection_range_m(now_ns, 1, {}) != {}) == proves, age_ns


def test_the_touched_box_is_wider_by_a_step_and_two_squares(way: SweptField) -> None:
    def way_of(step_m: float, arc_step_m: float | None = None) -> Any:
        arc = None if arc_step_m is None else SimpleNamespace(box=Box((0.0, 1.0), (0.0, 1.0)), step_m=arc_step_m)
        return SimpleNamespace(main=SimpleNamespace(box=Box((-1.0, 5.0), (-2.0, 9.0)), step_m=step_m), arc=arc)

    for laid in (way_of(0.4), way_of(0.4, 0.1), way_of(0.1, 0.4)):
        found = reachable_box(laid)
        assert (*found.x_m, *found.y_m) == pytest.approx((-1.5, 5.5, -2.5, 9.5))

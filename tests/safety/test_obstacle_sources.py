"""One lidar by itself, and all sensors of the raw channel together: what counts, is kept, and is asked for again."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Lidar, Mount, TrailedImplement, Vehicle
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import LidarScan, RadarScan, UltrasonicRange
from safety.config import SafetyConfig
from safety.obstacle_sources import Measurements, Senses, is_newer, touched_box
from safety.pose_history import Trail, from_frame, to_frame
from safety.sources.detection_range import reach_m
from safety.sources.ground_filter import Box, Motion, deskew
from safety.sources.lidar import Eye, is_same
from safety.zones.footprint import Rectangle, Shape, shape_of
from safety.zones.protective_field import Way, way_ahead
from tests.safety.safety_world import NO_BYTES, START_NS, healthy

AREA = Box((-12.0, 15.0), (-8.0, 8.0))
STILL = Motion(0.0, 0.0)
SMALL = Shape((Rectangle(-0.1, 0.1, 0.1),), None, None, 2.9)
POSE = np.array([5.0, -3.0, 0.7])
NOWHERE = np.zeros(3)


@pytest.fixture
def lidar(vehicle: Vehicle) -> Lidar:
    """2 m above base, whose lowest ring falls by 45 degrees."""
    front = vehicle.sensors.lidar["front"]
    return front.model_copy(update={"mount": Mount(xyz_m=(0.0, 0.0, 2.0))})


@pytest.fixture
def eye(lidar: Lidar, config: SafetyConfig) -> Eye:
    return Eye("front", lidar, SMALL, config)


def scan(*base: tuple[float, float, float], stamp_ns: int = START_NS, offset_s: float = 0.0) -> LidarScan:
    """Four returns about each place in base."""
    some = np.array([(x + dx, y, z + dz - 2.0) for x, y, z in base for dx in (0.0, 0.01) for dz in (0.0, 0.01)])
    offsets = np.full(len(some), offset_s, np.float32)
    nothing = np.empty((0, 0), np.uint16)
    return LidarScan(
        stamp_ns, nothing, np.empty(0), np.empty(0), some.reshape(-1, 3).astype(np.float32), NO_BYTES, offsets
    )


def take(eye: Eye, seen: LidarScan, pose: np.ndarray = NOWHERE, motion: Motion = STILL, curvature: float = 0.0) -> int:
    eye.take(seen, pose, motion, curvature, AREA)
    return len(eye.hits_odom_m)


def few(seen: LidarScan, stamp_ns: int, count: int) -> LidarScan:
    return LidarScan(stamp_ns, seen.ranges_mm, seen.elevation_rad, seen.azimuth_rad, seen.xyz_m[:count], NO_BYTES,
                     seen.offset_s[:count])  # fmt: skip


def test_an_eye_begins_with_nothing(eye: Eye, lidar: Lidar, config: SafetyConfig) -> None:
    assert (eye.name, eye.stamp_ns, eye.scan, eye.hits_odom_m.shape) == ("front", None, None, (0, 3))
    assert eye.reach_m == reach_m(lidar, config.field, config.proven) > 0.0
    assert (eye.is_frozen, eye.proven_m(1), eye.looks(1), eye.looks(-1)) == (False, 0.0, False, False)
    seen = scan((8.1, 0.1, 1.5))
    take(eye, seen)
    assert (eye.scan, eye.stamp_ns) == (seen, START_NS)


def test_hits_lie_in_odom_as_at_the_stamp(eye: Eye) -> None:
    seen, motion = scan((8.1, 1.1, 1.5), offset_s=-0.1), Motion(3.0, 0.2)
    assert take(eye, seen, POSE, motion) == 4
    base = deskew(np.add(seen.xyz_m, (0.0, 0.0, 2.0)).T.astype(np.float32), seen.offset_s, motion)
    expected = np.column_stack([to_frame(POSE, base[:2].T), base[2]])
    assert eye.hits_odom_m == pytest.approx(expected, abs=1e-5)


def test_returns_count_in_the_box_above_the_ground_and_below_the_top(eye: Eye) -> None:
    for place, counts in (
        ((8.1, 0.1, 3.18), 4), ((8.1, 0.1, 3.205), 0), ((14.98, 0.1, 1.6), 4), ((15.1, 0.1, 1.6), 0),
        ((8.1, 0.1, 0.3), 0), ((0.2, 0.0, 1.6), 0), ((0.3, 0.1, 1.6), 4),
    ):  # fmt: skip
        assert take(eye, scan(place)) == counts, place


def test_a_cell_with_few_returns_counts_the_second_time_and_not_of_the_same_scan(eye: Eye) -> None:
    whole = scan((8.1, 0.1, 1.6))
    first, second, third = (few(whole, START_NS + k, 2) for k in range(3))
    assert [take(eye, one) for one in (first, second, second, third)] == [0, 2, 0, 2]
    assert [take(eye, few(whole, 9, count)) for count in (3, 1, 3, 3)] == [3, 0, 0, 3]


def test_the_own_trailer_is_masked_by_the_bend_it_is_in(lidar: Lidar, vehicle: Vehicle, config: SafetyConfig) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    for curvature, count in ((0.0, 0), (0.2, 4)):
        eye = Eye("rear", lidar, shape_of(vehicle, wagon), config)
        assert take(eye, scan((-6.3, 0.2, 1.5)), curvature=curvature) == count, curvature


def test_equal_scans_are_counted_from_the_second_on(eye: Eye, config: SafetyConfig) -> None:
    whole = scan((8.1, 0.1, 1.6))
    scans = [few(whole, START_NS + k, 3) for k in range(3)]
    states = []
    for one in (scans[0], scans[0], scans[0], scans[1], scans[1], scans[2], few(whole, 9, 2)):
        take(eye, one)
        states.append(eye.is_frozen)
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
def test_what_went_into_the_hole_is_kept_for_a_time(eye: Eye, x: float, later_ns: int, count: int) -> None:
    at = np.array([0.0, 0.0, 0.3])
    assert take(eye, scan((5.0, 0.0, 0.9)), at) == 4
    hits = eye.hits_odom_m
    there = np.array([*to_frame(at, np.array([[x, 0.0]]))[0], 0.3])
    assert take(eye, scan(stamp_ns=START_NS + later_ns), there) == count
    assert eye.hits_odom_m.tolist() == hits[:count].tolist()


def test_what_is_kept_keeps_its_age_beside_what_is_new(eye: Eye) -> None:
    take(eye, scan((5.0, 0.0, 0.9)))
    old = eye.hits_odom_m
    there = np.array([4.0, 0.0, 0.0])
    assert take(eye, scan((6.0, 0.0, 1.6), stamp_ns=START_NS + 5_000_000_000), there) == 8
    assert eye.hits_odom_m[4:].tolist() == old.tolist()
    assert take(eye, scan(stamp_ns=START_NS + 9_000_000_000), there) == 4
    assert take(eye, scan(stamp_ns=START_NS + 10_000_000_000), there) == 0


# ---- all together


@pytest.fixture
def senses(full: Vehicle, implement, config: SafetyConfig) -> Senses:
    return Senses(full.sensors, shape_of(full, implement), config)


def odometry(stamp_ns: int = START_NS) -> Odometry:
    return Odometry(stamp_ns, np.eye(4), 3.0, 0.0, 0.0, 0.2, 0.1, np.eye(6))


@pytest.fixture
def trail() -> Trail:
    found = Trail()
    found.add(odometry())
    return found


def came(**what: Any) -> Measurements:
    return Measurements(what.get("scans", {}), what.get("radars", {}), what.get("echoes", {}))


def test_there_is_one_sense_each_sensor(senses: Senses) -> None:
    assert [eye.name for eye in senses.eyes] == ["front", "rear"]
    assert [radar.name for radar in senses.radars] == ["front"]
    assert [ear.name for ear in senses.ears] == ["left", "right", "rear"]
    assert (senses.radars[0]._low_m, senses.radars[0]._high_m, senses.radars[0]._mask_m) == pytest.approx(
        (0.25, 3.2, 0.15)
    )
    senses.wear(SMALL)
    assert all(eye.shape is SMALL for eye in senses.eyes)
    assert senses._shape is SMALL


def test_newer_is_after_the_last() -> None:
    assert [is_newer(5, taken) for taken in (None, 4, 5, 6)] == [True, True, False, False]


def radar_scan(stamp_ns: int, *ranges: float) -> RadarScan:
    some = np.array(ranges)
    return RadarScan(stamp_ns, some, 0 * some, 0 * some, 0 * some - 3.0, 0 * some + 5.0)


def test_what_is_heard_is_news_while_it_is_or_was_in_the_way(senses: Senses, trail: Trail) -> None:
    def hear(k: int, radar: tuple[float, ...] | None = None, echo: float | None = None) -> bool:
        stamp_ns = START_NS + k * 50_000_000
        radars = {"front": None if radar is None else radar_scan(stamp_ns, *radar)}
        echoes = {"left": None, "rear": None if echo is None else UltrasonicRange(stamp_ns, echo)}
        return senses.hear(came(radars=radars, echoes=echoes), trail, odometry())

    assert [hear(k, (8.0,)) for k in range(6)] == [False] * 4 + [True] * 2
    assert not hear(5, (8.0,))  # not newer
    assert [hear(6 + k, ()) for k in range(9)] == [True] * 4 + [False] * 5  # eight cycles are remembered
    assert [hear(20 + k, None, 0.3 + 0.15 * k) for k in range(4)] == [False] * 2 + [True] * 2
    assert not hear(23, None, 0.3)
    assert hear(24, None, math.nan)
    assert not hear(23)


def test_news_of_one_is_not_undone_by_another(full: Vehicle, config: SafetyConfig, trail: Trail) -> None:
    radar = full.sensors.radar["front"]
    sensors = full.sensors.model_copy(update={"radar": {"front": radar, "rear": radar}})
    for is_radar in (True, False):
        senses = Senses(sensors, SMALL, config)
        senses.radars[0].hits = np.zeros((5 * is_radar, 4))
        senses.ears[0].arc_odom_m = np.zeros((7 * (not is_radar), 2))
        radars = {name: radar_scan(START_NS) for name in ("front", "rear")}
        echoes = {name: UltrasonicRange(START_NS, math.nan) for name in ("left", "right")}
        assert senses.hear(came(radars=radars, echoes=echoes), trail, odometry()), is_radar


def test_what_is_heard_lies_where_the_machine_was(senses: Senses, trail: Trail) -> None:
    asked: list[int] = []
    where: Any = SimpleNamespace(pose_at=lambda stamp_ns: asked.append(stamp_ns) or POSE)
    for k in range(5):
        stamp_ns = START_NS + k
        senses.hear(came(radars={"front": radar_scan(stamp_ns, 8.0)},
                         echoes={"left": UltrasonicRange(stamp_ns, 2.0)}), where, odometry())  # fmt: skip
    assert asked == [START_NS + k for k in range(5) for _ in range(2)]
    assert senses.radars[0].hits[0, :2] == pytest.approx(to_frame(POSE, np.array([[11.5, 0.0]]))[0])
    assert senses.ears[0].arc_odom_m[3] == pytest.approx(to_frame(POSE, np.array([[5.5, 0.6]]))[0])


def test_fresh_are_those_with_a_newer_scan(senses: Senses) -> None:
    front, rear = senses.eyes
    scans = {"front": scan(), "rear": None}
    assert senses.fresh(came(scans=scans)) == [front]
    front.stamp_ns, rear.stamp_ns = START_NS, START_NS - 1
    assert senses.fresh(came(scans=scans)) == []
    assert senses.fresh(came(scans={"front": scan(), "rear": scan()})) == [rear]


def test_for_another_way_the_last_scan_is_taken_again(senses: Senses) -> None:
    taken: list[Any] = []
    where: Any = SimpleNamespace(pose_at=lambda stamp_ns: stamp_ns)
    for eye in senses.eyes:
        one: Any = eye
        one.take = lambda *args, name=eye.name: taken.append((name, *args))
    front, rear = senses.eyes
    fresh, last = scan(stamp_ns=7), scan(stamp_ns=6)
    rear.scan = last
    rest = (Motion(3.0, 0.2), 0.1, AREA)
    for is_other_way, expected in ((False, []), (True, [("rear", last, 6, *rest)])):
        taken.clear()
        senses.scan(came(scans={"front": fresh, "rear": None}), [front], where, odometry(), AREA, is_other_way)
        assert taken == [("front", fresh, 7, *rest), *expected]
    rear.scan = None
    taken.clear()
    senses.scan(came(scans={"front": None, "rear": None}), [], where, odometry(), AREA, True)
    assert taken == []


@pytest.fixture
def way(full: Vehicle, implement, config: SafetyConfig) -> Way:
    return way_ahead(None, None, 0.0, 1, 20.0, 8.0, shape_of(full, implement), config.field)


def odom_of(*base: tuple[float, ...]) -> np.ndarray:
    some = np.array(base)
    return np.column_stack([to_frame(POSE, some[:, :2]), some[:, 2:]])


def gap_of(senses: Senses, way: Way, speed_mps: float = 1.0, **how: Any) -> Any:
    return senses.gap(way, POSE, speed_mps, how.get("is_explained"), how.get("tracks"))


def test_before_any_lidar_has_looked_no_gap_is_known(senses: Senses, way: Way) -> None:
    assert gap_of(senses, way) is None
    senses.eyes[1].stamp_ns = START_NS
    found = gap_of(senses, way)
    assert (found.main_m, found.arc_m, found.triggering_points_base_m.shape) == (math.inf, math.inf, (0, 3))


def test_hits_of_lidars_and_radars_make_one_gap(senses: Senses, way: Way) -> None:
    front, rear = senses.eyes
    front.stamp_ns = START_NS
    front.hits_odom_m, rear.hits_odom_m = odom_of((12.0, 1.0, 1.5), (12.0, 30.0, 1.0)), odom_of((14.0, 0.0, 0.5))
    found = gap_of(senses, way)
    assert found.main_m == pytest.approx(8.5)
    assert sorted(found.triggering_points_base_m[:, 2].tolist()) == [0.5, 1.5]
    senses.radars[0].hits = odom_of((10.0, 0.0, 0.7, 0.1))
    assert gap_of(senses, way).main_m == pytest.approx(6.5)
    for y in (3.35 - 0.2 - 0.01, 3.35 - 0.2 + 0.01):  # a bearing of 0.1 m, twice
        senses.radars[0].hits = odom_of((6.0, y, 0.7, 0.1))
        assert (gap_of(senses, way).main_m < 8.0) == (y < 3.15), y

    def is_explained(points: np.ndarray) -> np.ndarray:
        return from_frame(POSE, points)[:, 0] < 13.0

    senses.radars[0].hits = odom_of((10.0, 0.0, 0.7, 0.1))
    assert gap_of(senses, way, is_explained=is_explained).main_m == pytest.approx(10.5)
    assert gap_of(senses, way, is_explained=lambda points: np.ones(len(points), bool)).main_m == math.inf


def test_points_in_one_square_are_thinned(senses: Senses, way: Way) -> None:
    senses.eyes[0].stamp_ns = START_NS
    x, y = 0.05 * 400 + 0.01, 0.01
    senses.eyes[0].hits_odom_m = np.array([(x, y, 1.0), (x + 0.02, y, 2.0), (x + 0.05, y, 3.0)])
    found = senses.gap(way, np.array([10.0, 0.0, 0.0]), 9.0, None, None)
    assert found is not None
    assert found.triggering_points_base_m[:, 2].tolist() == [1.0, 3.0]


def arc(*base: tuple[float, float]) -> np.ndarray:
    return to_frame(POSE, np.array(base))


IN_WAY = [(7.0, 0.1 * k) for k in range(10)]


def test_an_arc_counts_when_four_fifths_of_it_lie_in_the_way(senses: Senses, way: Way) -> None:
    senses.eyes[0].stamp_ns = START_NS
    ear = senses.ears[0]
    for beside, main_m in ((0, 3.5), (2, 3.5), (3, math.inf), (10, math.inf)):
        ear.arc_odom_m = arc(*IN_WAY[beside:], *[(7.0, 4.0)] * beside)
        found = gap_of(senses, way)
        assert found.main_m == pytest.approx(main_m), beside
        assert set(found.triggering_points_base_m[:, 2].tolist()) == ({0.25} if main_m < 9.0 else set())
        assert len(found.triggering_points_base_m) == (10 - beside if main_m < 9.0 else 0)
    ear.arc_odom_m = arc(*[(60.0, 0.0)] * 10)
    assert gap_of(senses, way).main_m == math.inf


def test_an_arc_counts_while_slow_unexplained_and_unanswered(senses: Senses, way: Way, config: SafetyConfig) -> None:
    senses.eyes[0].stamp_ns = START_NS
    senses.ears[2].arc_odom_m = arc(*IN_WAY)
    most_mps = config.ultrasonic.most_kmh / 3.6
    assert gap_of(senses, way, most_mps).main_m == pytest.approx(3.5)
    assert gap_of(senses, way, most_mps + 1e-6).main_m == math.inf

    def explained(count: int) -> Any:
        return lambda points: np.arange(len(points)) < count

    assert gap_of(senses, way, is_explained=explained(0)).main_m == pytest.approx(3.5)
    assert gap_of(senses, way, is_explained=explained(1)).main_m == math.inf
    for away, main_m in ((0.29, math.inf), (0.31, 3.5)):
        place = np.array([*to_frame(POSE, np.array([[7.0, -0.05 - away]]))[0], 0.5])
        post = Track(1, ObstacleClass.POLE, 0.9, place, np.zeros(3), np.eye(4), np.array([0.1, 0.1, 1.0]), 0.7, 0, 1,
                     True, ("lidar_front",))  # fmt: skip
        assert gap_of(senses, way, tracks=Tracks(START_NS, (post,))).main_m == pytest.approx(main_m), away
    senses.ears[0].arc_odom_m = arc(*[(6.0, 0.1 * k) for k in range(7)])
    assert gap_of(senses, way).main_m == pytest.approx(2.5)


def test_lidars_that_look_there_and_are_not_silent_prove(senses: Senses) -> None:
    front, rear = senses.eyes
    front._proven_m, rear._proven_m = {1: 40.0}, {-1: 20.0}
    now_ns = START_NS + 10_000_000_000
    assert senses.proven_m(now_ns, 1, {}) == {}
    front.stamp_ns = rear.stamp_ns = now_ns
    assert senses.proven_m(now_ns, 1, {}) == {"lidar/front": 40.0}
    assert senses.proven_m(now_ns, -1, {}) == {"lidar/rear": 20.0}
    half = math.radians(30.0)
    for edge, proven in ((half - 0.01, 0.0), (half + 0.01, 30.0)):
        said = SimpleNamespace(
            sector_edges_rad=np.array([-math.pi, edge, 3.0]), detection_range_m=np.array([30.0, 0.0])
        )
        health: Any = {"lidar_front": said, "lidar_rear": healthy(now_ns, "lidar_rear")}
        assert senses.proven_m(now_ns, 1, health) == {"lidar/front": proven}, edge
    for age_ns, proves in ((350_000_000, True), (350_000_001, False)):
        front.stamp_ns = now_ns - age_ns
        assert (senses.proven_m(now_ns, 1, {}) != {}) == proves, age_ns


def test_the_touched_box_is_wider_by_a_step_and_two_squares(way: Way) -> None:
    def way_of(step_m: float, arc_step_m: float | None = None) -> Any:
        arc = None if arc_step_m is None else SimpleNamespace(box=Box((0.0, 1.0), (0.0, 1.0)), step_m=arc_step_m)
        return SimpleNamespace(main=SimpleNamespace(box=Box((-1.0, 5.0), (-2.0, 9.0)), step_m=step_m), arc=arc)

    for laid in (way_of(0.4), way_of(0.4, 0.1), way_of(0.1, 0.4)):
        found = touched_box(laid)
        assert (*found.x_m, *found.y_m) == pytest.approx((-1.5, 5.5, -2.5, 9.5))

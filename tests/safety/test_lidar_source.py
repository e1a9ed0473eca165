"""Lidar source: hits, hold in the blind zone, detection range, frozen scans."""

from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import Lidar, Mount, TrailedImplement, Vehicle
from geometry.pose2 import to_frame
from geometry.rectangle import Rectangle
from messages.sensors import LidarScan
from safety.config import SafetyConfig
from safety.sources.detection_range import (
    nominal_range_m,
)
from safety.sources.ground_filter import Motion, deskew
from safety.sources.lidar import LidarSource, content_of
from safety.zones.footprint import Box as Area
from safety.zones.footprint import Footprint, footprint_of
from tests.clause import clause
from tests.safety.safety_world import NO_BYTES, START_NS, Box, scan_of

STILL = Motion(0.0, 0.0)


def front(vehicle: Vehicle) -> Lidar:
    return vehicle.sensors.lidar["front"]


def lidar_source(vehicle: Vehicle, implement, config: SafetyConfig, name: str = "front") -> LidarSource:
    return LidarSource(name, vehicle.sensors.lidar[name], footprint_of(vehicle, implement), config)


def take(
    source: LidarSource, lidar: Lidar, boxes: tuple[Box, ...] = (), stamp_ns: int = START_NS, seed: int = 1, **changes
) -> LidarScan:
    scan = scan_of(lidar, stamp_ns, (0.0, 0.0, 0.0), boxes, np.random.default_rng(seed))
    scan = replace(scan, **{k: v(scan) for k, v in changes.items()})
    source.update(scan, np.zeros(3), STILL, 0.0, Area((-12.0, 15.0), (-8.0, 8.0)))
    return scan


def test_full_detection_range(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    for name, direction in (("front", 1), ("rear", -1)):
        source = lidar_source(vehicle, implement, config, name)
        assert source.detection_range_m(direction) == 0.0
        take(source, vehicle.sensors.lidar[name])
        assert source.detection_range_m(direction) == source.nominal_range_m
        assert source.detection_range_m(-direction) == 0.0


def dark(share: float, columns: slice = slice(None)):
    """Removes a ratio of the returns of some columns."""

    def blank(scan: LidarScan) -> np.ndarray:
        ranges = scan.ranges_mm.copy()
        gone = np.random.default_rng(3).random(ranges.shape) < share
        ranges[:, columns][gone[:, columns]] = 0
        return ranges

    return blank


def test_detection_range_with_fewer_returns(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    detection_range = []
    for share in (0.0, 0.3, 0.5, 0.6, 0.7, 0.9, 1.0):
        source = lidar_source(vehicle, implement, config)
        take(source, front(vehicle), ranges_mm=dark(share))
        detection_range.append(source.detection_range_m(1))
    assert detection_range == sorted(detection_range, reverse=True)
    assert detection_range[0] == source.nominal_range_m
    assert detection_range[-2:] == [0.0, 0.0]


def test_blind_sector_ahead(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    middle, aside = slice(512, 597), slice(700, 785)
    for columns, expected in ((middle, 0.0), (aside, 40.0)):
        source = lidar_source(vehicle, implement, config)
        take(source, front(vehicle), ranges_mm=dark(1.0, columns))
        assert source.detection_range_m(1) == expected


def test_frozen_lidar_range(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    source = lidar_source(vehicle, implement, config)
    for k in range(5):
        take(source, front(vehicle), stamp_ns=START_NS + k * 100_000_000)
        assert source.is_frozen == (k >= config.detection_range.frozen_scans)
        assert (source.detection_range_m(1) == 0.0) == source.is_frozen
    take(source, front(vehicle), seed=2, stamp_ns=START_NS + 1_000_000_000)
    assert not source.is_frozen
    empty = replace(source.scan, ranges_mm=np.empty((0, 0), np.uint16))
    assert content_of(empty) is None


def test_replayed_scans_are_frozen(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    source = lidar_source(vehicle, implement, config)
    for k in range(20):
        take(source, front(vehicle), seed=k % 8, stamp_ns=START_NS + k * 100_000_000)
        assert source.is_frozen == (k >= 8 + config.detection_range.frozen_scans - 1), k
    take(source, front(vehicle), seed=9, stamp_ns=START_NS + 3_000_000_000)
    assert not source.is_frozen


def test_memory_of_repeated_scans_ends(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    short = config.detection_range.model_copy(update={"repeat_memory_scans": 7})
    source = lidar_source(vehicle, implement, config.model_copy(update={"detection_range": short}))
    for k in range(20):
        take(source, front(vehicle), seed=k % 8, stamp_ns=START_NS + k * 100_000_000)
        assert not source.is_frozen


def test_empty_scans_are_not_frozen(source: LidarSource, config: SafetyConfig) -> None:
    whole = scan((8.1, 0.1, 1.6))
    for k in range(5):
        process(source, few(whole, START_NS + k, 0))
        assert not source.is_frozen


def test_person_hits_and_blind_zone_hold(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    """An object 0.4 m high enters the blind zone before the bumper: held until an operator confirms that it left."""
    source, lidar = lidar_source(vehicle, implement, config), front(vehicle)
    thing = (Box(5.4, 0.0, (0.4, 0.4, 0.4)),)
    take(source, lidar, thing)
    seen = len(source.hits_odom_m)
    assert seen > 3

    def nearer(stamp_ns: int) -> int:
        scan = scan_of(lidar, stamp_ns, (1.2, 0.0, 0.0), (), np.random.default_rng(2))
        source.update(scan, np.array([1.2, 0.0, 0.0]), STILL, 0.0, Area((-5.0, 15.0), (-8.0, 8.0)))
        return len(source.hits_odom_m)

    hole_ns = round(config.field.blind_zone_hold_s * 1e9)
    assert nearer(START_NS + 100_000_000) > 0
    assert nearer(START_NS + 60 * hole_ns) > 0
    source.forget_held()
    assert len(source.hits_odom_m) == 0
    assert nearer(START_NS + 61 * hole_ns) == 0


def test_hit_outside_blind_zone_dropped(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    source = lidar_source(vehicle, implement, config)
    take(source, front(vehicle), (Box(9.0, 0.0),))
    assert len(source.hits_odom_m) > 20
    take(source, front(vehicle), (), START_NS + 100_000_000)
    assert len(source.hits_odom_m) == 0


def test_dust(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    """2 000 returns per scan at random positions within 40 m and 4 m of height: none is confirmed in 50 scans."""
    source = lidar_source(vehicle, implement, config)
    rng, hits = np.random.default_rng(5), 0

    def dusty(scan: LidarScan) -> np.ndarray:
        air = rng.uniform((-40.0, -40.0, -2.0), (40.0, 40.0, 2.0), (2000, 3))
        return np.concatenate([scan.points_m, air]).astype(np.float32)

    for k in range(50):
        nothing = {"ranges_mm": lambda _: np.empty((0, 0), np.uint16)}
        take(source, front(vehicle), (), START_NS + k * 100_000_000, k, xyz_m=dusty, **nothing)
        hits += len(source.hits_odom_m) > 0
    assert hits == 0


AREA = Area((-12.0, 15.0), (-8.0, 8.0))

SMALL = Footprint((Rectangle(-0.1, 0.1, 0.2),), None, None, 2.9)

POSE = np.array([5.0, -3.0, 0.7])

NOWHERE = np.zeros(3)


@pytest.fixture
def lidar(vehicle: Vehicle) -> Lidar:
    """Lidar 2 m above base with a lowest ring at -45 degrees."""
    front = vehicle.sensors.lidar["front"]
    return front.model_copy(update={"mount": Mount(xyz_m=(0.0, 0.0, 2.0))})


@pytest.fixture
def source(lidar: Lidar, config: SafetyConfig) -> LidarSource:
    return LidarSource("front", lidar, SMALL, config)


def scan(*base: tuple[float, float, float], stamp_ns: int = START_NS, offset_s: float = 0.0) -> LidarScan:
    """Four returns about each position in base."""
    some = np.array([(x + dx, y, z + dz - 2.0) for x, y, z in base for dx in (0.0, 0.01) for dz in (0.0, 0.01)])
    offsets = np.full(len(some), offset_s, np.float32)
    nothing = np.empty((0, 0), np.uint16)
    return LidarScan(
        stamp_ns, nothing, np.empty(0), np.empty(0), some.reshape(-1, 3).astype(np.float32), NO_BYTES, offsets
    )


def process(
    source: LidarSource, seen: LidarScan, pose: np.ndarray = NOWHERE, motion: Motion = STILL, curvature: float = 0.0
) -> int:
    source.update(seen, pose, motion, curvature, AREA)
    return len(source.hits_odom_m)


def few(seen: LidarScan, stamp_ns: int, count: int) -> LidarScan:
    return LidarScan(stamp_ns, seen.ranges_mm, seen.elevation_rad, seen.azimuth_rad, seen.xyz_m[:count], NO_BYTES,
                     seen.offset_s[:count])  # fmt: skip


def test_initial_state(source: LidarSource, lidar: Lidar, config: SafetyConfig) -> None:
    assert (source.name, source.stamp_ns, source.scan, source.hits_odom_m.shape) == ("front", None, None, (0, 3))
    assert source.nominal_range_m == nominal_range_m(lidar, config.field, config.detection_range) > 0.0
    assert (source.is_frozen, source.detection_range_m(1), source.covers(1), source.covers(-1)) == (
        False,
        0.0,
        False,
        False,
    )
    seen = scan((8.1, 0.1, 1.5))
    process(source, seen)
    assert (source.scan, source.stamp_ns) == (seen, START_NS)


def test_hits_in_odom_at_stamp(source: LidarSource) -> None:
    seen, motion = scan((8.1, 1.1, 1.5), offset_s=-0.1), Motion(3.0, 0.2)
    assert process(source, seen, POSE, motion) == 4
    base = deskew(np.add(seen.xyz_m, (0.0, 0.0, 2.0)).T.astype(np.float32), seen.offset_s, motion)
    expected = np.column_stack([to_frame(POSE, base[:2].T), base[2]])
    assert source.hits_odom_m == pytest.approx(expected, abs=1e-5)


def test_height_and_box_limits(source: LidarSource) -> None:
    for place, counts in (
        ((8.1, 0.1, 3.18), 4), ((8.1, 0.1, 3.205), 0), ((14.98, 0.1, 1.6), 4), ((15.1, 0.1, 1.6), 0),
        ((8.1, 0.1, 0.3), 0), ((0.2, 0.0, 1.6), 0), ((0.3, 0.1, 1.6), 4),
    ):  # fmt: skip
        assert process(source, scan(place)) == counts, place


def test_multiple_scan_evaluation(source: LidarSource) -> None:
    whole = scan((8.1, 0.1, 1.6))
    first, second, third = (few(whole, START_NS + k, 2) for k in range(3))
    assert [process(source, one) for one in (first, second, second, third)] == [0, 2, 0, 2]
    assert [process(source, few(whole, 9, count)) for count in (3, 1, 3, 3)] == [3, 0, 0, 3]


@clause("BD-5.2.4")
def test_one_return_in_each_of_many_scans_at_rest(lidar: Lidar, config: SafetyConfig) -> None:
    """A thin post between the columns of a lidar, right before a wing, has one return a scan (draw 10945)."""
    whole, enough = scan((8.1, 0.1, 1.6)), config.field.scans_at_rest
    for motion, hits in ((STILL, 1), (Motion(config.modes.standstill_mps + 0.01, 0.0), 0)):
        source = LidarSource("front", lidar, SMALL, config)
        seen = [process(source, few(whole, START_NS + k, 1), motion=motion) for k in range(enough)]
        assert seen == [0] * (enough - 1) + [hits]
        again = source.scan
        assert again is not None
        assert process(source, again, motion=motion) == hits  # for another box
    process(source, few(whole, START_NS + enough, 0))  # a scan without it
    assert process(source, few(whole, START_NS + enough + 1, 1)) == 0


def test_trailer_self_mask_by_curvature(lidar: Lidar, vehicle: Vehicle, config: SafetyConfig) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    for curvature, count in ((0.0, 0), (0.2, 4)):
        source = LidarSource("rear", lidar, footprint_of(vehicle, wagon), config)
        assert process(source, scan((-6.3, 0.2, 1.5)), curvature=curvature) == count, curvature


def test_frozen_scan_count(source: LidarSource, config: SafetyConfig) -> None:
    whole = scan((8.1, 0.1, 1.6))
    scans = [few(whole, START_NS + k, 3) for k in range(3)]
    states = []
    for one in (scans[0], scans[0], scans[0], scans[1], scans[1], scans[2], few(whole, 9, 2)):
        process(source, one)
        states.append(source.is_frozen)
    assert states == [False] * 5 + [True, False]


def test_content_of_a_scan() -> None:
    listed, other = scan((8.0, 0.0, 1.0)), scan((8.1, 0.0, 1.0))
    assert content_of(listed) == content_of(scan((8.0, 0.0, 1.0), stamp_ns=7))
    assert content_of(listed) != content_of(other)
    ranges = np.ones((1, 2), np.uint16)
    image, more = (LidarScan(1, one, np.zeros(1), np.zeros(2), np.empty((0, 3), np.float32), NO_BYTES,
                             np.empty(0, np.float32)) for one in (ranges, 2 * ranges))  # fmt: skip
    assert content_of(image) != content_of(more)
    assert content_of(image) == content_of(replace(image, stamp_ns=2))
    assert content_of(few(listed, 1, 0)) is None


@pytest.mark.parametrize(("x", "later_ns", "count"), [
    (3.98, 9_999_999_999, 4), (3.98, 10_000_000_000, 0), (4.1, 600_000_000_000, 4), (3.85, 1, 0), (3.95, 1, 4),
    (4.7, 1, 4), (4.8, 1, 0),
])  # fmt: skip
def test_blind_zone_hold(source: LidarSource, x: float, later_ns: int, count: int) -> None:
    at = np.array([0.0, 0.0, 0.3])
    assert process(source, scan((5.0, 0.0, 0.9)), at) == 4
    hits = source.hits_odom_m
    there = np.array([*to_frame(at, np.array([[x, 0.0]]))[0], 0.3])
    assert process(source, scan(stamp_ns=START_NS + later_ns), there) == count
    assert source.hits_odom_m.tolist() == hits[:count].tolist()


def test_held_hits_keep_their_age(source: LidarSource) -> None:
    process(source, scan((5.0, 0.0, 0.9)))
    old = source.hits_odom_m
    there = np.array([3.98, 0.0, 0.0])
    assert process(source, scan((6.0, 0.0, 1.6), stamp_ns=START_NS + 5_000_000_000), there) == 8
    assert source.hits_odom_m[4:].tolist() == old.tolist()
    assert process(source, scan(stamp_ns=START_NS + 9_000_000_000), there) == 4
    assert process(source, scan(stamp_ns=START_NS + 10_000_000_000), there) == 0


def test_lidar_on_a_lowered_implement(sparse: Vehicle, implement, config: SafetyConfig) -> None:
    """Ground seen from 0.6 m lower is ground, and a low box on it a hit; with a wrong hitch position all is a hit."""
    mount = Mount(xyz_m=(-2.5, 0.0, 1.7), rpy_deg=(0.0, 0.0, 180.0), sinks_m=0.6)
    raised = sparse.sensors.lidar["rear"].model_copy(update={"mount": mount})
    lowered = raised.model_copy(update={"mount": mount.model_copy(update={"xyz_m": (-2.5, 0.0, 1.1)})})
    body = Box(-4.25, 0.0, (0.5, 0.6, 0.6))
    for hitch, truth in ((1.0, raised), (0.0, lowered)):
        for boxes in ((), (body,)):
            source = LidarSource("rear_near", raised, footprint_of(sparse, implement), config)
            source.hitch = hitch
            take(source, truth, boxes)
            assert bool(len(source.hits_odom_m)) == bool(boxes), (hitch, boxes)
    wrong = LidarSource("rear_near", raised, footprint_of(sparse, implement), config)
    take(wrong, lowered)
    assert len(wrong.hits_odom_m)

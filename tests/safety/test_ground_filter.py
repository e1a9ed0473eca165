"""From scan to hits: lowest height, terrain, mask, cells, what a lidar proves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.vehicle import Lidar, TrailedImplement, Vehicle
from messages.perception import HealthState, SensorHealth
from messages.sensors import LidarScan
from safety.config import SafetyConfig
from safety.sources.detection_range import (
    covers,
    expected_density,
    limit_by_health,
    min_range_towards,
    nominal_range_m,
    range_by_ratio,
    sector_edges,
)
from safety.sources.ground_filter import Motion, bound_ground, crop, deskew, mark_obstacles, to_base
from safety.sources.lidar import LidarSource, is_same
from safety.sources.multiple_evaluation import cell_keys, evaluate, thin
from safety.zones.footprint import Box as Area
from safety.zones.footprint import footprint_of, is_own
from tests.safety.safety_world import START_NS, Box, around, scan_of

AREA = Area((-5.0, 30.0), (-8.0, 8.0))
STILL = Motion(0.0, 0.0)
SETTINGS = settings(derandomize=True, deadline=None, max_examples=40)


def ground(step: float = 0.25, rise: float = 0.0, rough: float = 0.0, seed: int = 1) -> np.ndarray:
    """Ground points (3, N) that begin to rise at x = 3."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-4.9, 29.9, step), np.arange(-7.9, 7.9, step)))
    z = rise * np.maximum(x - 3.0, 0.0) + np.random.default_rng(seed).uniform(-rough, rough, len(x))
    return np.stack([x, y, z]).astype(np.float32)


def with_points(base: np.ndarray, *points: tuple[float, float, float]) -> np.ndarray:
    return np.concatenate([base, np.array(points, np.float32).reshape(-1, 3).T], axis=1)


@pytest.mark.parametrize("x", [5.0, 10.0, 20.0])
def test_lowest_height(config: SafetyConfig, x: float) -> None:
    limit = 0.25 + 0.02 * x
    for z in around(limit, 0.02):
        up = mark_obstacles(with_points(ground(), (x, 0.0, z)), AREA, config.field)
        assert not up[:-1].any()
        if abs(z - limit) > 0.001:
            assert up[-1] == (z > limit), z


@pytest.mark.parametrize("rise", [0.0, 0.04, 0.08, -0.04, -0.08])
@pytest.mark.parametrize("rough", [0.0, 0.1])
def test_slopes_that_bend_and_furrows_are_not_obstacles(config: SafetyConfig, rise: float, rough: float) -> None:
    points = ground(rise=rise, rough=rough)
    assert not mark_obstacles(points[:, points[0] < 15.0], AREA, config.field).any()


@pytest.mark.parametrize("rise", [0.0, 0.08, -0.08])
def test_people_on_slopes_stand_out(config: SafetyConfig, rise: float) -> None:
    x = 9.0
    z0 = rise * (x - 3.0)
    person = [(x, 0.05 * k, z0 + 0.1 * j) for k in range(8) for j in range(18)]
    up = mark_obstacles(with_points(ground(rise=rise), *person), AREA, config.field)
    assert up[-len(person) :].sum() > 0.6 * len(person)


def test_a_wall_across_everything_stands_out(config: SafetyConfig) -> None:
    base = ground()
    base = base[:, base[0] < 10.0]
    wall = [(10.0, y, z) for y in np.arange(-7.5, 7.5, 0.1) for z in np.arange(0.1, 2.0, 0.17)]
    assert mark_obstacles(with_points(base, *wall), AREA, config.field)[-len(wall) :].sum() > 0.6 * len(wall)


def test_ghosts_below_the_ground_do_not_drag_it(config: SafetyConfig) -> None:
    ghosts = [(10.0 + 0.01 * k, 0.0, -1.5) for k in range(4)]
    assert not mark_obstacles(with_points(ground(rough=0.05), *ghosts), AREA, config.field).any()


@given(st.lists(st.tuples(st.floats(3.0, 25.0), st.floats(-7.0, 7.0), st.floats(-1.0, 3.0)), max_size=30))
@SETTINGS
def test_more_returns_never_hide_one(points: list[tuple[float, float, float]]) -> None:
    base = ground(1.0, 0.05, 0.1)
    before = mark_obstacles(base, AREA, CONFIG.field)
    after = mark_obstacles(with_points(base, *points), AREA, CONFIG.field)[: base.shape[1]]
    assert np.all(after >= before)


CONFIG: SafetyConfig


@pytest.fixture(autouse=True)
def _config(config: SafetyConfig) -> None:
    global CONFIG
    CONFIG = config


def test_bend_is_bounded(config: SafetyConfig) -> None:
    far = np.array([0.0, 2.0, 7.0, 30.0])
    assert bound_ground(np.full(4, np.inf), far, config.field) == pytest.approx([0.0, 0.0, 0.4, 0.5])
    assert bound_ground(np.full(4, -3.0), far, config.field) == pytest.approx([0.0, 0.0, -0.4, -2.24])
    assert bound_ground(np.full(4, -0.05), far, config.field) == pytest.approx([0.0] * 4)


def test_deskew_undoes_the_motion() -> None:
    """A post seen at the begin of a sweep in which the machine drove on and turned."""
    speed, rate, before = 8.0, 0.5, -0.1
    post_at_stamp = np.array([20.0, 3.0])
    yaw, way = rate * before, speed * before
    c, s = math.cos(yaw), math.sin(yaw)
    seen = np.array([[c, s], [-s, c]]) @ (post_at_stamp - np.array([way, 0.0]))
    point = np.array([[seen[0]], [seen[1]], [1.0]], np.float32)
    found = deskew(point, np.array([before], np.float32), Motion(speed, rate))
    assert np.hypot(*(found[:2, 0] - post_at_stamp)) < 0.05


def test_to_base_and_within(vehicle: Vehicle) -> None:
    lidar = vehicle.sensors.lidar["rear"]
    xyz = to_base(np.array([[4.0, 1.0, -2.0]], np.float32), lidar.mount.T_base_sensor)
    assert xyz[:, 0] == pytest.approx([-5.0, -1.0, 0.2], abs=1e-5)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 4.0], [31.0, 0.0, 0.0], [0.0, 9.0, 0.0]], np.float32).T
    assert list(crop(points, AREA, 3.2)) == [0]


def test_own_body_and_implement_are_masked(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    footprint = footprint_of(vehicle, implement)
    for x in around(3.5 + config.field.mask_m, 0.01):
        own = is_own(np.array([[x - 1e-6], [0.0], [1.0]]), footprint, 0.0, config.field.mask_m)[0]
        assert own == (x <= 3.5 + config.field.mask_m + 1e-9), x
    assert list(is_own(np.array([[-1.7, -1.7], [3.1, 3.3], [0.5, 0.5]]), footprint, 0.0, 0.15)) == [True, False]
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    pulled = footprint_of(vehicle, wagon)
    assert list(is_own(np.array([[-5.0, -7.5], [0.0, 0.0], [1.0, 1.0]]), pulled, 0.0, 0.1)) == [True, False]


def test_cells_need_enough_returns() -> None:
    none = np.empty(0, np.int64)
    for count in range(1, 8):
        keys = cell_keys(np.tile([[10.1, 0.1, 0.6]], (count, 1)), 0.5)
        hits, cells = evaluate(keys, none, 4, 2)
        assert hits.all() == (count >= 4)
        assert len(cells) == (1 if count >= 2 else 0)
        again, _ = evaluate(keys, cells, 4, 2)
        assert again.all() == (count >= 2)
    apart = [[10.1, 0.1, 0.6], [10.6, 0.1, 0.6], [10.1, 0.6, 0.6], [10.1, 0.1, 1.1], [-0.1, 0, 0]]
    spread = cell_keys(np.array(apart), 0.5)
    assert len(set(spread.tolist())) == 5
    assert not evaluate(spread, none, 2, 2)[0].any()
    hits, cells = evaluate(none, none, 4, 2)
    assert len(hits) == len(cells) == 0


def test_thinned_keeps_one_of_each_square() -> None:
    points = np.array([[1.01, 0.0, z] for z in (0.3, 0.6, 0.9)] + [[1.2, 0.0, 0.5]])
    assert len(thin(points, 0.05)) == 2
    assert len(thin(np.empty((0, 3)), 0.05)) == 0


def front(vehicle: Vehicle) -> Lidar:
    return vehicle.sensors.lidar["front"]


def eye_of(vehicle: Vehicle, implement, config: SafetyConfig, name: str = "front") -> LidarSource:
    return LidarSource(name, vehicle.sensors.lidar[name], footprint_of(vehicle, implement), config)


def take(
    source: LidarSource, lidar: Lidar, boxes: tuple[Box, ...] = (), stamp_ns: int = START_NS, seed: int = 1, **changes
) -> LidarScan:
    scan = scan_of(lidar, stamp_ns, (0.0, 0.0, 0.0), boxes, np.random.default_rng(seed))
    scan = replace(scan, **{k: v(scan) for k, v in changes.items()})
    source.update(scan, np.zeros(3), STILL, 0.0, Area((-12.0, 15.0), (-8.0, 8.0)))
    return scan


def test_reach_follows_from_the_lidar(vehicle: Vehicle, config: SafetyConfig) -> None:
    far, rear = (
        nominal_range_m(vehicle.sensors.lidar[n], config.field, config.detection_range) for n in ("front", "rear")
    )
    assert far == 40.0
    assert 10.0 <= rear < far
    up = front(vehicle).model_copy(update={"elevation_deg": (40.0,)})
    assert nominal_range_m(up, config.field, config.detection_range) == 0.0


def test_which_way_a_lidar_looks(vehicle: Vehicle, implement) -> None:
    footprint = footprint_of(vehicle, implement)
    lidars = vehicle.sensors.lidar
    assert [covers(lidars["front"], footprint, d) for d in (1, -1)] == [True, False]
    assert [covers(lidars["rear"], footprint, d) for d in (1, -1)] == [False, True]
    mount = lidars["front"].mount.model_copy(update={"xyz_m": (0.5, 0.0, 2.9)})
    roof = lidars["front"].model_copy(update={"mount": mount})
    assert [covers(roof, footprint, d) for d in (1, -1)] == [True, True]


def test_a_seeing_lidar_proves_its_reach(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    for name, direction in (("front", 1), ("rear", -1)):
        source = eye_of(vehicle, implement, config, name)
        assert source.detection_range_m(direction) == 0.0
        take(source, vehicle.sensors.lidar[name])
        assert source.detection_range_m(direction) == source.nominal_range_m
        assert source.detection_range_m(-direction) == 0.0


def dark(share: float, columns: slice = slice(None)):
    """Takes away a share of the returns of some columns."""

    def blank(scan: LidarScan) -> np.ndarray:
        ranges = scan.ranges_mm.copy()
        gone = np.random.default_rng(3).random(ranges.shape) < share
        ranges[:, columns][gone[:, columns]] = 0
        return ranges

    return blank


def test_fewer_returns_prove_less(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    detection_range = []
    for share in (0.0, 0.3, 0.5, 0.6, 0.7, 0.9, 1.0):
        source = eye_of(vehicle, implement, config)
        take(source, front(vehicle), ranges_mm=dark(share))
        detection_range.append(source.detection_range_m(1))
    assert detection_range == sorted(detection_range, reverse=True)
    assert detection_range[0] == source.nominal_range_m
    assert detection_range[-2:] == [0.0, 0.0]


def test_a_blind_sector_ahead_blinds(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    middle, aside = slice(512, 597), slice(700, 785)
    for columns, expected in ((middle, 0.0), (aside, 40.0)):
        source = eye_of(vehicle, implement, config)
        take(source, front(vehicle), ranges_mm=dark(1.0, columns))
        assert source.detection_range_m(1) == expected


def test_a_frozen_lidar_proves_nothing(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    source = eye_of(vehicle, implement, config)
    for k in range(5):
        take(source, front(vehicle), stamp_ns=START_NS + k * 100_000_000)
        assert source.is_frozen == (k >= config.detection_range.frozen_scans)
        assert (source.detection_range_m(1) == 0.0) == source.is_frozen
    take(source, front(vehicle), seed=2, stamp_ns=START_NS + 1_000_000_000)
    assert not source.is_frozen
    empty = replace(source.scan, ranges_mm=np.empty((0, 0), np.uint16))
    assert not is_same(empty, replace(empty, stamp_ns=1))
    assert not is_same(empty, None)


def test_hits_of_a_person_and_memory_in_the_hole(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    """A thing 0.4 m high goes below the lowest beam before the bumper: it is kept for a while, then forgotten."""
    source, lidar = eye_of(vehicle, implement, config), front(vehicle)
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
    assert nearer(START_NS + hole_ns - 1) > 0
    assert nearer(START_NS + hole_ns) == 0


def test_what_left_the_visible_field_is_gone(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    source = eye_of(vehicle, implement, config)
    take(source, front(vehicle), (Box(9.0, 0.0),))
    assert len(source.hits_odom_m) > 20
    take(source, front(vehicle), (), START_NS + 100_000_000)
    assert len(source.hits_odom_m) == 0


def test_dust_is_no_hit(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
    """2 000 returns a scan at random places within 40 m and 4 m of height: none is confirmed in 50 scans."""
    source = eye_of(vehicle, implement, config)
    rng, hits = np.random.default_rng(5), 0

    def dusty(scan: LidarScan) -> np.ndarray:
        air = rng.uniform((-40.0, -40.0, -2.0), (40.0, 40.0, 2.0), (2000, 3))
        return np.concatenate([scan.points_m, air]).astype(np.float32)

    for k in range(50):
        nothing = {"ranges_mm": lambda _: np.empty((0, 0), np.uint16)}
        take(source, front(vehicle), (), START_NS + k * 100_000_000, k, xyz_m=dusty, **nothing)
        hits += len(source.hits_odom_m) > 0
    assert hits == 0


def test_expected_returns(vehicle: Vehicle, config: SafetyConfig) -> None:
    slopes, density = expected_density(front(vehicle), config.detection_range)
    assert slopes == pytest.approx((-1.95 / 4.0, -1.95 / 15.0))
    assert density == pytest.approx(10 * 1024 / (2 * math.pi))


def health(ranges: list[float], edges_rad: list[float] | None = None) -> SensorHealth:
    edges_rad = [-math.pi, 0.0, math.pi] if edges_rad is None else edges_rad
    return SensorHealth(START_NS, "front", HealthState.GOOD, "", np.array(edges_rad), np.array(ranges), 0)


def test_health_only_shrinks() -> None:
    half = math.radians(30.0)
    assert limit_by_health(30.0, None, 1, half) == 30.0
    assert limit_by_health(30.0, health([50.0, 50.0]), 1, half) == 30.0
    assert limit_by_health(30.0, health([10.0, 50.0]), 1, half) == 10.0
    assert limit_by_health(30.0, health([math.inf, math.inf]), 1, half) == 30.0
    assert limit_by_health(30.0, health([math.nan, 5.0]), 1, half) == 0.0
    assert limit_by_health(30.0, health([], [0.0]), 1, half) == 30.0


def test_sectors_of_a_direction() -> None:
    edges_rad = sector_edges(12)
    ranges = np.arange(12.0)
    half = math.radians(30.0)
    assert min_range_towards(edges_rad, ranges, 1, half) == 5.0
    assert min_range_towards(edges_rad, ranges, -1, half) == 0.0
    assert min_range_towards(edges_rad, ranges[::-1].copy(), -1, half) == 0.0
    assert min_range_towards(np.array([1.0, 2.0]), np.array([9.0]), -1, half) == 0.0


def test_range_by_share_at_its_ends(config: SafetyConfig) -> None:
    for share in around(config.detection_range.blind_ratio, 0.01):
        assert (range_by_ratio(np.array([share]), 40.0, config.detection_range)[0] > 0.0) == (share > 0.2), share
    for share in around(config.detection_range.good_ratio, 0.01):
        full = range_by_ratio(np.array([share]), 40.0, config.detection_range)[0] >= 40.0
        assert full == (share >= 0.6), share

"""Obstacle sources: update of all sensors, clearance, detection range."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Lidar, Mount, Vehicle
from geometry.pose2 import from_frame, to_frame
from geometry.rectangle import Rectangle
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import LidarScan, RadarScan, UltrasonicRange
from safety.config import SafetyConfig
from safety.obstacle_sources import ObstacleSources, SourceData, is_newer, reachable_box
from safety.pose_history import PoseHistory
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.zones.footprint import Box, Footprint, footprint_of
from safety.zones.protective_field import SweptField, sweep_field
from tests.safety.safety_world import NO_BYTES, START_NS, healthy

AREA = Box((-12.0, 15.0), (-8.0, 8.0))

SMALL = Footprint((Rectangle(-0.1, 0.1, 0.2),), None, None, 2.9)

POSE = np.array([5.0, -3.0, 0.7])


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


def test_edges_of_all_lidars(sources: ObstacleSources) -> None:
    assert sources.holes_odom_m.shape == (0, 2)
    sources.lidars[0].holes_odom_m = np.array([(1.0, 2.0)])
    sources.lidars[-1].holes_odom_m = np.array([(3.0, 4.0)])
    assert sources.holes_odom_m.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_hits_of_all_lidars(sources: ObstacleSources) -> None:
    assert sources.lidar_hits_odom_m.shape == (0, 2)
    for k, source in enumerate(sources.lidars):
        source.hits_odom_m = np.array([(1.0 + k, 2.0, 0.5)])
    assert sources.lidar_hits_odom_m.tolist() == [[1.0, 2.0], [2.0, 2.0]]


def test_one_source_per_sensor(sources: ObstacleSources) -> None:
    assert [source.name for source in sources.lidars] == ["front", "rear"]
    assert [radar.name for radar in sources.radars] == ["front"]
    assert [source.name for source in sources.ultrasonics] == ["left", "right", "rear"]
    assert (sources.radars[0]._low_m, sources.radars[0]._high_m, sources.radars[0]._mask_m) == pytest.approx(
        (0.25, 3.2, 0.15)
    )
    sources.set_footprint(SMALL)
    assert all(source.footprint is SMALL for source in sources.lidars)
    assert sources._footprint is SMALL


def test_hitch_position_of_all_lidars(sources: ObstacleSources) -> None:
    assert {source.hitch for source in sources.lidars} == {1.0}
    sources.set_hitch(0.3)
    assert {source.hitch for source in sources.lidars} == {0.3}


def test_is_newer() -> None:
    assert [is_newer(5, taken) for taken in (None, 4, 5, 6)] == [True, True, False, False]


def radar_scan(stamp_ns: int, *ranges: float) -> RadarScan:
    some = np.array(ranges)
    return RadarScan(stamp_ns, some, 0 * some, 0 * some, 0 * some - 3.0, 0 * some + 5.0)


def test_update_relevance(sources: ObstacleSources, pose_history: PoseHistory) -> None:
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


def test_relevance_of_several_sources(full: Vehicle, config: SafetyConfig, pose_history: PoseHistory) -> None:
    radar = full.sensors.radar["front"]
    sensors = full.sensors.model_copy(update={"radar": {"front": radar, "rear": radar}})
    for is_radar in (True, False):
        sources = ObstacleSources(sensors, SMALL, config)
        sources.radars[0].hits = np.zeros((5 * is_radar, 4))
        sources.ultrasonics[0].echo_arc_odom_m = np.zeros((7 * (not is_radar), 2))
        radars = {name: radar_scan(START_NS) for name in ("front", "rear")}
        echoes = {name: UltrasonicRange(START_NS, math.nan) for name in ("left", "right")}
        assert sources.update(came(radars=radars, echoes=echoes), pose_history, odometry()), is_radar


def test_echoes_at_pose_of_stamp(sources: ObstacleSources, pose_history: PoseHistory) -> None:
    asked: list[int] = []
    where: Any = SimpleNamespace(pose_at=lambda stamp_ns: asked.append(stamp_ns) or POSE)
    for k in range(5):
        stamp_ns = START_NS + k
        sources.update(came(radars={"front": radar_scan(stamp_ns, 8.0)},
                         echoes={"left": UltrasonicRange(stamp_ns, 2.0)}), where, odometry())  # fmt: skip
    assert asked == [START_NS + k for k in range(5) for _ in range(2)]
    assert sources.radars[0].hits[0, :2] == pytest.approx(to_frame(POSE, np.array([[11.5, 0.0]]))[0])
    assert sources.ultrasonics[0].echo_arc_odom_m[3] == pytest.approx(to_frame(POSE, np.array([[5.5, 0.6]]))[0])


def test_with_new_scan(sources: ObstacleSources) -> None:
    front, rear = sources.lidars
    scans = {"front": scan(), "rear": None}
    assert sources.with_new_scan(came(scans=scans)) == [front]
    front.stamp_ns, rear.stamp_ns = START_NS, START_NS - 1
    assert sources.with_new_scan(came(scans=scans)) == []
    assert sources.with_new_scan(came(scans={"front": scan(), "rear": scan()})) == [rear]


def test_last_scan_reprocessed_for_new_field(sources: ObstacleSources) -> None:
    taken: list[Any] = []
    where: Any = SimpleNamespace(pose_at=lambda stamp_ns: stamp_ns)
    for source in sources.lidars:
        one: Any = source
        one.update = lambda *args, name=source.name: taken.append((name, *args))
    front, rear = sources.lidars
    fresh, last = scan(stamp_ns=7), scan(stamp_ns=6)
    rear.scan = last
    rest = (Motion(3.0, 0.2), 0.1, AREA)
    for is_new_field, expected in ((False, []), (True, [("rear", last, 6, *rest, [front])])):
        taken.clear()
        sources.update_lidars(
            came(scans={"front": fresh, "rear": None}), [front], where, odometry(), AREA, is_new_field
        )
        assert taken == [("front", fresh, 7, *rest, [rear]), *expected]
    rear.scan = None
    taken.clear()
    sources.update_lidars(came(scans={"front": None, "rear": None}), [], where, odometry(), AREA, True)
    assert taken == []


@pytest.fixture
def swept_field(full: Vehicle, implement, config: SafetyConfig) -> SweptField:
    return sweep_field(None, None, 0.0, 1, 20.0, 8.0, footprint_of(full, implement), config.field)


def odom_of(*base: tuple[float, ...]) -> np.ndarray:
    some = np.array(base)
    return np.column_stack([to_frame(POSE, some[:, :2]), some[:, 2:]])


def clearance_of(sources: ObstacleSources, swept_field: SweptField, speed_mps: float = 1.0, **how: Any) -> Any:
    return sources.clearance(swept_field, POSE, speed_mps, how.get("is_known"), how.get("tracks"))


def test_no_clearance_before_first_scan(sources: ObstacleSources, swept_field: SweptField) -> None:
    assert clearance_of(sources, swept_field) is None
    sources.lidars[1].stamp_ns = START_NS
    found = clearance_of(sources, swept_field)
    assert (found.main_m, found.arc_m, found.triggering_points_base_m.shape) == (math.inf, math.inf, (0, 3))


def test_clearance_of_lidar_and_radar_hits(sources: ObstacleSources, swept_field: SweptField) -> None:
    front, rear = sources.lidars
    front.stamp_ns = START_NS
    front.hits_odom_m, rear.hits_odom_m = odom_of((12.0, 1.0, 1.5), (12.0, 30.0, 1.0)), odom_of((14.0, 0.0, 0.5))
    found = clearance_of(sources, swept_field)
    assert found.main_m == pytest.approx(8.5)
    assert sorted(found.triggering_points_base_m[:, 2].tolist()) == [0.5, 1.5]
    sources.radars[0].hits = odom_of((10.0, 0.0, 0.7, 0.1))
    assert clearance_of(sources, swept_field).main_m == pytest.approx(6.5)
    for y in (3.35 - 0.2 - 0.01, 3.35 - 0.2 + 0.01):  # a bearing of 0.1 m, twice
        sources.radars[0].hits = odom_of((6.0, y, 0.7, 0.1))
        assert (clearance_of(sources, swept_field).main_m < 8.0) == (y < 3.15), y

    def is_known(points: np.ndarray) -> np.ndarray:
        return from_frame(POSE, points)[:, 0] < 13.0

    sources.radars[0].hits = odom_of((10.0, 0.0, 0.7, 0.1))
    assert clearance_of(sources, swept_field, is_known=is_known).main_m == pytest.approx(10.5)
    assert clearance_of(sources, swept_field, is_known=lambda points: np.ones(len(points), bool)).main_m == math.inf


def test_thinning(sources: ObstacleSources, swept_field: SweptField) -> None:
    sources.lidars[0].stamp_ns = START_NS
    x, y = 0.05 * 400 + 0.01, 0.01
    sources.lidars[0].hits_odom_m = np.array([(x, y, 1.0), (x + 0.02, y, 2.0), (x + 0.05, y, 3.0)])
    found = sources.clearance(swept_field, np.array([10.0, 0.0, 0.0]), 9.0, None, None)
    assert found is not None
    assert found.triggering_points_base_m[:, 2].tolist() == [1.0, 3.0]


def arc(*base: tuple[float, float]) -> np.ndarray:
    return to_frame(POSE, np.array(base))


IN_WAY = [(7.0, 0.1 * k) for k in range(10)]


def test_min_arc_ratio(sources: ObstacleSources, swept_field: SweptField) -> None:
    sources.lidars[0].stamp_ns = START_NS
    source = sources.ultrasonics[0]
    for beside, main_m in ((0, 3.5), (2, 3.5), (3, math.inf), (10, math.inf)):
        source.echo_arc_odom_m = arc(*IN_WAY[beside:], *[(7.0, 4.0)] * beside)
        found = clearance_of(sources, swept_field)
        assert found.main_m == pytest.approx(main_m), beside
        assert set(found.triggering_points_base_m[:, 2].tolist()) == ({0.25} if main_m < 9.0 else set())
        assert len(found.triggering_points_base_m) == (10 - beside if main_m < 9.0 else 0)
    source.echo_arc_odom_m = arc(*[(60.0, 0.0)] * 10)
    assert clearance_of(sources, swept_field).main_m == math.inf


def test_echo_conditions(sources: ObstacleSources, swept_field: SweptField, config: SafetyConfig) -> None:
    sources.lidars[0].stamp_ns = START_NS
    sources.ultrasonics[2].echo_arc_odom_m = arc(*IN_WAY)
    most_mps = config.ultrasonic.max_speed_kmh / 3.6
    assert clearance_of(sources, swept_field, most_mps).main_m == pytest.approx(3.5)
    assert clearance_of(sources, swept_field, most_mps + 1e-6).main_m == math.inf

    def explained(count: int) -> Any:
        return lambda points: np.arange(len(points)) < count

    assert clearance_of(sources, swept_field, is_known=explained(0)).main_m == pytest.approx(3.5)
    assert clearance_of(sources, swept_field, is_known=explained(1)).main_m == math.inf
    for away, main_m in ((0.29, math.inf), (0.31, 3.5)):
        place = np.array([*to_frame(POSE, np.array([[7.0, -0.05 - away]]))[0], 0.5])
        post = Track(1, ObstacleClass.POLE, 0.9, place, np.zeros(3), np.eye(4), np.array([0.1, 0.1, 1.0]), 0.7, 0, 1,
                     True, ("lidar_front",))  # fmt: skip
        assert clearance_of(sources, swept_field, tracks=Tracks(START_NS, (post,))).main_m == pytest.approx(main_m), (
            away
        )
    sources.ultrasonics[0].echo_arc_odom_m = arc(*[(6.0, 0.1 * k) for k in range(7)])
    assert clearance_of(sources, swept_field).main_m == pytest.approx(2.5)
    sources.lidars[1].vegetation_m = 0.3
    assert sources.vegetation_m == 0.3
    assert clearance_of(sources, swept_field).main_m == math.inf  # the echo may be of a plant


@pytest.mark.parametrize(
    ("vegetation_m", "floor_m", "cover_m"), [(0.0, 0.12, 0.0), (0.0, 0.25, 0.0), (0.0, 0.3, 0.3), (0.35, 0.3, 0.35)]
)
def test_plants_and_rough_ground_hide_who_lies(
    sources: ObstacleSources, vegetation_m: float, floor_m: float, cover_m: float
) -> None:
    sources.lidars[0].vegetation_m, sources.lidars[1].floor_m = vegetation_m, floor_m
    assert sources.cover_m == cover_m


def test_detection_range_of_covering_lidars(sources: ObstacleSources) -> None:
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
    for age_ns, proves in ((300_000_000, True), (300_000_001, False)):
        front.stamp_ns = now_ns - age_ns
        assert (sources.detection_range_m(now_ns, 1, {}) != {}) == proves, age_ns


def test_reachable_box(swept_field: SweptField) -> None:
    def way_of(step_m: float, arc_step_m: float | None = None) -> Any:
        arc = None if arc_step_m is None else SimpleNamespace(box=Box((0.0, 1.0), (0.0, 1.0)), step_m=arc_step_m)
        return SimpleNamespace(main=SimpleNamespace(box=Box((-1.0, 5.0), (-2.0, 9.0)), step_m=step_m), arc=arc)

    for laid in (way_of(0.4), way_of(0.4, 0.1), way_of(0.1, 0.4)):
        found = reachable_box(laid)
        assert (*found.x_m, *found.y_m) == pytest.approx((-1.5, 5.5, -2.5, 9.5))

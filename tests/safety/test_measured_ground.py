"""Measured ground: waves and crests are no obstacles, who is on them is; misaligned lidars prove nothing."""

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest

from configs.vehicle import Lidar, MountedImplement, Vehicle
from messages.sensors import LidarScan
from safety.sources.ground_filter import Motion, mark_obstacles
from safety.sources.lidar import LidarSource
from safety.sources.measured_ground import is_below_wheels, level, lowest_bound, stands_out
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import Box as Area
from safety.zones.footprint import footprint_of
from tests.clause import clause
from tests.safety.safety_world import NO_BYTES, START_NS, tractor

AREA = Area((-6.0, 15.0), (-6.0, 6.0))
AXLES_M, STEP_M, FAR_M = 2.6, 0.1, 15.0
ADULT, CHILD, LYING = (0.45, 0.4, 1.75), (0.3, 0.3, 1.05), (0.45, 1.7, 0.25)
Height = Callable[[np.ndarray, np.ndarray], np.ndarray]
Body = tuple[float, float, tuple[float, float, float]]  # x, y; length, width, height


def waves(seed: int) -> Height:
    """Eight waves of 5 cm amplitude and 6 to 12 m length."""
    rng = np.random.default_rng(seed)
    k, way, phase = 2.0 * math.pi / rng.uniform(6.0, 12.0, 8), rng.uniform(0, 2 * math.pi, 8), rng.uniform(0, 7.0, 8)

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        parts = zip(k, way, phase, strict=True)
        return sum((0.05 * np.sin(a * (x * math.cos(b) + y * math.sin(b)) + c) for a, b, c in parts), np.zeros(1))

    return height


def crest(x_m: float) -> Height:
    """A crest across, 0.5 m high and 8 m long, with its top at x."""
    return lambda x, y: 0.25 * (1.0 + np.cos(2.0 * math.pi / 8.0 * np.clip(x - x_m, -4.0, 4.0))) + 0.0 * y


def on_wheels(height: Height) -> Height:
    """The ground in base: the wheels of both axles stand on its plane z = 0."""
    rear, front = ((height(np.full(2, x), np.array([-0.9, 0.9]))) for x in (0.0, AXLES_M))
    left = (rear[1] - rear[0] + front[1] - front[0]) / 3.6
    slope = (front.mean() - rear.mean()) / AXLES_M
    return lambda x, y: height(x, y) - rear.mean() - slope * x - left * y


@functools.cache
def beams_over(lidar: Lidar, ground: Height) -> tuple[np.ndarray, np.ndarray]:
    """Directions in base of the beams below the horizon (N, 3), and their range to the ground (N,) by marching."""
    el, fov = np.radians([e for e in lidar.elevation_deg if e < 0.0]), math.radians(lidar.field_of_view_deg)
    az = fov * ((np.arange(lidar.columns) + 0.5) / lidar.columns - 0.5)
    flat = np.cos(el)[:, None]
    rays = np.stack([flat * np.cos(az), flat * np.sin(az), np.sin(el)[:, None] * np.ones_like(az)], -1).reshape(-1, 3)
    T = lidar.mount.T_base_sensor
    rays, range_m, above_m = rays @ T[:3, :3].T, np.full(len(rays), np.inf), np.full(len(rays), np.inf)
    is_open = np.ones(len(rays), bool)
    for at in np.arange(1.5, FAR_M, STEP_M):
        x, y, z = (T[:3, 3] + at * rays[is_open]).T
        index, now_m = np.flatnonzero(is_open), z - ground(x, y)
        is_hit, before_m = now_m < 0.0, above_m[index]
        range_m[index[is_hit]] = at + STEP_M * now_m[is_hit] / np.maximum(before_m - now_m, 1e-6)[is_hit]
        above_m[index], is_open[index[is_hit]] = now_m, False
    return rays, range_m


def scan_over(lidar: Lidar, ground: Height, bodies: tuple[Body, ...] = (), stamp_ns: int = START_NS) -> LidarScan:
    """Scan of uneven ground, with upright boxes whose foot is the ground at their middle."""
    T = lidar.mount.T_base_sensor
    rays, range_m = beams_over(lidar, ground)
    for x, y, size_m in bodies:
        middle = np.array([x, y, float(ground(np.array([x]), np.array([y]))[0])])
        half = np.array([0.5 * size_m[0], 0.5 * size_m[1], 0.0])
        low, high = middle - half - [0.0, 0.0, 0.3], middle + half + [0.0, 0.0, size_m[2]]
        first, second = ((end - T[:3, 3]) / rays for end in (low, high))
        enter_m, leave_m = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
        range_m = np.where((enter_m <= leave_m) & (enter_m > 0.0), np.minimum(enter_m, range_m), range_m)
    noise = np.random.default_rng(stamp_ns % 1000).normal(0.0, lidar.range_sigma_m, len(rays))
    found = np.isfinite(range_m)
    points_m = ((rays[found] * (range_m + noise)[found, None]) @ T[:3, :3]).astype(np.float32)
    empty = np.empty(0)
    return LidarScan(stamp_ns, np.empty((0, 0), np.uint16), empty, empty, points_m, NO_BYTES, empty.astype("f4"))


def hits_of(lidar: Lidar, config: SupervisorConfig, footprint, ground: Height, *bodies: Body) -> np.ndarray:
    """Hits (N, 3) in base before the machine after two scans."""
    source = LidarSource("one", lidar, footprint, config)
    for k in range(2):
        seen = scan_over(lidar, ground, bodies, START_NS + k * 100_000_001)
        source.update(seen, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
    hits = source.hits_odom_m
    return hits[(hits[:, 0] > 3.0) & (hits[:, 0] < 13.0) & (np.abs(hits[:, 1]) < 4.0)]


@pytest.fixture(scope="module")
def lidars() -> dict[str, Lidar]:
    """The front lidar, with every other column, and a dome of the shipped machine."""
    found = tractor("front", "front_left").sensors.lidar
    return found | {"front": found["front"].model_copy(update={"columns": 512})}


def is_at(hits: np.ndarray, body: Body) -> bool:
    return bool(((np.abs(hits[:, 0] - body[0]) < 0.8) & (np.abs(hits[:, 1] - body[1]) < 1.2)).any())


GROUNDS = {
    **{f"waves {k}": on_wheels(waves(k)) for k in range(4)},
    **{f"crest {x:g}": on_wheels(crest(x)) for x in (-1.0, 2.5, 4.0, 5.5, 7.0)},
}


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("x", [10.5, 11.0, 11.5, 12.0, 12.5])
def test_a_small_child_far_off_stands_out(
    vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig, lidars: dict[str, Lidar], x: float
) -> None:
    """Beyond `range_m`: by the rise from the nearest ground, a child of 0.8 m would be ground."""
    footprint, child = footprint_of(vehicle, implement), (x, 0.7, (0.3, 0.3, 0.8))
    for ground in (on_wheels(lambda x, y: 0.0 * x), GROUNDS["waves 0"], GROUNDS["waves 1"], GROUNDS["crest 7"]):
        assert is_at(hits_of(lidars["front"], config, footprint, ground, child), child)


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("name", GROUNDS)
def test_ground_is_no_obstacle_and_who_is_on_it_is(
    vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig, lidars: dict[str, Lidar], name: str
) -> None:
    ground, footprint = GROUNDS[name], footprint_of(vehicle, implement)
    for lidar in lidars.values():
        assert len(hits_of(lidar, config, footprint, ground)) == 0
    for body in ((6.0, 1.0, CHILD), (9.0, -1.0, ADULT), (11.0, 1.5, ADULT), (5.5, 0.5, LYING), (7.0, 1.0, LYING)):
        assert any(is_at(hits_of(one, config, footprint, ground, body), body) for one in lidars.values()), body


def test_the_plane_through_the_wheels_counts_that_ground(config: SupervisorConfig, lidars: dict[str, Lidar]) -> None:
    """What the test above would find without the measured ground."""
    lidar = lidars["front"]
    counts = []
    for ground in GROUNDS.values():
        points = scan_over(lidar, ground).points_m @ lidar.mount.T_base_sensor[:3, :3].T
        xyz = np.ascontiguousarray((points + lidar.mount.T_base_sensor[:3, 3]).T, np.float32)
        counts.append(int(mark_obstacles(xyz, AREA, config.field).sum()))
    assert np.count_nonzero(counts) >= 4


@pytest.mark.parametrize("error_m", [-0.5, 0.5])
def test_a_misaligned_lidar_keeps_what_is_above_the_plane(
    vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig, lidars: dict[str, Lidar], error_m: float
) -> None:
    """The mount is configured too high or too low: the ground beside the wheels is not that on which they stand."""
    true, footprint = lidars["front"], footprint_of(vehicle, implement)
    x, y, z = true.mount.xyz_m
    wrong = true.model_copy(update={"mount": true.mount.model_copy(update={"xyz_m": (x, y, z + error_m)})})
    source, seen = LidarSource("one", wrong, footprint, config), scan_over(true, GROUNDS["waves 1"])
    source.update(seen, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
    xyz = np.ascontiguousarray((seen.points_m + wrong.mount.T_base_sensor[:3, 3]).T, np.float32)
    above = mark_obstacles(xyz, AREA, config.field)
    assert above.any()
    kept = stands_out(xyz, above, AREA, config.field, config.measured_ground)
    assert (kept == above).all()
    assert len(source.hits_odom_m) > (300 if error_m > 0.0 else 0)


def surface(slope: float = 0.0, height_m: float = 0.0) -> np.ndarray:
    """Returns (3, N) each 0.1 m on a plane."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-3.95, 12.0, 0.1), np.arange(-4.95, 5.0, 0.1)))
    return np.stack([x, y, slope * x + height_m]).astype(np.float32)


def test_height_above_the_measured_ground(config: SupervisorConfig) -> None:
    """On ground that rises by 20 % ahead what is 0.25 m + 2 % above it counts."""
    field, measured = config.field, config.measured_ground.model_copy(update={"range_m": 20.0})
    ground = surface()
    ground[2] = 0.2 * np.maximum(ground[0] - 3.0, 0.0)
    above_m = np.array([0.3, 0.5, 0.9, 1.5])
    points = np.stack([np.full(4, 8.05), np.arange(4.0), 1.01 + above_m])
    xyz = np.concatenate([ground, points], axis=1).astype(np.float32)
    every = np.ones(xyz.shape[1], bool)
    found = stands_out(xyz, every, AREA, field, measured)
    assert not found[:-4].any()
    assert found[-4:].tolist() == [False, True, True, True]
    none = np.zeros(xyz.shape[1], bool)
    assert stands_out(xyz, none, AREA, field, measured) is none
    assert (stands_out(xyz, every & (xyz[2] > 2.0), AREA, field, measured) == (xyz[2] > 2.0)).all()


def test_without_ground_around_it_the_plane_decides(config: SupervisorConfig) -> None:
    away = np.array([[14.9, 14.95], [0.1, 0.1], [1.0, 1.0]])
    field, measured = config.field, config.measured_ground.model_copy(update={"range_m": 20.0})
    for count, is_known in ((1, False), (2, True)):
        xyz = np.concatenate([surface(), away[:, :count]], axis=1).astype(np.float32)
        found = stands_out(xyz, xyz[2] > 0.5, AREA, field, measured)
        assert found[-count:].all() != is_known


def test_ground_beside_the_wheels(config: SupervisorConfig) -> None:
    measured = config.measured_ground
    near = np.array([1.0, 2.0, 3.0, 4.0, 4.01])

    def check(*low_m: float) -> bool:
        low = np.array([low_m])
        return is_below_wheels(low, low, np.zeros(1), near, measured)

    assert check(0.3, 0.3, 0.3, 0.3, 9.0)
    assert check(-0.3, -0.3, -0.3, -0.3, 9.0)
    assert check(0.0, 0.1, 5.0, 0.2, 9.0)
    assert not check(0.31, 0.31, 0.31, 0.31, 0.0)
    assert not check(-0.31, -0.31, -0.31, -0.31, 0.0)
    assert not check(0.0, 0.0, 0.0, math.inf, 0.0)


def test_plane_of_the_ground_reaches_the_wheels_from_behind(config: SupervisorConfig) -> None:
    """The machine stands askew in a rut: 0.4 m beside the wing is no obstacle; 0.4 m all along, or a body, is."""
    measured = config.measured_ground
    x_m, y_m = np.arange(-9.75, -4.0, 0.5), np.arange(-3.75, 4.0, 0.5)
    askew = 0.02 * x_m[:, None] + 0.1 * y_m + 0.1

    def check(low_m: np.ndarray, bound_m: np.ndarray | None = None) -> bool:
        return is_below_wheels(low_m, low_m if bound_m is None else bound_m, x_m, y_m, measured)

    assert check(askew)
    assert not check(askew + 0.25)
    assert not check(askew - 0.45)
    wall = askew.copy()
    wall[:, :5] += 1.5
    assert not check(wall)
    assert check(wall, askew + 0.2)
    few = np.full_like(askew, np.inf)
    few[-1, : measured.plane_cells - 1] = 0.0
    assert not check(few)
    few[-1, : measured.plane_cells] = 0.0  # in one row: no plane
    assert not check(few)
    few[-2, 0] = 0.0
    assert check(few)
    few[-2, 0], few[0, 0] = np.inf, 0.0  # too far off
    assert not check(few)


def test_lowest_bound(config: SupervisorConfig) -> None:
    measured = config.measured_ground
    low_m = np.full((9, 20), np.inf)
    low_m[2, 3], low_m[4, 3] = 1.0, 0.0
    bound = lowest_bound(low_m, measured)
    rise_m = measured.slope * measured.cell_m
    assert bound[4, 3] == 0.0
    assert bound[2, 3] == pytest.approx(min(1.0, 2.0 * rise_m))
    assert bound[4, 3 + measured.reach_cells] == pytest.approx(rise_m * measured.reach_cells)
    assert math.isinf(bound[4, 4 + measured.reach_cells])
    assert bound[7, 7] == pytest.approx(5.0 * rise_m)
    assert bound[0, 3] == pytest.approx(min(1.0 + 2.0 * rise_m, 4.0 * rise_m))


def test_level(config: SupervisorConfig) -> None:
    """A slope becomes level, a body on it keeps its height, and returns too few for a plane keep theirs."""
    measured = config.measured_ground
    for slope in (0.0, 0.15, -0.15):
        ground = surface(slope, 0.1)
        is_body = (np.abs(ground[0] - 7.0) < 0.85) & (np.abs(ground[1]) < 0.22)
        ground[2, is_body] += 0.25
        found = level(ground, AREA, 0.1, measured)
        assert (found[:2] == ground[:2]).all()
        assert np.abs(found[2, ~is_body]).max() < 0.13, slope
        assert (found[2, is_body].mean() - found[2, ~is_body].mean()) == pytest.approx(0.25, abs=0.05)
    few = np.array([[5.0, 5.1], [1.0, 1.1], [0.7, 0.8]], np.float32)
    assert (level(few, AREA, 0.1, measured) == few).all()


def test_a_wall_does_not_tilt_the_level(config: SupervisorConfig) -> None:
    """In a shed the ground beside walls and posts stays level: it stopped a docking machine as an obstacle."""
    ground = surface(0.0, 0.1)
    is_wall = ground[1] > float(np.quantile(ground[1], 0.85))
    ground[2, is_wall] += np.random.default_rng(3).uniform(0.4, 2.5, int(is_wall.sum())).astype(np.float32)
    found = level(ground, AREA, 0.1, config.measured_ground)
    assert np.abs(found[2, ~is_wall]).max() < 0.13


def test_beyond_the_range_planes_through_cells_count(config: SupervisorConfig) -> None:
    """On rising ground what is 0.25 m + 2 % above it counts; where no ground surrounds it, all does."""
    field, measured = config.field, config.measured_ground
    ground, x = surface(), measured.range_m + 0.55
    ground[2] = 0.2 * np.maximum(ground[0] - 3.0, 0.0)
    limit_m = field.min_height_m + field.min_height_slope * x
    bare = ground[:, (ground[0] < measured.range_m - 2.0) | (np.abs(ground[1]) > 3.0)]
    for there, height_m, counts in (
        (ground, limit_m - 0.2, False), (ground, limit_m + 0.05, True), (bare, 0.1, True),
    ):  # fmt: skip
        xyz = np.concatenate([there, [[x], [0.0], [0.2 * (x - 3.0) + height_m]]], axis=1).astype(np.float32)
        above = np.zeros(xyz.shape[1], bool)
        above[-1] = True
        assert stands_out(xyz, above, AREA, field, measured)[-1] == counts, height_m

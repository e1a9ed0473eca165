"""Near field: low objects on the measured ground."""

import numpy as np
import pytest

from configs.vehicle import Mount, MountedImplement, Vehicle
from geometry.drawbar import Drawbar
from geometry.rectangle import Rectangle
from messages.sensors import LidarScan
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.sources.near_field import NearField, ground_lidars, mark_low_obstacles, near_box
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import Box, Footprint, enclosing, footprints_of
from tests.clause import clause
from tests.safety.safety_world import NO_BYTES, START_NS, tractor

AREA = Box((3.5, 11.0), (-4.0, 4.0))


def field_of(rng: np.random.Generator, rough_m: float = 0.0) -> np.ndarray:
    """Returns (3, N) of ground whose height is normally distributed."""
    count = 3000
    return np.stack([
        rng.uniform(3.5, 11.0, count), rng.uniform(-4.0, 4.0, count), rng.normal(0.0, rough_m, count)
    ]).astype(np.float32)  # fmt: skip


def put_body(xyz: np.ndarray, height_m: float, size_m: tuple[float, float]) -> np.ndarray:
    """Raises the returns on a body at (7, 0); returns which they are."""
    is_body = (np.abs(xyz[0] - 7.0) < 0.5 * size_m[0]) & (np.abs(xyz[1]) < 0.5 * size_m[1])
    xyz[2, is_body] += height_m
    return is_body


def marked(xyz: np.ndarray, box: Box, config: SupervisorConfig, consented_m: float = 0.0) -> NearField:
    return mark_low_obstacles(xyz, box, config.near_field, config.vegetation, consented_m)


def crop_of(rng: np.random.Generator, height_m: float, from_m: float = 3.5) -> np.ndarray:
    """Ground, from some distance on with plants of which half of the returns are."""
    xyz = field_of(rng, 0.01)
    is_plant = (xyz[0] > from_m) & (rng.random(xyz.shape[1]) < 0.5)
    xyz[2, is_plant] = rng.uniform(0.2, 1.0, is_plant.sum()) * height_m
    return xyz


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("size_m", [(1.7, 0.45), (0.45, 1.7), (0.5, 0.3)])
def test_a_lying_person_stands_out_and_the_ground_does_not(
    config: SupervisorConfig, size_m: tuple[float, float]
) -> None:
    for seed in range(5):
        xyz = field_of(np.random.default_rng(seed), 0.01)
        is_body = put_body(xyz, 0.22, size_m)
        found = marked(xyz, AREA, config)
        assert found.is_obstacle[is_body].mean() > 0.8
        assert found.is_obstacle[~is_body].mean() < 0.001


def test_least_height_follows_the_roughness(config: SupervisorConfig) -> None:
    smooth = marked(field_of(np.random.default_rng(1), 0.002), AREA, config)
    assert smooth.min_height_m == config.near_field.min_height_m
    rough = marked(field_of(np.random.default_rng(1), 0.04), AREA, config)
    assert rough.min_height_m > 2.0 * 0.04
    assert not rough.is_obstacle.any()


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("verge_m", [-2.5, -1.5])
def test_a_rough_verge_does_not_hide_who_lies_on_the_smooth_track(config: SupervisorConfig, verge_m: float) -> None:
    """Tufts of 0.3 m along one side are the roughness there, and no obstacles; on the track a child counts."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        xyz = np.concatenate([field_of(rng, 0.01), field_of(rng, 0.01)], axis=1)
        is_tuft = (xyz[1] < verge_m) & (rng.random(xyz.shape[1]) < 0.2)
        xyz[2, is_tuft] = rng.uniform(0.1, 0.3, is_tuft.sum())
        is_body = put_body(xyz, 0.17, (1.1, 0.3))
        found = marked(xyz, AREA, config)
        assert found.min_height_m > 0.3
        assert found.is_obstacle[is_body].mean() > 0.8
        assert found.is_obstacle[~is_body].mean() < 0.01


@clause("BD-5.2.4", rule="protective_field")
def test_a_low_body_among_rows_of_crop(config: SupervisorConfig) -> None:
    """Rows reach 0.08 m, so a few returns count from 0.2 m on, and many from 0.12 m."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        xyz = np.concatenate([field_of(rng, 0.01), field_of(rng, 0.01)], axis=1)
        is_row = (xyz[1] % 1.0 < 0.2) & (rng.random(xyz.shape[1]) < 0.3)
        xyz[2, is_row] += rng.uniform(0.02, 0.09, is_row.sum())
        is_body = put_body(xyz, 0.17, (1.1, 0.45))
        found = marked(xyz, AREA, config)
        assert found.min_height_m > 0.17
        assert np.count_nonzero(found.is_obstacle & is_body) >= 5
        assert not found.is_obstacle[~is_body].any()
        assert np.count_nonzero(found.is_dense & is_body) >= 5
        assert not (found.is_dense & ~found.is_obstacle).any()
        put_body(xyz, 0.2, (1.1, 0.45))
        assert not (marked(xyz, AREA, config).is_dense & is_body).any()  # high enough for itself


@pytest.mark.parametrize(("dx_m", "dy_m"), [(0.0, 0.0), (0.25, 0.0), (0.0, 0.25), (0.25, 0.25)])
def test_a_narrow_body_stands_out_wherever_the_cells_are(config: SupervisorConfig, dx_m: float, dy_m: float) -> None:
    """A child who lies curled, 0.4 m: before, four cells that share its returns had too few of each."""
    rows = np.random.default_rng(1)
    xyz = np.concatenate([field_of(rows, 0.01), field_of(rows, 0.01)], axis=1)
    is_row = (xyz[1] % 1.0 < 0.2) & (rows.random(xyz.shape[1]) < 0.3)
    xyz[2, is_row] += rows.uniform(0.02, 0.09, is_row.sum())
    x_m, y_m = 7.25 + dx_m, 0.75 + dy_m
    is_body = (np.abs(xyz[0] - x_m) < 0.2) & (np.abs(xyz[1] - y_m) < 0.2)
    xyz[2, is_body] += 0.16
    found = marked(xyz, AREA, config)
    assert np.count_nonzero(found.is_obstacle & is_body) >= 4
    assert not found.is_obstacle[~is_body].any()


def test_few_returns_of_a_cell_are_a_plant(config: SupervisorConfig) -> None:
    """Of 80 returns in a cell three on a plant do not count, and eight on a body do."""
    rng = np.random.default_rng(3)
    for count, expected in ((3, 0), (8, 8)):
        cell = np.stack([rng.uniform(7.02, 7.48, 80), rng.uniform(0.02, 0.48, 80), rng.normal(0.0, 0.005, 80)])
        cell[2, :count] = 0.2
        xyz = np.concatenate([field_of(rng, 0.005), cell.astype(np.float32)], axis=1)
        assert np.count_nonzero(marked(xyz, AREA, config).is_obstacle) == expected


@clause("BD-5.2.4", rule="vegetation")
@pytest.mark.parametrize("from_m", [3.5, 7.0])
def test_plants_are_no_obstacle_with_consent_and_who_stands_in_them_is(config: SupervisorConfig, from_m: float) -> None:
    for seed in range(5):
        xyz = crop_of(np.random.default_rng(seed), 0.35, from_m)
        assert not marked(xyz, AREA, config).is_plant.any()
        found = marked(xyz, AREA, config, 0.35)
        assert not found.is_obstacle.any()
        assert not (found.is_plant & found.is_obstacle).any()
        child = np.abs(xyz[:2] - [[8.5], [1.0]]).max(axis=0) < 0.2
        xyz[2, child] = np.linspace(0.1, 0.8, child.sum())
        found = marked(xyz, AREA, config, 0.35)
        assert np.array_equal(found.is_obstacle, child & (xyz[2] > 0.48) | found.is_obstacle & child)
        assert found.is_obstacle[child & (xyz[2] > 0.5)].all()


def test_height_of_plants_around(config: SupervisorConfig) -> None:
    for height_m, consented_m in ((0.35, 0.0), (0.35, 0.35), (0.6, 0.35)):
        found = marked(crop_of(np.random.default_rng(1), height_m), AREA, config, consented_m)
        assert found.vegetation_m == pytest.approx(height_m, abs=0.12)
    for height_m in (0.1, 1.5):  # lower plants hide nobody, and what is higher is no plant that is worked
        assert marked(crop_of(np.random.default_rng(1), height_m), AREA, config).vegetation_m == 0.0
    some = crop_of(np.random.default_rng(1), 0.35)[:, :300]
    few = some[:, (some[0] < 7.0) & (some[1] > 0.0)]
    assert marked(few, AREA, config).vegetation_m == 0.0


def test_dense_plants_are_as_high_as_their_surface_above_the_wheels(config: SupervisorConfig) -> None:
    """Grass of which only the tops are seen is rough; a wave of bare ground as high is smooth."""
    for rough_m, expected_m in ((0.04, 0.3), (0.005, 0.0)):
        xyz = field_of(np.random.default_rng(1), rough_m)
        xyz[2] += 0.27
        assert marked(xyz, AREA, config).vegetation_m == pytest.approx(expected_m, abs=0.05)
    far = xyz[:, xyz[0] > 6.0]
    far[2] += np.random.default_rng(2).normal(0.0, 0.04, far.shape[1]).astype(np.float32)
    assert marked(far, AREA, config).vegetation_m == 0.0  # nothing near the wheels says how high


def test_consent_hides_nobody_on_bare_ground(config: SupervisorConfig) -> None:
    for seed in range(5):
        xyz = field_of(np.random.default_rng(seed), 0.01)
        is_body = put_body(xyz, 0.22, (1.7, 0.45))
        assert np.array_equal(marked(xyz, AREA, config, 0.35).is_obstacle, marked(xyz, AREA, config).is_obstacle)
        assert marked(xyz, AREA, config, 0.35).is_obstacle[is_body].mean() > 0.8


def test_only_returns_in_the_box_count(config: SupervisorConfig) -> None:
    xyz = field_of(np.random.default_rng(2))
    put_body(xyz, 0.3, (1.0, 1.0))
    away = marked(xyz, Box((20.0, 30.0), (-4.0, 4.0)), config)
    assert not away.is_obstacle.any()
    assert away.min_height_m == config.near_field.min_height_m
    assert not marked(np.empty((3, 0), np.float32), AREA, config).is_obstacle.any()
    high = np.array([[5.0], [0.0], [2.0]], np.float32)  # no ground around it: left to the ground filter
    assert not marked(high, AREA, config).is_obstacle.any()


def test_a_wall_is_no_roughness(config: SupervisorConfig) -> None:
    xyz = field_of(np.random.default_rng(3), 0.005)
    wall = xyz[:, :2000].copy()
    wall[1], wall[2] = 3.0, np.abs(wall[0]) * 0.2
    is_body = put_body(xyz, 0.22, (1.7, 0.45))
    found = marked(np.concatenate([xyz, wall], axis=1), AREA, config)
    assert found.is_obstacle[: xyz.shape[1]][is_body].mean() > 0.8


def test_near_box(vehicle: Vehicle, implement: MountedImplement, config: SupervisorConfig) -> None:
    footprints, near = footprints_of(vehicle, implement), config.near_field
    wide, narrow = (near_box(one, near) for one in (footprints.working, footprints.transport))
    assert wide.x_m == (
        footprints.working.foremost_m(-1) - near.range_m,
        footprints.working.foremost_m(1) + near.range_m,
    )
    assert wide.y_m[1] == 0.5 * implement.width_m + near.aside_m > narrow.y_m[1]
    cart = Footprint(footprints.transport.rigid[:1], Rectangle(-4.0, 0.0, 9.0), Drawbar(-1.1, 3.0), 2.0)
    assert near_box(cart, near).y_m == (-4.5 - near.aside_m, 4.5 + near.aside_m)


def test_enclosing() -> None:
    assert enclosing(Box((0.0, 5.0), (-2.0, 1.0)), Box((-1.0, 4.0), (-1.0, 3.0))) == Box((-1.0, 5.0), (-2.0, 3.0))


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize(
    ("highest_deg", "measures_ground", "sees"), [(-10.0, False, True), (5.0, False, False), (5.0, True, True)]
)
def test_a_lidar_that_measures_the_ground_sees_who_lies(
    config: SupervisorConfig, vehicle: Vehicle, highest_deg: float, measures_ground: bool, sees: bool
) -> None:
    """A body of 0.2 m before the machine, in two scans of the same beams; a lidar that looks down always does."""
    lidar = vehicle.sensors.lidar["front"].model_copy(
        update={"mount": Mount(xyz_m=(3.0, 0.0, 2.0)), "elevation_deg": [-40.0, highest_deg]}
    )
    footprint = footprints_of(vehicle, None).working
    xyz = field_of(np.random.default_rng(4), 0.002)
    count = put_body(xyz, 0.2, (0.5, 1.7)).sum() * sees
    points_m = np.ascontiguousarray((xyz - np.array([[3.0], [0.0], [2.0]])).T, np.float32)
    source = LidarSource("low", lidar, footprint, config, measures_ground=measures_ground)
    for k in range(2):
        stamp_ns, none = START_NS + k * 100_000_000, np.empty(0)
        scan = LidarScan(stamp_ns, np.empty((0, 0), np.uint16), none, none, points_m, NO_BYTES, none.astype("f4"))
        source.update(scan, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
    assert len(source.hits_odom_m) == pytest.approx(count, abs=0.2 * count)


def test_lidars_that_do_not_look_down_measure_the_ground_where_no_other_does(
    vehicle: Vehicle, implement: MountedImplement
) -> None:
    footprint = footprints_of(vehicle, implement).working
    upright = vehicle.sensors.lidar
    dome = tractor("front_left").sensors.lidar
    assert ground_lidars(upright, footprint) == {"front", "rear"}
    assert ground_lidars(upright | dome, footprint) == {"front_left", "rear"}
    assert ground_lidars({}, footprint) == set()


@clause("BD-5.2.4", rule="vegetation")
@pytest.mark.parametrize("elevation_deg", [[-40.0, -10.0], [-40.0, 5.0]])
def test_lidar_in_crop(config: SupervisorConfig, vehicle: Vehicle, elevation_deg: list[float]) -> None:
    """Near the machine crop of 0.35 m is above the least height of every lidar, whether it looks down or not."""
    mount = Mount(xyz_m=(3.0, 0.0, 2.0))
    lidar = vehicle.sensors.lidar["front"].model_copy(update={"mount": mount, "elevation_deg": elevation_deg})
    footprint, rng = footprints_of(vehicle, None).working, np.random.default_rng(5)
    crop = crop_of(rng, 0.35)
    crop[2, crop[2] > 0.15] = rng.uniform(0.3, 0.36, np.count_nonzero(crop[2] > 0.15))
    child = np.stack([rng.uniform(7.9, 8.1, 30), rng.uniform(-0.2, 0.2, 30), np.linspace(0.1, 0.9, 30)])
    for consented_m, has_child, sees in ((0.0, False, True), (0.35, False, False), (0.35, True, True)):
        source = LidarSource("low", lidar, footprint, config, consented_m)
        points = np.concatenate([crop, child], axis=1) if has_child else crop
        points_m = np.ascontiguousarray((points - np.array([[3.0], [0.0], [2.0]])).T, np.float32)
        for k in range(2):
            stamp_ns, none = START_NS + k * 100_000_000, np.empty(0)
            scan = LidarScan(stamp_ns, np.empty((0, 0), np.uint16), none, none, points_m, NO_BYTES, none.astype("f4"))
            source.update(scan, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
        assert bool(len(source.hits_odom_m)) == sees, (consented_m, has_child)
        if has_child:
            assert np.abs(source.hits_odom_m[:, :2] - [8.0, 0.0]).max() < 0.3


@clause("BD-5.2.4", rule="vegetation")
def test_plants_seen_from_ahead_are_plants_at_the_edge_of_what_is_seen(
    config: SupervisorConfig, vehicle: Vehicle
) -> None:
    lidar = vehicle.sensors.lidar["front"].model_copy(update={"mount": Mount(xyz_m=(3.0, 0.0, 2.0))})
    footprint, none = footprints_of(vehicle, None).working, np.empty(0)
    rng = np.random.default_rng(3)
    xyz = np.concatenate([field_of(rng, 0.01) for _ in range(3)], axis=1)
    is_plant = (xyz[0] > 6.0) & (rng.random(xyz.shape[1]) < 0.8)
    xyz[2, is_plant] = rng.uniform(0.16, 0.22, is_plant.sum())
    bare = xyz[:, ~is_plant | (np.abs(xyz[1]) < 0.3) & (xyz[0] > 8.5)]
    higher = bare.copy()
    higher[2, (np.abs(higher[1]) < 0.3) & (np.abs(higher[0] - 8.5) < 0.3)] = 0.29
    for views, sees in (([xyz] * 6 + [bare] * 6, False), ([bare] * 6, True), ([xyz] * 6 + [higher] * 6, True)):
        source = LidarSource("low", lidar, footprint, config, 0.35, measures_ground=True)
        for k, view in enumerate(views):
            points_m = np.ascontiguousarray((view - np.array([[3.0], [0.0], [2.0]])).T, np.float32)
            stamp_ns = START_NS + k * 100_000_000
            scan = LidarScan(stamp_ns, np.empty((0, 0), np.uint16), none, none, points_m, NO_BYTES, none.astype("f4"))
            source.update(scan, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
        assert bool(len(source.hits_odom_m)) == sees

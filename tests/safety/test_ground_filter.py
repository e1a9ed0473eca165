"""Ground filter: minimum height, terrain, self mask, deskewing, patches against a slow reference."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.vehicle import TrailedImplement, Vehicle
from safety.config import FieldConfig, SafetyConfig
from safety.sources.ground_filter import Motion, bound_ground, crop, deskew, estimate_ground, mark_obstacles, to_base
from safety.zones.footprint import Box as Area
from safety.zones.footprint import footprint_of, is_own
from tests.safety.safety_world import around

AREA = Area((-5.0, 30.0), (-8.0, 8.0))

SETTINGS = settings(derandomize=True, deadline=None, max_examples=40)


def ground(step: float = 0.25, rise: float = 0.0, rough: float = 0.0, seed: int = 1) -> np.ndarray:
    """Ground points (3, N) that begin to rise at x = 3."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-4.9, 29.9, step), np.arange(-7.9, 7.9, step)))
    z = rise * np.maximum(x - 3.0, 0.0) + np.random.default_rng(seed).uniform(-rough, rough, len(x))
    return np.stack([x, y, z]).astype(np.float32)


def with_points(base: np.ndarray, *points: tuple[float, float, float]) -> np.ndarray:
    return np.concatenate([base, np.array(points, np.float32).reshape(-1, 3).T], axis=1)


@pytest.mark.parametrize("x", [5.0, 10.0, 20.0])
def test_min_height(config: SafetyConfig, x: float) -> None:
    limit = 0.25 + 0.02 * x
    for z in around(limit, 0.02):
        up = mark_obstacles(with_points(ground(), (x, 0.0, z)), AREA, config.field)
        assert not up[:-1].any()
        if abs(z - limit) > 0.001:
            assert up[-1] == (z > limit), z


@pytest.mark.parametrize("rise", [0.0, 0.04, 0.08, -0.04, -0.08])
@pytest.mark.parametrize("rough", [0.0, 0.1])
def test_grade_changes_and_furrows(config: SafetyConfig, rise: float, rough: float) -> None:
    points = ground(rise=rise, rough=rough)
    assert not mark_obstacles(points[:, points[0] < 15.0], AREA, config.field).any()


@pytest.mark.parametrize("rise", [0.0, 0.08, -0.08])
def test_person_on_slope(config: SafetyConfig, rise: float) -> None:
    x = 9.0
    z0 = rise * (x - 3.0)
    person = [(x, 0.05 * k, z0 + 0.1 * j) for k in range(8) for j in range(18)]
    up = mark_obstacles(with_points(ground(rise=rise), *person), AREA, config.field)
    assert up[-len(person) :].sum() > 0.6 * len(person)


def test_wall_across_field(config: SafetyConfig) -> None:
    base = ground()
    base = base[:, base[0] < 10.0]
    wall = [(10.0, y, z) for y in np.arange(-7.5, 7.5, 0.1) for z in np.arange(0.1, 2.0, 0.17)]
    assert mark_obstacles(with_points(base, *wall), AREA, config.field)[-len(wall) :].sum() > 0.6 * len(wall)


def test_ghosts_below_ground(config: SafetyConfig) -> None:
    ghosts = [(10.0 + 0.01 * k, 0.0, -1.5) for k in range(4)]
    assert not mark_obstacles(with_points(ground(rough=0.05), *ghosts), AREA, config.field).any()


@given(st.lists(st.tuples(st.floats(3.0, 25.0), st.floats(-7.0, 7.0), st.floats(-1.0, 3.0)), max_size=30))
@SETTINGS
def test_more_returns_never_remove_obstacle(points: list[tuple[float, float, float]]) -> None:
    base = ground(1.0, 0.05, 0.1)
    before = mark_obstacles(base, AREA, CONFIG.field)
    after = mark_obstacles(with_points(base, *points), AREA, CONFIG.field)[: base.shape[1]]
    assert np.all(after >= before)


CONFIG: SafetyConfig


@pytest.fixture(autouse=True)
def _config(config: SafetyConfig) -> None:
    global CONFIG
    CONFIG = config


def test_ground_bounds(config: SafetyConfig) -> None:
    far = np.array([0.0, 2.0, 7.0, 30.0])
    assert bound_ground(np.full(4, np.inf), far, config.field) == pytest.approx([0.0, 0.0, 0.4, 0.5])
    assert bound_ground(np.full(4, -3.0), far, config.field) == pytest.approx([0.0, 0.0, -0.4, -2.24])
    assert bound_ground(np.full(4, -0.05), far, config.field) == pytest.approx([0.0] * 4)


def test_deskew() -> None:
    """A post scanned at the beginning of a rotation during which the machine drove and turned."""
    speed, rate, before = 8.0, 0.5, -0.1
    post_at_stamp = np.array([20.0, 3.0])
    yaw, distance = rate * before, speed * before
    c, s = math.cos(yaw), math.sin(yaw)
    seen = np.array([[c, s], [-s, c]]) @ (post_at_stamp - np.array([distance, 0.0]))
    point = np.array([[seen[0]], [seen[1]], [1.0]], np.float32)
    found = deskew(point, np.array([before], np.float32), Motion(speed, rate))
    assert np.hypot(*(found[:2, 0] - post_at_stamp)) < 0.05


def test_to_base_and_crop(vehicle: Vehicle) -> None:
    lidar = vehicle.sensors.lidar["rear"]
    xyz = to_base(np.array([[4.0, 1.0, -2.0]], np.float32), lidar.mount.T_base_sensor)
    assert xyz[:, 0] == pytest.approx([-5.0, -1.0, 0.2], abs=1e-5)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 4.0], [31.0, 0.0, 0.0], [0.0, 9.0, 0.0]], np.float32).T
    assert list(crop(points, AREA, 3.2)) == [0]


def test_self_mask(vehicle: Vehicle, implement, config: SafetyConfig) -> None:
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


PATCH_AREA = Area((-4.0, 20.0), (-7.0, 5.0))


def test_to_base() -> None:
    T = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]])
    found = to_base(np.array([[4.0, 1.0, -2.0], [0.0, 0.0, 0.0]], np.float32), T)
    assert found.T.tolist() == [[2.0, 6.0, -0.5], [3.0, 2.0, 1.5]]
    assert found.dtype == np.float32


def test_deskew_by_motion() -> None:
    xyz = np.array([[10.0, 10.0], [4.0, 4.0], [1.0, 2.0]], np.float32)
    found = deskew(xyz, np.array([-0.1, 0.0], np.float32), Motion(8.0, 0.5))
    moved = found.T
    assert moved == pytest.approx(np.array([(10.0 + 0.05 * 4.0 - 0.8, 4.0 - 0.05 * 10.0, 1.0), (10.0, 4.0, 2.0)]))


def test_crop() -> None:
    inside = [(0.0, 0.0, 1.0), (19.9, 4.9, 2.9), (-3.9, -6.9, -9.0)]
    outside = [(-4.0, 0.0, 1.0), (20.0, 0.0, 1.0), (0.0, -7.0, 1.0), (0.0, 5.0, 1.0), (0.0, 0.0, 3.0)]
    points = np.array(outside + inside, np.float32).T
    assert crop(points, PATCH_AREA, 3.0).tolist() == [5, 6, 7]


def test_estimate_ground_order() -> None:
    heights = {0: [0.02, 0.07, 0.12, 0.52], 1: [0.02, 0.07], 2: [], 3: [-9.0, -1.98, 9.0], 4: [0.02] * 2 + [0.12] * 18}
    patch = np.concatenate([np.full(len(z), k) for k, z in heights.items()]).astype(np.int64)
    z = np.concatenate([np.array(some, np.float32) for some in heights.values()])
    for order, share, expected in (
        (3, 0.0, [0.1, math.inf, math.inf, 1.95, 0.1]),
        (2, 0.0, [0.05, 0.05, math.inf, -2.0, 0.0]),
        (1, 0.0, [0.0, 0.0, math.inf, -2.0, 0.0]),
        (1, 0.5, [0.05, 0.0, math.inf, -2.0, 0.1]),
        (1, 0.1, [0.0, 0.0, math.inf, -2.0, 0.0]),
        (1, 0.101, [0.0, 0.0, math.inf, -2.0, 0.1]),
    ):
        assert estimate_ground(patch, z, 5, order, share) == pytest.approx(np.array(expected)), (order, share)


def test_bound_ground(config: SafetyConfig) -> None:
    far = np.array([2.0, 4.0, 7.0, 50.0])
    for ground, expected in (
        (0.1, (0.0, 0.1, 0.1, 0.1)), (0.3, (0.0, 0.16, 0.3, 0.3)), (9.0, (0.0, 0.16, 0.4, 0.5)),
        (0.0, (0.0, 0.0, 0.0, 0.0)), (-0.1, (0.0, 0.0, 0.0, 0.0)), (-0.2, (0.0, -0.1, -0.1, -0.1)),
        (-9.0, (0.0, -0.16, -0.4, -3.84)),
    ):  # fmt: skip
        assert bound_ground(np.full(4, ground), far, config.field) == pytest.approx(np.array(expected)), ground


def limits_of(xyz: np.ndarray, box: Area, field: FieldConfig) -> np.ndarray:
    """Height above which each return counts, computed one by one."""
    size = field.ground_patch_m

    def index(value: float, ends: tuple[float, float]) -> int:
        return min(max(math.floor(value / size), math.floor(ends[0] / size)), math.floor(ends[1] / size))

    patch = [(index(x, box.x_m), index(y, box.y_m)) for x, y in xyz[:2].T]
    heights: dict[tuple[int, int], list[float]] = {}
    for own, z in zip(patch, xyz[2], strict=True):
        heights.setdefault(own, []).append(z)
    limits = []
    for own, (x, y, _) in zip(patch, xyz.T, strict=True):
        some = sorted(heights[own])
        order = max(field.ground_returns, math.ceil(field.ground_ratio * len(some)))
        lowest = some[order - 1] if len(some) >= field.ground_returns else math.inf
        ground = 0.05 * math.floor(lowest / 0.05) if math.isfinite(lowest) else math.inf
        away = math.hypot((own[0] + 0.5) * size - 1.3, (own[1] + 0.5) * size)
        lift = float(bound_ground(np.array([ground]), np.array([away]), field)[0])
        limits.append(lift + field.min_height_m + field.min_height_slope * math.hypot(x, y))
    return np.array(limits)


@pytest.mark.parametrize("share", [0.0, 0.09])
@pytest.mark.parametrize("box", [PATCH_AREA, Area((-4.0, 20.0), (1.0, 13.0)), Area((3.0, 8.9), (-13.0, 9.0))])
def test_mark_obstacles_against_reference(config: SafetyConfig, box: Area, share: float) -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(box.x_m[0] - 6.0, box.x_m[1] + 6.0, 900), rng.uniform(box.y_m[0] - 6.0, box.y_m[1] + 6.0, 900)
    slope = 0.08 * np.maximum(x, 0.0) * np.sign(y)
    z = slope + rng.choice([0.0, 0.2, 0.4, 0.7], 900) + rng.uniform(-0.1, 0.1, 900)
    xyz = np.stack([x, y, np.clip(z, -1.9, 1.9)]).astype(np.float32)
    field = config.field.model_copy(update={"ground_ratio": share})
    limits = limits_of(xyz.astype(np.float64), box, field)
    is_clear = np.abs(xyz[2] - limits) > 1e-4
    assert is_clear.sum() > 880
    assert (mark_obstacles(xyz, box, field) == (xyz[2] > limits))[is_clear].all()

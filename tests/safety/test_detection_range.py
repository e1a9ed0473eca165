"""Detection range: nominal range, coverage, expected returns, ratios by sector, limit by health."""

import math
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Lidar, Mount, Vehicle
from messages.perception import HealthState, SensorHealth
from safety.config import SafetyConfig
from safety.sources.detection_range import (
    TURN_RAD,
    covers,
    down_beams,
    expected_density,
    limit_by_health,
    min_range_towards,
    nominal_range_m,
    range_by_ratio,
    return_ratios,
    sector_edges,
)
from safety.zones.footprint import Footprint, footprint_of
from tests.safety.safety_world import START_NS, around


@pytest.fixture
def footprint(vehicle: Vehicle, implement) -> Footprint:
    return footprint_of(vehicle, implement)


@pytest.fixture
def lidar(vehicle: Vehicle) -> Lidar:
    """One level ring, 1.2 m high, with dense columns."""
    mount = Mount(xyz_m=(3.3, 0.0, 1.2))
    return changed(vehicle.sensors.lidar["front"], mount=mount, elevation_deg=(0.0,), columns=8192)


def changed(lidar: Lidar, height_m: float | None = None, **changes: Any) -> Lidar:
    if height_m is not None:
        changes["mount"] = Mount(xyz_m=(3.3, 0.0, height_m))
    return lidar.model_copy(update=changes)


def reach(lidar: Lidar, config: SafetyConfig, **changes: Any) -> float:
    return nominal_range_m(lidar, config.field, config.detection_range.model_copy(update=changes))


def test_nominal_range_cap(lidar: Lidar, config: SafetyConfig) -> None:
    assert reach(lidar, config) == 40.0
    assert reach(lidar, config, cap_m=7.0) == 7.0
    assert reach(changed(lidar, range_m=(0.4, 12.0)), config) == 12.0


def test_nominal_range_by_columns(lidar: Lidar, config: SafetyConfig) -> None:
    sparse = changed(lidar, columns=256, field_of_view_deg=180.0)
    column_rad = math.pi / 256
    assert reach(sparse, config) == 10.0  # 40.7 returns at 1 m, and 4 are needed
    assert reach(sparse, config, object_m=(4.0 * (9.5 * column_rad), 1.7)) == 9.5
    assert reach(changed(sparse, elevation_deg=(0.0, 0.1, 30.0)), config) == 20.0


def test_nominal_range_by_downward_ring(lidar: Lidar, config: SafetyConfig) -> None:
    for elevation_deg, expected_m in ((-10.0, 8.5), (-45.0, 1.5), (-58.0, 0.0), (-8.0, 10.5)):
        falling = changed(lidar, 2.0, elevation_deg=(elevation_deg,))
        assert reach(falling, config) == expected_m, elevation_deg


def test_nominal_range_ring_height_limits(lidar: Lidar, config: SafetyConfig) -> None:
    min_height_m = config.field.min_height_m + config.field.min_height_slope * 10.0
    assert reach(changed(lidar, min_height_m), config) == 10.0
    assert reach(changed(lidar, 1.7), config) == 40.0
    assert reach(changed(lidar, 1.71), config) == 0.0


def test_coverage_by_field_of_view(lidar: Lidar, footprint: Footprint) -> None:
    for ahead_deg, direction, x in ((0.0, 1, 3.0), (180.0, -1, -1.0), (-180.0, -1, -1.0)):
        for away_deg in (-120.0, -45.001, -45.0, 0.0, 45.0, 45.001, 120.0):
            mount = Mount(xyz_m=(x, 0.0, 1.0), rpy_deg=(0.0, 0.0, ahead_deg + away_deg))
            turned = changed(lidar, mount=mount, field_of_view_deg=90.0)
            assert covers(turned, footprint, direction) == (abs(away_deg) <= 45.0), (direction, away_deg)


def test_coverage_by_mount_position(lidar: Lidar, footprint: Footprint) -> None:
    for x, z, seen in (
        (1.25, 1.0, []), (1.26, 1.0, [1]), (1.24, 1.0, [-1]), (1.25, footprint.height_m - 0.11, []),
        (1.25, footprint.height_m - 0.1, [1, -1]), (3.3, 3.0, [1, -1]),
    ):  # fmt: skip
        around_it = changed(lidar, mount=Mount(xyz_m=(x, 0.0, z)))
        assert [d for d in (1, -1) if covers(around_it, footprint, d)] == seen, (x, z)


def test_a_lidar_beside_the_machine_covers_both_directions(lidar: Lidar, footprint: Footprint) -> None:
    half_m = footprint.rigid[0].half_width_m
    for y, seen in ((half_m, []), (half_m + 0.01, [1, -1]), (-half_m - 0.01, [1, -1])):
        on_wing = changed(lidar, mount=Mount(xyz_m=(1.25, y, 1.0)))
        assert [d for d in (1, -1) if covers(on_wing, footprint, d)] == seen, y


def test_expected_slope_limits(lidar: Lidar, config: SafetyConfig) -> None:
    slope = -float(np.tan(np.radians(-20.0)))
    high = changed(lidar, 4.0 * slope, elevation_deg=(-20.0,), columns=100, field_of_view_deg=180.0)
    for beams_m, count in (((4.0, 50.0), 1), ((1.0, 4.0), 1), ((4.1, 50.0), 0), ((1.0, 3.9), 0)):
        slopes, density = expected_density(high, config.detection_range.model_copy(update={"beams_m": beams_m}))
        assert slopes.tolist() == [-4.0 * slope / beams_m[0], -4.0 * slope / beams_m[1]]
        assert density == pytest.approx([count * 100 / math.pi]), beams_m


def test_down_beams_every_fourth_return() -> None:
    origin = np.array([1.0, 2.0, 3.0])
    flat = [(5.0, 3.0, 4.0), (2.0, 0.0, -2.0), (0.5, 0.5, 0.0), (0.625, 0.375, 0.5)]
    places = [(x, y, -m * slope) for m, x, y in flat for slope in (0.26, 0.25, 0.5, 0.51, 0.24)]
    some = np.array(places, np.float32) + origin.astype(np.float32)
    everything = np.repeat(some, 4, axis=0)
    everything[1::4] += 0.01
    found = down_beams(everything.T.astype(np.float32), origin, np.array([-0.5, -0.3, -0.25]))
    is_seen = [m > 0.5 and 0.25 <= slope <= 0.5 for m, _, _ in flat for slope in (0.26, 0.25, 0.5, 0.51, 0.24)]
    assert found.T.tolist() == some[is_seen].tolist()


def test_return_ratios_by_band_and_sector() -> None:
    """Two bands: one of slopes below -0.2, in which one beam is expected in each quarter, and one without beams."""
    origin = np.array([1.0, 2.0, 1.0])
    azimuth = np.radians([-170.0, -100.0, -95.0, -80.0, 10.0, 100.0, 180.0])
    z = 1.0 - 3.0 * np.array([0.3, 0.3, 0.1, 0.3, 0.3, 0.3, 0.3])
    xyz = np.stack([origin[0] + 3.0 * np.cos(azimuth), origin[1] + 3.0 * np.sin(azimuth), z])
    xyz[1, -1] = 2.0
    slopes, density = np.array([-0.4, -0.2, 0.0]), np.array([4.0 * 4.0, 0.0]) / TURN_RAD
    ratios = return_ratios(xyz.astype(np.float32), origin, slopes, density, 4)
    assert ratios[0] == pytest.approx([2.0, 1.0, 1.0, 2.0])
    assert np.isinf(ratios[1]).all()
    ratios = return_ratios(xyz.astype(np.float32), origin, slopes, density[0] * np.ones(2), 4)
    assert ratios[1] == pytest.approx([1.0, 0.0, 0.0, 0.0])


def test_range_by_ratio_linear(config: SafetyConfig) -> None:
    share = np.array([[0.1, 0.2, 0.4, 0.6, 0.9]])
    one = config.detection_range.model_copy(update={"beams_m": (4.0, 15.0)})
    assert range_by_ratio(share, 40.0, one) == pytest.approx([0.0, 0.0, 20.0, 40.0, 40.0])


def test_range_by_ratio_of_the_worst_band(config: SafetyConfig) -> None:
    """Without returns from 6 to 9 m the range ends at 6 m; without those before them it is 0."""
    bands = config.detection_range.model_copy(update={"beams_m": (4.0, 6.0, 9.0, 15.0)})
    share = np.array(
        [[0.9, 0.9, 0.2, 0.9, 0.4, math.inf], [0.9, 0.1, 0.9, 0.4, 0.9, 0.9], [0.9, 0.9, 0.9, 0.0, 0.2, 0.9]]
    )
    assert range_by_ratio(share, 40.0, bands) == pytest.approx([40.0, 6.0, 0.0, 9.0, 9.0, 40.0])
    assert range_by_ratio(share, 8.0, bands) == pytest.approx([8.0, 6.0, 0.0, 6.0, 4.0, 8.0])


def test_sector_edges() -> None:
    assert sector_edges(4) == pytest.approx([-math.pi, -math.pi / 2, 0.0, math.pi / 2, math.pi])


def test_min_range_in_cone() -> None:
    edges_rad = np.array([-0.3, -0.1, 0.1, 0.3])
    for ranges, least in (((5.0, 9.0, 3.0), 3.0), ((5.0, 5.0, 6.0), 5.0), ((9.0, 5.0, 7.0), 5.0)):
        assert min_range_towards(edges_rad, np.array(ranges), 1, 0.5) == least
        assert min_range_towards(edges_rad + math.pi, np.array(ranges), -1, 0.5) == least
        assert min_range_towards(edges_rad - math.pi, np.array(ranges), -1, 0.5) == least
        assert min_range_towards(edges_rad + TURN_RAD, np.array(ranges), 1, 0.5) == least
        assert min_range_towards(edges_rad, np.array(ranges), -1, 0.5) == 0.0
    assert math.isnan(min_range_towards(edges_rad, np.array([5.0, math.nan, 6.0]), 1, 0.5))
    assert min_range_towards(edges_rad, np.array([5.0, 6.0, math.nan]), 1, 0.05) == 6.0


def test_touching_sector_excluded() -> None:
    for low, high in ((1.0, 2.0), (-2.0, -1.0)):
        for half_rad in around(1.0, 0.001):
            found = min_range_towards(np.array([low, high]), np.array([9.0]), 1, half_rad)
            assert found == (9.0 if half_rad > 1.0 else 0.0), half_rad


def test_edges_and_ranges_of_unequal_length() -> None:
    with pytest.raises(ValueError, match="zip"):
        min_range_towards(np.array([-1.0, 0.0, 1.0]), np.array([9.0]), 1, 0.5)


@pytest.mark.parametrize(("said_m", "left_m"), [(10.0, 10.0), (50.0, 30.0), (0.0, 0.0), (math.inf, 30.0)])
def test_health_of_one_sector(said_m: float, left_m: float) -> None:
    edges_rad = np.array([-math.pi, math.pi])
    health = SensorHealth(START_NS, "front", HealthState.GOOD, "", edges_rad, np.array([said_m]), 0)
    for direction in (1, -1):
        assert limit_by_health(30.0, health, direction, 0.5) == left_m
    away = SensorHealth(START_NS, "front", HealthState.GOOD, "", np.array([-0.5, 0.5]), np.array([said_m]), 0)
    assert limit_by_health(30.0, away, 1, 0.5) == left_m
    assert limit_by_health(30.0, away, -1, 0.5) == 0.0


def front(vehicle: Vehicle) -> Lidar:
    return vehicle.sensors.lidar["front"]


def test_nominal_range_of_machine_lidars(vehicle: Vehicle, config: SafetyConfig) -> None:
    far, rear = (
        nominal_range_m(vehicle.sensors.lidar[n], config.field, config.detection_range) for n in ("front", "rear")
    )
    assert far == 40.0
    assert 10.0 <= rear < far
    up = front(vehicle).model_copy(update={"elevation_deg": (40.0,)})
    assert nominal_range_m(up, config.field, config.detection_range) == 0.0


def test_coverage_of_machine_lidars(vehicle: Vehicle, implement) -> None:
    footprint = footprint_of(vehicle, implement)
    lidars = vehicle.sensors.lidar
    assert [covers(lidars["front"], footprint, d) for d in (1, -1)] == [True, False]
    assert [covers(lidars["rear"], footprint, d) for d in (1, -1)] == [False, True]
    mount = lidars["front"].mount.model_copy(update={"xyz_m": (0.5, 0.0, 2.9)})
    roof = lidars["front"].model_copy(update={"mount": mount})
    assert [covers(roof, footprint, d) for d in (1, -1)] == [True, True]


def test_expected_density(vehicle: Vehicle, config: SafetyConfig) -> None:
    slopes, density = expected_density(front(vehicle), config.detection_range)
    assert slopes == pytest.approx(-1.95 / np.array(config.detection_range.beams_m))
    assert density.sum() == pytest.approx(16 * 1024 / (2 * math.pi))  # rings from -23 to -3 degrees


def health(ranges: list[float], edges_rad: list[float] | None = None) -> SensorHealth:
    edges_rad = [-math.pi, 0.0, math.pi] if edges_rad is None else edges_rad
    return SensorHealth(START_NS, "front", HealthState.GOOD, "", np.array(edges_rad), np.array(ranges), 0)


def test_health_only_reduces() -> None:
    half = math.radians(30.0)
    assert limit_by_health(30.0, None, 1, half) == 30.0
    assert limit_by_health(30.0, health([50.0, 50.0]), 1, half) == 30.0
    assert limit_by_health(30.0, health([10.0, 50.0]), 1, half) == 10.0
    assert limit_by_health(30.0, health([math.inf, math.inf]), 1, half) == 30.0
    assert limit_by_health(30.0, health([math.nan, 5.0]), 1, half) == 0.0
    assert limit_by_health(30.0, health([], [0.0]), 1, half) == 30.0


def test_min_range_towards() -> None:
    edges_rad = sector_edges(12)
    ranges = np.arange(12.0)
    half = math.radians(30.0)
    assert min_range_towards(edges_rad, ranges, 1, half) == 5.0
    assert min_range_towards(edges_rad, ranges, -1, half) == 0.0
    assert min_range_towards(edges_rad, ranges[::-1].copy(), -1, half) == 0.0
    assert min_range_towards(np.array([1.0, 2.0]), np.array([9.0]), -1, half) == 0.0


def test_range_by_ratio_limits(config: SafetyConfig) -> None:
    for share in around(config.detection_range.blind_ratio, 0.01):
        assert (range_by_ratio(np.full((5, 1), share), 40.0, config.detection_range)[0] > 0.0) == (share > 0.2), share
    for share in around(config.detection_range.good_ratio, 0.01):
        full = range_by_ratio(np.full((5, 1), share), 40.0, config.detection_range)[0] >= 40.0
        assert full == (share >= 0.6), share


@pytest.mark.parametrize(("bands", "range_m"), [(5, 40.0), (4, 25.0), (3, 15.0), (2, 9.0)])
def test_in_fog_the_range_ends_where_the_ground_is_no_longer_seen(
    config: SafetyConfig, bands: int, range_m: float
) -> None:
    ratios = np.array([[1.0]] * bands + [[0.0]] * (5 - bands))
    assert range_by_ratio(ratios, 40.0, config.detection_range)[0] == range_m

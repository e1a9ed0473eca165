"""Radar source: usable detections, confirmation over cycles, limits, self mask, frozen cycles."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Mount, Radar, TrailedImplement, Vehicle
from geometry.pose2 import to_frame
from messages.motion import Odometry
from messages.sensors import RadarScan
from safety.config import SafetyConfig
from safety.sources.radar import RadarSource, confirmed, is_same, usable_detections
from safety.zones.footprint import Footprint, footprint_of
from tests.safety.safety_world import START_NS

STILL = Odometry(START_NS, np.eye(4), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(6))

RADAR = Radar(mount=Mount(xyz_m=(1.0, 2.0, 0.5), rpy_deg=(0.0, 0.0, 90.0)), field_of_view_deg=120.0, rate_hz=20.0,
              range_m=(0.5, 60.0), range_sigma_m=0.1, azimuth_sigma_deg=1.0, doppler_sigma_mps=0.1)  # fmt: skip

AHEAD = RADAR.model_copy(update={"mount": Mount(xyz_m=(3.5, 0.0, 0.7))})

Row = tuple[float, ...]


def scan(*rows: Row, stamp_ns: int = START_NS) -> RadarScan:
    """Rows of range, azimuth, elevation, Doppler and cross-section."""
    return RadarScan(stamp_ns, *(column.copy() for column in np.array(rows, np.float64).reshape(-1, 5).T))


def test_usable_detections() -> None:
    odom = replace(STILL, speed_mps=2.0, lateral_mps=0.1, yaw_rate_radps=0.3)
    base, radial, rcs = usable_detections(scan((10.0, 0.2, 0.1, -1.5, 4.0)), RADAR, RADAR.mount.T_base_sensor, odom)
    line = np.array([-math.cos(0.1) * math.sin(0.2), math.cos(0.1) * math.cos(0.2), math.sin(0.1)])
    assert base == pytest.approx(np.array([(1.0, 2.0, 0.5) + 10.0 * line]))
    assert radial == pytest.approx([-1.5 + line[0] * (2.0 - 0.3 * 2.0) + line[1] * (0.1 + 0.3 * 1.0)])
    assert rcs.tolist() == [4.0]


def test_range_and_view_limits() -> None:
    half = math.radians(60.0)
    rows = [(0.5, half), (60.0, -half), (0.499, 0.0), (60.01, 0.0), (9.0, half + 1e-9), (9.0, -half - 1e-9)]
    used = usable_detections(
        scan(*((r, a, 0.0, 0.0, float(k)) for k, (r, a) in enumerate(rows))), RADAR, np.eye(4), STILL
    )
    assert used[2].tolist() == [0.0, 1.0]
    for column in range(5):
        for bad in (math.nan, math.inf, -math.inf):
            row = [9.0, 0.1, 0.2, 0.0, 1.0]
            row[column] = bad
            base, _, _ = usable_detections(scan(tuple(row)), RADAR, np.eye(4), STILL)
            assert len(base) == (column == 2), (column, bad)
            if column == 2:
                assert base[0] == pytest.approx([9.0 * math.cos(0.1), 9.0 * math.sin(0.1), 0.0])


@pytest.mark.parametrize("field", ["range_m", "azimuth_rad", "elevation_rad", "doppler_mps", "rcs_dbsm"])
def test_arrays_of_unequal_length(field: str) -> None:
    broken = replace(scan((9.0, 0.0, 0.0, 0.0, 1.0)), **{field: np.zeros(3)})
    assert [part.shape for part in usable_detections(broken, RADAR, np.eye(4), STILL)] == [(0, 3), (0,), (0,)]


def test_is_same() -> None:
    one = scan((9.0, 0.1, 0.0, 1.0, 2.0))
    assert is_same(one, replace(one, stamp_ns=1))
    assert not is_same(one, None)
    assert not is_same(one, replace(one, range_m=np.array([9.1])))
    assert not is_same(one, replace(one, doppler_mps=np.array([1.1])))
    assert not is_same(scan(), scan())


def cycle(*places: tuple[float, float], moves: bool = False) -> np.ndarray:
    return np.array([(x, y, 1.0 + x, float(moves), 10.0) for x, y in places])


def test_confirmed_positions(config: SafetyConfig) -> None:
    radar = config.radar.model_copy(update={"static_cycles": 2, "moving_cycles": 1})
    here, near, far = (0.0, 0.0), (0.8, 0.0), (0.81, 0.0)
    assert confirmed([], radar, 0.02).shape == (0, 4)
    assert confirmed([cycle(here)], radar, 0.02).shape == (0, 4)
    assert confirmed([cycle(here, near)], radar, 0.02).shape == (0, 4)  # two of one cycle
    assert confirmed([cycle(here), cycle(far)], radar, 0.02).shape == (0, 4)
    both = np.array([(0.4, 0.0, 1.4, 0.2 / math.sqrt(2.0))] * 2)
    assert confirmed([cycle(here), cycle(near)], radar, 0.02) == pytest.approx(both)
    aside = confirmed([cycle((2.0, 1.0)), cycle((2.0, 1.8)), cycle((9.0, 9.0))], radar, 0.02)
    assert aside == pytest.approx(np.array([(2.0, 1.4, 3.0, 0.2 / math.sqrt(2.0))] * 2))
    assert len(confirmed([cycle((3.0, 4.0), moves=True)], radar, 0.02)) == 1
    alone = confirmed([cycle((3.0, 4.0), moves=True), cycle((0.0, 4.0))], radar, 0.02)
    assert alone == pytest.approx(np.array([(3.0, 4.0, 4.0, 0.2)]))


@pytest.fixture
def footprint(vehicle: Vehicle) -> Footprint:
    return footprint_of(vehicle, None)


def take(
    config: SafetyConfig, footprint: Footprint, scans: list[RadarScan], pose: Any = (0.0, 0.0, 0.0)
) -> RadarSource:
    source = RadarSource("front", AHEAD, (0.25, 3.2), 0.15, config.radar)
    for one in scans:
        source.update(one, np.array(pose), STILL, footprint)
    return source


def again(row: Row, count: int = 5, every_ns: int = 50_000_000) -> list[RadarScan]:
    return [scan(row, stamp_ns=START_NS + k * every_ns) for k in range(count)]


def test_initial_state(config: SafetyConfig, footprint: Footprint) -> None:
    source = take(config, footprint, [])
    assert (source.name, source.stamp_ns, source.hits.shape, source.is_frozen) == ("front", None, (0, 4), False)
    assert take(config, footprint, again((8.0, 0.0, 0.0, 0.0, 5.0))).stamp_ns == START_NS + 200_000_000


@pytest.mark.parametrize(("row", "counts"), [
    ((15.0, 0.0, 0.0, 0.0, -10.0), True), ((15.01, 0.0, 0.0, 0.0, -10.0), False),
    ((15.0, 0.0, 0.0, 0.0, -10.01), False), ((25.0, 0.0, 0.0, 0.5, -18.0), True),
    ((25.01, 0.0, 0.0, 0.5, -18.0), False), ((25.0, 0.0, 0.0, 0.5, -18.01), False),
    ((25.0, 0.0, 0.0, 0.499, 5.0), False), ((25.0, 0.0, 0.0, -0.5, -18.0), True),
    ((15.0, 1.0, 0.0, 0.0, -10.0), True), ((10.0, 0.0, math.asin(0.251), 0.0, 5.0), False),
    ((10.0, 0.0, math.asin(0.249), 0.0, 5.0), True), ((10.0, 0.0, math.asin(0.2501), 0.0, 5.0), False),
    ((10.0, 0.0, -math.asin(0.0449), 0.0, 5.0), True), ((10.0, 0.0, -math.asin(0.0451), 0.0, 5.0), False),
    ((12.0, 0.0, math.asin(2.49 / 12.0), 0.0, 5.0), True), ((12.0, 0.0, math.asin(2.51 / 12.0), 0.0, 5.0), False),
    ((0.5, 0.0, 0.0, 0.0, 5.0), True), ((0.51, 1.04, 0.0, 0.0, 5.0), True),
])  # fmt: skip
def test_detection_limits(config: SafetyConfig, footprint: Footprint, row: Row, counts: bool) -> None:
    assert (len(take(config, footprint, again(row)).hits) > 0) == counts


def test_self_mask(config: SafetyConfig, footprint: Footprint) -> None:
    inward = AHEAD.model_copy(update={"mount": Mount(xyz_m=(3.0, 0.0, 0.7))})
    for range_m, counts in ((0.64, False), (0.66, True)):
        source = RadarSource("front", inward, (0.25, 3.2), 0.15, config.radar)
        for one in again((range_m, 0.0, 0.0, 0.0, 5.0)):
            source.update(one, np.zeros(3), STILL, footprint)
        assert (len(source.hits) > 0) == counts, range_m


def test_trailer_self_mask(config: SafetyConfig, vehicle: Vehicle) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    back = AHEAD.model_copy(update={"mount": Mount(xyz_m=(-1.3, 0.0, 0.7), rpy_deg=(0.0, 0.0, 180.0))})
    for curvature, counts in ((0.0, False), (0.2, True)):
        source = RadarSource("rear", back, (0.25, 3.2), 0.15, config.radar)
        for one in again((5.0, -0.2, 0.0, 0.0, 5.0)):
            source.update(one, np.zeros(3), replace(STILL, curvature_radpm=curvature), footprint_of(vehicle, wagon))
        assert (len(source.hits) > 0) == counts, curvature


def test_height_limits(config: SafetyConfig, footprint: Footprint) -> None:
    for height, counts in (((0.7, 3.2), True), ((0.25, 0.7), True), ((0.71, 3.2), False), ((0.25, 0.69), False)):
        source = RadarSource("front", AHEAD, height, 0.15, config.radar)
        for one in again((8.0, 0.0, 0.0, 0.0, 5.0)):
            source.update(one, np.zeros(3), STILL, footprint)
        assert (len(source.hits) > 0) == counts, height


def test_hits_in_odom(config: SafetyConfig, footprint: Footprint) -> None:
    hits = take(config, footprint, again((10.0, 0.3, 0.1, 0.0, 5.0)), (5.0, -2.0, 0.7)).hits
    flat = 10.0 * math.cos(0.1)
    place = to_frame(np.array([5.0, -2.0, 0.7]), np.array([[3.5 + flat * math.cos(0.3), flat * math.sin(0.3)]]))[0]
    sigma = math.radians(1.0) * flat / math.sqrt(5.0)
    assert hits == pytest.approx(np.array([(*place, 0.7 + 10.0 * math.sin(0.1), sigma)] * 5))


def test_cycle_memory(config: SafetyConfig, footprint: Footprint) -> None:
    there = (8.0, 0.0, 0.0, 0.0, 5.0)
    for last_ns, counts in ((400_000_000, True), (400_001_000, False)):
        cycles = [*again(there, 4, 100_000_000), scan(there, stamp_ns=START_NS + last_ns)]
        assert (len(take(config, footprint, cycles).hits) > 0) == counts, last_ns
    for empty, counts in ((3, True), (4, False)):
        gone = [scan(stamp_ns=START_NS + 50_000_000 + k * 1_000_000) for k in range(empty)]
        assert (len(take(config, footprint, [*again(there, 5, 1_000_000), *gone]).hits) > 0) == counts, empty


def test_frozen_cycles(config: SafetyConfig, footprint: Footprint) -> None:
    for count, is_frozen in ((5, False), (6, True), (9, True)):
        assert take(config, footprint, again((8.0, 0.0, 0.0, 0.0, 5.0), count)).is_frozen == is_frozen, count
    others = [*again((8.0, 0.0, 0.0, 0.0, 5.0), 6), *again((9.0, 0.0, 0.0, 0.0, 5.0), 5)]
    assert not take(config, footprint, others).is_frozen

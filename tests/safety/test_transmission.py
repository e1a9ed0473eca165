"""Transmission: dust that most beams pass through is no hit, posts and persons are, also behind dust."""

from dataclasses import replace

import numpy as np
import pytest

from configs.vehicle import Lidar, MountedImplement
from messages.sensors import LidarScan
from safety.config import TransmissionConfig
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.sources.transmission import are_transparent
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import Box as Area
from safety.zones.footprint import footprint_of
from tests.clause import clause
from tests.safety.safety_world import START_NS, Box, scan_of, tractor

AREA = Area((-5.0, 15.0), (-6.0, 6.0))
POST, CHILD, ADULT = (0.06, 0.06, 1.2), (0.3, 0.3, 1.05), (0.45, 0.4, 1.75)


def dusty(scan: LidarScan, rng: np.random.Generator, share: float) -> LidarScan:
    """Replaces a share of the ranges by isolated nearer ones at 0.8 to 8 m."""
    dust_mm = np.where(
        rng.random(scan.ranges_mm.shape) < share, rng.uniform(800.0, 8000.0, scan.ranges_mm.shape), 65535
    )
    is_dust = (scan.ranges_mm == 0) & (dust_mm < 65535) | (dust_mm < scan.ranges_mm)
    return replace(scan, ranges_mm=np.where(is_dust, dust_mm, scan.ranges_mm).astype(np.uint16))


def hits_in_dust(
    lidar: Lidar, implement: MountedImplement, config: SupervisorConfig, scans: int, *boxes: Box, share: float = 0.01
) -> list[np.ndarray]:
    """Hits before the machine below the height of the sensor, scan by scan."""
    machine = tractor("front")
    source = LidarSource("front", lidar, footprint_of(machine, implement), config)
    rng, found = np.random.default_rng(3), []
    for k in range(scans):
        seen = dusty(scan_of(lidar, START_NS + k * 100_000_000, (0.0, 0.0, 0.0), boxes, rng), rng, share)
        source.update(seen, np.zeros(3), Motion(0.0, 0.0), 0.0, AREA)
        hits = source.hits_odom_m
        found.append(hits[(hits[:, 0] > 3.6) & (np.abs(hits[:, 1]) < 4.0) & (hits[:, 2] < 1.9)])
    return found


@pytest.fixture(scope="module")
def front() -> Lidar:
    return tractor("front").sensors.lidar["front"]


@clause("BD-5.2.4", rule="protective_field")
def test_dust_is_transparent(front: Lidar, implement: MountedImplement, config: SupervisorConfig) -> None:
    """Dust on 1 % of the rays: hardly a scan has a hit, without the test of transmission most have."""
    opaque = config.model_copy(update={"transmission": TransmissionConfig(max_returns=8, max_blocked_ratio=0.0)})
    count = {name: sum(len(hits) > 0 for hits in hits_in_dust(front, implement, one, 30))
             for name, one in (("tested", config), ("not tested", opaque))}  # fmt: skip
    assert count["tested"] <= 1
    assert count["not tested"] >= 10


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("size_m", [POST, CHILD, ADULT])
@pytest.mark.parametrize("place_m", [(4.6, 0.0), (6.0, 1.5), (9.0, -1.0)])
def test_bodies_in_dust_are_hits(
    front: Lidar, implement: MountedImplement, config: SupervisorConfig, size_m: tuple[float, float, float],
    place_m: tuple[float, float],
) -> None:  # fmt: skip
    body = Box(*place_m, size_m)
    for hits in hits_in_dust(front, implement, config, 6, body, share=0.02)[1:]:
        assert (np.hypot(hits[:, 0] - place_m[0], hits[:, 1] - place_m[1]) < 0.6).any()


def beams(blocked: int, passing: int, range_m: float = 3.0, behind_m: float = 9.0) -> tuple[np.ndarray, np.ndarray]:
    """Returns (3, N) in one cell ahead of the sensor, and all returns of its scan: these, others behind and aside."""
    rng = np.random.default_rng(1)
    hits = np.stack([np.full(blocked, range_m), rng.uniform(-0.02, 0.02, blocked), rng.uniform(-0.02, 0.02, blocked)])
    away = behind_m * np.stack([np.ones(passing), *rng.uniform(-0.04, 0.04, (2, passing))])
    aside = 9.0 * np.stack([np.ones(500), np.full(500, 0.2), np.zeros(500)])
    return hits.astype(np.float32), np.concatenate([hits, away, aside], axis=1).astype(np.float32)


def test_ratio_of_blocked_beams() -> None:
    config = TransmissionConfig(max_returns=8, max_blocked_ratio=0.04)
    for blocked, passing, behind_m, is_clear in (
        (4, 97, 9.0, True), (4, 96, 9.0, False), (2, 49, 9.0, True), (2, 48, 9.0, False), (8, 193, 9.0, True),
        (9, 900, 9.0, False), (4, 200, 3.4, False), (4, 200, 3.7, True),
    ):  # fmt: skip
        hits, every = beams(blocked, passing, behind_m=behind_m)
        keys, is_hit = np.zeros(blocked, np.int64), np.ones(blocked, bool)
        found = are_transparent(keys, is_hit, hits, every, 0.5, config)
        assert found.tolist() == [is_clear] * blocked, (blocked, passing, behind_m)
        assert not are_transparent(keys, ~is_hit, hits, every, 0.5, config).any()


def test_cells_are_tested_one_by_one() -> None:
    """A dense cell, one that is no hit and one of dust in one scan."""
    config = TransmissionConfig(max_returns=8, max_blocked_ratio=0.04)
    dust, every = beams(3, 400)
    body = np.stack([np.full(20, 5.0), np.linspace(1.9, 2.1, 20), np.zeros(20)]).astype(np.float32)
    hits = np.concatenate([body, dust, dust + np.float32(0.001)], axis=1)
    keys = np.repeat([7, 3, 5], [20, 3, 3])
    found = are_transparent(keys, keys != 5, hits, np.concatenate([hits, every], axis=1), 0.5, config)
    assert found.tolist() == (keys == 3).tolist()

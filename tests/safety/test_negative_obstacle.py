"""Negative obstacles: ditches and banks are hits at their near edge; waves, crests and wheel tracks are none."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from configs.vehicle import Lidar, Mount
from messages.sensors import LidarScan
from safety.sources.ground_filter import Motion
from safety.sources.lidar import LidarSource
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import Box, footprint_of
from tests.clause import clause
from tests.safety.safety_world import NO_BYTES, START_NS, tractor

Ground = Callable[[np.ndarray, np.ndarray], np.ndarray]
MACHINE = tractor("front_left")
AHEAD = MACHINE.sensors.lidar["front_left"].model_copy(
    update={"mount": Mount(xyz_m=(3.0, 0.0, 2.0)), "columns": 60, "field_of_view_deg": 60.0}
)
EDGE_M = 5.0  # before the bumper: more than the stopping distance at 10 km/h
STEP_M = 0.05  # along a beam


def across(x: np.ndarray, y: np.ndarray, heading_deg: float) -> np.ndarray:
    """Distance beyond a line through the edge that lies `EDGE_M` before the bumper."""
    a = math.radians(heading_deg)
    return np.asarray((x - MACHINE.body.front_m - EDGE_M) * math.cos(a) + y * math.sin(a))


def ditch(depth_m: float, width_m: float, heading_deg: float = 0.0) -> Ground:
    def height_m(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s = across(x, y, heading_deg)
        section = 0.5 * depth_m * (np.cos(2.0 * np.pi * s / width_m) - 1.0)
        return np.where((s > 0.0) & (s < width_m), section, 0.0)

    return height_m


def pit(depth_m: float, width_m: float) -> Ground:
    return lambda x, y: np.where((across(x, y, 0.0) > 0.0) & (across(x, y, 0.0) < width_m), -depth_m, 0.0)


def bank(height_m: float, heading_deg: float = 0.0) -> Ground:
    return lambda x, y: -height_m * np.clip(across(x, y, heading_deg) / 0.3, 0.0, 1.0)


def waves(seed: int) -> Ground:
    """Eight waves of 0.1 m from trough to crest in all directions."""
    rng = np.random.default_rng(seed)
    rows = [(rng.uniform(6.0, 12.0), *rng.uniform(0.0, 2.0 * np.pi, 2)) for _ in range(8)]
    return lambda x, y: np.sum([
        0.05 * np.sin(2.0 * np.pi / m * (x * math.cos(a) + y * math.sin(a)) + phase) for m, a, phase in rows
    ], axis=0)  # fmt: skip


def crest(height_m: float, length_m: float) -> Ground:
    def at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s = across(x, y, 0.0)
        return np.where(np.abs(s) < 0.5 * length_m, 0.5 * height_m * (1.0 + np.cos(2.0 * np.pi / length_m * s)), 0.0)

    return at


def furrows(depth_m: float, spacing_m: float, heading_deg: float) -> Ground:
    return lambda x, y: 0.5 * depth_m * np.sin(2.0 * np.pi / spacing_m * across(x, y, heading_deg))


def wheel_track(depth_m: float, heading_deg: float) -> Ground:
    def height_m(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s = np.abs(across(x, y, heading_deg))
        return np.where(s < 0.25, -0.5 * depth_m * (1.0 + np.cos(4.0 * np.pi * s)), 0.0)

    return height_m


def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Low and 1 m thick: rings climb it, and the ground behind is lower."""
    s = across(x, y, 15.0)
    return np.where((s > 0.0) & (s < 1.0), 0.5, 0.0)


def rows_of_crop(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Strips of plants 0.12 m high, 0.1 m wide, 0.5 m apart, as opaque as a wall."""
    return np.where(across(x, y, 20.0) % 0.5 < 0.1, 0.12, 0.0)


def scan_over(ground: Ground, lidar: Lidar, stamp_ns: int, x_m: float, rng: np.random.Generator) -> LidarScan:
    """Scan from a machine at `x_m` whose wheels stand level on the ground under the middle between its axles."""
    el = np.radians(lidar.elevation_deg)
    az = np.radians(lidar.field_of_view_deg) * ((np.arange(lidar.columns) + 0.5) / lidar.columns - 0.5)
    beams = np.stack(
        [np.cos(el)[:, None] * np.cos(az), np.cos(el)[:, None] * np.sin(az), np.sin(el)[:, None] + 0.0 * az], axis=-1
    ).reshape(-1, 3, 1)
    under = float(ground(np.array([x_m + 1.3]), np.zeros(1))[0])
    origin = np.add(lidar.mount.xyz_m, (x_m, 0.0, under))
    reach = np.arange(STEP_M, 20.0, STEP_M)
    x, y, z = (origin[k] + beams[:, k] * reach for k in range(3))
    height_m = ground(x, y) - z
    is_below = height_m > 0.0
    k = np.maximum(is_below.argmax(axis=1), 1)
    row = np.arange(len(k))
    before, behind = height_m[row, k - 1], height_m[row, k]
    range_m = reach[k] - STEP_M * behind / np.where(behind > before, behind - before, 1.0)
    range_m = np.where(is_below.any(axis=1), range_m + rng.normal(0.0, lidar.range_sigma_m, len(k)), 0.0)
    ranges_mm = np.round(1000.0 * range_m).astype(np.uint16).reshape(len(el), len(az))
    return LidarScan(stamp_ns, ranges_mm, el, az, np.empty((0, 3), np.float32), NO_BYTES, np.empty(0, np.float32))


def source_over(ground: Ground, config: SupervisorConfig) -> LidarSource:
    """A source after four scans of a machine that comes nearer to within `EDGE_M`."""
    source = LidarSource("front_left", AHEAD, footprint_of(MACHINE, None), config)
    rng = np.random.default_rng(1)
    for k in range(4):
        x_m, stamp_ns = 0.28 * (k - 3), START_NS + k * 100_000_000
        scan = scan_over(ground, AHEAD, stamp_ns, x_m, rng)
        source.update(scan, np.array([x_m, 0.0, 0.0]), Motion(2.8, 0.0), 0.0, Box((-1.0, 12.0), (-4.0, 4.0)))
    return source


NEGATIVE = {  # with the heading of the edge
    "ditch of 0.5 m": (ditch(0.5, 1.0), 0.0), "ditch askew": (ditch(0.6, 1.2, 35.0), 35.0),
    "wide ditch": (ditch(0.6, 3.0), 0.0), "pit": (pit(0.5, 1.0), 0.0), "deep pit": (pit(2.0, 2.0), 0.0),
    "bank of 0.5 m": (bank(0.5), 0.0), "bank of 1 m": (bank(1.0), 0.0), "bank of 3 m": (bank(3.0), 0.0),
    "bank askew": (bank(0.8, 30.0), 30.0),
}  # fmt: skip
EVEN = {
    "waves": waves(1), "other waves": waves(2), "crest": crest(0.5, 8.0), "hollow": crest(-0.4, 10.0),
    "furrows across": furrows(0.2, 0.5, 0.0), "furrows askew": furrows(0.2, 1.0, 20.0),
    "wheel track across": wheel_track(0.2, 0.0), "wheel track askew": wheel_track(0.2, 60.0),
    "wheel track along": wheel_track(0.2, 90.0), "rows of crop": rows_of_crop, "wall": wall,
}  # fmt: skip


@clause("BD-5.4.1c", rule="protective_field")
@pytest.mark.parametrize("name", NEGATIVE)
def test_a_negative_obstacle_is_a_hit_at_its_near_edge(config: SupervisorConfig, name: str) -> None:
    ground, heading_deg = NEGATIVE[name]
    source = source_over(ground, config)
    hits = source.hits_odom_m
    assert np.isin(source.holes_odom_m[:, 0], hits[:, 0]).all()
    assert len(source.holes_odom_m) >= 2
    before = hits[np.abs(hits[:, 1]) < 2.0]
    assert len(before) >= 2
    beyond_m = across(before[:, 0], before[:, 1], heading_deg)
    assert beyond_m.min() > -0.6  # rings are up to 0.5 m apart there
    assert np.median(beyond_m) < 0.1


@clause("BD-5.2.4", rule="protective_field")
@pytest.mark.parametrize("name", EVEN)
def test_even_ground_is_no_negative_obstacle(config: SupervisorConfig, name: str) -> None:
    without = config.model_copy(
        update={"negative_obstacle": config.negative_obstacle.model_copy(update={"depth_m": 1e3})}
    )
    source = source_over(EVEN[name], config)
    assert np.array_equal(source.hits_odom_m, source_over(EVEN[name], without).hits_odom_m)
    assert len(source.holes_odom_m) == 0

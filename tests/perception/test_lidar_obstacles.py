"""Lidar node on complete scans: obstacles, rejected scans and health."""

import dataclasses

import numpy as np
import pytest

from configs.vehicle import Lidar
from messages.perception import HealthState
from perception.lidar.obstacles import LidarObstacles
from tests.perception.lidar_scenes import FRONT, LIDAR_CONFIG, VEHICLE, Feed, box, cast, listed, odometry, person

SECOND = 1_000_000_000


@pytest.fixture
def node():
    return LidarObstacles("front", FRONT, VEHICLE, None, LIDAR_CONFIG)


def step(node, scan):
    out = dict(node.step(scan.stamp_ns, Feed(lidar__front=scan, odom=odometry(scan.stamp_ns))))
    return out.get("ground/front"), out.get("obstacles/lidar_front"), out["health/lidar_front"]


def hit(obstacles, corners, reach=0.3):
    """Clusters with returns within an enlarged box, and the share of those returns in the largest cluster."""
    found = []
    for k in range(len(obstacles.yaw_rad)):
        p = obstacles.points_base_m[obstacles.offsets[k] : obstacles.offsets[k + 1]]
        if ((p[:, :2] > corners[0, :2] - reach) & (p[:, :2] < corners[1, :2] + reach)).all(axis=1).mean() > 0.5:
            found.append(k)
    return found


@pytest.mark.parametrize("range_m", range(5, 36, 3))
@pytest.mark.parametrize("slope", [0.0, 0.08, -0.08])
def test_person_on_furrows(node, range_m, slope):
    if slope > 0 and range_m > 30:
        pytest.skip("uphill, two rings at most cross a person so far off")
    corners = person(3.5 + range_m, 1.0)
    scan = cast([corners], furrow_m=0.06, slope=(slope, 0.0))
    _, obstacles, _ = step(node, scan)
    assert len(hit(obstacles, corners)) == 1
    assert len(obstacles.yaw_rad) == 1
    assert obstacles.nearest_base_m[0, 0] == pytest.approx(corners[0, 0], abs=0.1)


@pytest.mark.parametrize("range_m", range(4, 22, 2))
def test_box_of_half_metre_height(node, range_m):
    corners = box(3.5 + range_m, -1.0, 0.5, 0.5, 0.5)
    _, obstacles, _ = step(node, cast([corners], furrow_m=0.05))
    sizes = [np.diff(obstacles.offsets)[k] for k in hit(obstacles, corners)]
    assert max(sizes) >= 0.8 * np.diff(obstacles.offsets).sum()


def test_adjacent_persons_and_person_near_wall(node):
    scene = [person(12, -0.5), person(12, 0.5), person(14, 6.0), box(14, 8.0, 10, 0.3, 2.5)]
    _, obstacles, _ = step(node, cast(scene))
    assert [len(hit(obstacles, corners)) for corners in scene] == [1, 1, 1, 1]


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.08, 0.0), (0.0, -0.08), (-0.08, 0.04)])
def test_bare_ground_has_no_obstacles(node, slope):
    ground, obstacles, health = step(node, cast(slope=slope, furrow_m=0.1))
    assert len(obstacles.yaw_rad) == 0
    assert ground.is_obstacle_point.mean() < 0.002
    assert health.state is not HealthState.BLIND


def test_cluster_indices_refer_to_scan(node):
    scan = cast([person(10, 0), box(20, 3, 4, 2, 2)])
    ground, o, _ = step(node, scan)
    assert o.offsets[0] == 0
    assert o.offsets[-1] == len(o.indices) == len(o.points_base_m)
    assert scan.points_m[o.indices] + FRONT.mount.T_base_sensor[:3, 3] == pytest.approx(o.points_base_m, abs=1e-4)
    assert len(np.unique(o.indices)) == len(o.indices)
    assert len(ground.is_obstacle_point) == len(scan.points_m)
    assert o.class_scores.sum(axis=1) == pytest.approx(1.0)
    assert np.isnan(o.velocity_mps).all()


def test_unordered_scan_thinned_to_quarter(node):
    scene = [person(12, 0), box(18, 5, 4, 2, 2)]
    _, obstacles, _ = step(node, listed(cast(scene), 0.25))
    assert [len(hit(obstacles, corners)) for corners in scene] == [1, 1]


@pytest.mark.parametrize("rings", [16, 128])
def test_ring_count(rings):
    values = FRONT.model_dump() | {"elevation_deg": tuple(np.linspace(-25, 15, rings)), "columns": 1800}
    lidar = Lidar.model_validate(values)
    node = LidarObstacles("front", lidar, VEHICLE, None, LIDAR_CONFIG)
    scene = [person(9, 2), person(16, -3), box(20, 5, 4, 2, 2)]
    _, obstacles, health = step(node, cast(scene, lidar=lidar))
    assert [len(hit(obstacles, corners)) for corners in scene] == [1, 1, 1]
    assert len(obstacles.yaw_rad) == 3
    assert health.state is HealthState.GOOD


def test_roof_above_machine(node):
    scene = [person(12, 0), box(12, 0, 6, 6, 0.2, low=4.0)]
    _, obstacles, _ = step(node, cast(scene))
    assert len(obstacles.yaw_rad) == 1
    assert obstacles.size_m[0, 2] < 2.0


@pytest.mark.parametrize("spoil", ["empty", "zeros", "nan", "shape", "angles", "offsets"])
def test_invalid_scan_is_blind(node, spoil):
    scan = cast([person(10, 0)])
    spoilt = {
        "empty": lambda: dataclasses.replace(listed(scan), xyz_m=np.zeros((0, 3), np.float32)),
        "zeros": lambda: dataclasses.replace(scan, ranges_mm=np.zeros_like(scan.ranges_mm)),
        "nan": lambda: dataclasses.replace(listed(scan), xyz_m=np.full((500, 3), np.nan, np.float32)),
        "shape": lambda: dataclasses.replace(scan, ranges_mm=scan.ranges_mm[:-1]),
        "angles": lambda: dataclasses.replace(scan, elevation_rad=scan.elevation_rad * np.nan),
        "offsets": lambda: dataclasses.replace(scan, offset_s=np.zeros(7, np.float32)),
    }[spoil]()
    ground, obstacles, health = step(node, spoilt)
    assert ground is None
    assert obstacles is None
    assert health.state is HealthState.BLIND
    assert (health.detection_range_m == 0.0).all()
    assert health.rejected_count == (spoil not in ("empty", "zeros"))
    assert health.reason


def test_single_return_is_blind(node):
    scan = dataclasses.replace(listed(cast()), xyz_m=np.array([[9.0, 0.0, 0.0]], np.float32))
    assert step(node, scan)[2].state is HealthState.BLIND


def test_few_nan_returns(node):
    scan = listed(cast([person(10, 0)]))
    points = scan.xyz_m.copy()
    points[::7] = np.nan
    _, obstacles, health = step(node, dataclasses.replace(scan, xyz_m=points))
    assert len(hit(obstacles, person(10, 0))) == 1
    assert np.isfinite(obstacles.points_base_m).all()
    assert health.state is not HealthState.BLIND


def test_repeated_scan_and_constant_time_are_blind(node):
    first = cast([person(10, 0)], stamp_ns=SECOND)
    assert step(node, first)[2].state is HealthState.GOOD
    again = dataclasses.replace(first, stamp_ns=2 * SECOND)
    assert step(node, again)[2].state is HealthState.BLIND
    fresh = cast([person(10, 0)], seed=1, stamp_ns=2 * SECOND)
    assert step(node, fresh)[2].state is HealthState.BLIND
    assert step(node, cast([person(10, 0)], seed=2, stamp_ns=3 * SECOND))[2].rejected_count == 2


def test_dirt_reduces_range_of_its_sectors(node):
    def dirt(mm, rng):
        mm[:, 480:544] = 0
        return mm

    health = step(node, cast(extra=dirt))[2]
    middle = (health.sector_edges_rad[:-1] + health.sector_edges_rad[1:]) / 2
    ahead = health.detection_range_m[np.abs(middle) < np.radians(8)]
    aside = health.detection_range_m[(np.abs(middle) > np.radians(30)) & (np.abs(middle) < np.radians(80))]
    assert health.state is HealthState.DEGRADED
    assert (ahead == 0.0).all()
    assert (aside >= 40.0).all()


def test_fog_reduces_range(node):
    def fog(mm, rng):
        mm[mm > 15000] = 0
        return mm

    health = step(node, cast(extra=fog))[2]
    ahead = health.detection_range_m[np.abs((health.sector_edges_rad[:-1] + health.sector_edges_rad[1:]) / 2) < 1.0]
    assert health.state is HealthState.DEGRADED
    assert ((ahead > 8.0) & (ahead < 20.0)).all()


def test_bitwise_reproducibility(node):
    scan = cast([person(10, 0), box(20, 3, 4, 2, 2)], furrow_m=0.05)
    other = LidarObstacles("front", FRONT, VEHICLE, None, LIDAR_CONFIG)
    a, b = step(node, scan)[1], step(other, scan)[1]
    assert a.center_base_m.tobytes() == b.center_base_m.tobytes()
    assert a.indices.tobytes() == b.indices.tobytes()

"""Lidar odometry: true where the surroundings hold it, refused where they do not."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from geometry.transforms import transform
from localization.dead_reckoning.kernels import first_in_voxel
from localization.lidar.lidar_odometry import LidarOdometryNode
from localization.lidar.odometry_spans import LidarLink
from localization.lidar.scan_matching import ScanMatcher, covariance_of, deskew, information_of, refusal_of
from messages.errors import ConfigError
from messages.motion import LidarOdometry
from tests.localization.localization_bench import Box, configuration, errors, run
from tests.localization.localization_drive import START_NS, Wrongs, drive, tractor
from tests.localization.localization_surroundings import corridor, relative, scan, yard

CONFIG = configuration()
MATCHING = CONFIG.lidar_odometry.matching
DATA = Path(os.environ.get("HEADLAND_DATA", Path(__file__).parents[3] / "shared" / "data"))
KITTI = DATA / "kitti-seq-pcd" / "frames"


def motions_in(world, seconds=6.0):
    """What the node says without any odometry to help it, driving at walking pace from the start."""
    truth = drive(seconds, legs=[(0.5, 0.0, 0.0), (100.0, 1.5, 0.05)], wrongs=Wrongs(seed=2))
    node, rng, out = LidarOdometryNode(tractor(), "front", CONFIG.lidar_odometry), np.random.default_rng(0), []
    for k in range(2, int(seconds * 10) - 2, 2):
        stamp_ns = START_NS + k * 100_000_000
        pair = scan(truth, stamp_ns, world, rng)
        out += [m for _, m in node.step(stamp_ns, Box([("lidar/front", pair[0]), ("ground/front", pair[1])]))]
    return truth, out


def test_a_yard_holds_the_machine():
    truth, motions = motions_in(yard())
    assert len(motions) >= 26
    assert all(m.is_valid for m in motions)
    off = [np.linalg.inv(relative(truth, m.from_stamp_ns, m.stamp_ns)) @ m.T_from_to for m in motions]
    assert np.max([np.hypot(*T[:2, 3]) for T in off]) < 0.03
    assert np.degrees(np.max([abs(T[1, 0]) for T in off])) < 0.1
    total = np.linalg.multi_dot([m.T_from_to for m in motions])
    away = np.linalg.inv(relative(truth, motions[0].from_stamp_ns, motions[-1].stamp_ns)) @ total
    assert np.hypot(*away[:2, 3]) < 0.05
    assert all(a.stamp_ns == b.from_stamp_ns for a, b in itertools.pairwise(motions))


def test_one_straight_hedge_does_not():
    _, motions = motions_in(corridor(), seconds=3.0)
    assert motions
    assert not any(m.is_valid and m.covariance[3, 3] < 0.02**2 for m in motions)
    assert any("degenerate" in m.reason for m in motions)


@pytest.mark.parametrize("world", [np.zeros((0, 3)), yard()[:: 12000 // 60]])
def test_nothing_to_see_is_refused_not_zero(world):
    _, motions = motions_in(world, seconds=2.0)
    assert motions
    assert not any(m.is_valid for m in motions)
    assert all("points" in m.reason for m in motions)


def test_a_gap_starts_a_new_map():
    truth = drive(4, legs=[(100.0, 0.0, 0.0)])
    node, rng, world = LidarOdometryNode(tractor(), "front", CONFIG.lidar_odometry), np.random.default_rng(0), yard()
    said = []
    for k in (2, 4, 12, 14):
        pair = scan(truth, START_NS + k * 100_000_000, world, rng)
        said.append(len(list(node.step(0, Box([("lidar/front", pair[0]), ("ground/front", pair[1])])))))
    assert said == [0, 1, 0, 1]


def test_geometry_tells_what_it_cannot():
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(-20, 20, 3000), 5 + rng.normal(0, 0.02, 3000), rng.uniform(0, 2, 3000)])
    other = wall[:, [1, 0, 2]]
    wall, other = (w[first_in_voxel(w, 0.4)] for w in (wall, other))
    one = covariance_of(information_of(wall[:200], wall, 8, 0.12), 0.1)
    assert one[3, 3] > 0.2**2
    assert one[4, 4] < 0.02**2
    both = np.vstack([wall[:200], other[:200]])
    two = covariance_of(information_of(both, np.vstack([wall, other]), 8, 0.12), 0.1)
    assert max(two[3, 3], two[4, 4]) < 0.02**2


@pytest.mark.parametrize(("share", "is_refused"), [(0.97, False), (0.999, False), (1.001, True), (1.03, True)])
def test_limits_of_refusal(share, is_refused):
    small = np.eye(6) * 1e-8
    far = transform((0.0, share * MATCHING.largest_step_m, 0.0))
    assert bool(refusal_of(far, np.eye(4), small, MATCHING)) is is_refused
    turned = transform((0, 0, 0), (0, 0, share * np.radians(MATCHING.largest_turn_deg)))
    assert bool(refusal_of(turned, np.eye(4), small, MATCHING)) is is_refused
    weak = small.copy()
    weak[4, 4] = (share * MATCHING.largest_sigma_m) ** 2
    assert bool(refusal_of(np.eye(4), np.eye(4), weak, MATCHING)) is is_refused


def test_deskew_brings_a_sweep_to_its_end():
    T = transform((0.5, 0.02, 0.0), (0.0, 0.01, 0.05))
    point = np.array([[20.0, 5.0, 1.0]])
    seen_at_start = (np.linalg.inv(transform((0, 0, 0))) @ np.append(point, 1.0))[None, :3]
    at_end = (np.linalg.inv(T) @ np.append(point, 1.0))[:3]
    assert deskew(seen_at_start, np.array([-0.1]), T, 0.1)[0] == pytest.approx(at_end, abs=0.02)
    assert deskew(point, np.array([0.0]), T, 0.1)[0] == pytest.approx(point[0])


def motion(start, end, is_valid=True, x=0.1):
    T = transform((x, 0, 0))
    return LidarOdometry(end * 100_000_000, start * 100_000_000, T, np.eye(6) * 1e-6, is_valid, "", 100)


def test_spans_join_what_follows_and_break_where_it_does_not():
    link = LidarLink(CONFIG.placement.lidar_link)
    for k in range(0, 10, 2):
        link.add(motion(k, k + 2))
    spans = link.take(2**62)
    assert [(s.start_ns, s.end_ns) for s in spans] == [(0, 1_000_000_000)]
    assert spans[0].T_start_end[0, 3] == pytest.approx(0.5)
    for bad in (motion(12, 14, is_valid=False), motion(12, 14, x=np.nan), motion(14, 12)):
        for k in (10, 12, 14, 16):
            link.add(bad if k == 12 else motion(k, k + 2))
        assert link.take(2**62) == []
        link.clear()


def test_lidar_carries_the_machine_through_an_outage():
    truth = drive(18, legs=[(4.0, 0.0, 0.0), (100.0, 2.0, 0.0)], wrongs=Wrongs(seed=2))
    cut = [m for m in truth.messages if m[1] != "gnss/main" or m[2].stamp_ns < START_NS + 10_000_000_000]
    node, rng, world = LidarOdometryNode(tractor(), "front", CONFIG.lidar_odometry), np.random.default_rng(0), yard()

    def look(stamp_ns):
        is_due = stamp_ns > START_NS + 200_000_000 and (stamp_ns - START_NS) % 200_000_000 == 0
        return scan(truth, stamp_ns, world, rng) if is_due else None

    with_lidar, without = errors(run(cut, lidar=(node, look)), truth), errors(run(cut), truth)
    assert np.max(np.abs(with_lidar.p_m[:, :2])) < 0.05
    assert np.abs(with_lidar.p_m[-1, 0]) <= np.abs(without.p_m[-1, 0]) + 0.01
    assert with_lidar.level_m[-1] < 0.7 * without.level_m[-1]
    assert np.all(np.linalg.norm(with_lidar.p_m[:, :2], axis=1) < with_lidar.level_m)


def test_an_unknown_sensor_is_named():
    with pytest.raises(ConfigError, match="top"):
        LidarOdometryNode(tractor(), "top", CONFIG.lidar_odometry)


@pytest.mark.skipif(not KITTI.is_dir(), reason="no kitti-seq-pcd")
def test_a_turning_car_on_real_scans():
    """KITTI 2011_09_26_drive_0005, the first second: a bend at about 12 km/h (10 Hz: 0.33 m, 0.75° a scan)."""
    cfg = MATCHING.model_copy(update={"largest_step_m": 2.0, "largest_turn_deg": 10.0, "kernel_m": 0.5})
    matcher, step, before, found = ScanMatcher(cfg), np.eye(4), np.eye(4), []
    for path in sorted(KITTI.glob("*.npz"))[:9]:
        p = np.load(path)["xyz_5mm"].astype(np.float64)[::3] * 0.005
        r = np.linalg.norm(p, axis=1)
        matcher.match(p[(p[:, 2] > -1.3) & (p[:, 2] < 2.0) & (r > 3) & (r < 50)], step)
        step, before = np.linalg.inv(before) @ matcher.T_local_body, matcher.T_local_body
        found.append(step)
    way = np.array([T[0, 3] for T in found[1:]])
    turn = np.degrees([np.arctan2(T[1, 0], T[0, 0]) for T in found[1:]])
    assert np.all(np.abs(way - 0.33) < 0.06)
    assert np.all(np.abs(turn - 0.75) < 0.2)
    assert np.all(np.abs([T[1, 3] for T in found[1:]]) < 0.06)

"""Lidar odometry: accuracy, and rejection in degenerate surroundings."""

import itertools

import numpy as np
import pytest

from geometry.transforms import transform
from localization.lidar.lidar_odometry import LidarOdometryNode
from localization.lidar.odometry_spans import OdometrySpans
from localization.lidar.scan_matching import ScanMatcher, deskew, rejection_of
from messages.errors import ConfigError
from messages.motion import LidarOdometry
from tests.localization.harness import StubInbox, configuration, errors, run
from tests.localization.synthetic_drive import START_NS, SensorErrors, drive, tractor
from tests.localization.synthetic_surroundings import corridor, relative, scan, yard
from tests.recordings import DATA, needs

CONFIG = configuration()
MATCHING = CONFIG.lidar_odometry.matching
KITTI = DATA / "kitti-seq-pcd" / "frames"


def motions_in(world, seconds=6.0):
    """Lidar motions at walking pace without `odom`."""
    truth = drive(seconds, legs=[(0.5, 0.0, 0.0), (100.0, 1.5, 0.05)], sensor_errors=SensorErrors(seed=2))
    node, rng, out = LidarOdometryNode(tractor(), None, CONFIG.lidar_odometry), np.random.default_rng(0), []
    for k in range(2, int(seconds * 10) - 2, 2):
        stamp_ns = START_NS + k * 100_000_000
        pair = scan(truth, stamp_ns, world, rng)
        out += [m for _, m in node.step(stamp_ns, StubInbox([("lidar/front", pair[0]), ("ground/front", pair[1])]))]
    return truth, out


def test_accuracy_in_yard():
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


def test_straight_hedge_is_degenerate():
    _, motions = motions_in(corridor(), seconds=3.0)
    assert motions
    assert not any(m.is_valid and m.covariance[3, 3] < 0.02**2 for m in motions)
    assert any("degenerate" in m.reason for m in motions)


@pytest.mark.parametrize("world", [np.zeros((0, 3)), yard()[:: 12000 // 60]])
def test_too_few_points_are_invalid(world):
    _, motions = motions_in(world, seconds=2.0)
    assert motions
    assert not any(m.is_valid for m in motions)
    assert all("returns" in m.reason for m in motions)


def test_gap_starts_new_map():
    truth = drive(4, legs=[(100.0, 0.0, 0.0)])
    node, rng, world = LidarOdometryNode(tractor(), None, CONFIG.lidar_odometry), np.random.default_rng(0), yard()
    counts = []
    for k in (2, 4, 12, 14):
        pair = scan(truth, START_NS + k * 100_000_000, world, rng)
        counts.append(len(list(node.step(0, StubInbox([("lidar/front", pair[0]), ("ground/front", pair[1])])))))
    assert counts == [0, 1, 0, 1]


def test_covariance_of_wall_and_corner():
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(-20, 20, 3000), 5 + rng.normal(0, 0.02, 3000), rng.uniform(0, 2, 3000)])
    sigma = {}
    for name, points in (("wall", wall), ("corner", np.vstack([wall, wall[:, [1, 0, 2]]]))):
        matcher = ScanMatcher(MATCHING, np.zeros(3))
        results = [matcher.match(points, np.eye(4)) for _ in range(4)]
        sigma[name] = np.sqrt(np.diag(results[-1].covariance)[3:5])
    assert sigma["wall"][0] > 0.2 or "degenerate" in results[-1].reason
    assert sigma["wall"][1] < 0.02
    assert max(sigma["corner"]) < 0.02


def test_rings_on_a_fence_are_no_standstill():
    """A fence along the path and some posts: rings that move with the lidar must not hold the match back."""
    matcher, rng = ScanMatcher(MATCHING, np.array([0.0, 0.0, 2.0])), np.random.default_rng(3)
    posts = np.column_stack([rng.uniform(-40, 60, 25), rng.choice([-9.0, 9.0], 25) + rng.uniform(-1, 1, 25)])
    moved = []
    for k in range(25):
        x = 0.0 if k < 6 else 0.15 * (k - 5)
        azimuth = np.radians(np.arange(10.0, 170.0, 0.4))
        rings = [np.column_stack([8.0 / np.tan(azimuth), np.full(len(azimuth), 8.0), np.full(len(azimuth), z)])
                 for z in (0.5, 0.9, 1.3, 1.7)]  # fmt: skip
        angles = np.linspace(0, 2 * np.pi, 12)
        around = [np.column_stack([p[0] - x + 0.1 * np.cos(angles), p[1] + 0.1 * np.sin(angles), np.full(12, z)])
                  for p in posts for z in (0.5, 0.9, 1.3, 1.7)]  # fmt: skip
        points = np.vstack([*rings, *around])
        points = points[np.linalg.norm(points, axis=1) < 50.0] + rng.normal(0, 0.01, (1, 3))
        before = matcher.T_local_body
        match = matcher.match(points, transform((0.6 * (0.15 if k >= 6 else 0.0), 0, 0)))  # wheels say too little
        moved.append((np.linalg.inv(before) @ match.T_local_body)[0, 3])
    assert np.abs(np.sum(moved) - 0.15 * 19) < 0.1


def test_lost_matcher_begins_a_new_map():
    rng = np.random.default_rng(4)
    one, other = yard(), yard() @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [7.0, 3.0, 0.0]
    matcher, reasons = ScanMatcher(MATCHING, np.zeros(3)), []
    for k in range(24):
        points = (one if k < 8 else other) + rng.normal(0, 0.01, (1, 3))
        reasons.append(matcher.match(points, np.eye(4)).reason)
    assert not any(reasons[2:8])
    assert all(reasons[8 : 8 + MATCHING.lost_scans])
    assert not any(reasons[-6:])


@pytest.mark.parametrize(("share", "is_rejected"), [(0.97, False), (0.999, False), (1.001, True), (1.03, True)])
def test_rejection_limits(share, is_rejected):
    small, many = np.eye(3) * 1e-8, MATCHING.min_points
    assert bool(rejection_of(np.array([0.0, share * MATCHING.max_step_m, 0.0]), small, many, MATCHING)) is is_rejected
    turn = np.array([0.0, 0.0, share * np.radians(MATCHING.max_turn_deg)])
    assert bool(rejection_of(turn, small, many, MATCHING)) is is_rejected
    weak = small.copy()
    weak[1, 1] = (share * MATCHING.max_sigma_m) ** 2
    assert bool(rejection_of(np.zeros(3), weak, many, MATCHING)) is is_rejected
    assert rejection_of(np.zeros(3), small, many - 1, MATCHING)


def test_deskew_to_end_of_sweep():
    T = transform((0.5, 0.02, 0.0), (0.0, 0.01, 0.05))
    point = np.array([[20.0, 5.0, 1.0]])
    seen_at_start = (np.linalg.inv(transform((0, 0, 0))) @ np.append(point, 1.0))[None, :3]
    at_end = (np.linalg.inv(T) @ np.append(point, 1.0))[:3]
    assert deskew(seen_at_start, np.array([-0.1]), T, 0.1)[0] == pytest.approx(at_end, abs=0.02)
    assert deskew(point, np.array([0.0]), T, 0.1)[0] == pytest.approx(point[0])


def motion(start, end, is_valid=True, x=0.1):
    T = transform((x, 0, 0))
    return LidarOdometry(end * 100_000_000, start * 100_000_000, T, np.eye(6) * 1e-6, is_valid, "", 100)


def test_odometry_spans_join_consecutive_motions():
    odometry_spans = OdometrySpans(CONFIG.map_alignment.odometry_spans)
    for k in range(0, 10, 2):
        odometry_spans.add(motion(k, k + 2))
    spans = odometry_spans.take(2**62)
    assert [(s.start_ns, s.end_ns) for s in spans] == [(0, 1_000_000_000)]
    assert spans[0].T_start_end[0, 3] == pytest.approx(0.5)
    for bad in (motion(12, 14, is_valid=False), motion(12, 14, x=np.nan), motion(14, 12)):
        for k in (10, 12, 14, 16):
            odometry_spans.add(bad if k == 12 else motion(k, k + 2))
        assert odometry_spans.take(2**62) == []
        odometry_spans.clear()


def test_gnss_outage_with_lidar_odometry():
    truth = drive(18, legs=[(4.0, 0.0, 0.0), (100.0, 2.0, 0.0)], sensor_errors=SensorErrors(seed=2))
    cut = [m for m in truth.messages if m[1] != "gnss/main" or m[2].stamp_ns < START_NS + 10_000_000_000]
    node, rng, world = LidarOdometryNode(tractor(), None, CONFIG.lidar_odometry), np.random.default_rng(0), yard()

    def simulate(stamp_ns):
        is_due = stamp_ns > START_NS + 200_000_000 and (stamp_ns - START_NS) % 200_000_000 == 0
        return scan(truth, stamp_ns, world, rng) if is_due else None

    with_lidar, without = errors(run(cut, lidar=(node, simulate)), truth), errors(run(cut), truth)
    assert np.max(np.abs(with_lidar.p_m[:, :2])) < 0.05
    assert np.abs(with_lidar.p_m[-1, 0]) <= np.abs(without.p_m[-1, 0]) + 0.01
    assert with_lidar.level_m[-1] < 0.7 * without.level_m[-1]
    assert np.all(np.linalg.norm(with_lidar.p_m[:, :2], axis=1) < with_lidar.level_m)


def test_unknown_sensor_raises():
    with pytest.raises(ConfigError, match="top"):
        LidarOdometryNode(tractor(), None, CONFIG.lidar_odometry.model_copy(update={"sensor": "top"}))


@needs("kitti-seq-pcd/frames")
def test_matching_of_kitti_scans():
    """KITTI 2011_09_26_drive_0005, the first second: a bend at about 12 km/h (10 Hz: 0.33 m, 0.75° a scan)."""
    cfg = MATCHING.model_copy(update={"max_step_m": 2.0, "max_turn_deg": 10.0})
    matcher, step, before, found = ScanMatcher(cfg, np.zeros(3)), np.eye(4), np.eye(4), []
    for path in sorted(KITTI.glob("*.npz"))[:9]:
        p = np.load(path)["xyz_5mm"].astype(np.float64)[::3] * 0.005
        r = np.linalg.norm(p, axis=1)
        matcher.match(p[(p[:, 2] > -1.3) & (p[:, 2] < 2.0) & (r > 3) & (r < 50)], step)
        step, before = np.linalg.inv(before) @ matcher.T_local_body, matcher.T_local_body
        found.append(step)
    forward = np.array([T[0, 3] for T in found[1:]])
    turn = np.degrees([np.arctan2(T[1, 0], T[0, 0]) for T in found[1:]])
    assert np.all(np.abs(forward - 0.33) < 0.06)
    assert np.all(np.abs(turn - 0.75) < 0.2)
    assert np.all(np.abs([T[1, 3] for T in found[1:]]) < 0.06)

"""Radar from echoes of an independent forward model to obstacles: ego-motion compensation, clutter rejection."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.strict import load, parse, read_yaml
from configs.vehicle import Mount, Radar, Vehicle
from geometry.transforms import planar
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.perception import HealthState, SensorHealth
from messages.sensors import RadarScan
from perception.radar.clusters import find_clusters
from perception.radar.doppler import Echoes, estimate_velocity, sensor_velocity, to_base, usable
from perception.radar.health import RadarHealth
from perception.radar.obstacles import RadarConfig, RadarObstacles
from runtime.bus import NodeInbox

ROOT = Path(__file__).parents[3]
CONFIG = parse(RadarConfig, read_yaml(ROOT / "configs/stack/perception.yaml")["radar"], "stack/perception.yaml")
VEHICLE = load(Vehicle, ROOT / "configs" / "machines" / "tractor_e.yaml")
RADAR = Radar(
    mount=Mount(xyz_m=(3.4, 0.3, 0.9), rpy_deg=(0.0, 0.0, 10.0)), field_of_view_deg=120.0, rate_hz=20.0,
    range_m=(0.3, 60.0), range_sigma_m=0.1, azimuth_sigma_deg=1.0, doppler_sigma_mps=0.1,
)  # fmt: skip
S = 1_000_000_000
CYCLE = S // 20


def odometry(
    stamp_ns: int, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, v: float = 0.0, w: float = 0.0
) -> Odometry:
    return Odometry(stamp_ns, planar(x, y, yaw), v, 0.0, 0.0, w, 0.0, np.zeros((6, 6)))


def echo(
    odom: Odometry, p: tuple[float, float], v: tuple[float, float], rng: np.random.Generator | None = None
) -> list[float]:
    """Measurement of a point at `p` with velocity `v` in `odom`; Doppler by a finite difference in time."""
    dt, T = 1e-4, odom.T_odom_base
    yaw = math.atan2(T[1, 0], T[0, 0])
    later = planar(
        T[0, 3] + odom.speed_mps * math.cos(yaw) * dt, T[1, 3] + odom.speed_mps * math.sin(yaw) * dt,
        yaw + odom.yaw_rate_radps * dt,
    )  # fmt: skip
    places = []
    for pose, t in ((T, 0.0), (later, dt)):
        sensor = np.linalg.inv(pose @ RADAR.mount.T_base_sensor)
        places.append((sensor @ [p[0] + v[0] * t, p[1] + v[1] * t, RADAR.mount.xyz_m[2], 1.0])[:3])
    near, far = (float(np.linalg.norm(q)) for q in places)
    noise = rng.normal(0.0, (0.1, math.radians(1.0), 0.1)) if rng is not None else np.zeros(3)
    azimuth = math.atan2(places[0][1], places[0][0])
    return [near + noise[0], azimuth + noise[1], 0.0, (far - near) / dt + noise[2], 0.0]


def scan(stamp_ns: int, rows: list[list[float]]) -> RadarScan:
    return RadarScan(stamp_ns, *np.array(rows, np.float64).reshape(-1, 5).T.copy())


@given(
    st.floats(5.0, 50.0), st.floats(-0.9, 0.9), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-2.0, 5.0),
    st.floats(-0.5, 0.5), st.floats(-3.0, 3.0),
)  # fmt: skip
@settings(derandomize=True, max_examples=100)
def test_ego_motion_compensation(r: float, a: float, vx: float, vy: float, v: float, w: float, yaw: float) -> None:
    odom = odometry(S, 7.0, -4.0, yaw, v, w)
    p = odom.T_odom_base @ [3.4 + r * math.cos(a), 0.3 + r * math.sin(a), 0.0, 1.0]
    one = scan(S, [echo(odom, (p[0], p[1]), (vx, vy))])
    T = RADAR.mount.T_base_sensor
    targets = to_base(one, np.ones(1, bool), T, sensor_velocity(odom, T))
    np.testing.assert_allclose(targets.p_base_m[0, :2], [3.4 + r * math.cos(a), 0.3 + r * math.sin(a)], atol=1e-6)
    line_of_sight = odom.T_odom_base[:2, :2] @ [math.cos(a), math.sin(a)]
    assert targets.radial_mps[0] == pytest.approx(line_of_sight @ [vx, vy], abs=2e-3)


def test_ego_velocity_from_static_majority() -> None:
    rng = np.random.default_rng(1)
    odom = odometry(S, v=2.0, w=0.2)
    rows = [echo(odom, (x, y), (0.0, 0.0), rng) for x, y in rng.uniform((8, -15), (40, 15), (30, 2))]
    rows += [echo(odom, (x, y), (3.0, 1.0), rng) for x, y in rng.uniform((8, -15), (40, 15), (10, 2))]
    which = usable(scan(S, rows), RADAR.range_m, 1.1)
    velocity, agrees = estimate_velocity(scan(S, rows), which, 0.3)
    wanted = RADAR.mount.T_base_sensor[:2, :2].T @ sensor_velocity(odom, RADAR.mount.T_base_sensor)[:2]
    np.testing.assert_allclose(velocity, wanted, atol=0.15)
    assert agrees[: 30 - int((~which[:30]).sum())].mean() > 0.9
    none, _ = estimate_velocity(scan(S, rows[:1]), np.ones(1, bool), 0.3)
    assert np.isnan(none).all()


def test_walking_person_beside_post() -> None:
    odom = odometry(S, v=1.5)
    rows = [
        echo(odom, (15.0, 0.0), (0.0, 0.0)),
        echo(odom, (15.3, 0.1), (-1.4, 0.0)),
        echo(odom, (15.2, 0.2), (0.0, 0.0)),
    ]
    one, T = scan(S, rows), RADAR.mount.T_base_sensor
    found = find_clusters(to_base(one, np.ones(3, bool), T, sensor_velocity(odom, T)), 0.017, CONFIG.clusters)
    assert sorted(found.count.tolist()) == [1, 2]
    assert sorted(np.abs(found.radial_mps).round(1).tolist()) == [0.0, 1.4]


@given(
    st.lists(st.tuples(st.floats(1, 50), st.floats(-1, 1), st.floats(-3, 3)), max_size=12),
    st.randoms(use_true_random=False),
)
@settings(derandomize=True, max_examples=60)
def test_clusters_invariant_to_order(items: list[tuple[float, float, float]], order) -> None:
    def partition(rows: list[tuple[float, float, float]]) -> list[tuple[int, float]]:
        r, a, v = np.array(rows, np.float64).reshape(-1, 3).T.copy()
        line_of_sight = np.stack([np.cos(a), np.sin(a)], axis=1)
        p = np.concatenate([r[:, None] * line_of_sight, np.zeros((len(r), 1))], axis=1)
        found = find_clusters(Echoes(p, line_of_sight, r, a, v, np.zeros(len(r))), 0.02, CONFIG.clusters)
        return sorted(zip(found.count.tolist(), found.range_m.round(9).tolist(), strict=True))

    shuffled = list(items)
    order.shuffle(shuffled)
    assert partition(shuffled) == partition(items)
    assert sum(n for n, _ in partition(items)) == len(items)


def test_min_cross_section() -> None:
    odom = odometry(S)
    for rcs, n in ((CONFIG.clusters.min_rcs_dbsm - 0.1, 0), (CONFIG.clusters.min_rcs_dbsm, 1)):
        row = echo(odom, (15.0, 0.0), (0.0, 0.0))
        row[4] = rcs
        T = RADAR.mount.T_base_sensor
        assert (
            len(find_clusters(to_base(scan(S, [row]), np.ones(1, bool), T, np.zeros(3)), 0.017, CONFIG.clusters)) == n
        )


def drive(
    targets: list[tuple[tuple[float, float], tuple[float, float]]], cycles: int = 40, clutter: int = 5, seed: int = 0
):
    """Last message of a drive at 2 m/s in a slight bend past targets (initial position, velocity) in `odom`."""
    rng = np.random.default_rng(seed)
    node = RadarObstacles("front", RADAR, VEHICLE, None, CONFIG)
    x = y = yaw = 0.0
    for k in range(cycles):
        stamp, v, w = S + k * CYCLE, 2.0, 0.05
        odom = odometry(stamp, x, y, yaw, v, w)
        rows = [echo(odom, (p[0] + u[0] * k / 20, p[1] + u[1] * k / 20), u, rng) for p, u in targets]
        rows += [
            [rng.uniform(2, 60), rng.uniform(-1, 1), 0.0, rng.uniform(-5, 2), rng.uniform(-15, -5)]
            for _ in range(clutter)
        ]
        obstacles = node.process(scan(stamp, rows), odom)
        last = odom
        x, y, yaw = x + v / 20 * math.cos(yaw + w / 40), y + v / 20 * math.sin(yaw + w / 40), yaw + w / 20
    return obstacles, last


def test_velocity_of_moving_and_static_targets() -> None:
    crossing, post = ((20.0, -3.0), (0.0, 1.5)), ((22.0, 6.0), (0.0, 0.0))
    obstacles, odom = drive([crossing, post])
    for (p, v), fastest_error in ((crossing, 0.9), (post, 0.9)):
        place = np.linalg.inv(odom.T_odom_base) @ [p[0] + v[0] * 39 / 20, p[1] + v[1] * 39 / 20, 0.0, 1.0]
        gap = np.hypot(*(obstacles.center_base_m[:, :2] - place[:2]).T)
        k = int(gap.argmin())
        assert gap[k] < 1.0
        published = odom.T_odom_base[:2, :2] @ obstacles.velocity_mps[k]
        assert np.hypot(*(published - np.array(v))) < fastest_error
        assert (obstacles.sigma_m[k] > 0).all()
        assert obstacles.sigma_m[k, 1] > obstacles.sigma_m[k, 0]  # bearing is the weaker part
    np.testing.assert_allclose(obstacles.class_scores.sum(axis=1), 1.0)


def test_part_of_a_fence_in_view_that_changes_is_no_motion() -> None:
    node, fence = RadarObstacles("front", RADAR, VEHICLE, None, CONFIG), np.arange(-4.0, 5.0, 0.7)
    moving = 0
    for k in range(60):
        odom, begin = odometry(S + k * CYCLE), -3.5 + 1.5 * k / 20  # the view goes along the fence at 1.5 m/s
        rows = [echo(odom, (10.0, y), (0.0, 0.0)) for y in fence if begin <= y <= begin + 3.5]
        obstacles = node.process(scan(S + k * CYCLE, rows), odom)
        moving += int(np.isfinite(obstacles.velocity_mps).any())
        assert (obstacles.sigma_m[:, 1] > 0.7).all()
    assert moving == 0


def test_obstacle_rate_from_clutter() -> None:
    ghosts = sum(len(drive([], cycles=30, clutter=8, seed=seed)[0].yaw_rad) for seed in range(10))
    assert ghosts <= 1


def test_confirmation_and_reset_on_time_reversal() -> None:
    node = RadarObstacles("front", RADAR, VEHICLE, None, CONFIG)
    row = [echo(odometry(S), (15.0, 0.0), (0.0, 0.0))]
    published = [len(node.process(scan(S + k * CYCLE, row), odometry(S + k * CYCLE)).yaw_rad) for k in range(6)]
    assert published == [0, 0, 0, 1, 1, 1]
    assert len(node.process(scan(S, row), odometry(S)).yaw_rad) == 0


def test_invalid_detections() -> None:
    row = echo(odometry(S), (15.0, 0.0), (0.0, 0.0))
    bad = [[*row[:i], value, *row[i + 1 :]] for i in (0, 1, 3, 4) for value in (math.nan, math.inf)]
    assert not usable(scan(S, bad), RADAR.range_m, 1.05).any()
    no_elevation = [*row[:2], math.nan, *row[3:]]
    assert usable(scan(S, [no_elevation, row]), RADAR.range_m, 1.05).all()
    edges = [[r, a, 0.0, 0.0, 0.0] for r, a in ((0.3, 0.0), (60.0, 1.0), (0.29, 0.0), (60.1, 0.0), (5.0, 1.06))]
    assert usable(scan(S, edges), RADAR.range_m, 1.05).tolist() == [True, True, False, False, False]
    node = RadarObstacles("front", RADAR, VEHICLE, None, CONFIG)
    for k in range(6):
        assert len(node.process(scan(S + k * CYCLE, bad), odometry(S + k * CYCLE)).yaw_rad) == 0
    assert len(node.process(scan(2 * S, []), odometry(2 * S)).yaw_rad) == 0


class Bench:
    """Node with an inbox of given messages."""

    def __init__(self, node: RadarHealth | RadarObstacles) -> None:
        self.node, self.inbox = node, NodeInbox(node)

    def put(self, topic: str, message: Message) -> None:
        self.inbox.put(Envelope(topic, 0, message.stamp_ns, message))

    def step(self, now_ns: int) -> list[tuple[str, Message]]:
        self.inbox.now_ns = now_ns
        out = list(self.node.step(now_ns, self.inbox))
        self.inbox.clear()
        return out

    def health(self, now_ns: int) -> SensorHealth:
        ((topic, message),) = self.step(now_ns)
        assert topic == "health/radar_front"
        assert isinstance(message, SensorHealth)
        return message


def test_no_output_without_odometry_or_valid_scan() -> None:
    bench = Bench(RadarObstacles("front", RADAR, VEHICLE, None, CONFIG))
    assert bench.step(S) == []
    one = scan(S, [echo(odometry(S), (15.0, 0.0), (0.0, 0.0))])
    bench.put("radar/front", one)
    assert bench.step(S) == []
    bench.put("odom", odometry(S))
    assert [topic for topic, _ in bench.step(S)] == ["obstacles/radar_front"]
    bench.put("radar/front", replace(one, stamp_ns=2 * S, rcs_dbsm=np.zeros(3)))
    assert bench.step(2 * S) == []


def test_radar_health() -> None:
    bench = Bench(RadarHealth("front", RADAR, CONFIG))
    assert bench.health(S).reason == "no cycle yet"
    world = [(x, y) for x in (10.0, 20.0, 30.0) for y in (-6.0, -2.0, 2.0, 6.0)]

    def cycle(stamp_ns: int, speed: float, rows: list[list[float]]) -> SensorHealth:
        bench.put("odom", odometry(stamp_ns, v=speed))
        bench.put("radar/front", scan(stamp_ns, rows))
        return bench.health(stamp_ns)

    good = cycle(2 * S, 2.0, [echo(odometry(S, v=2.0), p, (0.0, 0.0)) for p in world])
    assert (good.state, good.detection_range_m.tolist()) == (HealthState.GOOD, [CONFIG.health.detection_range_m])
    assert good.sector_edges_rad[1] - good.sector_edges_rad[0] == pytest.approx(math.radians(120))
    off = cycle(3 * S, 2.0, [echo(odometry(S, v=4.0), p, (0.0, 0.0)) for p in world])
    assert (off.state, off.reason) == (HealthState.DEGRADED, "Doppler does not fit the odometry")
    cycle(4 * S, 2.0, [echo(odometry(S, v=2.0), p, (0.0, 0.0)) for p in world])
    limit = 4 * S + round(CONFIG.health.blocked_s * S)
    assert cycle(limit, 2.0, []).state is HealthState.GOOD
    covered = cycle(limit + 1, 2.0, [])
    assert (covered.state, covered.reason) == (HealthState.BLIND, "no echo while moving: covered")
    assert not covered.detection_range_m.any()
    assert cycle(limit + S, 0.0, []).state is HealthState.GOOD  # at rest, no echo is required
    bench.put("radar/front", RadarScan(limit + S, *(np.zeros(n) for n in (2, 2, 2, 3, 2))))
    assert bench.health(limit + S).rejected_count == 1
    silent = bench.health(limit + S + round(CONFIG.health.timeout_s * S) + 1)
    assert (silent.state, silent.reason) == (HealthState.BLIND, "no cycles any more")

"""The tracker at 10 Hz and 2.5 Hz: confirmation in seconds, speed, identity, walls, noise and several sensors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.transforms import planar
from messages.perception import ObstacleClass, Obstacles
from perception.class_order import CLASSES
from perception.fusion.kalman import box_noise, correct, distances, predict
from perception.fusion.tracker import Tracker
from perception.fusion.tracks import is_upright, is_view
from perception.lidar.classes import class_scores
from tests.perception.lidar_scenes import TRACKER_CONFIG, Feed, odometry

START = 5_000_000_000
NS = 1_000_000_000
LIDAR = "obstacles/lidar_front"
RADAR = "obstacles/radar_front"


def message(stamp_ns, centers, sizes=(0.4, 0.4, 1.7), returns=30, yaw=0.0, sensor="lidar_front", velocity=None, seed=0):
    """Obstacles in `base` with returns spread over their boxes."""
    centers = np.asarray(centers, float).reshape(-1, 3)
    k = len(centers)
    sizes = np.broadcast_to(np.asarray(sizes, float), (k, 3)).copy()
    yaws = np.broadcast_to(np.asarray(yaw, float), (k,)).copy()
    rng = np.random.default_rng(seed)
    local = rng.uniform(-0.5, 0.5, (k, returns, 3)) * sizes[:, None]
    c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    points = local.copy()
    points[..., 0], points[..., 1] = c * local[..., 0] - s * local[..., 1], s * local[..., 0] + c * local[..., 1]
    points = (points + centers[:, None]).reshape(-1, 3).astype(np.float32)
    scores = np.full((k, 8), 0.4 / 7)
    scores[:, 1] = 0.6
    speeds = np.full((k, 2), np.nan) if velocity is None else np.broadcast_to(velocity, (k, 2)).astype(float)
    return Obstacles(
        stamp_ns, sensor, stamp_ns, centers.copy(), sizes, yaws, centers.copy(), speeds.copy(), scores,
        (np.arange(k + 1) * returns).astype(np.int32), np.arange(k * returns, dtype=np.int32), points,
    )  # fmt: skip


def run(tracker, scans, topic=LIDAR, poses=None):
    """Feeds messages and returns the tracks published after each."""
    published = []
    for i, m in enumerate(scans):
        odom = odometry(m.stamp_ns, T=None if poses is None else poses[i])
        feed = Feed(odom=odom)
        feed.topics[topic] = (m,)
        published.append(dict(tracker.step(m.stamp_ns, feed))["tracks"])
    return published


def new_tracker(*topics):
    return Tracker(topics or (LIDAR,), TRACKER_CONFIG)


def stamps(rate_hz, seconds):
    return [START + round(i * NS / rate_hz) for i in range(int(seconds * rate_hz) + 1)]


RATES = pytest.mark.parametrize("rate_hz", [20.0, 10.0, 5.0, 2.5])


@RATES
def test_confirmation_time_by_rate(rate_hz):
    published = run(new_tracker(), [message(t, [[12.0, 1.0, 0.9]], returns=10, seed=t) for t in stamps(rate_hz, 2.0)])
    first = next(i for i, t in enumerate(published) if t.tracks[0].is_confirmed)
    assert (published[first].stamp_ns - START) / NS <= max(0.3, 1.0 / rate_hz) + 1e-9
    assert first >= 1
    assert {t.id for m in published for t in m.tracks} == {1}


@RATES
@pytest.mark.parametrize("speed", [(1.4, 0.0), (0.0, -1.5), (-5.0, 2.0)])
def test_velocity_estimate(rate_hz, speed):
    v = np.array([*speed, 0.0])
    rng = np.random.default_rng(1)
    scans = [
        message(t, [[20.0, 3.0, 0.9] + v * (t - START) / NS + [*rng.normal(0, 0.05, 2), 0.0]], seed=i)
        for i, t in enumerate(stamps(rate_hz, 3.0))
    ]
    last = run(new_tracker(), scans)[-1].tracks
    assert len(last) == 1
    assert last[0].velocity_mps == pytest.approx(speed, abs=0.4)
    assert last[0].is_confirmed


@RATES
def test_static_obstacles_from_moving_machine(rate_hz):
    """The visible 20 m of a long fence move with the machine."""
    poses = [planar(2.8 * (t - START) / NS, 0.0, 0.0) for t in stamps(rate_hz, 4.0)]
    rng = np.random.default_rng(2)
    scans = []
    for i, t in enumerate(stamps(rate_hz, 4.0)):
        fence = message(t, [[12.0, 4.0, 1.0]], (20.0, 0.2, 1.5), returns=600, seed=i)
        pole = np.array([30.0 - poses[i][0, 3], -3.0, 1.0]) + np.array([*rng.normal(0, 0.03, 2), 0.0])
        scans.append(_joined(t, fence, message(t, [pole], (0.2, 0.2, 2.0), seed=i)))
    published = run(new_tracker(), scans, poses=poses)
    assert len(published[-1].tracks) == 2
    for tracks in published[round(2.0 * rate_hz) :]:
        assert np.hypot(*np.array([t.velocity_mps for t in tracks.tracks]).T).max() < 0.8


def _joined(stamp_ns, a, b):
    def stack(name):
        return np.concatenate([getattr(a, name), getattr(b, name)])

    return Obstacles(
        stamp_ns, a.sensor, stamp_ns, stack("center_base_m"), stack("size_m"), stack("yaw_rad"),
        stack("nearest_base_m"), stack("velocity_mps"), stack("class_scores"),
        np.concatenate([a.offsets, b.offsets[1:] + a.offsets[-1]]).astype(np.int32),
        np.concatenate([a.indices, b.indices + a.offsets[-1]]).astype(np.int32), stack("points_base_m"),
    )  # fmt: skip


@pytest.mark.parametrize("rate_hz", [10.0, 2.5])
def test_noise_is_not_confirmed(rate_hz):
    rng = np.random.default_rng(3)
    scans = []
    for t in stamps(rate_hz, 10.0):
        places = np.column_stack([rng.uniform(-40, 40, (20, 2)), np.ones(20)])
        scans.append(message(t, places, (0.4, 0.3, 0.5), returns=3, seed=t))
    assert not any(t.is_confirmed for m in run(new_tracker(), scans) for t in m.tracks)


def test_single_scan_unconfirmed_and_deletion_time():
    tracker = new_tracker()
    empty = np.zeros((0, 3))
    scans = [message(t, [[12.0, 1.0, 0.9]] if t < START + NS else empty) for t in stamps(10, 3.0)]
    published = run(tracker, scans)
    assert not published[0].tracks[0].is_confirmed
    assert published[10].tracks[0].is_confirmed
    gone = next(m.stamp_ns for m in published if m.stamp_ns > START + NS and not m.tracks)
    assert (gone - START) / NS == pytest.approx(0.9 + TRACKER_CONFIG.kinds["lidar"].keep_s, abs=0.21)


def test_crossing_tracks_keep_ids():
    scans = []
    for t in stamps(10, 4.0):
        s = (t - START) / NS
        scans.append(message(t, [[10.0 + 0.6, -3.0 + 1.5 * s, 0.9], [10.0 - 0.6, 3.0 - 1.5 * s, 0.9]], seed=t))
    published = run(new_tracker(), scans)
    assert [t.id for t in published[-1].tracks] == [1, 2]
    assert published[-1].tracks[0].p_odom_m[1] > 2.0


def test_half_second_gap_keeps_track():
    times = [t for t in stamps(10, 3.0) if not START + 1.2 * NS < t < START + 1.8 * NS]
    published = run(new_tracker(), [message(t, [[12.0, 1.5 * (t - START) / NS, 0.9]], seed=t) for t in times])
    assert {t.id for m in published for t in m.tracks} == {1}


def test_velocity_reset_after_gap():
    there = [message(t, [[10.0, 3.0, 0.1]], (0.2, 0.1, 0.1)) for t in stamps(10.0, 0.5)]
    elsewhere = message(there[-1].stamp_ns + round(0.7 * NS), [[10.4, 3.4, 0.1]], (0.2, 0.1, 0.1))
    published = run(new_tracker(), [*there, elsewhere])
    assert np.hypot(*published[-1].tracks[0].velocity_mps) == 0.0


def test_single_jump_is_no_motion():
    tracker = new_tracker()
    scans = [message(t, [[10.0, 3.0, 0.9]]) for t in stamps(10.0, 0.1)]
    run(tracker, [*scans, message(scans[-1].stamp_ns + NS // 10, [[10.7, 3.0, 0.9]])])
    published = run(tracker, [message(tracker._stamp_ns + i * NS // 10, []) for i in range(1, 4)])
    for track in (k for tracks in published for k in tracks.tracks):
        assert np.hypot(*track.velocity_mps) == 0.0
        assert track.p_odom_m[0] == pytest.approx(10.7, abs=0.15)


@pytest.mark.parametrize(("width_m", "expected_mps"), [(0.08, 0.0), (1.5, 3.0)])
def test_strip_moving_along_itself(width_m, expected_mps):
    scans = [message(t, [[10.0 + 3.0 * (t - START) / NS, 4.0, 0.6]], (3.0, width_m, 1.2)) for t in stamps(10.0, 1.0)]
    published = run(new_tracker(), scans)
    assert published[-1].tracks[0].velocity_mps[0] == pytest.approx(expected_mps, abs=0.6)


@pytest.mark.parametrize("is_left_empty", [True, False])
def test_occupied_trail_contradicts_motion(is_left_empty):
    def scan(i, t):
        moving = [10.0 + 0.3 * i, 4.0, 1.0]
        behind = [[moving[0] - 1.2 - 0.3 * k, 4.0, 1.0] for k in range(8)]
        centers = [moving] if is_left_empty else [moving, *behind]
        scores = np.full((len(centers), 8), 1.0 / 8.0)
        return replace(message(t, centers, (0.4, 0.3, 1.2)), class_scores=scores)

    published = run(new_tracker(), [scan(i, t) for i, t in enumerate(stamps(10.0, 1.0))])
    foremost = max(published[-1].tracks, key=lambda k: k.p_odom_m[0])
    assert np.hypot(*foremost.velocity_mps) == pytest.approx(3.0 if is_left_empty else 0.0, abs=0.6)


def test_a_slab_that_is_joined_with_what_it_lies_on_does_not_move():
    """A thing in the shed, in dust (as simulated): first the edge of its top alone is seen, then all of it."""
    edge = [(1.4, 3.6, 0.3)] * 8 + [(1.29, 3.56, 0.45), (1.25, 3.57, 0.5), (1.22, 3.55, 0.58), (1.2, 3.54, 0.63),
                                    (1.18, 3.52, 0.68)]  # fmt: skip
    whole = [(1.32, 3.29), (1.32, 3.23), (1.38, 3.24), (1.49, 3.21), (1.49, 3.21), (1.51, 3.24), (1.35, 3.2)]
    times = stamps(10.0, 0.1 * (len(edge) + len(whole)))
    scans = [
        message(t, [[x, y, 0.92]], (long, 0.05, 0.05), yaw=0.5) for t, (x, y, long) in zip(times, edge, strict=False)
    ]
    scans += [
        message(t, [[x, y, 0.46]], (1.02, 0.88, 0.95)) for t, (x, y) in zip(times[len(edge) :], whole, strict=False)
    ]
    published = run(new_tracker(), scans)
    assert all(not t.velocity_mps.any() for m in published for t in m.tracks)


def test_one_contradiction_does_not_stop_a_body_that_moved():
    """Dust behind it fills its trail in single scans."""

    def scan(i, t):
        moving = [10.0 + 0.3 * i, 4.0, 1.0]
        dust = [[moving[0] - 1.2 - 0.3 * k, 4.0, 1.0] for k in range(8)] if i == 10 else []
        centers = [moving, *dust]
        return replace(message(t, centers, (0.4, 0.3, 1.2)), class_scores=np.full((len(centers), 8), 1.0 / 8.0))

    published = run(new_tracker(), [scan(i, t) for i, t in enumerate(stamps(10.0, 1.6))])
    foremost = [max(m.tracks, key=lambda k: k.p_odom_m[0]) for m in published[9:11]]
    assert [np.hypot(*track.velocity_mps) for track in foremost] == pytest.approx([3.0, 3.0], abs=0.6)


def test_high_pole_is_static():
    def scan(t, height_m):
        pole = np.full((1, 8), 0.02)
        pole[0, 4] = 0.86
        return replace(message(t, [[10.0 + 1.5 * (t - START) / NS, 4.0, 1.0]], (0.1, 0.1, height_m)), class_scores=pole)

    for height_m, expected_mps in ((1.7, 1.5), (2.9, 0.0)):
        published = run(new_tracker(), [scan(t, height_m) for t in stamps(10.0, 1.5)])
        assert np.hypot(*published[-1].tracks[0].velocity_mps) == pytest.approx(expected_mps, abs=0.4)


def test_wall_edge_end_on_is_static():
    def scan(t, width_m, height_m):
        seen = message(t, [[10.0 + 6.0 * (t - START) / NS, 4.0, 1.3]], (width_m, 0.05, height_m))
        return replace(seen, class_scores=np.full((1, 8), 1 / 8))

    for width_m, height_m, expected_mps in ((0.1, 2.6, 0.0), (0.1, 1.7, 6.0), (0.6, 2.6, 6.0)):
        published = run(new_tracker(), [scan(t, width_m, height_m) for t in stamps(10.0, 1.5)])
        assert np.hypot(*published[-1].tracks[0].velocity_mps) == pytest.approx(expected_mps, abs=0.4)


@pytest.mark.parametrize(("hold", "jump_m"), [(3, 1.0), (4, 1.0), (6, 1.0)])
def test_alternating_position_is_static(hold, jump_m):
    places = [[10.0 + jump_m * (i // hold % 2), 4.0, 0.5] for i in range(31)]
    scans = [message(t, [p], (1.0, 0.5, 0.2)) for t, p in zip(stamps(10.0, 3.0), places, strict=True)]
    for published in run(new_tracker(), scans):
        assert all(np.hypot(*track.velocity_mps) == 0.0 for track in published.tracks)


@pytest.mark.parametrize("seed", range(6))
@RATES
def test_structure_separated_otherwise_in_each_scan_is_static(seed, rate_hz):
    """A hedge of 8 m, cut in up to three sections at other places in each scan."""
    rng, scans = np.random.default_rng(seed), []
    for t in stamps(rate_hz, 2.0):
        ends = np.sort([0.0, 8.0, *rng.uniform(0.5, 7.5, rng.integers(0, 3))])
        lengths = np.diff(ends)
        centers = np.column_stack([10.0 + ends[:-1] + lengths / 2, np.full((len(lengths), 2), (5.0, 1.0))])
        sizes = np.sort(np.column_stack([lengths, np.full(len(lengths), 1.4)]), axis=1)[:, ::-1]
        yaws = np.where(lengths >= 1.4, 0.0, np.pi / 2)
        scan = message(t, centers, np.column_stack([sizes, np.full(len(lengths), 1.8)]), 60, yaws, seed=t)
        scans.append(replace(scan, class_scores=np.full((len(lengths), 8), 1 / 8)))
    for published in run(new_tracker(), scans):
        assert all(np.hypot(*track.velocity_mps) < 0.5 for track in published.tracks)


@pytest.mark.parametrize(("rate_hz", "moves_s"), [(10.0, 0.6), (5.0, 1.4)])
def test_vehicle_that_comes_into_view_is_moving(rate_hz, moves_s):
    """Its visible length grows from 0.3 m to 4.5 m, from behind a wall."""
    scans = []
    for t in stamps(rate_hz, 2.0):
        front_m = 0.3 + 4.0 * (t - START) / NS
        length = min(front_m, 4.5)
        size, yaw = ((length, 1.8, 1.5), 0.0) if length >= 1.8 else ((1.8, length, 1.5), np.pi / 2)
        scans.append(message(t, [[10.0 + front_m - length / 2, 5.0, 0.8]], size, 100, yaw, seed=t))
    published = run(new_tracker(), scans)
    speeds = [np.hypot(*tracks.tracks[0].velocity_mps) for tracks in published]
    assert min(speeds[round(moves_s * rate_hz) :]) > 1.5
    assert speeds[-1] == pytest.approx(4.0, abs=0.8)


def test_radar_velocity_in_lidar_track():
    tracker = new_tracker(LIDAR, RADAR)
    for i, t in enumerate(stamps(10, 1.0)):
        feed = Feed(odom=odometry(t))
        feed.topics[LIDAR] = (message(t, [[15.0 - 4.0 * i * 0.1, 0.0, 0.9]], seed=i),)
        feed.topics[RADAR] = (
            message(t + 1, [[15.0 - 4.0 * i * 0.1, 0.1, 0.9]], returns=1, sensor="radar_front", velocity=(-4.0, 0.0)),
        )
        published = dict(tracker.step(t, feed))["tracks"]
    assert len(published.tracks) == 1
    assert published.tracks[0].sensors == ("lidar_front", "radar_front")
    assert published.tracks[0].velocity_mps == pytest.approx((-4.0, 0.0), abs=0.4)


def test_class_by_shape_and_speed():
    published = run(new_tracker(), [message(t, [[12.0, 1.0, 0.9]], seed=t) for t in stamps(10, 1.0)])
    assert published[-1].tracks[0].label is ObstacleClass.PERSON
    assert published[-1].tracks[0].confidence > 0.9


def class_of(size_m: tuple[float, float, float], speed_mps: float, up_m: float, floats: bool = False) -> ObstacleClass:
    """Class of a body of this size that moves away for 2 s, its centre at this height."""
    scores = class_scores(np.array([size_m]), np.array([size_m[2]]), np.array([floats]), np.zeros(1, np.uint8))
    scans = [
        replace(message(t, [[10.0 + speed_mps * (t - START) / NS, 1.0, up_m]], sizes=size_m), class_scores=scores)
        for t in stamps(10, 2.0)
    ]
    (track,) = run(new_tracker(LIDAR), scans)[-1].tracks
    return track.label


@pytest.mark.parametrize(
    ("size_m", "speed_mps", "is_person"),
    [
        ((1.75, 0.75, 1.7), 4.7, True), ((1.65, 0.6, 1.6), 3.0, True), ((1.9, 0.8, 1.8), 8.0, True),
        ((1.75, 0.75, 1.7), 0.0, False),  # a shrub, a parked bicycle
        ((1.75, 0.75, 1.7), 1.0, False),  # a shrub whose visible part changes
        ((1.2, 0.5, 1.0), 6.0, False),  # a deer
        ((4.2, 1.8, 1.5), 5.0, False), ((1.75, 1.6, 1.7), 5.0, False),  # a car, its rear
        ((1.75, 0.75, 1.7), 16.0, False),  # a motorcycle
    ],
)  # fmt: skip
def test_cyclist_is_a_person(size_m, speed_mps, is_person):
    assert (class_of(size_m, speed_mps, 0.9) is ObstacleClass.PERSON) == is_person


def test_dust_of_the_size_and_speed_of_a_cyclist_is_airborne():
    assert class_of((1.5, 0.6, 1.55), 2.3, 0.9, floats=True) is ObstacleClass.AIRBORNE


@pytest.mark.parametrize(
    ("size_m", "speed_mps", "label"),
    [
        ((0.45, 0.1, 0.3), 1.5, ObstacleClass.ANIMAL), ((0.45, 0.1, 0.3), 5.0, ObstacleClass.ANIMAL),  # a dog
        ((0.45, 0.1, 0.3), 0.0, ObstacleClass.UNKNOWN),  # a tuft, a stone
        ((3.2, 0.1, 0.4), 1.5, ObstacleClass.UNKNOWN),  # a part of a fence that appears to move
        ((1.86, 0.96, 0.96), 0.0, ObstacleClass.VEHICLE),  # a quad bike, seen without its handlebar
        ((1.9, 1.05, 1.2), 3.0, ObstacleClass.VEHICLE),
        ((2.2, 0.75, 1.4), 0.0, ObstacleClass.ANIMAL),  # a cow
        ((3.0, 2.0, 0.6), 0.0, ObstacleClass.MOUND),
        ((0.15, 0.1, 0.9), 0.0, ObstacleClass.PERSON),  # a child, seen narrowly
        ((0.1, 0.1, 1.2), 0.0, ObstacleClass.POLE),
    ],
)  # fmt: skip
def test_class_of_shape(size_m, speed_mps, label):
    assert class_of(size_m, speed_mps, 0.3) is label


def test_no_output_without_odometry():
    feed = Feed()
    feed.topics[LIDAR] = (message(START, [[12.0, 1.0, 0.9]]),)
    assert list(new_tracker().step(START, feed)) == []


def test_no_obstacles_give_empty_list():
    assert run(new_tracker(), [message(START, np.zeros((0, 3)))])[0].tracks == ()


def test_tracks_in_odom_with_turning_machine():
    poses = [planar(3.0, -2.0, 0.3 * i) for i in range(11)]
    scans = []
    for i, t in enumerate(stamps(10, 1.0)):
        p = np.linalg.inv(poses[i]) @ [20.0, 5.0, 0.9, 1.0]
        scans.append(message(t, [p[:3]], seed=i))
    last = run(new_tracker(), scans, poses=poses)[-1].tracks
    assert len(last) == 1
    assert last[0].p_odom_m == pytest.approx([20.0, 5.0, 0.9], abs=0.1)
    assert last[0].velocity_mps == pytest.approx([0.0, 0.0], abs=1e-9)


def test_bitwise_reproducibility():
    scans = [message(t, [[12.0, 1.0, 0.9], [15.0, -3.0, 0.9]], seed=t) for t in stamps(10, 1.0)]
    a, b = run(new_tracker(), scans)[-1], run(new_tracker(), scans)[-1]
    assert [t.covariance.tobytes() for t in a.tracks] == [t.covariance.tobytes() for t in b.tracks]


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.lists(st.floats(0.05, 1.0), min_size=1, max_size=8), st.floats(0.1, 20.0), st.floats(-3.0, 3.0))
def test_covariance_symmetric_positive(steps, length, yaw):
    x, P = np.zeros((1, 4)), np.diag([1.0, 1.0, 16.0, 16.0])[None].copy()
    R = box_noise(np.array([[length, 0.3, 1.0]]), np.array([yaw]), 0.1, 0.2)
    for dt in steps:
        predict(x, P, dt, 2.0)
        d2, _ = distances(x, P, np.array([[0.1, 0.0]]), R)
        assert d2[0, 0] >= 0.0
        correct(x, P, np.array([[0.1, 0.0]]), R, 0)
    assert pytest.approx(P[0].T) == P[0]
    assert np.linalg.eigvalsh(P[0]).min() > 0.0


@pytest.mark.parametrize("step_s", [0.5, 2.0])
def test_prediction_by_partial_steps(step_s):
    a, b = (np.array([[1.0, 2.0, 3.0, -1.0]]) for _ in range(2))
    P, Q = (np.eye(4)[None].copy() for _ in range(2))
    predict(a, P, step_s, 2.0)
    for _ in range(5):
        predict(b, Q, step_s / 5, 2.0)
    assert a == pytest.approx(b)
    assert pytest.approx(Q) == P


def _parts(speed_mps, seconds, scores, size=(0.8, 0.4, 0.15)):
    """A body 8 m beside the machine that moves to it: scores of its class by time."""
    scans = []
    for i, t in enumerate(stamps(10.0, seconds)):
        m = message(t, [[4.0, 8.0 - speed_mps * (t - START) / NS, 1.1]], size, seed=i)
        scans.append(replace(m, class_scores=scores(i)))
    return scans


@pytest.mark.parametrize(("speed_mps", "label"), [(6.0, ObstacleClass.AIRBORNE), (1.5, ObstacleClass.PERSON)])
def test_a_bird_in_flight_stays_one_where_nothing_shows_the_space_beneath(speed_mps, label):
    floats = class_scores(np.array([[0.8, 0.4, 0.15]]), np.array([1.2]), np.array([True]), np.zeros(1, np.uint8))
    person = np.full((1, 8), 0.4 / 7)
    person[0, 1] = 0.6
    published = run(new_tracker(), _parts(speed_mps, 2.0, lambda i: floats if i < 8 else person))
    (track,) = published[-1].tracks
    assert track.label is label


@pytest.mark.parametrize(("speed_mps", "label"), [(5.0, ObstacleClass.AIRBORNE), (1.5, ObstacleClass.PERSON)])
def test_dust_at_the_ground_whose_parts_seem_to_run_is_airborne(speed_mps, label):
    """It has clear space beneath it in every fifth scan, and looks like a person in the others."""
    floats = class_scores(np.array([[0.8, 0.4, 0.15]]), np.array([1.2]), np.array([True]), np.zeros(1, np.uint8))
    person = np.full((1, 8), 0.01)
    person[0, 1] = 0.93
    published = run(new_tracker(), _parts(speed_mps, 1.5, lambda i: person if i % 5 else floats))
    moving = [t for m in published for t in m.tracks if t.is_confirmed and t.velocity_mps.any()]
    assert moving
    assert {t.label for t in moving} == {label}


def test_a_calf_whose_parts_alternate_is_known_to_move():
    """Two lidars see it, one its whole length, one a part: before, the track started again with each of them."""
    scans = []
    for i, t in enumerate(stamps(20.0, 1.2)):
        part = i % 2
        y = 10.0 - 3.9 * (t - START) / NS + 0.45 * part
        size = (0.35, 0.25, 0.5) if part else (1.25, 0.3, 0.9)
        scans.append(message(t, [[-1.7, y, 0.6]], size, seed=i, yaw=np.pi / 2.0))
    moved = [i for i, m in enumerate(run(new_tracker(), scans)) for t in m.tracks if t.velocity_mps[1] < -2.5]
    assert moved
    assert moved[0] / 20.0 <= 0.9
    still = []
    for i, t in enumerate(stamps(20.0, 2.0)):
        part = i % 2
        still.append(message(t, [[-1.7, 10.0 + 0.45 * part, 0.6]], (0.35, 0.25, 0.5) if part else (1.25, 0.3, 0.9),
                             seed=i, yaw=np.pi / 2.0))  # fmt: skip
    assert all(not t.velocity_mps.any() for m in run(new_tracker(), still) for t in m.tracks)


def test_rings_on_a_crest_do_not_run() -> None:
    """A line of returns 0.1 m high that jumped by 12 m, and 4 m more, as the machine pitched, moved at 13 m/s."""
    unknown, vehicle = (list(CLASSES).index(c) for c in (ObstacleClass.UNKNOWN, ObstacleClass.VEHICLE))
    size_m = np.array([[1.25, 0.05, 0.1], [1.25, 0.05, 0.1], [1.25, 0.05, 0.1], [1.25, 0.05, 0.4]])
    label = np.array([unknown, unknown, vehicle, unknown])
    velocity_mps = np.array([[0.0, -13.0], [0.0, -7.9], [0.0, -13.0], [0.0, -13.0]])
    assert is_view(size_m, label, velocity_mps).tolist() == [True, False, False, False]


def test_posts_seen_through_a_moving_gap_do_not_run() -> None:
    """One after the other of a row was seen as the machine passed: a sliver 1.85 m high moved at 9.8 m/s."""
    unknown, person = (list(CLASSES).index(c) for c in (ObstacleClass.UNKNOWN, ObstacleClass.PERSON))
    size_m = np.array([[0.1, 0.05, 1.85], [0.1, 0.05, 1.85], [0.1, 0.05, 1.85], [0.3, 0.05, 1.85]])
    label = np.array([unknown, person, unknown, unknown])
    velocity_mps = np.array([[2.3, -9.5], [2.3, -9.5], [0.0, -7.9], [2.3, -9.5]])
    assert is_view(size_m, label, velocity_mps).tolist() == [True, False, False, False]


def test_the_edge_of_a_wall_does_not_run() -> None:
    """The edge of a shed, 2.4 m high and 0.46 m of it visible while the machine turned, moved at 10 m/s."""
    unknown, person = (list(CLASSES).index(c) for c in (ObstacleClass.UNKNOWN, ObstacleClass.PERSON))
    size_m = np.array([[0.46, 0.05, 2.4], [0.55, 0.05, 2.4], [0.46, 0.05, 1.9], [0.46, 0.3, 2.4]])
    assert is_upright(size_m, np.array([unknown, unknown, unknown, person])).tolist() == [True, False, False, False]

"""Fusion of several sensors: single-sensor tracks, common tracks and fragments."""

import numpy as np
import pytest

from messages.perception import ObstacleClass, Obstacles
from perception.camera.classes import class_scores
from perception.fusion.tracker import Tracker
from tests.perception.lidar_scenes import TRACKER_CONFIG, Feed, odometry

START, NS = 5_000_000_000, 1_000_000_000
TOPICS = tuple(f"obstacles/{kind}_front" for kind in ("lidar", "camera", "radar", "ultrasonic"))
EVEN = np.full(8, 1.0 / 8.0)


def detected(
    kind, stamp_ns, places, size=(0.5, 0.5, 1.7), sigma=(0.2, 0.2), velocity=None, scores=EVEN, returns=0, yaw=0.0
):
    """Obstacles of a kind of sensor at positions (K, 2) in `base`."""
    xy = np.asarray(places, float).reshape(-1, 2)
    k = len(xy)
    center = np.column_stack([xy, np.full(k, 0.9)])
    box = np.broadcast_to(np.asarray(size, float), (k, 3)).copy()
    yaws = np.broadcast_to(np.asarray(yaw, float), (k,)).copy()
    rng = np.random.default_rng(stamp_ns % 1000)
    points = rng.uniform(-0.5, 0.5, (k, returns, 3)) * box[:, None]
    c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    x, y = points[..., 0].copy(), points[..., 1].copy()
    points[..., 0], points[..., 1] = c * x - s * y, s * x + c * y
    points = (points + center[:, None]).reshape(-1, 3).astype(np.float32)
    speeds = np.full((k, 2), np.nan) if velocity is None else np.broadcast_to(velocity, (k, 2)).astype(float).copy()
    sigmas = np.empty((0, 2)) if kind == "lidar" else np.broadcast_to(np.asarray(sigma, float), (k, 2)).copy()
    return Obstacles(
        stamp_ns, f"{kind}_front", stamp_ns, center, box, yaws, center.copy(), speeds,
        np.broadcast_to(scores, (k, 8)).copy(), (np.arange(k + 1) * returns).astype(np.int32),
        np.arange(k * returns, dtype=np.int32), points, sigmas,
    )  # fmt: skip


def shape(label, share=0.6):
    row = np.full(8, (1.0 - share) / 7.0)
    row[tuple(ObstacleClass).index(label)] = share
    return row


def camera(stamp_ns, places, score, range_error_m=0.0, group=0, size=(0.5, 0.5, 1.7)):
    """Camera obstacles: small sigma across, large sigma along the line of sight."""
    xy = np.asarray(places, float).reshape(-1, 2)
    away = np.hypot(*xy.T)
    xy = xy * (1.0 + range_error_m / away)[:, None]
    sigma = np.column_stack([0.012 * away**2, 0.01 * away])
    return detected(
        "camera", stamp_ns, xy, size, sigma, scores=class_scores(group, score), yaw=np.arctan2(xy[:, 1], xy[:, 0])
    )


def run(make, seconds, rate_hz=100.0):
    """Feeds the messages of `make(i, stamp_ns)` at 100 Hz; returns (time, tracks) of each output."""
    tracker, published = Tracker(TOPICS, TRACKER_CONFIG), []
    for i in range(round(seconds * rate_hz) + 1):
        t, stamp = i / rate_hz, START + round(i * NS / rate_hz)
        feed = Feed(odom=odometry(stamp))
        for message in make(i, stamp):
            feed.topics[f"obstacles/{message.sensor}"] = (message,)
        published += [(t, tracks) for _, tracks in tracker.step(stamp, feed)]
    return published


def confirmed_s(published):
    return next((t for t, tracks in published if any(x.is_confirmed for x in tracks.tracks)), None)


ALONE = {
    "camera": (0.6, lambda i, s: [camera(s, [[15.0, 1.0]], 0.7, (-1) ** i * 0.8)] if i % 50 == 0 else []),
    "radar": (0.5, lambda i, s: [detected("radar", s, [[20.0, -2.0]])] if i % 5 == 0 else []),
    "ultrasonic": (0.3, lambda i, s: [detected("ultrasonic", s, [[5.0, 0.5]])] if i % 10 == 0 else []),
    "lidar": (0.3, lambda i, s: [detected("lidar", s, [[15.0, 1.0]], returns=20)] if i % 10 == 0 else []),
}


@pytest.mark.parametrize("kind", ALONE)
def test_single_sensor_confirmation_time(kind):
    limit, make = ALONE[kind]
    published = run(make, 4.0)
    assert confirmed_s(published) <= limit
    assert {x.id for _, tracks in published for x in tracks.tracks} == {1}
    assert published[-1][1].tracks[0].sensors == (f"{kind}_front",)
    assert published[-1][1].tracks[0].label is (ObstacleClass.PERSON if kind == "camera" else ObstacleClass.UNKNOWN)
    assert np.hypot(*published[-1][1].tracks[0].velocity_mps) == 0.0


@pytest.mark.parametrize(("score", "min_s", "max_s"), [(0.36, 9.0, 99.0), (0.45, 1.9, 3.1), (0.6, 0.0, 0.6)])
def test_low_score_needs_more_images(score, min_s, max_s):
    when = confirmed_s(run(lambda i, s: [camera(s, [[12.0, 0.0]], score)] if i % 50 == 0 else [], 4.0))
    assert min_s <= (99.0 if when is None else when) <= max_s


def test_false_boxes_and_echoes_are_not_confirmed():
    rng = np.random.default_rng(4)

    def make(i, stamp):
        out = []
        if i % 50 == 0:  # one random box of high score per second
            out.append(camera(stamp, rng.uniform([5, -10], [30, 10], (int(i % 100 == 0), 2)), 0.8))
        if i % 5 == 0:
            out.append(detected("radar", stamp, rng.uniform([5, -20], [50, 20], (2, 2)), velocity=rng.normal(0, 3, 2)))
        return out

    assert confirmed_s(run(make, 60.0)) is None


@pytest.mark.parametrize("error_m", [-2.0, -0.7, 0.7, 2.0])
def test_camera_range_error_makes_no_second_track(error_m):
    def make(i, stamp):
        p = [[14.0, -3.0 + 1.4 * i / 100.0]]
        out = [detected("lidar", stamp, p, scores=shape(ObstacleClass.POLE), returns=30)] if i % 10 == 0 else []
        return out + ([camera(stamp, p, 0.8, error_m)] if i % 50 == 7 else [])

    published = run(make, 4.0)
    assert {x.id for _, tracks in published for x in tracks.tracks if x.is_confirmed} == {1}
    last = published[-1][1].tracks
    assert [x.sensors for x in last] == [("lidar_front", "camera_front")]
    assert last[0].velocity_mps == pytest.approx((0.0, 1.4), abs=0.4)


def fence(stamp):
    return detected("lidar", stamp, [[15.0, 0.0]], (20.0, 0.3, 1.2), returns=400, yaw=np.pi / 2)


def test_echo_on_fence_fragment():
    def make(i, stamp):
        piece = detected("lidar", stamp, [[15.0, -5.0]], (1.7, 0.2, 1.2), returns=60, yaw=np.pi / 2)
        out = [fence(stamp)] if i % 10 == 0 else []
        out += [piece] if i % 10 == 5 and i < 100 else []
        return out + ([detected("radar", stamp, [[15.0, -5.0]], velocity=(0.0, 0.0))] if i % 5 == 0 else [])

    published = run(make, 4.0)
    before = [tracks for t, tracks in published if t < 1.0][-1]
    assert len([k for k in before.tracks if k.is_confirmed]) == 2
    assert [k.size_m[0] for k in published[-1][1].tracks if k.is_confirmed] == pytest.approx([20.0], abs=0.5)


def test_echoes_on_fence_are_fragments():
    rng = np.random.default_rng(5)

    def make(i, stamp):
        out = [fence(stamp)] if i % 10 == 0 else []
        places = np.column_stack([np.full(6, 15.0), np.linspace(-9, 9, 6)]) + rng.normal(0, 0.2, (6, 2))
        return out + ([detected("radar", stamp, places, velocity=(0.0, 0.0))] if i % 5 == 0 and i > 20 else [])

    last = run(make, 3.0)[-1][1].tracks
    assert [x.sensors for x in last if x.is_confirmed] == [("lidar_front", "radar_front")]


@pytest.mark.parametrize("kind", ["camera", "radar"])
def test_person_walking_along_fence_has_own_track(kind):
    def make(i, stamp):
        p = [[14.6, -4.0 + 1.4 * i / 100.0]]
        out = [fence(stamp)] if i % 10 == 0 else []
        if kind == "camera" and i % 50 == 0:
            out.append(camera(stamp, p, 0.8))
        if kind == "radar" and i % 5 == 0:
            out.append(detected("radar", stamp, p, velocity=(0.0, 1.4)))
        return out

    published = run(make, 4.0)
    tracks = [
        x for x in published[-1][1].tracks if x.is_confirmed and f"{kind}_front" in x.sensors and x.size_m[0] < 5.0
    ]
    assert len(tracks) == 1
    assert tracks[0].p_odom_m[:2] == pytest.approx((14.6, 1.6), abs=0.8)


def car(stamp, pieces):
    """A complete car at 8 m, or the fragments of it at close range."""
    if not pieces:
        return detected("lidar", stamp, [[8.0, 0.0]], (4.2, 1.8, 1.5), scores=shape(ObstacleClass.VEHICLE), returns=300)
    places = [[8.9, 0.1], [6.6, 0.5], [7.6, -0.4]][:pieces]
    return detected("lidar", stamp, places, (1.0, 0.4, 0.5), scores=shape(ObstacleClass.PERSON), returns=40)


def test_vehicle_fragments_and_person_leaving_vehicle():
    def make(i, stamp):
        if i % 10:
            return []
        message = car(stamp, 0 if i < 100 else 1 + i // 10 % 3)
        if i < 250:
            return [message]
        beside = [[8.0, 1.8 + 1.2 * (i - 250) / 100.0]]
        return [message] if i < 250 else [_with(message, detected("lidar", stamp, beside, returns=30))]

    published = run(make, 3.5)
    before = [tracks for t, tracks in published if 1.0 < t < 2.5]
    assert {x.id for tracks in before for x in tracks.tracks} == {1}
    for tracks in before:
        assert tracks.tracks[0].label is ObstacleClass.VEHICLE
        assert tracks.tracks[0].p_odom_m[:2] == pytest.approx((8.0, 0.0), abs=1.2)
        assert np.hypot(*tracks.tracks[0].velocity_mps) < 0.5
    assert sum(x.is_confirmed for x in published[-1][1].tracks) == 2


def test_vehicle_keeps_its_track_beside_a_new_one():
    """Echoes beside a car begin a track that its next detection is nearer to; the car is still the same object."""

    def make(i, stamp):
        messages = []
        if 104 <= i < 120 and i % 2:
            messages.append(detected("radar", stamp, [[9.0, 0.9]], sigma=(0.15, 0.15), velocity=(1.5, -1.5)))
        if i % 10 == 0:
            place, length, yaw = ([8.0, 0.0], 3.9, 0.0) if i < 120 else ([8.6, 0.7], 4.1, 0.25)
            scores = shape(ObstacleClass.VEHICLE)
            messages.append(detected("lidar", stamp, [place], (length, 1.8, 1.5), scores=scores, returns=300, yaw=yaw))
        return messages

    published = run(make, 2.0)
    assert {x.id for t, tracks in published if t > 1.25 for x in tracks.tracks} == {1}


@pytest.mark.parametrize(("size", "moves"), [((0.97, 0.05, 0.13), False), ((0.5, 0.3, 1.7), True)])
def test_piece_of_fence_does_not_move_along_it(size, moves):
    """Rings show other pieces of a fence as the machine drives; a person who walks along it moves."""

    def make(i, stamp):
        if i % 10:
            return []
        fence = detected("lidar", stamp, [[5.0, 4.2]], (24.0, 0.3, 1.2), returns=3000)
        piece = [[-4.0 + 0.016 * i, 4.2 if size[1] < 0.1 else 3.7]]
        return [_with(fence, detected("lidar", stamp, piece, size, scores=shape(ObstacleClass.PERSON), returns=30))]

    seen = [x for t, tracks in run(make, 4.0) if t > 2.0 for x in tracks.tracks if x.size_m[0] < 2.0]
    assert len(seen) > 15
    assert (max(np.hypot(*x.velocity_mps) for x in seen) > 1.0) == moves


@pytest.mark.parametrize(("size", "heading_deg", "fence", "moves"), [
    ((0.42, 0.05, 0.06), 0.0, True, False), ((0.42, 0.05, 0.06), 0.0, False, True),
    ((0.42, 0.05, 0.06), 90.0, True, True), ((0.5, 0.16, 0.25), 0.0, True, True),
])  # fmt: skip
def test_low_line_of_returns_does_not_move_along_a_fence(size, heading_deg, fence, moves):
    """A ring meets a rail further on as the machine drives; a hare is broader, and has free ground ahead."""
    c, s = np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))

    def make(i, stamp):
        if i % 10:
            return []
        if i < 30:  # the front lidar has passed it
            return [detected("lidar", stamp, [[8.0, 3.0]], (16.0, 0.1, 1.2), returns=2000)] if fence else []
        place = [[2.0 + 0.016 * i * c, 3.0 + 0.016 * i * s]]
        return [detected("lidar", stamp, place, size, scores=shape(ObstacleClass.PERSON), returns=30)]

    seen = [x for t, tracks in run(make, 3.0) if t > 1.8 for x in tracks.tracks if x.size_m[0] < 2.0]
    assert seen
    assert (max(np.hypot(*x.velocity_mps) for x in seen) > 1.0) == moves


def _with(a, b):
    def both(name):
        return np.concatenate([getattr(a, name), getattr(b, name)])

    return Obstacles(
        a.stamp_ns, a.sensor, a.stamp_ns, both("center_base_m"), both("size_m"), both("yaw_rad"),
        both("nearest_base_m"), both("velocity_mps"), both("class_scores"),
        np.concatenate([a.offsets, b.offsets[1:] + a.offsets[-1]]).astype(np.int32),
        np.concatenate([a.indices, b.indices + a.offsets[-1]]).astype(np.int32), both("points_base_m"),
    )  # fmt: skip


def test_echoes_do_not_change_class():
    def make(i, stamp):
        p = [[14.0, 0.0]]
        out = [detected("lidar", stamp, p, scores=shape(ObstacleClass.PERSON), returns=30)] if i % 10 == 0 else []
        return out + ([detected("radar", stamp, p)] if i % 5 == 2 else [])

    last = run(make, 2.0)[-1][1].tracks
    assert [(x.label, x.confidence > 0.9) for x in last] == [(ObstacleClass.PERSON, True)]

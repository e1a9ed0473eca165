"""Returns in `base`: mount, self filter, deskewing and invalid returns."""

import numpy as np
import pytest

from configs.strict import find, load
from configs.vehicle import ImplementFile
from geometry.transforms import apply, planar, transform
from perception.lidar.points import self_boxes, to_base
from tests.perception.lidar_scenes import LIDAR_CONFIG, VEHICLE

NOWHERE = np.zeros((0, 2, 3))
STILL = (0.0, 0.0, 0.0)


def test_mount_transform():
    T = transform((3.3, 0.5, 1.9), (0.02, -0.1, 2.0))
    points = np.random.default_rng(0).uniform(-20, 20, (100, 3)).astype(np.float32)
    out, usable = to_base(points, np.zeros(100, np.float32), T, STILL, NOWHERE)
    assert out == pytest.approx(apply(T, points), abs=1e-4)
    assert usable.all()


@pytest.mark.parametrize("motion", [(3.0, 0.0, 0.0), (2.0, 0.3, 0.5), (-1.0, 0.0, -0.8), (8.0, 0.0, 1e-9)])
def test_deskewing(motion):
    still = np.array([12.0, -3.0, 1.0])
    offsets = np.array([0.0, -0.05, -0.1, -0.4], np.float32)
    v, w, rate = motion
    seen = []
    for t in offsets.astype(float):
        # integrate the pose of base at t against the stamp in fine steps
        T = np.eye(4)
        steps = 2000
        for _ in range(steps if t else 0):
            T = T @ planar(v * t / steps, w * t / steps, rate * t / steps)
        seen.append(apply(np.linalg.inv(T), still[None])[0])
    out, _ = to_base(np.array(seen, np.float32), offsets, np.eye(4), motion, NOWHERE)
    assert out == pytest.approx(np.repeat(still[None], 4, axis=0), abs=3e-3)


def test_invalid_returns_are_unusable():
    bad = np.array([[np.nan, 1, 1], [np.inf, 0, 0], [0, 0, 0], [9, 0, 1]], np.float32)
    _, usable = to_base(bad, np.zeros(4, np.float32), np.eye(4), STILL, NOWHERE)
    assert usable.tolist() == [0, 0, 0, 1]


def test_self_filter_margin():
    implement = load(ImplementFile, find("implements", "harrow_6m")).implement
    own = self_boxes(VEHICLE, implement, LIDAR_CONFIG.self_filter)
    m, body = LIDAR_CONFIG.self_filter.margin_m, VEHICLE.body
    points = [
        ([1.0, 0.0, 2.0], 0),
        ([body.front_m + m - 0.01, 0.0, 1.0], 0),
        ([body.front_m + m + 0.01, 0.0, 1.0], 1),
        ([1.0, body.width_m / 2 + m + 0.01, 1.0], 1),
        ([-2.0, 3.0, 0.5], 0),
        ([-2.0, 3.05 + m + 0.01, 0.5], 1),
        ([-2.0, 0.0, 2.0], 1),
        ([1.0, 0.0, body.height_m + m + 0.01], 1),
    ]
    _, usable = to_base(
        np.array([p for p, _ in points], np.float32), np.zeros(len(points), np.float32), np.eye(4), STILL, own
    )
    assert usable.tolist() == [u for _, u in points]

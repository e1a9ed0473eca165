"""Scores of boxes: returns below the foot of a box do not count."""

import numpy as np
import pytest

from geometry.arrays import Float32, Float64
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.consistency.truth_kernels import foot_m, points_around, score_at, scores_of_shifts

LOWEST = -1e9
SHIFTS = np.array([(x, y) for x in (-1.0, -0.3, 0.0, 0.4, 2.0) for y in (-2.0, 0.0, 0.6)])


def scores(points: Float32, box: Box) -> Float64:
    here = score_at(points, box.center_m, box.size_m, box.yaw_rad, 5.0)
    return np.append(scores_of_shifts(points, box.center_m, box.size_m, box.yaw_rad, 5.0, SHIFTS), here)


@pytest.mark.parametrize("seed", range(20))
def test_ground_is_left_out_without_effect(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform((0.05, 0.05, 0.05), (4.0, 2.0, 2.0))
    center = np.array([*rng.uniform(-20.0, 20.0, 2), rng.uniform(-1.0, 1.5)])
    box = Box(1, "person", "", center, size, float(rng.uniform(-3.0, 3.0)))
    around = rng.normal(scale=(1.5, 1.5, 0.8), size=(3000, 3)) + center
    foot = foot_m(box) + 1e-3
    near = np.column_stack([around[:400, :2], foot + rng.uniform(-2e-6, 2e-6, 400)])  # on the border, as floats
    points = np.vstack([around, near]).astype(np.float32)
    every = points_around(points, center[0], center[1], 4.0, LOWEST)
    kept = points_around(points, center[0], center[1], 4.0, foot_m(box))
    assert 0 < len(kept) < len(every)
    assert (kept[:, 2] >= np.float32(foot_m(box))).all()
    assert scores(kept, box).tolist() == scores(every, box).tolist()
    assert scores(every, box).max() > 0.0

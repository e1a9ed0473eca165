"""SE(2) poses against rigid transforms."""

import math

import numpy as np
import pytest

from geometry.pose2 import Pose2, from_frame, point_from_frame, to_frame
from geometry.transforms import apply, invert, planar

A, B = Pose2(1.0, -2.0, 2.5), Pose2(-3.0, 0.5, 1.5)
XY = np.array([[4.0, -1.0], [0.0, 0.0], [-2.5, 7.0]])


def test_composition_and_inverse_against_transforms() -> None:
    T_a, T_b = planar(*A), planar(*B)
    assert np.allclose(A @ B, Pose2.of(T_a @ T_b))
    assert np.allclose(A.inverse(), Pose2.of(invert(T_a)))
    assert np.allclose(A @ A.inverse(), (0.0, 0.0, 0.0))


def test_yaw_within_pi() -> None:
    assert -math.pi < (A @ A).yaw_rad <= math.pi


@pytest.mark.parametrize("pose", [A, B, np.array(A)])
def test_points_against_transforms(pose: Pose2) -> None:
    T, points = planar(*pose), np.column_stack([XY, np.zeros(3)])
    assert to_frame(pose, XY) == pytest.approx(apply(T, points)[:, :2])
    assert from_frame(pose, XY) == pytest.approx(apply(invert(T), points)[:, :2])
    assert all(point_from_frame(pose, *p) == tuple(q) for p, q in zip(XY.tolist(), from_frame(pose, XY), strict=True))


def test_shifted_poses() -> None:
    assert A.ahead(2.0) == pytest.approx(A @ Pose2(2.0, 0.0, 0.0))
    assert A.beside(0.5) == pytest.approx(A @ Pose2(0.0, 0.5, 0.0))

"""Rotations against scipy, including singular cases."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geometry.angles import wrap
from geometry.transforms import (
    apply,
    interpolate,
    invert,
    planar,
    quaternion_of,
    rotation,
    rotation_vector,
    rpy_of,
    transform,
    yaw_of,
)  # fmt: skip

angle = st.floats(-math.pi, math.pi)
angles = st.tuples(angle, st.floats(-1.5, 1.5), angle)
place = st.tuples(*[st.floats(-1e3, 1e3)] * 3)


@settings(derandomize=True)
@given(place, angles)
def test_transform_roll_pitch_yaw(p: tuple[float, ...], rpy: tuple[float, ...]) -> None:
    T = transform(p, rpy)
    assert np.allclose(T[:3, :3], Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-12)
    assert np.allclose(T @ invert(T), np.eye(4), atol=1e-9)
    assert np.allclose(transform(p, rpy_of(T)), T, atol=1e-9)


@settings(derandomize=True)
@given(angles)
def test_quaternion_and_rotation_vector_against_scipy(rpy: tuple[float, ...]) -> None:
    R = Rotation.from_euler("xyz", rpy)
    q = quaternion_of(R.as_matrix())
    assert abs(q @ R.as_quat()) == pytest.approx(1.0, abs=1e-12)
    assert q[3] >= 0.0
    assert np.allclose(rotation(rotation_vector(R.as_matrix())), R.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-7, 1e-5, math.pi - 1e-7, math.pi])
def test_singular_rotations(axis: int, turn: float) -> None:
    vector = np.zeros(3)
    vector[axis] = turn
    R = Rotation.from_rotvec(vector).as_matrix()
    assert np.allclose(rotation(vector), R, atol=1e-12)
    assert np.linalg.norm(rotation_vector(R)) == pytest.approx(turn, abs=1e-9)


@settings(derandomize=True)
@given(place, angles, place, angles)
def test_interpolation_ends_and_rate(
    p: tuple[float, ...], a: tuple[float, ...], q: tuple[float, ...], b: tuple[float, ...]
) -> None:
    A, B = transform(p, a), transform(q, b)
    assert np.allclose(interpolate(A, B, 0.0), A, atol=1e-9)
    assert np.allclose(interpolate(A, B, 1.0), B, atol=1e-6)
    total = np.linalg.norm(rotation_vector(A[:3, :3].T @ B[:3, :3]))
    third = np.linalg.norm(rotation_vector(A[:3, :3].T @ interpolate(A, B, 1 / 3)[:3, :3]))
    assert third == pytest.approx(total / 3, abs=1e-6)


def test_frame_composition() -> None:
    T_map_base, T_base_lidar = planar(10.0, 5.0, math.pi / 2), transform((2.0, 0.0, 1.0))
    assert np.allclose(apply(T_map_base @ T_base_lidar, np.array([[1.0, 0.0, 0.0]])), [[10.0, 8.0, 1.0]])
    assert yaw_of(T_map_base) == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(("given_rad", "wrapped"), [(math.pi, math.pi), (-math.pi, math.pi), (7.0, 7.0 - 2 * math.pi)])
def test_wrap_at_pi(given_rad: float, wrapped: float) -> None:
    assert wrap(given_rad) == pytest.approx(wrapped)

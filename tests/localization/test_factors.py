"""Derivatives of the factors against differences, and their zeros."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, S, X
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.transforms import invert, planar
from localization.dead_reckoning.imu_track import Steps
from localization.dead_reckoning.wheel_track import displacement_columns
from localization.graph.factors import heading_factor, relative_pose_factor, wheel_factor

ARM = np.array([-0.4, 0.0, -1.1])
angle = st.floats(-3.0, 3.0)
tilt = st.floats(-0.3, 0.3)


def values_at(roll, pitch, yaw, turn):
    first = gtsam.Pose3(gtsam.Rot3.RzRyRx(roll, pitch, yaw), np.array([3.0, -2.0, 1.0]))
    step = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.02, turn), np.array([0.5, 0.05, 0.02]))
    values = gtsam.Values()
    values.insert(X(1), first)
    values.insert(X(2), first.compose(step))
    values.insert(S(1), np.array([0.96, 0.01, 0.3, 0.2]))
    return values


def differences(factor, values, key, size):
    columns = []
    for k in range(size):
        ends = []
        for h in (1e-6, -1e-6):
            delta = np.zeros(size)
            delta[k] = h
            moved = gtsam.Values(values)
            if size == 6:
                moved.update(key, values.atPose3(key).retract(delta))
            else:
                moved.update(key, values.atVector(key) + delta)
            ends.append(factor.unwhitenedError(moved))
        columns.append((ends[0] - ends[1]) / 2e-6)
    return np.stack(columns, axis=1)


@given(roll=tilt, pitch=tilt, yaw=angle, turn=tilt)
@settings(max_examples=20, derandomize=True, deadline=None)
def test_factor_derivatives(roll, pitch, yaw, turn):
    values = values_at(roll, pitch, yaw, turn)
    columns = np.array([[0.5, -0.01, -0.1, 0.0], [0.01, 0.5, 0.0, -0.1], [0.0, 0.0, 0.0, 0.0]])
    for factor in (wheel_factor(1, 2, columns, ARM, np.ones(3)), heading_factor(1, yaw + 0.01, 1.0)):
        jacobian, _ = factor.linearize(values).jacobian()
        order = factor.linearize(values).keys()
        expected = np.hstack([differences(factor, values, key, 4 if key == S(1) else 6) for key in order])
        assert np.allclose(jacobian, expected, atol=1e-6)


@given(roll=tilt, pitch=tilt, yaw=angle, turn=tilt)
@settings(max_examples=20, derandomize=True, deadline=None)
def test_derivatives_of_a_motion_that_is_turned(roll, pitch, yaw, turn):
    values, T_base_body, course = values_at(roll, pitch, yaw, turn), np.eye(4), np.array([0.01])
    T_base_body[:3, 3] = -ARM
    first, last = (values.atPose3(X(k)).matrix() @ invert(T_base_body) for k in (1, 2))
    motion = invert(first) @ last
    motion[:3, 3] = planar(0.0, 0.0, -0.01)[:3, :3] @ motion[:3, 3]
    values.insert(M(2), course)
    A = gtsam.Pose3(T_base_body).AdjointMap()  # covariance 1 in the body
    factor = relative_pose_factor(1, 2, 2, motion, T_base_body, A @ A.T)
    assert factor.unwhitenedError(values) == pytest.approx(np.zeros(6), abs=1e-12)
    linear = factor.linearize(values)
    order = linear.keys()
    expected = np.hstack([differences(factor, values, key, 1 if key == M(2) else 6) for key in order])
    assert np.allclose(linear.jacobian()[0], expected, atol=1e-6)


def test_heading_error_wraps():
    values = values_at(0.0, 0.0, np.pi - 0.001, 0.0)
    assert heading_factor(1, -np.pi + 0.001, 1.0).unwhitenedError(values)[0] == pytest.approx(-0.002, abs=1e-9)


def test_displacement_of_circle_is_chord():
    n, dt, rate, speed = 20, 0.01, 0.4, 2.0
    steps = Steps(np.full(n, dt), np.arange(n) * 1e7, np.zeros((n, 3)), np.tile([0, 0, rate], (n, 1)), np.zeros((n, 2)))
    displacement = displacement_columns(steps, np.full(n, speed), np.zeros(3)) @ np.array([1.0, 0.0, 0.3, 0.2])
    a = rate * n * dt
    assert displacement == pytest.approx([speed / rate * np.sin(a), speed / rate * (1 - np.cos(a)), 0.0], abs=1e-5)


def test_displacement_under_tyre_force():
    steps = Steps(np.array([0.1]), np.array([5e7]), np.zeros((1, 3)), np.zeros((1, 3)), np.array([[0.1, 0.05]]))
    displacement = displacement_columns(steps, np.array([2.0]), np.zeros(3)) @ np.array([1.0, 0.0, 0.3, 0.2])
    assert displacement == pytest.approx([0.2 * (1 - 0.03), -0.2 * 0.01, 0.0])

"""Motion models of a tag between keyframes: whitened residuals and their derivatives.

Two models with one interface: wheel and gyro odometry on (x, y, yaw), and constant velocity on (x, y, vx, vy) without
odometry. `size` is the length of a keyframe, `extra` the number of parameters of the model.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.arrays import Float64


@dataclass(frozen=True)
class Linearization:
    """Residuals (n, k) with derivatives by the first and the last keyframe (n, k, size) and the model (n, k, extra)."""

    r: Float64
    first: Float64
    last: Float64
    extra: Float64


class MotionModel(Protocol):
    """Interface of a motion model; `steps` (n, ...) are rows of the model."""

    size: int
    extra: int

    def predict(self, x: Float64, extra: Float64, step: Float64) -> Float64:
        """Predicts the keyframe after `step`."""

    def linear(self, first: Float64, last: Float64, extra: Float64, steps: Float64) -> Linearization:
        """Whitened residuals of n steps."""

    def tag(self, x: Float64, age_s: Float64, arm_m: Float64) -> tuple[Float64, Float64]:
        """Position (n, 2) of a tag `arm_m` from the keyframe's origin, `age_s` before it; derivative (n, 2, size)."""


class OdometryModel:
    """Pose (x, y, yaw) with wheel scale error and gyro bias (rad/s) as parameters.

    A step is (forward_m, left_m, turn_rad, duration_s, sigma_forward_m, sigma_left_m, sigma_turn_rad) in the first
    keyframe's axes.
    """

    size, extra = 3, 2

    def predict(self, x: Float64, extra: Float64, step: Float64) -> Float64:
        """Dead reckoning with the estimated parameters."""
        angle = x[2] + 0.5 * extra[1] * step[3]
        c, s = np.cos(angle), np.sin(angle)
        forward_m, left_m = (1.0 + extra[0]) * step[:2]
        return np.array(
            [
                x[0] + c * forward_m - s * left_m,
                x[1] + s * forward_m + c * left_m,
                x[2] + step[2] + extra[1] * step[3],
            ]
        )

    def linear(self, first: Float64, last: Float64, extra: Float64, steps: Float64) -> Linearization:
        """Displacement in the first keyframe's axes, rotated by half the effect of gyro bias; yaw not wrapped."""
        n, T = len(steps), steps[:, 3]
        angle = first[:, 2] + 0.5 * extra[1] * T
        c, s = np.cos(angle), np.sin(angle)
        back = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
        displacement = np.einsum("nij,nj->ni", back, last[:, :2] - first[:, :2])
        r = np.empty((n, 3))
        r[:, :2] = displacement - (1.0 + extra[0]) * steps[:, :2]
        r[:, 2] = last[:, 2] - first[:, 2] - steps[:, 2] - extra[1] * T
        J, K, L = np.zeros((n, 3, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 2))
        turned = np.stack([displacement[:, 1], -displacement[:, 0]], -1)
        J[:, :2, :2], K[:, :2, :2], J[:, :2, 2] = -back, back, turned
        J[:, 2, 2], K[:, 2, 2] = -1.0, 1.0
        L[:, :2, 0], L[:, :2, 1], L[:, 2, 1] = -steps[:, :2], 0.5 * T[:, None] * turned, -T
        w = 1.0 / steps[:, 4:7]
        return Linearization(r * w, J * w[:, :, None], K * w[:, :, None], L * w[:, :, None])

    def tag(self, x: Float64, age_s: Float64, arm_m: Float64) -> tuple[Float64, Float64]:
        """Ages must be zero: there is a keyframe at every range."""
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        turned = np.stack([c * arm_m[0] - s * arm_m[1], s * arm_m[0] + c * arm_m[1]], -1)
        J = np.zeros((len(x), 2, 3))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, 0, 2], J[:, 1, 2] = -turned[:, 1], turned[:, 0]
        return x[:, :2] + turned, J


class ConstantVelocityModel:
    """Position and velocity (x, y, vx, vy) with white acceleration of a density in m²/s³; a step is (duration_s,)."""

    size, extra = 4, 0

    def __init__(self, density_m2_s3: float) -> None:
        self._density = density_m2_s3

    def predict(self, x: Float64, extra: Float64, step: Float64) -> Float64:
        """Constant velocity."""
        return np.concatenate([x[:2] + x[2:] * step[0], x[2:]])

    def linear(self, first: Float64, last: Float64, extra: Float64, steps: Float64) -> Linearization:
        """Whitened by the inverse of the Cholesky factor of [[T³/3, T²/2], [T²/2, T]] times the density."""
        n, T = len(steps), steps[:, :1]
        r = np.concatenate([last[:, :2] - first[:, :2] - first[:, 2:] * T, last[:, 2:] - first[:, 2:]], axis=1)
        one = np.broadcast_to(np.eye(4), (n, 4, 4))
        J = -one.copy()
        J[:, 0, 2] = J[:, 1, 3] = -T[:, 0]
        W = np.zeros((n, 4, 4))
        position, velocity = np.sqrt(3.0 / (self._density * T[:, 0] ** 3)), 2.0 / np.sqrt(self._density * T[:, 0])
        for axis in (0, 1):
            W[:, axis, axis] = position
            W[:, axis + 2, axis] = -1.5 / T[:, 0] * velocity
            W[:, axis + 2, axis + 2] = velocity
        return Linearization(np.einsum("nij,nj->ni", W, r), W @ J, W @ one, np.zeros((n, 4, 0)))

    def tag(self, x: Float64, age_s: Float64, arm_m: Float64) -> tuple[Float64, Float64]:
        """Position at constant velocity; the arm must be zero, since there is no yaw."""
        J = np.zeros((len(x), 2, 4))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, 0, 2] = J[:, 1, 3] = -age_s
        return x[:, :2] - x[:, 2:] * age_s[:, None], J

"""Kalman filter of many obstacles at once: state (x, y, vx, vy) in `odom`, driven by white acceleration."""

import math

import numpy as np

from geometry.arrays import Float64
from geometry.jit import kernel

EYE = np.eye(4)


def predict(x: Float64, P: Float64, dt_s: float, acceleration_mps2: float) -> None:
    """Predicts states (T, 4) and covariances (T, 4, 4) in place by `dt_s`."""
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt_s
    x[:] = x @ F.T
    q, Q = acceleration_mps2**2, np.zeros((4, 4))
    for i in (0, 1):
        # white acceleration with 1 s correlation: the velocity variance grows by q dt at any measurement rate
        Q[i, i], Q[i, i + 2], Q[i + 2, i], Q[i + 2, i + 2] = q * dt_s**3 / 3, q * dt_s**2 / 2, q * dt_s**2 / 2, q * dt_s
    P[:] = F @ P @ F.T + Q


def box_noise(size_m: Float64, yaw_rad: Float64, sigma_m: float, share: float) -> Float64:
    """Covariance (K, 2, 2) of box centres: grows with the extent of the box, since only parts are visible."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    along, across = (sigma_m + share * size_m[:, 0]) ** 2, (sigma_m + share * size_m[:, 1]) ** 2
    R = np.empty((len(yaw_rad), 2, 2))
    R[:, 0, 0] = c * c * along + s * s * across
    R[:, 1, 1] = s * s * along + c * c * across
    R[:, 0, 1] = R[:, 1, 0] = c * s * (along - across)
    return R


def distances(x: Float64, P: Float64, z: Float64, R: Float64) -> tuple[Float64, Float64]:
    """Squared Mahalanobis distances (T, K) of measurements `z` (K, 2), and the cost: distance plus log det S."""
    d2, cost = np.empty((len(x), len(z))), np.empty((len(x), len(z)))
    _distances(x, P, z, R, d2, cost)
    return d2, cost


@kernel
def _distances(x: Float64, P: Float64, z: Float64, R: Float64, d2: Float64, cost: Float64) -> None:
    for i in range(x.shape[0]):
        for j in range(z.shape[0]):
            a, b, c = P[i, 0, 0] + R[j, 0, 0], P[i, 0, 1] + R[j, 0, 1], P[i, 1, 1] + R[j, 1, 1]
            dx, dy = z[j, 0] - x[i, 0], z[j, 1] - x[i, 1]
            det = a * c - b * b
            d2[i, j] = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / det
            cost[i, j] = d2[i, j] + math.log(det)


def correct(x: Float64, P: Float64, z: Float64, R: Float64, first: int) -> None:
    """Corrects states (T, 4) and covariances in place by `z` (T, 2), noise `R`, of components `first`, `first` + 1."""
    own = slice(first, first + 2)
    K = P[:, :, own] @ np.linalg.inv(P[:, own, own] + R)
    x += (K @ (z - x[:, own])[:, :, None])[:, :, 0]
    I_KH = np.zeros(P.shape) + EYE
    I_KH[:, :, own] -= K
    # Joseph's form keeps P symmetric and positive over hours
    P[:] = I_KH @ P @ I_KH.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1)

"""Rigid transforms as (4, 4) float64 matrices: `T_a_b` takes coordinates in b to coordinates in a."""

import math

import numpy as np
import numpy.typing as npt

from geometry.arrays import Float64


def transform(p_m: npt.ArrayLike, rpy_rad: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Float64:
    """Pose at `p_m` (3,) with roll, pitch and yaw (REP-103: about x, then y, then z, fixed axes)."""
    T = np.eye(4)
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = p_m
    return T


def planar(x_m: float, y_m: float, yaw_rad: float) -> Float64:
    """The level pose at height 0."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0, x_m], [s, c, 0, y_m], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64)


def invert(T: Float64) -> Float64:
    """The inverse of a rigid transform."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def apply(T: Float64, points_m: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Points (N, 3) transformed by `T`, in the float type of the points."""
    R, t = T[:3, :3].astype(points_m.dtype), T[:3, 3].astype(points_m.dtype)
    return np.asarray(points_m @ R.T + t)


def yaw_of(T: Float64) -> float:
    """Heading of the x axis."""
    return math.atan2(T[1, 0], T[0, 0])


def rpy_of(T: Float64) -> Float64:
    """Roll, pitch and yaw, (3,)."""
    return np.array([math.atan2(T[2, 1], T[2, 2]), -math.asin(max(-1.0, min(1.0, T[2, 0]))), yaw_of(T)])


def quaternion_of(T: Float64) -> Float64:
    """Orientation as (x, y, z, w), w ≥ 0 (Shepperd 1978: divides by the largest component alone)."""
    (a, b, c), (d, e, f), (g, h, i) = T[:3, :3].tolist()
    trace = a + e + i
    squares = (1.0 + 2.0 * a - trace, 1.0 + 2.0 * e - trace, 1.0 + 2.0 * i - trace, 1.0 + trace)
    k = squares.index(max(squares))
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    half = math.copysign(0.5 / math.sqrt(squares[k]), rows[k][3])
    return np.array([half * value for value in rows[k]])


def rotation_vector(R: Float64) -> Float64:
    """Axis times angle (3,) of a rotation (3, 3), angle in [0, π]."""
    x, y, z, w = quaternion_of(R).tolist()
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return np.array([scale * x, scale * y, scale * z])


def rotation(vector: Float64) -> Float64:
    """The rotation (3, 3) of an axis times angle (3,) (Rodrigues)."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    sine = 1.0 if angle < 1e-9 else math.sin(angle) / angle
    half = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    K: Float64 = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R: Float64 = np.eye(3) + sine * K + (2.0 * half * half) * (K @ K)
    return R


def interpolate(T_a: Float64, T_b: Float64, share: float) -> Float64:
    """Pose between a (`share` 0) and b (1): linear in position, shortest rotation in orientation."""
    T = np.eye(4)
    R_a = T_a[:3, :3]
    T[:3, :3] = R_a @ rotation(share * rotation_vector(R_a.T @ T_b[:3, :3]))
    T[:3, 3] = (1.0 - share) * T_a[:3, 3] + share * T_b[:3, 3]
    return T

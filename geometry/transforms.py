"""Rigid transforms as (4, 4) float64 matrices: `T_a_b` takes coordinates in b to coordinates in a."""

import math

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Float64 = npt.NDArray[np.float64]


def transform(p_m: npt.ArrayLike, rpy_rad: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Float64:
    """The pose at `p_m` (3,) with roll, pitch and yaw (REP-103: turned about x, then y, then z, fixed axes)."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", np.asarray(rpy_rad, float)).as_matrix()
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
    """Points (N, 3) taken through `T`, in the points' own float type."""
    R, t = T[:3, :3].astype(points_m.dtype), T[:3, 3].astype(points_m.dtype)
    return points_m @ R.T + t


def yaw_of(T: Float64) -> float:
    """Heading of the x axis."""
    return math.atan2(T[1, 0], T[0, 0])


def rpy_of(T: Float64) -> Float64:
    """Roll, pitch and yaw, (3,)."""
    return np.array([math.atan2(T[2, 1], T[2, 2]), -math.asin(max(-1.0, min(1.0, T[2, 0]))), yaw_of(T)])


def quaternion_of(T: Float64) -> Float64:
    """Orientation as (x, y, z, w), w ≥ 0."""
    q = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return np.asarray(q, np.float64)


def interpolate(T_a: Float64, T_b: Float64, share: float) -> Float64:
    """The pose between two, at `share` 0 (a) to 1 (b): straight in position, shortest turn in orientation."""
    R_a = Rotation.from_matrix(T_a[:3, :3])
    turn = (R_a.inv() * Rotation.from_matrix(T_b[:3, :3])).as_rotvec()
    T = np.eye(4)
    T[:3, :3] = (R_a * Rotation.from_rotvec(share * turn)).as_matrix()
    T[:3, 3] = (1.0 - share) * T_a[:3, 3] + share * T_b[:3, 3]
    return T

"""Factors of the measurements on the variables of the graph.

A keyframe has pose X (`base` axes, origin at the IMU, in `map`), velocity V of that origin in `map`, bias B and slip
S (4,): scale, drift, slip per longitudinal force, slip angle per lateral force (see `displacement_columns` in
wheel_track.py); with UWB ranges also C, scale and bias of every anchor (see uwb_factor.py); with
fixes whose correlated error is estimated also E, that error (6,) in `map`, slow then fast part; with lidar odometry
also M, the angle (1,) by which it is turned against the positions: mounts of lidar and antennas in yaw.
"""

import math
from collections.abc import Callable

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, E, M, S, V, X

from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import invert, planar

__all__ = [
    "B",
    "C",
    "E",
    "M",
    "S",
    "V",
    "X",
    "antenna_factor",
    "decay_factor",
    "gnss_factor",
    "heading_factor",
    "no_sideslip_factor",
    "pose_factor",
    "relative_pose_factor",
    "standstill_factor",
    "velocity_factor",
    "wheel_factor",
]

FREE_MPS = 100.0  # sigma of a velocity that is not known

Error = Callable[[gtsam.CustomFactor, gtsam.Values, "list[Float64] | None"], Float64]


def skew(p: Float64) -> Float64:
    """Cross product matrix of p (3,)."""
    return np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])


def gnss_factor(key: int, p_map_m: Float64, arm_m: Float64, sigma_m: Float64) -> gtsam.GPSFactorArm:
    """Measured position of an antenna with lever arm `arm_m` from the IMU in `base` axes."""
    return gtsam.GPSFactorArm(X(key), p_map_m, arm_m, gtsam.noiseModel.Diagonal.Sigmas(sigma_m))


def antenna_factor(pose: int, offset: int, p_map_m: Float64, arm_m: Float64, sigma_m: Float64) -> gtsam.CustomFactor:
    """As `gnss_factor`, with the correlated error (6,) of the fixes as a variable: `pose` and `offset` are symbols."""
    both = np.hstack([np.eye(3), np.eye(3)])

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Float64] | None) -> Float64:
        T = values.atPose3(pose).matrix()
        if H is not None:
            H[0] = T[:3, :3] @ np.hstack([-skew(arm_m), np.eye(3)])
            H[1] = both
        return T[:3, 3] + T[:3, :3] @ arm_m + both @ values.atVector(offset) - p_map_m

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigma_m), [pose, offset], error)


def decay_factor(start: int, end: int, keep: Float64, sigma_m: Float64) -> gtsam.CustomFactor:
    """Correlated error of fixes (6,) at the symbol `end`: `keep` (6,) of that at `start`, and a change (6,)."""

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Float64] | None) -> Float64:
        if H is not None:
            H[0], H[1] = -np.diag(keep), np.eye(6)
        return values.atVector(end) - keep * values.atVector(start)

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigma_m), [start, end], error)


def velocity_factor(key: int, velocity_mps: Float64, sigma_mps: float) -> gtsam.PriorFactorVector:
    """Factor of the horizontal velocity (2,) in `map`."""
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma_mps, sigma_mps, FREE_MPS]))
    return gtsam.PriorFactorVector(V(key), np.array([*velocity_mps, 0.0]), sigmas)


def no_sideslip_factor(key: int, rate_radps: Float64, arm_m: Float64, sigma_mps: float) -> gtsam.CustomFactor:
    """Base moves along x, but for the mounting of the IMU: slip has the left and upward over the forward speed.

    `arm_m` is base relative to the IMU, which turns at `rate_radps` (3,). Without wheels, the first of slip has no use.
    """
    pose, velocity, bias, slip = X(key), V(key), B(key), S(key)
    pick = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Float64] | None) -> Float64:
        back, v = values.atPose3(pose).rotation().matrix().T, values.atVector(velocity)
        turn, share = rate_radps - values.atConstantBias(bias).gyroscope(), pick @ values.atVector(slip)
        body = back @ v + np.cross(turn, arm_m)
        across = np.column_stack([-share, np.eye(2)])
        if H is not None:
            H[0] = across @ np.hstack([skew(back @ v), np.zeros((3, 3))])
            H[1] = across @ back
            H[2] = across @ np.hstack([np.zeros((3, 3)), skew(arm_m)])
            H[3] = -float(body[0]) * pick
        return across @ body

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(2, sigma_mps), [pose, velocity, bias, slip], error)


def heading_factor(key: int, heading_rad: float, sigma_rad: float) -> gtsam.CustomFactor:
    """Measured yaw of base."""
    pose = X(key)

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Float64] | None) -> Float64:
        (east, b, c), (north, e, f), _ = values.atPose3(pose).rotation().matrix().tolist()
        if H is not None:
            # d(R e_x) = R (ω × e_x) = ω_z R e_y - ω_y R e_z; its lateral part over length squared changes the yaw
            length2 = east * east + north * north
            H[0] = np.array([[0.0, (north * c - east * f) / length2, (east * e - north * b) / length2, 0.0, 0.0, 0.0]])
        return np.array([wrap(math.atan2(north, east) - heading_rad)])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma_rad), [pose], error)


def wheel_factor(start: int, end: int, columns: Float64, arm_m: Float64, sigma_m: Float64) -> gtsam.CustomFactor:
    """Displacement of base between two keyframes, `columns` (3, 4) @ slip; `arm_m` is base relative to the IMU."""
    before, after, slip = X(start), X(end), S(start)
    by_slip, by_turn = -columns, np.hstack([-skew(arm_m), np.eye(3)])
    by_start = np.hstack([np.zeros((3, 3)), -np.eye(3)])

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Float64] | None) -> Float64:
        first, last = values.atPose3(before).matrix(), values.atPose3(after).matrix()
        back = first[:3, :3].T
        displacement = back @ (last[:3, 3] + last[:3, :3] @ arm_m - first[:3, 3])
        if H is not None:
            H[0] = by_start.copy()
            H[0][:, :3] = skew(displacement)
            H[1] = back @ last[:3, :3] @ by_turn
            H[2] = by_slip
        return displacement - arm_m - columns @ values.atVector(slip)

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigma_m), [before, after, slip], error)


def standstill_factor(start: int, end: int, sigma_rad: Float64, sigma_m: Float64) -> gtsam.BetweenFactorPose3:
    """No motion between two keyframes, with sigmas (3,) by axis; it makes the gyro bias observable too."""
    model = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([sigma_rad, sigma_m]))
    return gtsam.BetweenFactorPose3(X(start), X(end), gtsam.Pose3(), model)


def relative_pose_factor(
    start: int, end: int, turned: int, T_start_end: Float64, T_base_body: Float64, covariance: Float64
) -> gtsam.CustomFactor:
    """Motion of base between two keyframes, whose translation is turned by the angle of the keyframe `turned`.

    `covariance` (6, 6), rotation then translation in base at the end; `T_base_body` is without rotation.
    """
    before, after, angle = X(start), X(end), M(turned)
    T_body_base, to_body = invert(T_base_body), gtsam.Pose3(invert(T_base_body)).AdjointMap()
    by_end = np.eye(6)

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Float64] | None) -> Float64:
        T = T_start_end.copy()
        T[:3, 3] = planar(0.0, 0.0, float(values.atVector(angle)[0]))[:3, :3] @ T[:3, 3]
        moved = values.atPose3(before).between(values.atPose3(after))
        if H is not None:
            turned_m = np.array([-T[1, 3], T[0, 3], 0.0])
            H[0] = -moved.inverse().AdjointMap()
            H[1] = by_end.copy()
            H[2] = -to_body[:, 3:] @ (T[:3, :3].T @ turned_m)[:, None]
        return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(T_body_base @ invert(T) @ T_base_body).compose(moved)))

    return gtsam.CustomFactor(_huber(to_body @ covariance @ to_body.T), [before, after, angle], error)


def pose_factor(key: int, T_map_body: Float64, covariance: Float64) -> gtsam.PriorFactorPose3:
    """Measured pose of the body; covariance (6, 6), rotation then translation, in the body."""
    return gtsam.PriorFactorPose3(X(key), gtsam.Pose3(T_map_body), _huber(covariance))


def _huber(covariance: Float64) -> gtsam.noiseModel.Robust:
    return gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(1.345), gtsam.noiseModel.Gaussian.Covariance(covariance)
    )

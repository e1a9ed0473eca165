"""Scan matching against a local map (KISS-ICP), and covariance from the geometry of the points.

Vizzo et al. 2023, "KISS-ICP: In Defense of Point-to-Point ICP"; here dead reckoning gives the initial guess and the
motion for deskewing.
"""

import math
from dataclasses import dataclass

import numpy as np
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration
from pydantic import Field
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import invert, rotation_vector
from localization.dead_reckoning.kernels import first_in_voxel, move_points


class MatchingConfig(Config):
    """Size of map and match, and limits of a valid result."""

    range_m: tuple[float, float] = Field(description="nearest and farthest return used")
    voxel_m: float = Field(gt=0.05, le=5.0)
    points_per_voxel: int = Field(ge=1, le=100)
    max_points: int = Field(ge=50, le=20000, description="matched in one scan")
    geometry_points: int = Field(ge=10, le=20000, description="used for the covariance")
    iterations: int = Field(ge=1, le=500)
    convergence: float = Field(gt=0.0, le=0.1)
    kernel_m: float = Field(gt=0.0, le=5.0, description="robust loss; 1/3 of the maximum distance of correspondences")
    neighbours: int = Field(ge=3, le=30)
    point_sigma_m: float = Field(gt=0.0, le=1.0, description="of one matched point, including common errors")
    texture_m: float = Field(gt=0.0, le=1.0, description="neighbourhoods of larger extent do not constrain a direction")
    min_points: int = Field(ge=10, le=10000)
    max_sigma_m: float = Field(gt=0.0, le=1.0, description="of the weakest horizontal direction")
    max_yaw_sigma_deg: float = Field(gt=0.0, le=10.0)
    max_step_m: float = Field(gt=0.0, le=5.0, description="from the initial guess")
    max_turn_deg: float = Field(gt=0.0, le=20.0)


@dataclass(frozen=True)
class Match:
    """Pose in the local map, covariance (rotation, translation in the body); `reason` is empty when valid."""

    T_local_body: Float64
    covariance: Float64
    reason: str
    points: int


def deskew(points_m: Float64, offset_s: Float64, T_start_end: Float64, duration_s: float) -> Float64:
    """Points (N, 3) measured `offset_s` (≤ 0) before the end of a motion of constant twist, as seen at its end."""
    # rotation and translation one after the other: the error is half their product, a few millimetres
    rotation, translation = rotation_vector(T_start_end[:3, :3]), T_start_end[:3, :3].T @ T_start_end[:3, 3]
    return move_points(points_m, offset_s / duration_s, rotation, translation)


def thin(points_m: Float64, max_points: int) -> Float64:
    """Every n-th point, at most `max_points`."""
    return points_m[:: max(1, math.ceil(len(points_m) / max_points))]


def information_matrix(points_m: Float64, cloud_m: Float64, neighbours: int, texture_m: float) -> Float64:
    """Information matrix (6, 6) of points (N, 3) on a motion about their origin, rotation then translation, unit sigma.

    Each point counts only in directions in which its neighbourhood in its cloud (M, 3) is thin: across a wall, around
    a pole.
    """
    _, near = cKDTree(cloud_m, compact_nodes=False, balanced_tree=False).query(
        points_m, k=min(neighbours, len(cloud_m))
    )
    groups = cloud_m[near]
    spread = groups - groups.mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread) / groups.shape[1])
    weight = texture_m**2 / (texture_m**2 + np.maximum(values, 0.0))
    weight[weight < 0.5] = 0.0
    W = np.einsum("nik,nk,njk->nij", axes, weight, axes)
    A = np.zeros((len(points_m), 3, 6))
    x, y, z = points_m.T
    A[:, 0, 1], A[:, 0, 2], A[:, 1, 0] = z, -y, -z
    A[:, 1, 2], A[:, 2, 0], A[:, 2, 1] = x, y, -x
    A[:, 0, 3] = A[:, 1, 4] = A[:, 2, 5] = 1.0
    return np.asarray((W @ A).reshape(-1, 6).T @ A.reshape(-1, 6))


def match_covariance(information: Float64, sigma_m: float) -> Float64:
    """Covariance (6, 6) of a match; unobservable directions get a sigma of 1 rad or 1 m."""
    return np.asarray(np.linalg.inv(information / sigma_m**2 + np.eye(6)))


def rejection_of(match_T: Float64, guess_T: Float64, covariance: Float64, config: MatchingConfig) -> str:
    """Reason to reject a match, "" when valid."""
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance[3:5, 3:5])[1]))
    if sigma > config.max_sigma_m:
        return f"degenerate: {sigma:.3f} m in the weakest direction"
    if math.degrees(math.sqrt(covariance[2, 2])) > config.max_yaw_sigma_deg:
        return "degenerate: heading"
    step = invert(guess_T) @ match_T
    turn = float(np.linalg.norm(rotation_vector(step[:3, :3])))
    if float(np.linalg.norm(step[:3, 3])) > config.max_step_m or math.degrees(turn) > config.max_turn_deg:
        return "far from dead reckoning"
    return ""


class ScanMatcher:
    """Local map and the pose of the body in it."""

    def __init__(self, config: MatchingConfig) -> None:
        self._config = config
        self._registration = Registration(config.iterations, config.convergence, max_num_threads=1)
        self._map = VoxelHashMap(config.voxel_m, 1.5 * config.range_m[1], config.points_per_voxel)
        self.T_local_body = np.eye(4)

    def reset(self) -> None:
        """Starts a new map."""
        self._map.clear()
        self.T_local_body = np.eye(4)

    def match(self, points_m: Float64, T_previous_now: Float64) -> Match:
        """Matches points (N, 3) in the body from the initial guess, and adds them to the map."""
        cfg = self._config
        guess = self.T_local_body @ T_previous_now
        fine = points_m[first_in_voxel(points_m, 0.5 * cfg.voxel_m)]
        source = thin(fine[first_in_voxel(fine, 0.75 * cfg.voxel_m)], cfg.max_points)
        match = self._align(source, fine, guess)
        self.T_local_body = _orthonormal(guess if match.reason else match.T_local_body)
        if len(fine):
            self._map.update(fine, self.T_local_body)
        return match

    def _align(self, source: Float64, fine: Float64, guess: Float64) -> Match:
        cfg, unknown = self._config, np.eye(6)
        if len(source) < cfg.min_points:
            return Match(guess, unknown, f"only {len(source)} points", len(source))
        if self._map.empty():
            return Match(guess, unknown, "first scan", len(source))
        T = self._registration.align_points_to_map(source, self._map, guess, 3.0 * cfg.kernel_m, cfg.kernel_m)
        if not bool(np.isfinite(T).all()):
            return Match(guess, unknown, "did not converge", len(source))
        part = thin(source, cfg.geometry_points)
        information = information_matrix(part, fine, cfg.neighbours, cfg.texture_m) * (len(source) / len(part))
        covariance = match_covariance(information, cfg.point_sigma_m)
        return Match(T, covariance, rejection_of(T, guess, covariance, cfg), len(source))


def _orthonormal(T: Float64) -> Float64:
    """Removes the rounding errors of a long chain of products."""
    out = T.copy()
    out[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
    return out

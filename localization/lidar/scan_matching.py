"""Matching of ground-removed scans against the last metres of map (KISS-ICP), and what its geometry can tell.

Vizzo et al. 2023, "KISS-ICP: In Defense of Point-to-Point ICP"; here dead reckoning gives the first guess and takes the
sweep's own motion out of the points.
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
from geometry.transforms import Float64, invert, rotation_vector
from localization.dead_reckoning.kernels import first_in_voxel, moved_back


class MatchingConfig(Config):
    """Size of map and match, and when a result is refused."""

    range_m: tuple[float, float] = Field(description="nearest and farthest return used")
    voxel_m: float = Field(gt=0.05, le=5.0)
    points_per_voxel: int = Field(ge=1, le=100)
    most_points: int = Field(ge=50, le=20000, description="matched in one scan")
    judged_points: int = Field(ge=10, le=20000, description="of which the geometry is looked at")
    iterations: int = Field(ge=1, le=500)
    convergence: float = Field(gt=0.0, le=0.1)
    kernel_m: float = Field(gt=0.0, le=5.0, description="a third of the greatest distance of partners")
    neighbours: int = Field(ge=3, le=30)
    point_sigma_m: float = Field(gt=0.0, le=1.0, description="of one matched point, with what it shares with others")
    texture_m: float = Field(gt=0.0, le=1.0, description="extent above which a direction is one a surface can slide in")
    least_points: int = Field(ge=10, le=10000)
    largest_sigma_m: float = Field(gt=0.0, le=1.0, description="of the weakest horizontal direction")
    largest_yaw_sigma_deg: float = Field(gt=0.0, le=10.0)
    largest_step_m: float = Field(gt=0.0, le=5.0, description="off the first guess")
    largest_turn_deg: float = Field(gt=0.0, le=20.0)


@dataclass(frozen=True)
class Match:
    """A pose in the map of matching, its covariance (rotation, translation in the body); `reason` why it is refused."""

    T_local_body: Float64
    covariance: Float64
    reason: str
    points: int


def deskew(points_m: Float64, offset_s: Float64, T_start_end: Float64, duration_s: float) -> Float64:
    """Points (N, 3) seen `offset_s` (≤ 0) against the end of a motion at constant twist, as seen at its end."""
    # turn and way may be taken one after the other: the error is half their product, a few millimetres
    turn, way = rotation_vector(T_start_end[:3, :3]), T_start_end[:3, :3].T @ T_start_end[:3, 3]
    return moved_back(points_m, offset_s / duration_s, turn, way)


def thinned(points_m: Float64, most: int) -> Float64:
    """Every n-th point, so that at most `most` are left."""
    return points_m[:: max(1, math.ceil(len(points_m) / most))]


def information_of(points_m: Float64, cloud_m: Float64, neighbours: int, texture_m: float) -> Float64:
    """What points (N, 3) can tell of a motion about their origin: (6, 6), rotation then translation, for unit sigma.

    Each point counts only in directions in which its neighbourhood in the cloud (M, 3) that it comes from is thin: on a
    wall across it, on a pole around it.
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


def covariance_of(information: Float64, sigma_m: float) -> Float64:
    """Covariance (6, 6) of a match; what is not seen gets a sigma of 1 rad or 1 m instead of infinity."""
    return np.asarray(np.linalg.inv(information / sigma_m**2 + np.eye(6)))


def refusal_of(match_T: Float64, guess_T: Float64, covariance: Float64, config: MatchingConfig) -> str:
    """Why a match must not be used, "" when it may."""
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance[3:5, 3:5])[1]))
    if sigma > config.largest_sigma_m:
        return f"degenerate: {sigma:.3f} m in the weakest direction"
    if math.degrees(math.sqrt(covariance[2, 2])) > config.largest_yaw_sigma_deg:
        return "degenerate: heading"
    off = invert(guess_T) @ match_T
    turn = float(np.linalg.norm(rotation_vector(off[:3, :3])))
    if float(np.linalg.norm(off[:3, 3])) > config.largest_step_m or math.degrees(turn) > config.largest_turn_deg:
        return "far from dead reckoning"
    return ""


class ScanMatcher:
    """A map of the last surroundings and the pose of the body in it."""

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
        """Moves on by a first guess, matches points (N, 3) seen from the body now, and adds them to the map."""
        cfg = self._config
        guess = self.T_local_body @ T_previous_now
        fine = points_m[first_in_voxel(points_m, 0.5 * cfg.voxel_m)]
        source = thinned(fine[first_in_voxel(fine, 0.75 * cfg.voxel_m)], cfg.most_points)
        match = self._align(source, fine, guess)
        self.T_local_body = _orthonormal(guess if match.reason else match.T_local_body)
        if len(fine):
            self._map.update(fine, self.T_local_body)
        return match

    def _align(self, source: Float64, fine: Float64, guess: Float64) -> Match:
        cfg, unknown = self._config, np.eye(6)
        if len(source) < cfg.least_points:
            return Match(guess, unknown, f"only {len(source)} points", len(source))
        if self._map.empty():
            return Match(guess, unknown, "first scan", len(source))
        T = self._registration.align_points_to_map(source, self._map, guess, 3.0 * cfg.kernel_m, cfg.kernel_m)
        if not bool(np.isfinite(T).all()):
            return Match(guess, unknown, "did not converge", len(source))
        part = thinned(source, cfg.judged_points)
        information = information_of(part, fine, cfg.neighbours, cfg.texture_m) * (len(source) / len(part))
        covariance = covariance_of(information, cfg.point_sigma_m)
        return Match(T, covariance, refusal_of(T, guess, covariance, cfg), len(source))


def _orthonormal(T: Float64) -> Float64:
    """The same without what rounding does to a long chain of products."""
    out = T.copy()
    out[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
    return out

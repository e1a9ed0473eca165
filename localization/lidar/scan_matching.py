"""Scan matching: pose of base against surfaces of the scans before it.

Each point counts only across the thin directions of its surface. Point-to-point matching (KISS-ICP) of sparse rings on
a hedge or fence along the path gives too little motion, since rings move with the sensor: `benchmark lidar_odometry`.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from configs.strict import Config
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from geometry.transforms import planar, rotation_vector, yaw_of
from localization.dead_reckoning.kernels import move_points
from localization.lidar.surface_map import SurfaceMap, SurfaceMapConfig

UNOBSERVED = np.square([0.1, 0.1, 0.0, 0.0, 0.0, 10.0])  # variances of roll, pitch (rad²) and height (m²)


class MatchLimits(Config):
    """Points that are matched, and limits of a valid match."""

    range_m: tuple[float, float] = Field(description="nearest and farthest return used")
    voxel_m: float = Field(gt=0.0, le=2.0)
    max_points: int = Field(ge=50, le=20000, description="matched in one scan")
    min_points: int = Field(ge=10, le=10000, description="on a surface")
    max_sigma_m: float = Field(gt=0.0, le=1.0, description="of the weakest horizontal direction")
    max_sigma_deg: float = Field(gt=0.0, le=10.0)
    max_step_m: float = Field(gt=0.0, le=5.0, description="from the initial guess")
    max_turn_deg: float = Field(gt=0.0, le=20.0)
    surfaces: SurfaceMapConfig


class MatchingConfig(MatchLimits):
    """Section `matching` of lidar odometry."""

    learn_m: float = Field(gt=0.0, le=10.0, description="motion between scans that are added to the map")
    first_scans: int = Field(ge=1, le=100, description="added to a new map without motion")
    lost_scans: int = Field(ge=1, le=100, description="rejected in a row: a new map begins")


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
    return np.ascontiguousarray(points_m[:: max(1, math.ceil(len(points_m) / max_points))])


def level_of(T: Float64) -> Float64:
    """Transform from base to level axes about it without yaw; heights are those of `T`."""
    level = planar(0.0, 0.0, -yaw_of(T)) @ T
    level[:2, 3] = 0.0
    return np.asarray(level)


def rows_of(points_base_m: Float64, origin_base_m: Float64, T_level_base: Float64) -> Float64:
    """Points (N, 3) with the origin (3,) of their lidar as (N, 5), see map_kernels.py."""
    origin = T_level_base[:3, :3] @ origin_base_m + T_level_base[:3, 3]
    p = points_base_m @ T_level_base[:3, :3].T + T_level_base[:3, 3]
    return np.column_stack([p, np.broadcast_to(origin[:2], (len(p), 2))])


def rotated(T: Float64, angle_rad: float) -> Float64:
    """Pose turned about the vertical at its own place."""
    out = planar(0.0, 0.0, angle_rad) @ T
    out[:3, 3] = T[:3, 3]
    return np.asarray(out)


def shifted(T: Float64, step: Float64) -> Float64:
    """Pose after a step (x, y, yaw) in the map, turned at its own place."""
    return np.asarray(planar(step[0], step[1], 0.0) @ rotated(T, step[2]))


def in_body(covariance: Float64, unobserved: Float64, yaw_rad: float) -> Float64:
    """Covariance (6, 6), rotation and translation in the body, from that of (x, y, yaw) in the map."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    J = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    out, observed = np.diag(unobserved), [3, 4, 2]
    out[np.ix_(observed, observed)] = J @ covariance @ J.T
    return out


def rejection_of(step: Float64, covariance: Float64, found: int, limits: MatchLimits) -> str:
    """Reason to reject a match that is a step (x, y, yaw) from its guess, "" when valid."""
    if found < limits.min_points:
        return f"only {found} returns on the map"
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[1]))
    if sigma > limits.max_sigma_m:
        return f"degenerate: {sigma:.3f} m in the weakest direction"
    if math.sqrt(covariance[2, 2]) > math.radians(limits.max_sigma_deg):
        return "degenerate: heading"
    if math.hypot(step[0], step[1]) > limits.max_step_m or abs(step[2]) > math.radians(limits.max_turn_deg):
        return "far from the first guess"
    return ""


class ScanMatcher:
    """Local map and the pose of the body in it; `origin_m` (3,) of the lidar in the body."""

    def __init__(self, config: MatchingConfig, origin_m: Float64) -> None:
        self._config, self._origin_m = config, origin_m
        self.reset()
        self._map.warm()

    def reset(self, T_level_body: Float64 | None = None) -> None:
        """Starts a new map, at an attitude without yaw if that is known."""
        self._map = SurfaceMap(self._config.surfaces, None)
        self.T_local_body = np.eye(4) if T_level_body is None else T_level_body.copy()
        self._learned_m: Float64 | None = None
        self._scans = self._lost = 0

    def match(self, points_m: Float64, T_previous_now: Float64) -> Match:
        """Matches points (N, 3) in the body, one of each voxel, and adds them to the map after some motion."""
        cfg, T_guess = self._config, self.T_local_body @ T_previous_now
        rows = rows_of(points_m, self._origin_m, level_of(T_guess))
        match = self._align(rows, T_guess)
        self.T_local_body = _orthonormal(match.T_local_body)
        self._lost = self._lost + 1 if match.reason and self._scans else 0
        if self._lost >= cfg.lost_scans:
            self.reset(_orthonormal(level_of(self.T_local_body)))
        if not self._lost:
            self._learn(rows)
        return match

    def _align(self, rows: Float64, T_guess: Float64) -> Match:
        cfg, guess = self._config, np.array(Pose2.of(T_guess))
        if not self._scans:
            return Match(T_guess, np.eye(6), f"first scan of {len(rows)} returns", 0)
        min_scans = min(self._scans, cfg.surfaces.min_scans)
        pose, covariance, found = self._map.match(thin(rows, cfg.max_points), guess, min_scans)
        step = pose - guess
        reason = rejection_of(step, covariance, found, cfg)
        T = T_guess if reason else shifted(T_guess, step)
        return Match(T, in_body(covariance, UNOBSERVED, yaw_of(T)), reason, found)

    def _learn(self, rows: Float64) -> None:
        at_m, last_m = self.T_local_body[:2, 3].copy(), self._learned_m
        is_new = self._scans < self._config.first_scans
        if is_new or last_m is None or math.dist(at_m, last_m) >= self._config.learn_m:
            self._map.learn(rows, np.array(Pose2.of(self.T_local_body)))
            self._scans, self._learned_m = self._scans + 1, at_m


def _orthonormal(T: Float64) -> Float64:
    """Removes the rounding errors of a long chain of products."""
    out = T.copy()
    out[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
    return out

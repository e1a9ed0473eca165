"""Surface map in `map`: surveyed walls and posts, and surfaces learned while the pose was accurate."""

import math

import numpy as np
import shapely
from pydantic import Field

from configs.site import Shed
from configs.strict import Config
from geometry.arrays import Float64
from geometry.polygon import parts, ring_points
from localization.lidar.map_kernels import EMPTY, Table, insert, keep_near, match

MAX_LOAD = 0.6  # of a table with open addressing


class SurfaceMapConfig(Config):
    """Size of the map and parameters of matching."""

    cell_m: float = Field(gt=0.1, le=5.0)
    table_bits: int = Field(ge=10, le=20, description="base-2 logarithm of the table size")
    keep_radius_m: float = Field(gt=10.0, le=500.0, description="about the machine, kept when the table is full")
    max_points_per_cell: float = Field(ge=10.0, le=1e6, description="from which on older points are halved")
    min_scans: int = Field(ge=1, le=100, description="in which a cell must have been measured")
    max_thickness_m: float = Field(gt=0.0, le=0.5, description="maximum spread of a cell across a surface")
    gate_m: float = Field(gt=0.0, le=2.0, description="from a point to a surveyed surface")
    point_sigma_m: float = Field(gt=0.0, le=0.5)
    robust_sigmas: float = Field(gt=0.0, le=10.0, description="residual with half weight")
    correlated_points: float = Field(ge=1.0, le=1000.0, description="points with a common error")
    floor_m: float = Field(gt=0.0, le=0.5, description="lower bound of a match")
    floor_deg: float = Field(gt=0.0, le=5.0)
    iterations: int = Field(ge=1, le=100)


class SurfaceMap:
    """Matches points with surfaces, and learns surfaces from points."""

    def __init__(self, config: SurfaceMapConfig, shed: Shed | None) -> None:
        self._config = config
        self._surveyed = faces_of(shed), posts_of(shed)
        size = 1 << config.table_bits
        self._table: Table = np.full(size, EMPTY, np.int64), np.zeros((size, 6)), np.zeros((size, 2), np.int64)
        self._scans = self._cells = 0

    def warm(self) -> None:
        """Compiles the kernels or loads them from the cache."""
        self.match(np.zeros((0, 5)), np.zeros(3))
        insert(*self._table, np.zeros((0, 5)), np.zeros(3), self._config.cell_m, self._config.max_points_per_cell, 0)

    def learn(self, points: Float64, pose: Float64) -> None:
        """Adds one scan at a pose (x, y, yaw); points (N, 5) as in map_kernels.py."""
        cfg, size = self._config, len(self._table[0])
        if self._cells + len(points) > MAX_LOAD * size:
            at = float(pose[0]), float(pose[1])
            self._table, self._cells = keep_near(self._table, at, cfg.cell_m, cfg.keep_radius_m)
        if self._cells + len(points) > MAX_LOAD * size:
            return
        self._scans += 1
        self._cells += insert(*self._table, points, pose, cfg.cell_m, cfg.max_points_per_cell, self._scans)

    def match(self, points: Float64, guess: Float64, min_scans: int | None = None) -> tuple[Float64, Float64, int]:
        """Pose (x, y, yaw), covariance (3, 3) and number of points with a surface measured in `min_scans`."""
        cfg = self._config
        pose, information, found = match(
            points, guess, self._surveyed, self._table, cfg.cell_m, cfg.gate_m, cfg.point_sigma_m, cfg.max_thickness_m,
            cfg.robust_sigmas, cfg.min_scans if min_scans is None else min_scans, cfg.iterations,
        )  # fmt: skip
        floor = np.square([cfg.floor_m, cfg.floor_m, math.radians(cfg.floor_deg)])
        return pose, cfg.correlated_points * np.linalg.inv(information + 1e-3 * np.eye(3)) + np.diag(floor), found


def faces_of(shed: Shed | None) -> Float64:
    """Both sides of all walls, (M, 6): start, end, outward normal."""
    if shed is None or not shed.walls_m:
        return np.zeros((0, 6))
    half = 0.5 * shed.wall_thickness_m
    thick = [shapely.LineString(w).buffer(half, cap_style="flat", join_style="mitre") for w in shed.walls_m]
    walls = shapely.union_all(thick)
    rows = []
    for ring in (ring for polygon in parts(walls) for ring in ring_points(polygon)):
        step = np.diff(ring, axis=0)
        normal = np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1, keepdims=True)
        rows.append(np.hstack([ring[:-1], ring[1:], normal]))  # walls lie to the left of every ring
    return np.concatenate(rows)


def posts_of(shed: Shed | None) -> Float64:
    """Center and radius of all posts, (K, 3)."""
    return np.array([[*p.at_m, p.radius_m] for p in (shed.posts if shed is not None else ())]).reshape(-1, 3)

"""What stands about the machine, in `map`: surveyed walls and posts, and surfaces learnt while the pose was good."""

import math

import numpy as np
import shapely
from pydantic import Field

from configs.site import Shed
from configs.strict import Config
from geometry.polygon import parts, ring_points
from geometry.transforms import Float64
from localization.lidar.map_kernels import EMPTY, Table, insert, keep_near, match

FULL = 0.6  # of a table with open addressing


class SurfaceMapConfig(Config):
    """Size of the map and how scans are laid on it."""

    cell_m: float = Field(gt=0.1, le=5.0)
    slots: int = Field(ge=10, le=20, description="of the table, as a power of two")
    keep_m: float = Field(gt=10.0, le=500.0, description="about the machine, when the table is full")
    most_in_cell: float = Field(ge=10.0, le=1e6, description="returns, after which older ones begin to fade")
    least_looks: int = Field(ge=1, le=100, description="a cell must have been seen so often")
    thin_m: float = Field(gt=0.0, le=0.5, description="spread up to which a cell holds across a direction")
    gate_m: float = Field(gt=0.0, le=2.0, description="from a return to a surveyed surface")
    point_sigma_m: float = Field(gt=0.0, le=0.5)
    bound_sigmas: float = Field(gt=0.0, le=10.0, description="residual that counts half")
    shared: float = Field(ge=1.0, le=1000.0, description="returns that have one error in common")
    floor_m: float = Field(gt=0.0, le=0.5, description="no match is believed better than this")
    floor_deg: float = Field(gt=0.0, le=5.0)
    iterations: int = Field(ge=1, le=100)


class SurfaceMap:
    """Lays points on surfaces, and learns surfaces from points."""

    def __init__(self, config: SurfaceMapConfig, shed: Shed | None) -> None:
        self._config = config
        self._surveyed = faces_of(shed), posts_of(shed)
        size = 1 << config.slots
        self._table: Table = np.full(size, EMPTY, np.int64), np.zeros((size, 6)), np.zeros((size, 2), np.int64)
        self._looks = self._cells = 0

    def learn(self, points: Float64, pose: Float64) -> None:
        """Takes what one scan shows from a good pose (x, y, yaw); for the points see map_kernels.py."""
        cfg, size = self._config, len(self._table[0])
        if self._cells + len(points) > FULL * size:
            at = float(pose[0]), float(pose[1])
            self._table, self._cells = keep_near(self._table, at, cfg.cell_m, cfg.keep_m)
        if self._cells + len(points) > FULL * size:
            return
        self._looks += 1
        self._cells += insert(*self._table, points, pose, cfg.cell_m, cfg.most_in_cell, self._looks)

    def match(self, points: Float64, guess: Float64) -> tuple[Float64, Float64, int]:
        """Pose (x, y, yaw) that lays points on surfaces, its covariance (3, 3), and how many found one."""
        cfg = self._config
        pose, information, found = match(
            points, guess, self._surveyed, self._table, cfg.cell_m, cfg.gate_m, cfg.point_sigma_m, cfg.thin_m,
            cfg.bound_sigmas, cfg.least_looks, cfg.iterations,
        )  # fmt: skip
        floor = np.square([cfg.floor_m, cfg.floor_m, math.radians(cfg.floor_deg)])
        return pose, cfg.shared * np.linalg.inv(information + 1e-3 * np.eye(3)) + np.diag(floor), found


def faces_of(shed: Shed | None) -> Float64:
    """Both sides of all walls: start, end and outward normal (M, 6)."""
    if shed is None or not shed.walls_m:
        return np.zeros((0, 6))
    half = 0.5 * shed.wall_thickness_m
    thick = [shapely.LineString(w).buffer(half, cap_style="flat", join_style="mitre") for w in shed.walls_m]
    walls = shapely.union_all(thick)
    rows = []
    for ring in (ring for polygon in parts(walls) for ring in ring_points(polygon)):
        step = np.diff(ring, axis=0)
        normal = np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1, keepdims=True)
        rows.append(np.hstack([ring[:-1], ring[1:], normal]))  # solid lies to the left of every ring
    return np.concatenate(rows)


def posts_of(shed: Shed | None) -> Float64:
    """Middle and radius of all posts, (K, 3)."""
    return np.array([[*p.at_m, p.radius_m] for p in (shed.posts if shed is not None else ())]).reshape(-1, 3)

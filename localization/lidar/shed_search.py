"""Search of the pose in the shed without a first guess: one pose that the surveyed walls and posts leave, or none."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from pydantic import Field

from configs.site import Shed
from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from localization.lidar.map_kernels import scores
from localization.lidar.surface_map import SurfaceMap, faces_of, posts_of


class ShedSearchConfig(Config):
    """Grid of the search, and what proves a pose."""

    period_s: float = Field(gt=0.0, le=60.0)
    step_m: float = Field(gt=0.05, le=2.0)
    step_deg: float = Field(gt=0.5, le=45.0)
    points: int = Field(ge=20, le=2000, description="of a scan, on the grid")
    gate_m: float = Field(gt=0.05, le=2.0, description="from a point to a surface, on the grid")
    poses: int = Field(ge=2, le=1000, description="best of the grid, which are refined")
    fine_gate_m: float = Field(gt=0.01, le=1.0, description="the same, of a refined pose")
    min_points: int = Field(ge=10, le=10000)
    min_share: float = Field(gt=0.0, le=1.0, description="of the points under the roof that lie on a surface")
    rival_share: float = Field(gt=0.0, lt=1.0, description="of the best pose's points, with which another is a rival")
    apart_m: float = Field(gt=0.0, le=10.0, description="nearer poses are one")
    apart_deg: float = Field(gt=0.0, le=90.0)


@dataclass(frozen=True)
class Found:
    """Best pose (x, y, yaw) with covariance (3, 3) and number of points; `reason` why it is not proven, "" if it is."""

    pose: Float64
    covariance: Float64
    points: int
    reason: str


class ShedSearch:
    """Searches all places under the roof and all headings."""

    def __init__(self, config: ShedSearchConfig, shed: Shed) -> None:
        self._config, self._faces, self._posts = config, faces_of(shed), posts_of(shed)
        self._roof = shapely.Polygon(shed.outline_m).buffer(config.fine_gate_m)
        shapely.prepare(self._roof)
        low_x, low_y, high_x, high_y = self._roof.bounds
        x, y = np.arange(low_x, high_x, config.step_m), np.arange(low_y, high_y, config.step_m)
        yaw = np.radians(np.arange(0.0, 360.0, config.step_deg))
        grid = np.stack(np.meshgrid(x, y, yaw, indexing="ij"), axis=-1).reshape(-1, 3)
        self._grid = np.ascontiguousarray(grid[shapely.contains_xy(self._roof, grid[:, 0], grid[:, 1])])
        scores(np.zeros((0, 5)), self._grid[:1], self._faces, self._posts, config.gate_m)  # compiles or loads it

    def find(self, surfaces: SurfaceMap, points: Float64) -> Found:
        """Pose of a scan; points (N, 5) as in map_kernels.py, `surfaces` with the same survey and nothing learned."""
        cfg = self._config
        few = np.ascontiguousarray(points[:: max(1, math.ceil(len(points) / cfg.points))])
        coarse = scores(few, self._grid, self._faces, self._posts, cfg.gate_m)
        if len(points) < cfg.min_points:
            return Found(np.zeros(3), np.eye(3), 0, f"only {len(points)} returns")
        best = np.argsort(-coarse, kind="stable")[: cfg.poses]
        refined = [surfaces.match(points, self._grid[k]) for k in best.tolist()]
        poses = np.array([pose for pose, _, _ in refined])
        counts = scores(points, np.ascontiguousarray(poses), self._faces, self._posts, cfg.fine_gate_m)
        first = int(np.argmax(counts))
        pose, covariance, _ = refined[first]
        return Found(pose, covariance, int(counts[first]), self._reason(points, poses, counts, first))

    def _reason(self, points: Float64, poses: Float64, counts: Float64, first: int) -> str:
        """Why the best pose is not proven, "" if it is."""
        cfg, pose = self._config, poses[first]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = pose[0] + c * points[:, 0] - s * points[:, 1], pose[1] + s * points[:, 0] + c * points[:, 1]
        under = int(np.count_nonzero(shapely.contains_xy(self._roof, x, y)))
        if counts[first] < cfg.min_points or counts[first] < cfg.min_share * under:
            return f"{int(counts[first])} of {under} returns under the roof lie on the surveyed shed"
        for other, count in zip(poses, counts, strict=True):
            apart_m = float(np.hypot(*(other[:2] - pose[:2])))
            apart_deg = abs(math.degrees(wrap(float(other[2] - pose[2]))))
            if (apart_m > cfg.apart_m or apart_deg > cfg.apart_deg) and count >= cfg.rival_share * counts[first]:
                return f"ambiguous: a pose {apart_m:.1f} m and {apart_deg:.0f} deg apart fits too"
        return ""

"""Scan preprocessing: obstacle points outside the machine, voxel-filtered and deskewed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from configs.vehicle import Body, Lidar, MountedImplement, TrailedImplement, outlines
from geometry.arrays import Float64
from geometry.transforms import apply
from localization.dead_reckoning.kernels import first_in_voxel
from localization.lidar.scan_matching import deskew
from messages.perception import LidarGround
from messages.sensors import LidarScan


@dataclass(frozen=True)
class ScanPoints:
    """Points (N, 3) and the origin (3,) of the lidar, in base at the stamp of the scan."""

    points_base_m: Float64
    sensor_origin_base_m: Float64


class ScanPreprocessor:
    """Pairs scans with their ground and filters their points."""

    def __init__(
        self, lidar: Lidar, body: Body, implement: MountedImplement | TrailedImplement | None,
        range_m: tuple[float, float], margin_m: float, voxel_m: float,
    ) -> None:  # fmt: skip
        self._T_base_lidar, self._range_m, self._voxel_m = lidar.mount.T_base_sensor, range_m, voxel_m
        self.sweep_ns = round(1e9 / lidar.rate_hz)
        self._margin_m = margin_m
        self._body, *implements = outlines(body, implement)
        self._implement = implements[0] if implements else self._body
        offtracking_m = -self._implement.rear_m if isinstance(implement, TrailedImplement) else 0.0  # to either side
        self._half_width_m = self._implement.half_width_m + offtracking_m
        self._waiting: dict[int, LidarScan] = {}

    def pair(self, scans: Sequence[LidarScan], grounds: Sequence[LidarGround]) -> tuple[LidarScan, LidarGround] | None:
        """The newest scan with its ground, None without a new one."""
        self._waiting |= {scan.stamp_ns: scan for scan in scans}
        newest = None
        for ground in grounds:
            scan = self._waiting.pop(ground.scan_stamp_ns, None)
            if scan is not None and len(ground.is_obstacle_point) == len(scan.points_m):
                newest = scan, ground
        for stamp_ns in sorted(self._waiting)[:-4]:
            del self._waiting[stamp_ns]
        return newest

    def process(self, scan: LidarScan, ground: LidarGround, T_sweep: Float64) -> ScanPoints:
        """Obstacle points in base at the stamp; `T_sweep` is the motion during the sweep."""
        obstacle = np.flatnonzero(ground.is_obstacle_point)
        p = np.asarray(apply(self._T_base_lidar, scan.points_m[obstacle].astype(np.float64)), np.float64)
        near, far = self._range_m
        range2 = np.einsum("ni,ni->n", p, p)
        use = np.flatnonzero((range2 > near**2) & (range2 < far**2) & ~self._is_own(p))
        use = use[first_in_voxel(p[use], self._voxel_m)]
        offset_s = scan.point_offset_s[obstacle[use]].astype(np.float64)
        return ScanPoints(deskew(p[use], offset_s, T_sweep, 1e-9 * self.sweep_ns), self._T_base_lidar[:3, 3])

    def _is_own(self, p_base_m: Float64) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        x, y, m = p_base_m[:, 0], np.abs(p_base_m[:, 1]), self._margin_m
        on_body = (x < self._body.front_m + m) & (x > self._body.rear_m - m) & (y < self._body.half_width_m + m)
        behind = (x < m) & (x > self._implement.rear_m - m) & (y < self._half_width_m + m)  # with the drawbar
        return np.asarray(on_body | behind)

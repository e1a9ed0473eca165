"""One lidar as the supervisor sees it: its hits in odom, and how far it proves the field free."""

import math

import numpy as np

from configs.vehicle import Lidar
from messages.message import Float64, Int64
from messages.sensors import LidarScan
from safety.config import SafetyConfig
from safety.pose_history import from_frame, to_frame
from safety.sources.detection_range import (
    down_beams,
    edges,
    expected_returns,
    least_towards,
    looks,
    range_by_share,
    reach_m,
    shares,
)
from safety.sources.ground_filter import Box, Motion, deskew, is_own, raised, to_base, within
from safety.sources.multiple_evaluation import confirm, keys_of
from safety.zones.footprint import Shape


class Eye:
    """Takes scans of one lidar; `hits_odom_m` (N, 3) are the confirmed returns above the ground.

    `shape` masks the machine itself; whoever knows the fold sets it.
    """

    def __init__(self, name: str, lidar: Lidar, shape: Shape, config: SafetyConfig) -> None:
        self.name = name
        self.stamp_ns: int | None = None
        self.scan: LidarScan | None = None
        self.hits_odom_m: Float64 = np.empty((0, 3))
        self.reach_m = reach_m(lidar, config.field, config.proven)
        self.shape, self._config = shape, config
        self._T_base_sensor = lidar.mount.T_base_sensor
        self._lowest_slope = math.tan(math.radians(min(lidar.elevation_deg)))
        self._slopes, self._density = expected_returns(lidar, config.proven)
        self._directions = tuple(d for d in (1, -1) if looks(lidar, shape, d))
        self._edges = edges(config.proven.sectors)
        self._proven_m = dict.fromkeys(self._directions, 0.0)
        self._cells: Int64 = np.empty(0, np.int64)
        self._kept: tuple[Float64, Int64] = (np.empty((0, 3)), np.empty(0, np.int64))
        self._equal_scans = 0

    def looks(self, direction: int) -> bool:
        """Whether it sees the way ahead in a direction of travel."""
        return direction in self._directions

    def proven_m(self, direction: int) -> float:
        """How far its last scan proves the field free in a direction of travel."""
        return 0.0 if self.is_frozen else self._proven_m.get(direction, 0.0)

    @property
    def is_frozen(self) -> bool:
        """Whether it sends the same scan again and again."""
        return self._equal_scans >= self._config.proven.frozen_scans

    def take(self, scan: LidarScan, pose_odom: Float64, motion: Motion, curvature_radpm: float, box: Box) -> None:
        """Take a scan; `pose_odom` (3,) is base at its stamp, `box` what matters of base then.

        The last scan may be taken once more for another box; what was remembered of the one before is then gone.
        """
        if scan is self.scan:
            self._cells = np.empty(0, np.int64)
        else:
            self._equal_scans = self._equal_scans + 1 if is_same(scan, self.scan) else 0
        self.scan, self.stamp_ns = scan, scan.stamp_ns
        xyz = to_base(scan.points_m, self._T_base_sensor)
        self._judge_reach(xyz, curvature_radpm)
        field = self._config.field
        near = within(xyz, box, self.shape.height_m + field.over_height_m)
        looked = deskew(xyz.take(near, axis=1), scan.point_offset_s.take(near), motion)
        looked = looked.compress(raised(looked, box, field), axis=1)
        looked = looked.compress(~is_own(looked, self.shape, curvature_radpm, field.mask_m), axis=1)
        places = np.asarray(looked, np.float64)
        points_odom = np.column_stack([to_frame(pose_odom, places[:2].T), places[2]])
        is_hit, self._cells = confirm(
            keys_of(points_odom, field.cell_m), self._cells, field.returns_once, field.returns_twice
        )
        self._remember(points_odom[is_hit], pose_odom, curvature_radpm, scan.stamp_ns)

    def _judge_reach(self, xyz: np.ndarray, curvature_radpm: float) -> None:
        proven, origin = self._config.proven, self._T_base_sensor[:3, 3]
        some = down_beams(xyz, origin, self._slopes)
        some = some.compress(~is_own(some, self.shape, curvature_radpm, self._config.field.mask_m), axis=1)
        share = shares(some, origin, self._density, proven.sectors)
        ranges, half_rad = range_by_share(share, self.reach_m, proven), math.radians(proven.look_deg)
        self._proven_m = {d: least_towards(self._edges, ranges, d, half_rad) for d in self._directions}

    def _remember(self, hits_odom: Float64, pose_odom: Float64, curvature_radpm: float, stamp_ns: int) -> None:
        """Keep for a while what went where no beam can look: the ground right before the bumper."""
        old, seen_ns = self._kept
        base = np.vstack([from_frame(pose_odom, old[:, :2]).T, old[:, 2]])
        is_young = stamp_ns - seen_ns < self._config.field.hole_memory_s * 1e9
        is_outside = ~is_own(base, self.shape, curvature_radpm, self._config.field.mask_m)
        keep = is_young & is_outside & self._is_in_hole(base)
        self.hits_odom_m = np.concatenate([hits_odom, old[keep]])
        stamps = np.concatenate([np.full(len(hits_odom), stamp_ns, np.int64), seen_ns[keep]])
        self._kept = (self.hits_odom_m, stamps)

    def _is_in_hole(self, base: Float64) -> np.ndarray:
        """Which points (3, N) lie below the lowest beam."""
        x, y, z = base - self._T_base_sensor[:3, 3:]
        return np.asarray(z < self._lowest_slope * np.hypot(x, y))


def is_same(scan: LidarScan, before: LidarScan | None) -> bool:
    """Whether a scan repeats the ranges of the one before, to the bit, under a new stamp."""
    if before is None or (scan.ranges_mm.size == 0 and scan.xyz_m.size == 0):
        return False
    return np.array_equal(scan.ranges_mm, before.ranges_mm) and np.array_equal(scan.xyz_m, before.xyz_m)

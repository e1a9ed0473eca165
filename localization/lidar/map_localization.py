"""Lidar localization node: pose in a map of the surveyed shed and of surfaces learned before.

The map is learned while the pose is accurate, and matched where fixes are missing or the shed is near. Before the first
position the pose is searched in the whole shed.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np
import shapely
from pydantic import Field

from configs.site import Shed
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from geometry.transforms import invert, yaw_of
from localization.lidar.scan_matching import (
    UNOBSERVED,
    MatchLimits,
    in_body,
    level_of,
    rejection_of,
    rotated,
    rows_of,
    shifted,
    thin,
)
from localization.lidar.scan_preprocessing import ScanPreprocessor
from localization.lidar.shed_search import ShedSearch, ShedSearchConfig
from localization.lidar.surface_map import SurfaceMap
from messages.motion import LidarLocalization, MapPose, Odometry, PositionSource, odometry_at
from messages.node import All, At, Every, Inbox, Latest, Node, Output, Read
from messages.perception import LidarGround
from messages.sensors import LidarScan

LIDAR_LOCALIZATION = "lidar_localization"
UNMATCHED = np.square([100.0, 100.0, math.pi])  # variances of x, y (m²) and yaw (rad²) without a match


class LidarMapConfig(MatchLimits):
    """Section `lidar_map` of localization."""

    period_s: float = Field(ge=0.05, le=2.0)
    margin_m: float = Field(ge=0.0, le=5.0, description="self filter about machine and implement")
    near_shed_m: float = Field(ge=0.0, le=200.0, description="distance with matching in spite of fixed ambiguities")
    learn_period_s: float = Field(gt=0.0, le=60.0, description="between learned scans")
    learn_sigma_m: float = Field(gt=0.0, le=1.0, description="maximum sigma of a pose to learn from")
    learn_sigma_deg: float = Field(gt=0.0, le=10.0)
    floor_sigma_m: float = Field(gt=0.0, le=1.0, description="of height 0 on the level floor of the shed")
    search: ShedSearchConfig


class LidarMap(Node):
    """Matches the obstacle points of all lidars with the map; weak results are invalid, with a reason."""

    def __init__(
        self, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, shed: Shed | None,
        config: LidarMapConfig,
    ) -> None:  # fmt: skip
        lidars = vehicle.sensors.segmented_lidars
        self.name = "lidar_map"
        self.reads: Mapping[str, Read] = {
            **{f"lidar/{name}": All(4) for name in lidars},
            **{f"ground/{name}": All(4) for name in lidars},
            "odom": At(1.5),
            "map_pose": Latest(),
        }
        self.writes = (LIDAR_LOCALIZATION,)
        self.runs = Every(round(config.period_s * 1e9))
        self._config = config
        bounds = config.range_m, config.margin_m, config.voxel_m
        self._lidars = {n: ScanPreprocessor(lidar, vehicle.body, implement, *bounds) for n, lidar in lidars.items()}
        self._roof = shapely.Polygon(shed.outline_m) if shed is not None else shapely.Polygon()
        self._map = SurfaceMap(config.surfaces, shed)
        self._learned_ns: int | None = None
        self._search = ShedSearch(config.search, shed) if shed is not None and lidars else None
        self._searched_ns: int | None = None
        self._map.warm()

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Matches the newest scan of every lidar and learns from it; where no match is needed, the result says so."""
        pairs = self._newest(inbox)
        pose = inbox.latest("map_pose", MapPose)
        if not pairs or pose is None:
            return []
        stamp_ns = max(scan.stamp_ns for scan, _ in pairs.values())
        odom = odometry_at(inbox, stamp_ns)
        if odom is None:
            return []
        if not pose.is_initialized:
            return self._searched(stamp_ns, pairs, odom, inbox)
        self._search = None
        T_guess = np.asarray(pose.T_map_odom @ odom.T_odom_base)
        is_matching = pose.source is not PositionSource.RTK_FIXED or self._distance(T_guess) < self._config.near_shed_m
        is_learning = self._learned_ns is None or abs(stamp_ns - self._learned_ns) >= self._config.learn_period_s * 1e9
        points = self._points(pairs, odom, inbox, T_guess) if is_matching or is_learning else np.zeros((0, 5))
        if is_matching:
            found = self._match(stamp_ns, points, T_guess)
        else:
            found = self._located(stamp_ns, T_guess, np.diag(UNMATCHED), "not needed", 0)
        if is_learning and self._is_good(pose, found):
            self._learned_ns = stamp_ns
            T = T_guess if pose.source is PositionSource.RTK_FIXED else found.T_map_base
            self._map.learn(points, np.array(Pose2.of(T)))
        return [(LIDAR_LOCALIZATION, found)]

    def _newest(self, inbox: Inbox) -> dict[str, tuple[LidarScan, LidarGround]]:
        pairs = {}
        for name, lidar in self._lidars.items():
            scans, grounds = inbox.all(f"lidar/{name}", LidarScan), inbox.all(f"ground/{name}", LidarGround)
            pair = lidar.pair(scans, grounds)
            if pair is not None:
                pairs[name] = pair
        return pairs

    def _points(
        self, pairs: Mapping[str, tuple[LidarScan, LidarGround]], odom: Odometry, inbox: Inbox, T_map_base: Float64
    ) -> Float64:
        """Points (N, 5) in level axes about base with height in `map` and origin of their lidar; see map_kernels.py."""
        level, rows = level_of(T_map_base), []
        for name, (scan, ground) in pairs.items():
            lidar = self._lidars[name]
            then = odometry_at(inbox, scan.stamp_ns)
            before = odometry_at(inbox, scan.stamp_ns - lidar.sweep_ns)
            if then is None or before is None:
                continue
            T_sweep = invert(before.T_odom_base) @ then.T_odom_base
            T = level @ invert(odom.T_odom_base) @ then.T_odom_base
            found = lidar.process(scan, ground, T_sweep)
            rows.append(rows_of(found.points_base_m, found.sensor_origin_base_m, T))
        return np.concatenate(rows) if rows else np.zeros((0, 5))

    def _searched(
        self, stamp_ns: int, pairs: Mapping[str, tuple[LidarScan, LidarGround]], odom: Odometry, inbox: Inbox
    ) -> Iterable[Output]:
        """Pose in the shed without a first guess; once there was a position, nothing is searched any more."""
        period_ns, last_ns = self._config.search.period_s * 1e9, self._searched_ns
        if self._search is None or (last_ns is not None and 0 <= stamp_ns - last_ns < period_ns):
            return []
        points = self._points(pairs, odom, inbox, odom.T_odom_base)
        if not len(points):  # `odom` does not reach back over the sweep yet
            return []
        self._searched_ns = stamp_ns
        found = self._search.find(self._map, thin(points, self._config.max_points))
        T = rotated(odom.T_odom_base, float(found.pose[2]) - yaw_of(odom.T_odom_base))
        T[:3, 3] = *found.pose[:2], 0.0
        return [(LIDAR_LOCALIZATION, self._located(stamp_ns, T, found.covariance, found.reason, found.points))]

    def _match(self, stamp_ns: int, points: Float64, T_guess: Float64) -> LidarLocalization:
        cfg, guess = self._config, np.array(Pose2.of(T_guess))
        pose, covariance, found = self._map.match(thin(points, cfg.max_points), guess)
        reason = rejection_of(pose - guess, covariance, found, cfg)
        T = shifted(T_guess, pose - guess)
        return self._located(stamp_ns, T, covariance, reason, found)

    def _located(self, stamp_ns: int, T: Float64, covariance: Float64, reason: str, found: int) -> LidarLocalization:
        """Message with the height of the level floor under the roof; `covariance` (3, 3) of x, y, yaw in `map`."""
        unobserved = UNOBSERVED.copy()
        if self._roof.contains(shapely.Point(T[:2, 3])):
            T[2, 3], unobserved[5] = 0.0, self._config.floor_sigma_m**2
        return LidarLocalization(stamp_ns, T, in_body(covariance, unobserved, yaw_of(T)), not reason, reason, found)

    def _distance(self, T_map_base: Float64) -> float:
        return float(self._roof.distance(shapely.Point(T_map_base[:2, 3]))) if not self._roof.is_empty else math.inf

    def _is_good(self, pose: MapPose, found: LidarLocalization) -> bool:
        """Whether the pose may be learned from: fixed ambiguities, or a valid match under UWB."""
        cfg = self._config
        is_matched = pose.source is PositionSource.UWB and found.is_valid
        if not is_matched and pose.source is not PositionSource.RTK_FIXED:
            return False
        position, yaw = np.linalg.eigvalsh(pose.covariance[3:5, 3:5])[1], pose.covariance[2, 2]
        return bool(position < cfg.learn_sigma_m**2 and yaw < math.radians(cfg.learn_sigma_deg) ** 2)

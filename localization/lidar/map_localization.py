"""The node that says where the machine is by what stands about it: the shed as surveyed, and all that was seen before.

It learns while the pose is good, and finds the pose again where fixes are missing or the shed is near.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np
import shapely
from pydantic import Field

from configs.site import Shed
from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.transforms import Float64, invert, planar, yaw_of
from localization.lidar.scan_preprocessing import Returns, Seen
from localization.lidar.surface_map import SurfaceMap, SurfaceMapConfig
from messages.motion import LidarLocalization, MapPose, Odometry, PositionSource
from messages.node import All, At, Every, Inbox, Latest, Node, Output, Read
from messages.perception import LidarGround
from messages.sensors import LidarScan

LIDAR_POSE = "lidar_localization"
UNSEEN = np.square([0.1, 0.1, 0.0, 0.0, 0.0, 10.0])  # roll, pitch, height


class LidarMapConfig(Config):
    """Section `lidar_map` inside that of localization."""

    period_s: float = Field(ge=0.05, le=2.0)
    range_m: tuple[float, float] = Field(description="nearest and farthest return used")
    margin_m: float = Field(ge=0.0, le=5.0, description="about machine and implement, whose returns go along")
    thinning_m: float = Field(gt=0.0, le=2.0)
    most_points: int = Field(ge=50, le=20000, description="laid on the map in one match")
    least_points: int = Field(ge=10, le=10000)
    near_shed_m: float = Field(ge=0.0, le=200.0, description="matched although fixes are good")
    learn_s: float = Field(gt=0.0, le=60.0, description="between scans that are learnt")
    learn_sigma_m: float = Field(gt=0.0, le=1.0, description="of a pose that is good enough to learn from")
    learn_sigma_deg: float = Field(gt=0.0, le=10.0)
    largest_sigma_m: float = Field(gt=0.0, le=1.0, description="of the weakest direction")
    largest_sigma_deg: float = Field(gt=0.0, le=10.0)
    largest_step_m: float = Field(gt=0.0, le=5.0, description="off the first guess")
    largest_turn_deg: float = Field(gt=0.0, le=20.0)
    floor_sigma_m: float = Field(gt=0.0, le=1.0, description="of height 0 on the shed's level floor")
    surfaces: SurfaceMapConfig


class LidarMap(Node):
    """Lays the returns of all lidars on the map of what stands; refuses with a reason where that does not hold."""

    def __init__(
        self, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, shed: Shed | None,
        config: LidarMapConfig,
    ) -> None:  # fmt: skip
        lidars = vehicle.sensors.lidar
        self.name = "lidar_map"
        self.reads: Mapping[str, Read] = {
            **{f"lidar/{name}": All(4) for name in lidars},
            **{f"ground/{name}": All(4) for name in lidars},
            "odom": At(1.5),
            "map_pose": Latest(),
        }
        self.writes = (LIDAR_POSE,)
        self.runs = Every(round(config.period_s * 1e9))
        self._config = config
        bounds = config.range_m, config.margin_m, config.thinning_m
        self._lidars = {name: Returns(lidar, vehicle.body, implement, *bounds) for name, lidar in lidars.items()}
        self._roof = shapely.Polygon(shed.outline_m) if shed is not None else shapely.Polygon()
        self._map = SurfaceMap(config.surfaces, shed)
        self._learnt_ns: int | None = None
        none = np.zeros((0, 5))
        self._map.match(none, np.zeros(3))  # compiles, or loads what an earlier run compiled
        self._map.learn(none, np.zeros(3))

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Takes the newest scan of every lidar, finds the pose, and learns."""
        pairs = self._newest(inbox)
        pose = inbox.latest("map_pose", MapPose)
        if not pairs or pose is None or not pose.is_initialized:
            return []
        stamp_ns = max(scan.stamp_ns for scan, _ in pairs.values())
        odom = inbox.at("odom", Odometry, stamp_ns)
        if odom is None:
            return []
        T_guess = np.asarray(pose.T_map_odom @ odom.T_odom_base)
        wants_match = pose.source is not PositionSource.RTK_FIXED or self._distance(T_guess) < self._config.near_shed_m
        wants_learn = self._learnt_ns is None or abs(stamp_ns - self._learnt_ns) >= self._config.learn_s * 1e9
        if not wants_match and not wants_learn:
            return []
        points = self._points(pairs, odom, inbox, T_guess)
        found = self._match(stamp_ns, points, T_guess) if wants_match else None
        if wants_learn and self._is_good(pose, found):
            self._learnt_ns = stamp_ns
            T = found.T_map_base if found is not None and pose.source is not PositionSource.RTK_FIXED else T_guess
            self._map.learn(points, _flat(T))
        return [] if found is None else [(LIDAR_POSE, found)]

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
        """Returns in level axes about base, with height in map and where their lidar was; see map_kernels.py."""
        level = planar(0.0, 0.0, -yaw_of(T_map_base)) @ T_map_base
        level[:2, 3] = 0.0
        rows = []
        for name, (scan, ground) in pairs.items():
            lidar = self._lidars[name]
            then = inbox.at("odom", Odometry, scan.stamp_ns)
            before = inbox.at("odom", Odometry, scan.stamp_ns - lidar.sweep_ns)
            if then is None or before is None:
                continue
            T_sweep = invert(before.T_odom_base) @ then.T_odom_base
            T = level @ invert(odom.T_odom_base) @ then.T_odom_base
            rows.append(_rows(lidar.see(scan, ground, T_sweep), T))
        return np.concatenate(rows) if rows else np.zeros((0, 5))

    def _match(self, stamp_ns: int, points: Float64, T_guess: Float64) -> LidarLocalization:
        cfg, guess = self._config, _flat(T_guess)
        part = np.ascontiguousarray(points[:: max(1, math.ceil(len(points) / cfg.most_points))])
        pose, covariance, found = self._map.match(part, guess)
        reason = _refusal(pose - guess, covariance, found, cfg)
        T = np.asarray(planar(pose[0] - guess[0], pose[1] - guess[1], 0.0) @ _turned(T_guess, pose[2] - guess[2]))
        unseen = UNSEEN.copy()
        if self._roof.contains(shapely.Point(pose[:2])):
            T[2, 3], unseen[5] = 0.0, cfg.floor_sigma_m**2
        return LidarLocalization(stamp_ns, T, _in_base(covariance, unseen, float(pose[2])), not reason, reason, found)

    def _distance(self, T_map_base: Float64) -> float:
        return float(self._roof.distance(shapely.Point(T_map_base[:2, 3]))) if not self._roof.is_empty else math.inf

    def _is_good(self, pose: MapPose, found: LidarLocalization | None) -> bool:
        """Whether the pose may be learnt from: fixed, or found in the shed where UWB agrees."""
        cfg = self._config
        is_held = pose.source is PositionSource.UWB and found is not None and found.is_valid
        if not is_held and pose.source is not PositionSource.RTK_FIXED:
            return False
        place, turn = np.linalg.eigvalsh(pose.covariance[3:5, 3:5])[1], pose.covariance[2, 2]
        return bool(place < cfg.learn_sigma_m**2 and turn < math.radians(cfg.learn_sigma_deg) ** 2)


def _flat(T: Float64) -> Float64:
    return np.array([T[0, 3], T[1, 3], yaw_of(T)])


def _rows(seen: Seen, T_level_base: Float64) -> Float64:
    eye = T_level_base[:3, :3] @ seen.eye_base_m + T_level_base[:3, 3]
    p = seen.points_base_m @ T_level_base[:3, :3].T + T_level_base[:3, 3]
    return np.column_stack([p, np.broadcast_to(eye[:2], (len(p), 2))])


def _turned(T: Float64, angle_rad: float) -> Float64:
    out = planar(0.0, 0.0, angle_rad) @ T
    out[:3, 3] = T[:3, 3]
    return np.asarray(out)


def _in_base(covariance: Float64, unseen: Float64, yaw_rad: float) -> Float64:
    """From (x, y, yaw) in map to rotation and translation in base, (6, 6)."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    J = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    out, seen = np.diag(unseen), [3, 4, 2]
    out[np.ix_(seen, seen)] = J @ covariance @ J.T
    return out


def _refusal(step: Float64, covariance: Float64, found: int, config: LidarMapConfig) -> str:
    """Why a match must not be used, "" when it may."""
    if found < config.least_points:
        return f"only {found} returns on the map"
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[1]))
    if sigma > config.largest_sigma_m:
        return f"degenerate: {sigma:.3f} m in the weakest direction"
    if math.sqrt(covariance[2, 2]) > math.radians(config.largest_sigma_deg):
        return "degenerate: heading"
    if math.hypot(step[0], step[1]) > config.largest_step_m or abs(step[2]) > math.radians(config.largest_turn_deg):
        return "far from the first guess"
    return ""

"""Odometry from the scans of one lidar alone, for logs without speed: KISS-ICP with its constant-velocity guess.

Ground points are excluded: on level ground the rings look the same at every position, and matching them gives no
motion.
"""

import math
from collections.abc import Iterable

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.config.config import MappingConfig
from kiss_icp.kiss_icp import KissICP
from pydantic import Field
from scipy.spatial import cKDTree

from configs.strict import Config
from configs.vehicle import Body, Lidar
from geometry.arrays import Float64
from geometry.transforms import apply, invert
from localization.lidar.scan_matching import deskew
from messages.motion import Odometry
from messages.node import All, Inbox, Node, On, Output
from messages.perception import LidarGround
from messages.sensors import LidarScan

MIN_POINTS = 100  # with fewer obstacle points all points are matched


class ScanOdometryConfig(Config):
    """Scan matching without dead reckoning."""

    voxel_m: float = Field(gt=0.05, le=5.0)
    iterations: int = Field(ge=1, le=500)
    convergence: float = Field(gt=0.0, le=0.1)
    range_m: tuple[float, float] = Field(description="nearest and farthest return used")
    max_gap_s: float = Field(gt=0.0, le=10.0, description="a longer gap starts a new map at extrapolated motion")
    initial_speeds_mps: tuple[float, ...] = Field(min_length=1, description="forward speeds tried as initial guess")
    inlier_m: float = Field(gt=0.0, le=2.0, description="distance to a correspondence of an inlier")


class ScanOdometry(Node):
    """Writes `odom` for every scan; `speed_mps` is the mean since the previous scan."""

    def __init__(self, sensor: str, lidar: Lidar, body: Body, config: ScanOdometryConfig) -> None:
        self.name = f"scan_odometry_{sensor}"
        self._scan = f"lidar/{sensor}"
        self._ground = f"ground/{sensor}"
        self.reads = {self._scan: All(50), self._ground: All(50)}
        self.writes = ("odom",)
        self.runs = On((self._ground,))
        self._waiting: dict[int, LidarScan] = {}
        self._config, self._body = config, body
        self._T_base_lidar = lidar.mount.T_base_sensor
        self._sweep_s = 1.0 / lidar.rate_hz
        self._icp = new_icp(config)
        self._first: tuple[int, Float64] | None = None
        self._last_ns: int | None = None
        self._velocity = np.zeros(3)  # forward and left (m/s), turn (rad/s)
        self._T_odom_start = np.eye(4)
        self._T_odom_base = np.eye(4)

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Matches every new scan whose ground has arrived."""
        self._waiting |= {scan.stamp_ns: scan for scan in inbox.all(self._scan, LidarScan)}
        out: list[Output] = []
        for ground in inbox.all(self._ground, LidarGround):
            scan = self._waiting.pop(ground.scan_stamp_ns, None)
            if scan is not None and self._is_next(scan):
                out.append(("odom", self._match(scan, ground)))
        return out

    def _is_next(self, scan: LidarScan) -> bool:
        return self._last_ns is None or scan.stamp_ns > self._last_ns

    def _match(self, scan: LidarScan, ground: LidarGround) -> Odometry:
        dt_s = 0.0 if self._last_ns is None else (scan.stamp_ns - self._last_ns) * 1e-9
        points = self._points(scan, ground)
        before = self._T_odom_base
        if dt_s == 0.0 or dt_s > self._config.max_gap_s:
            self._restart(scan.stamp_ns, points, dt_s)
        elif self._first is not None:
            self._icp = start_icp(self._first[1], points, dt_s, self._config)
            self._first = None
            self._T_odom_base = self._T_odom_start @ self._icp.last_pose
        else:
            # the initial guess is the last motion, scaled to the elapsed time
            self._icp.last_delta = planar_step(self._velocity, dt_s)
            self._icp.register_frame(points, np.zeros(0))
            self._T_odom_base = self._T_odom_start @ self._icp.last_pose
        self._last_ns = scan.stamp_ns
        if dt_s > 0.0:
            self._velocity = velocity_of(invert(before) @ self._T_odom_base, dt_s)
        return self._message(scan.stamp_ns)

    def _restart(self, stamp_ns: int, points: Float64, dt_s: float) -> None:
        self._T_odom_start = self._T_odom_base = self._T_odom_base @ planar_step(self._velocity, dt_s)
        self._first = (stamp_ns, points)

    def _message(self, stamp_ns: int) -> Odometry:
        speed, lateral, turn = self._velocity.tolist()
        curvature = turn / speed if abs(speed) > 0.5 else 0.0
        return Odometry(
            stamp_ns, self._T_odom_base.copy(), speed, lateral, 0.0, turn, curvature, np.full((6, 6), np.nan)
        )

    def _points(self, scan: LidarScan, ground: LidarGround) -> Float64:
        """Deskewed points in base at the stamp, without those on the machine."""
        near, far = self._config.range_m
        measured = scan.points_m.astype(np.float64)
        distance = np.linalg.norm(measured, axis=1)
        use = np.isfinite(distance) & (distance > near) & (distance < far)
        obstacle = use & (ground.is_obstacle_point == 1) if len(ground.is_obstacle_point) == len(use) else use
        use = obstacle if np.count_nonzero(obstacle) >= MIN_POINTS else use
        p = np.asarray(apply(self._T_base_lidar, measured[use]), np.float64)
        body = self._body
        own = (p[:, 0] < body.front_m) & (p[:, 0] > -body.rear_m) & (np.abs(p[:, 1]) < 0.5 * body.width_m + 0.1)
        step = planar_step(self._velocity, self._sweep_s)
        return deskew(p[~own], scan.point_offset_s[use][~own].astype(np.float64), step, self._sweep_s)


def new_icp(config: ScanOdometryConfig) -> KissICP:
    """KISS-ICP with one thread, so that the same scans give the same poses to the bit."""
    kiss = KISSConfig(mapping=MappingConfig(voxel_size=config.voxel_m))
    kiss.data.max_range, kiss.data.min_range, kiss.data.deskew = config.range_m[1], 0.0, False
    kiss.registration.max_num_threads = 1
    kiss.registration.max_num_iterations = config.iterations
    kiss.registration.convergence_criterion = config.convergence
    return KissICP(kiss)


def start_icp(first_m: Float64, second_m: Float64, dt_s: float, config: ScanOdometryConfig) -> KissICP:
    """The match of the first two scans (N, 3) with most inliers, over several initial speeds.

    The initial speed is unknown; at 2.5 Hz a car moves by metres, outside convergence from standstill.
    """
    tree, best, best_ratio = cKDTree(first_m[::2]), None, -1.0
    for speed in config.initial_speeds_mps:
        icp = new_icp(config)
        icp.register_frame(first_m, np.zeros(0))
        icp.last_delta = planar_step(np.array([speed, 0.0, 0.0]), dt_s)
        icp.register_frame(second_m, np.zeros(0))
        sample = np.asarray(apply(icp.last_pose, second_m[::4]), np.float64)
        ratio = float(np.mean(tree.query(sample, distance_upper_bound=config.inlier_m)[0] < config.inlier_m))
        if ratio > best_ratio:
            best, best_ratio = icp, ratio
    assert best is not None, "at least one initial speed"
    return best


def planar_step(velocity: Float64, dt_s: float) -> Float64:
    """The pose (4, 4) after `dt_s` at a velocity (3,): forward, left, turn."""
    x, y, yaw = velocity * dt_s
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def velocity_of(T: Float64, dt_s: float) -> Float64:
    """Forward and left speed and turn rate of a step (4, 4)."""
    return np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])]) / dt_s

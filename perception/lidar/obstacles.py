"""The node that turns each scan of one lidar into ground, obstacles and health."""

from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Lidar, Vehicle
from geometry.jit import kernel
from messages.command import MachineState
from messages.message import Float32, Float64, Int32, UInt8
from messages.motion import Odometry
from messages.node import At, Inbox, Latest, Node, On, Output
from messages.perception import HealthState, LidarGround, Obstacles, SensorHealth
from messages.sensors import LidarScan
from perception.lidar.boxes import describe
from perception.lidar.classes import class_scores
from perception.lidar.clusters import ClusterConfig, Clusters, find_clusters, keep, new_board
from perception.lidar.evidence import beams_of, expected_returns
from perception.lidar.grid import Grid, build_grid
from perception.lidar.ground import Ground, GroundConfig, find_ground, fit_plane
from perception.lidar.health import Expectation, HealthConfig, count_beams, expect, judge, proven_range
from perception.lidar.points import MaskConfig, motion_of, own_boxes, to_base
from perception.self_filter import is_folded

# A block of this size, given back once, has glibc keep what later scans give back (mallopt(3): it raises the threshold
# of trimming to twice that); else 700 pages are fetched anew at every scan, which costs 1 to 5 ms.
KEPT_BYTES = 31 << 20


class LidarConfig(Config):
    """The whole way from returns to obstacles; the same for every lidar."""

    mask: MaskConfig
    ground: GroundConfig
    clusters: ClusterConfig
    health: HealthConfig
    plane_radius_m: float = Field(ge=3.0, le=50.0)


class LidarObstacles(Node):
    """Runs on every scan of the lidar `name`; a scan that is no measurement is counted, and health says blind."""

    def __init__(
        self, name: str, lidar: Lidar, vehicle: Vehicle, implement: Implement | None, config: LidarConfig
    ) -> None:
        self.name = f"lidar_{name}"
        self.reads = {f"lidar/{name}": Latest(), "odom": At(1.0), "machine": Latest()}
        self.writes = (f"ground/{name}", f"obstacles/lidar_{name}", f"health/lidar_{name}")
        self.runs = On((f"lidar/{name}",))
        self._scan_topic, self._lidar, self._config = f"lidar/{name}", lidar, config
        self._pipeline = Pipeline(lidar, vehicle, implement, config)
        self._pipeline.warm()
        self._dropped = 0
        self._last: LidarScan | None = None

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Ground, obstacles and health of the newest scan."""
        scan = inbox.last(self._scan_topic, LidarScan)
        if scan is None:
            return ()
        wrong = self._what_is_wrong(scan)
        self._last = scan
        if wrong:
            self._dropped += 1
            return ((self.writes[2], self._blind(scan.stamp_ns, wrong)),)
        odom = inbox.at("odom", Odometry, scan.stamp_ns) or inbox.latest("odom", Odometry)
        folded = is_folded(inbox.latest("machine", MachineState))
        ground, obstacles, health = self._pipeline.run(scan, odom, self.name, self._dropped, folded)
        if health.state is HealthState.BLIND:
            return ((self.writes[2], health),)
        return ((self.writes[0], ground), (self.writes[1], obstacles), (self.writes[2], health))

    def _what_is_wrong(self, scan: LidarScan) -> str:
        """Why a scan is no measurement, or "" when it is one."""
        if not is_well_formed(scan):
            return "scan is malformed"
        if self._last is None:
            return ""
        if scan.stamp_ns <= self._last.stamp_ns:
            return "time stands still or runs back"
        noisy = self._lidar.range_sigma_m > 0.0
        if noisy and scan.ranges_mm.size + scan.xyz_m.size > 0 and _is_same(scan, self._last):
            return "sends the same scan again"
        return ""

    def _blind(self, stamp_ns: int, reason: str) -> SensorHealth:
        edges = self._pipeline.expectations[0].sector_edges_rad
        return SensorHealth(
            stamp_ns, self.name, HealthState.BLIND, reason, edges.copy(), np.zeros(len(edges) - 1), self._dropped
        )


def is_well_formed(scan: LidarScan) -> bool:
    """Whether shapes agree and at least half of the coordinates are finite."""
    image, n = scan.ranges_mm, len(scan.xyz_m)
    if image.size:
        angles = (len(scan.elevation_rad), len(scan.azimuth_rad))
        fits = image.ndim == 2 and image.shape == angles and scan.offset_s.shape in ((0,), (angles[1],))
        return fits and bool(np.isfinite(scan.elevation_rad).all() and np.isfinite(scan.azimuth_rad).all())
    fits = scan.xyz_m.ndim == 2 and scan.xyz_m.shape[1] == 3 if n else True
    return fits and scan.offset_s.shape in ((0,), (n,)) and (n == 0 or float(np.isfinite(scan.xyz_m).mean()) > 0.5)


def _is_same(scan: LidarScan, last: LidarScan) -> bool:
    return np.array_equal(scan.ranges_mm, last.ranges_mm) and np.array_equal(scan.xyz_m, last.xyz_m)


class Pipeline:
    """From one scan to its messages; holds only what follows from configuration."""

    def __init__(self, lidar: Lidar, vehicle: Vehicle, implement: Implement | None, config: LidarConfig) -> None:
        self.config, self._reach_m = config, lidar.range_m[1]
        self._T: Float64 = lidar.mount.T_base_sensor
        self._center = self._T[:2, 3].copy()
        carried = (implement, implement and implement.folded)
        self._own = tuple(own_boxes(vehicle, one, config.mask) for one in carried)
        g = config.ground
        self._grid: Grid = build_grid(g.sector_deg, g.first_bin_m, g.bin_growth, g.reach_m)
        self._front = (vehicle.body.front_m, vehicle.body.width_m / 2)
        top_m = max(vehicle.body.height_m, config.clusters.least_top_m) + config.clusters.overhead_m
        self._limits = (
            self._center.astype(np.float32), np.float32(g.solid_m), np.float32(g.solid_growth), np.float32(g.foot_m),
            np.float32(top_m),
        )  # fmt: skip
        self._board = new_board(config.clusters)
        self._beams = beams_of(lidar)
        self.expectations = tuple(expect(lidar, own, config.health) for own in self._own)

    def warm(self) -> None:
        """Compile or load all kernels at start-up, with and without times of firing, so that no scan waits for it."""
        np.empty(KEPT_BYTES, np.uint8)  # and given back
        none, two = np.zeros(0, np.float64), np.array([[9.0, 0.0, 1.0], [9.0, 0.1, 1.0]], np.float32)
        for offset_s in (np.zeros(0, np.float32), np.full(2, -0.05, np.float32)):
            image, intensity = np.zeros((0, 0), np.uint16), np.zeros(0, np.uint8)
            self.run(LidarScan(0, image, none.copy(), none.copy(), two.copy(), intensity, offset_s), None, "", 0)

    def run(
        self, scan: LidarScan, odom: Odometry | None, sensor: str, dropped: int, is_folded: bool = False
    ) -> tuple[LidarGround, Obstacles, SensorHealth]:
        """The three messages of a well-formed scan."""
        own, seen = self._own[is_folded], self.expectations[is_folded]
        points, usable = to_base(scan.points_m, scan.point_offset_s, self._T, motion_of(odom), own)
        ground = find_ground(points, usable, self._center, self._grid, self.config.ground)
        level = np.empty(len(points), np.uint8)
        solid = np.empty(len(points), np.uint8)
        _levels(points, ground.height_m, *self._limits, level, solid)
        clusters = find_clusters(points, level, self._center, self.config.clusters, self._board)
        plane = fit_plane(ground, self._center, self._grid, self.config.plane_radius_m)
        return (
            LidarGround(scan.stamp_ns, scan.stamp_ns, solid, plane),
            self._obstacles(scan.stamp_ns, sensor, clusters, points, ground, level),
            self._health(scan, ground, usable, seen, sensor, dropped),
        )

    def _obstacles(
        self, stamp_ns: int, sensor: str, found: Clusters, points: Float32, ground: Ground, level: UInt8
    ) -> Obstacles:
        boxes = describe(found, points, ground.height_m, level, self._front)
        limits, counts = self.config.clusters, np.diff(found.offsets)
        expected = expected_returns(self._beams, boxes.center_m, boxes.size_m, boxes.yaw_rad)
        filled = (counts >= limits.least_fill * expected) | (counts >= limits.sure_returns)
        high = filled & (boxes.top_m >= limits.least_height_m)
        kept = keep(found, high)
        size, yaw = boxes.size_m[high], boxes.yaw_rad[high]
        return Obstacles(
            stamp_ns, sensor, stamp_ns, boxes.center_m[high], size, yaw, boxes.nearest_m[high],
            np.full((len(yaw), 2), np.nan), class_scores(size, boxes.top_m[high]), kept.offsets, kept.indices,
            _picked(points, kept.indices),
        )  # fmt: skip

    def _health(
        self, scan: LidarScan, ground: Ground, usable: UInt8, seen: Expectation, sensor: str, dropped: int
    ) -> SensorHealth:
        config = self.config.health
        counts = count_beams(scan.points_m, ground.turn, self._grid.sectors, usable, seen)
        proven = proven_range(seen, counts, config, self._reach_m)
        state, reason = judge(proven, seen.nominal_m, config)
        return SensorHealth(scan.stamp_ns, sensor, state, reason, seen.sector_edges_rad.copy(), proven, dropped)


@kernel
def _picked(points: Float32, indices: Int32) -> Float32:
    """`points[indices]`, row by row: from columns numpy takes it five times as long."""
    out = np.empty((indices.shape[0], 3), np.float32)
    for n in range(indices.shape[0]):
        i = indices[n]
        out[n, 0], out[n, 1], out[n, 2] = points[i, 0], points[i, 1], points[i, 2]
    return out


@kernel
def _levels(
    points: Float32, above: Float32, center: Float32, solid_m: np.float32, growth: np.float32, foot_m: np.float32,
    top_m: np.float32, level: UInt8, solid: UInt8,
) -> None:  # fmt: skip
    """What each return is to the clusters (2 stands, 1 at its feet, 0 nothing), and whether it is off the ground.

    Without branches, and true of no height that is NaN.
    """
    for i in range(points.shape[0]):
        h, x, y = above[i], points[i, 0] - center[0], points[i, 1] - center[1]
        is_obstacle_point = np.uint8(h >= solid_m + growth * np.sqrt(x * x + y * y))
        solid[i] = is_obstacle_point
        level[i] = np.uint8(2) * is_obstacle_point if h < top_m else np.uint8(0)
        level[i] += np.uint8(h >= -foot_m) - is_obstacle_point

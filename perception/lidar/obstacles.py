"""Node: ground, obstacles and health from each scan of one lidar."""

from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Lidar, Vehicle
from geometry.arrays import Float32, Float64, UInt8
from geometry.ground_surface import plant_heights
from geometry.jit import kernel
from geometry.range_image import ScatterMemory, beam_grid
from messages.command import MachineState
from messages.motion import Odometry, odometry_at
from messages.node import At, Inbox, Latest, Node, On, Output
from messages.perception import HealthState, LidarGround, Obstacles, SensorHealth
from messages.sensors import LidarScan
from perception.lidar.airborne import FLOATING, LOW, OBSTACLE, AirborneConfig, is_scattered, mark_airborne
from perception.lidar.bodies import BodyConfig, BodySplitter
from perception.lidar.boxes import fit_boxes
from perception.lidar.classes import class_scores
from perception.lidar.clusters import ClusterConfig, Clusters, find_clusters, new_cell_grid, select
from perception.lidar.expected_points import beams_of, expected_points
from perception.lidar.grid import Grid, build_grid, take_rows
from perception.lidar.ground import Ground, GroundConfig, find_ground, fit_plane
from perception.lidar.health import (
    HealthConfig,
    NominalCoverage,
    count_beams,
    detection_range,
    health_state,
    nominal_coverage,
)
from perception.lidar.points import SelfFilterConfig, motion_of, self_boxes, to_base
from perception.repeated_output import is_repeated
from perception.self_filter import is_folded

# A block of this size, freed once, raises glibc's trim threshold to twice that (mallopt(3)), so that memory freed by a
# scan stays mapped; otherwise 700 pages are mapped again at every scan, which costs 1 to 5 ms.
HEAP_RESERVE_BYTES = 31 << 20


class LidarConfig(Config):
    """Processing from returns to obstacles; the same for every lidar."""

    self_filter: SelfFilterConfig
    ground: GroundConfig
    airborne: AirborneConfig
    clusters: ClusterConfig
    bodies: BodyConfig
    health: HealthConfig
    plane_radius_m: float = Field(ge=3.0, le=50.0)


class LidarObstacles(Node):
    """Runs on every scan of the lidar `name`; an invalid scan is counted as rejected and makes health BLIND."""

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
        self._rejected_count = 0
        self._last: LidarScan | None = None
        self._scatter = ScatterMemory()

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Ground, obstacles and health of the newest scan."""
        scan = inbox.last(self._scan_topic, LidarScan)
        if scan is None:
            return ()
        reason = self._invalid_reason(scan)
        self._last = scan
        if reason:
            self._rejected_count += 1
            return ((self.writes[2], self._blind_health(scan.stamp_ns, reason)),)
        odom = odometry_at(inbox, scan.stamp_ns)
        machine = inbox.latest("machine", MachineState)
        hitch = 1.0 if machine is None or not np.isfinite(machine.hitch) else machine.hitch
        ground, obstacles, health = self._pipeline.run(
            scan, odom, self.name, self._rejected_count, is_folded(machine), hitch, self._scatter
        )
        if health.state is HealthState.BLIND:
            return ((self.writes[2], health),)
        return ((self.writes[0], ground), (self.writes[1], obstacles), (self.writes[2], health))

    def _invalid_reason(self, scan: LidarScan) -> str:
        """Reason why a scan is invalid, "" for a valid one."""
        if not is_well_formed(scan):
            return "scan is malformed"
        if self._last is None:
            return ""
        if scan.stamp_ns <= self._last.stamp_ns:
            return "scan time does not increase"
        noisy = self._lidar.range_sigma_m > 0.0
        if noisy and scan.ranges_mm.size + scan.xyz_m.size > 0 and _is_repeated(scan, self._last):
            return "sends the same scan again"
        return ""

    def _blind_health(self, stamp_ns: int, reason: str) -> SensorHealth:
        edges = self._pipeline.coverages[0].sector_edges_rad
        return SensorHealth(
            stamp_ns, self.name, HealthState.BLIND, reason, edges.copy(), np.zeros(len(edges) - 1), self._rejected_count
        )


def is_well_formed(scan: LidarScan) -> bool:
    """Whether shapes agree and more than half of the coordinates are finite."""
    image, n = scan.ranges_mm, len(scan.xyz_m)
    if image.size:
        angles = (len(scan.elevation_rad), len(scan.azimuth_rad))
        fits = image.ndim == 2 and image.shape == angles and scan.offset_s.shape in ((0,), (angles[1],))
        return fits and bool(np.isfinite(scan.elevation_rad).all() and np.isfinite(scan.azimuth_rad).all())
    fits = scan.xyz_m.ndim == 2 and scan.xyz_m.shape[1] == 3 if n else True
    return fits and scan.offset_s.shape in ((0,), (n,)) and (n == 0 or float(np.isfinite(scan.xyz_m).mean()) > 0.5)


def _is_repeated(scan: LidarScan, last: LidarScan) -> bool:
    return is_repeated((scan.ranges_mm, last.ranges_mm), (scan.xyz_m, last.xyz_m))


class Pipeline:
    """Processing of one scan into its messages; holds only values derived from configuration."""

    def __init__(self, lidar: Lidar, vehicle: Vehicle, implement: Implement | None, config: LidarConfig) -> None:
        self.config, self._reach_m = config, lidar.range_m[1]
        self._mount = lidar.mount
        self._center: Float64 = lidar.mount.T_base_sensor[:2, 3].copy()
        by_fold = (implement, implement and implement.folded)
        self._own = tuple(self_boxes(vehicle, one, config.self_filter) for one in by_fold)
        g = config.ground
        self._grid: Grid = build_grid(g.sector_deg, g.first_bin_m, g.bin_growth, g.max_range_m)
        self._front = (vehicle.body.front_m, vehicle.body.width_m / 2)
        top_m = max(vehicle.body.height_m, config.clusters.min_top_m) + config.clusters.overhead_margin_m
        self._limits = (
            self._center.astype(np.float32), np.float32(g.obstacle_height_m), np.float32(g.obstacle_height_growth),
            np.float32(g.low_point_depth_m),
            np.float32(top_m),
        )  # fmt: skip
        self._cell_grid = new_cell_grid(config.clusters)
        self._beams = beams_of(lidar)
        self._splitter = BodySplitter(config.bodies, config.clusters, self._beams, lidar.columns)
        self._beam_grid = beam_grid(np.radians(np.array(lidar.elevation_deg)), self._beams.column_rad)
        self.coverages = tuple(nominal_coverage(lidar, own, config.health) for own in self._own)

    def warm(self) -> None:
        """Compiles or loads all kernels at start-up, with and without firing times, so that no scan waits for it."""
        np.empty(HEAP_RESERVE_BYTES, np.uint8)  # freed at once
        plant_heights(np.zeros((1, 1)), 1, np.ones(1, np.int64), 0.0, 1.0, 0.5)  # else only called among plants
        none, two = np.zeros(0, np.float64), np.array([[9.0, 0.0, 1.0], [9.0, 0.1, 1.0]], np.float32)
        for offset_s in (np.zeros(0, np.float32), np.full(2, -0.05, np.float32)):
            image, intensity = np.zeros((0, 0), np.uint16), np.zeros(0, np.uint8)
            self.run(LidarScan(0, image, none.copy(), none.copy(), two.copy(), intensity, offset_s), None, "", 0)

    def run(
        self, scan: LidarScan, odom: Odometry | None, sensor: str, rejected_count: int, is_folded: bool = False,
        hitch: float = 1.0, memory: ScatterMemory | None = None,
    ) -> tuple[LidarGround, Obstacles, SensorHealth]:  # fmt: skip
        """The three messages of a valid scan; `memory`: of fog in the scans before it."""
        own, nominal = self._own[is_folded], self.coverages[is_folded]
        T = self._mount.at_hitch(hitch)
        points, usable = to_base(scan.points_m, scan.point_offset_s, T, motion_of(odom), own)
        usable[is_scattered(scan, self._beam_grid, memory)] = 0
        ground = find_ground(points, usable, self._center, self._grid, self.config.ground)
        point_class = np.empty(len(points), np.uint8)
        is_obstacle_point = np.empty(len(points), np.uint8)
        _classify_points(points, ground.height_m, *self._limits, point_class, is_obstacle_point)
        if ground.is_plant.any():
            point_class[ground.is_plant & (point_class == OBSTACLE)] = LOW
            is_obstacle_point[ground.is_plant] = 0
        mark_airborne(scan, point_class, T, self.config.airborne)
        clusters = find_clusters(points, point_class, self._center, self.config.clusters, self._cell_grid)
        clusters, kinds = self._splitter.split(clusters, points, ground.height_m, point_class, self._center)
        plane = fit_plane(ground, self._center, self._grid, self.config.plane_radius_m)
        return (
            LidarGround(scan.stamp_ns, scan.stamp_ns, is_obstacle_point, plane),
            self._obstacles(scan.stamp_ns, sensor, clusters, kinds, points, ground, point_class),
            self._health(scan, ground, usable, nominal, sensor, rejected_count),
        )

    def _obstacles(
        self, stamp_ns: int, sensor: str, found: Clusters, kinds: UInt8, points: Float32, ground: Ground,
        point_class: UInt8,
    ) -> Obstacles:  # fmt: skip
        boxes = fit_boxes(found, points, ground.height_m, point_class, self._front, self._center)
        limits, counts = self.config.clusters, np.diff(found.offsets)
        expected = expected_points(self._beams, boxes.center_m, boxes.size_m, boxes.yaw_rad)
        filled = (counts >= limits.min_fill * expected) | (counts >= limits.sufficient_returns)
        high = filled & (boxes.top_m >= limits.min_height_m)
        kept = select(found, high)
        size, yaw = boxes.size_m[high], boxes.yaw_rad[high]
        is_floating = floating_share(kept, point_class) >= self.config.airborne.min_share
        return Obstacles(
            stamp_ns, sensor, stamp_ns, boxes.center_m[high], size, yaw, boxes.nearest_m[high],
            np.full((len(yaw), 2), np.nan), class_scores(size, boxes.top_m[high], is_floating, kinds[high]),
            kept.offsets, kept.indices, take_rows(points, kept.indices),
        )  # fmt: skip

    def _health(
        self, scan: LidarScan, ground: Ground, usable: UInt8, nominal: NominalCoverage, sensor: str, rejected_count: int
    ) -> SensorHealth:
        config = self.config.health
        counts = count_beams(scan.points_m, ground.sector, self._grid.sectors, usable, nominal)
        detected_m = detection_range(nominal, counts, config, self._reach_m)
        state, reason = health_state(detected_m, nominal.nominal_m, config)
        return SensorHealth(
            scan.stamp_ns, sensor, state, reason, nominal.sector_edges_rad.copy(), detected_m, rejected_count
        )


def floating_share(clusters: Clusters, point_class: UInt8) -> Float64:
    """Share (K,) of the obstacle returns of each cluster that float."""
    if len(clusters.indices) == 0:
        return np.zeros(len(clusters.offsets) - 1)
    found = point_class[clusters.indices]
    floats, obstacles = (
        np.add.reduceat(found >= one, clusters.offsets[:-1], dtype=np.float64) for one in (FLOATING, OBSTACLE)
    )
    return np.asarray(floats / obstacles)


@kernel
def _classify_points(
    points: Float32, above: Float32, center: Float32, obstacle_height_m: np.float32, growth: np.float32,
    low_point_depth_m: np.float32,
    top_m: np.float32, point_class: UInt8, is_obstacle_point: UInt8,
) -> None:  # fmt: skip
    """Point class of each return (2 obstacle, 1 low, 0 unused), and whether it is an obstacle point.

    Without branches; a height of NaN gives class 0.
    """
    for i in range(points.shape[0]):
        h, x, y = above[i], points[i, 0] - center[0], points[i, 1] - center[1]
        is_obstacle = np.uint8(h >= obstacle_height_m + growth * np.sqrt(x * x + y * y))
        is_obstacle_point[i] = is_obstacle
        point_class[i] = np.uint8(2) * is_obstacle if h < top_m else np.uint8(0)
        point_class[i] += np.uint8(h >= -low_point_depth_m) - is_obstacle

"""Node: obstacles from each cycle of one radar."""

import math
from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Mount, Radar, Vehicle
from geometry.arrays import Bool, Float64
from messages.command import MachineState
from messages.motion import Odometry, odometry_at
from messages.node import At, Inbox, Latest, Node, On, Output
from messages.perception import ObstacleClass, Obstacles
from messages.sensors import RadarScan
from perception.radar.clusters import ClusterConfig, Clusters, find_clusters
from perception.radar.doppler import Echoes, is_well_formed, sensor_velocity, to_base, usable
from perception.radar.tracklets import (
    TrackletConfig,
    confirmed,
    empty_table,
    sigmas,
    to_odom,
    update_tracklets,
    velocities,
)
from perception.self_filter import is_folded, is_inside, own_outlines


class HealthConfig(Config):
    """Limits of radar health, and the detection range of a healthy radar."""

    timeout_s: float = Field(gt=0.0, le=10.0)
    moving_mps: float = Field(gt=0.0, le=5.0, description="speed above which echoes are required and checked")
    blocked_s: float = Field(
        gt=0.0, le=60.0, description="time without any echo while moving, after which it is blocked"
    )
    agree_mps: float = Field(gt=0.0, le=5.0, description="speed over ground of a static echo, by Doppler and odometry")
    agree_share: float = Field(ge=0.0, le=1.0, description="of static echoes, below which mount or odometry is wrong")
    agree_echoes: int = Field(ge=2, le=1000, description="least number of echoes for the check")
    detection_range_m: float = Field(gt=0.0, le=300.0)
    period_s: float = Field(gt=0.0, le=1.0)


class RadarConfig(Config):
    """Processing from detections to obstacles and health; the same for every radar."""

    clusters: ClusterConfig
    tracklets: TrackletConfig
    health: HealthConfig
    min_size_m: float = Field(gt=0.0, le=5.0, description="least extent of an obstacle")
    height_m: float = Field(gt=0.0, le=5.0, description="assumed: not measured by a radar")


class RadarObstacles(Node):
    """Runs on every cycle of the radar `name`; publishes nothing without odometry, which the target motion needs."""

    def __init__(
        self, name: str, radar: Radar, vehicle: Vehicle, implement: Implement | None, config: RadarConfig
    ) -> None:
        self.name = f"radar_{name}"
        self.reads = {f"radar/{name}": Latest(), "odom": At(1.0), "machine": Latest()}
        self.writes = (f"obstacles/radar_{name}",)
        self.runs = On((f"radar/{name}",))
        self._topic, self._radar, self._config = f"radar/{name}", radar, config
        self._own, self._T_base_radar = own_outlines(vehicle, implement), radar.mount.T_base_sensor
        self._table = empty_table()
        self._stamp_ns = 0
        warm()

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Confirmed targets of the newest cycle."""
        scan = inbox.last(self._topic, RadarScan)
        if scan is None or not is_well_formed(scan) or scan.stamp_ns == self._stamp_ns:
            return ()
        odom = odometry_at(inbox, scan.stamp_ns)
        if odom is None:
            return ()
        folded = is_folded(inbox.latest("machine", MachineState))
        return ((self.writes[0], self.process(scan, odom, folded)),)

    def process(self, scan: RadarScan, odom: Odometry, is_folded: bool = False) -> Obstacles:
        """Obstacles of a cycle, confirmed by the cycles before."""
        if scan.stamp_ns < self._stamp_ns:  # time ran back: another run
            self._table = empty_table()
        T, config = self._T_base_radar, self._config
        which = usable(scan, self._radar.range_m, math.radians(self._radar.field_of_view_deg) / 2)
        echoes = to_base(scan, which, T, sensor_velocity(odom, T))
        clusters = find_clusters(echoes, math.radians(self._radar.azimuth_sigma_deg), config.clusters)
        sigma = sigmas(clusters, self._radar, config.tracklets)
        since_s = (scan.stamp_ns - self._stamp_ns) * 1e-9 if self._stamp_ns and len(self._table.hits) else 0.0
        targets = to_odom(clusters, sigma, self._radar, odom.T_odom_base)
        self._table, row = update_tracklets(self._table, targets, scan.stamp_ns, since_s, config.tracklets)
        self._stamp_ns = scan.stamp_ns
        published = (confirmed(self._table, config.tracklets)[row] > 0) & ~is_inside(clusters.p_m, self._own[is_folded])
        turn = odom.T_odom_base[:2, :2] / math.hypot(odom.T_odom_base[0, 0], odom.T_odom_base[1, 0])
        velocity = velocities(self._table, row, clusters, config.tracklets) @ turn
        return self._message(scan.stamp_ns, clusters, velocity, sigma, published)

    def _message(self, stamp_ns: int, c: Clusters, velocity: Float64, sigma: Float64, published: Bool) -> Obstacles:
        n, height = int(published.sum()), self._config.height_m
        flat = np.maximum(c.extent_m[published], self._config.min_size_m)
        return Obstacles(
            stamp_ns, self.name, stamp_ns, np.concatenate([c.p_m[published], np.full((n, 1), height / 2)], axis=1),
            np.concatenate([flat, np.full((n, 1), height)], axis=1), np.arctan2(c.line_of_sight[published, 1],
            c.line_of_sight[published, 0]),
            c.nearest_m[published], velocity[published], no_evidence(n), np.zeros(n + 1, np.int32), np.empty(0,
            np.int32),
            np.empty((0, 3), np.float32), sigma[published],
        )  # fmt: skip


def warm() -> None:
    """Compiles or loads all kernels at start-up."""
    radar = Radar(
        mount=Mount(xyz_m=(0.0, 0.0, 1.0)), field_of_view_deg=90.0, rate_hz=20.0, range_m=(0.1, 50.0),
        range_sigma_m=0.1, azimuth_sigma_deg=1.0, doppler_sigma_mps=0.1,
    )  # fmt: skip
    clusters = ClusterConfig(
        join_range_m=1.0, join_across_m=1.0, join_bearing_sigma=1.0, join_doppler_mps=1.0, min_rcs_dbsm=0.0
    )
    tracklets = TrackletConfig(
        target_sigma_m=0.1, acceleration_mps2=1.0, initial_speed_sigma_mps=1.0, gate_sigma=3.0, confirm_hits=1,
        confirm_s=0.0,
        confirm_share=1.0, keep_s=1.0, velocity_sigma_mps=1.0, long_m=1.0,
    )  # fmt: skip
    echoes = Echoes(np.zeros((1, 3)), np.array([[1.0, 0.0]]), np.ones(1), np.zeros(1), np.zeros(1), np.ones(1))
    found = find_clusters(echoes, 0.01, clusters)
    targets = to_odom(found, sigmas(found, radar, tracklets), radar, np.eye(4))
    table, _ = update_tracklets(empty_table(), targets, 1, 0.0, tracklets)
    update_tracklets(table, targets, 2, 0.1, tracklets)


def no_evidence(n: int) -> Float64:
    """Uniform class scores (n, 8)."""
    return np.full((n, len(ObstacleClass)), 1.0 / len(ObstacleClass))

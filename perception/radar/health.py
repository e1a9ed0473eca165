"""Node: health of one radar, also without cycles."""

import math
from collections.abc import Iterable

import numpy as np

from configs.vehicle import Radar
from geometry.arrays import Bool
from messages.motion import Odometry
from messages.node import All, Every, Inbox, Latest, Node, Output
from messages.perception import HealthState, SensorHealth
from messages.sensors import RadarScan
from perception.radar.doppler import is_well_formed, sensor_velocity, to_base, usable
from perception.radar.obstacles import RadarConfig

MAX_SCANS = 20


class RadarHealth(Node):
    """Checks every cycle of the radar `name` and publishes its state periodically."""

    def __init__(self, name: str, radar: Radar, config: RadarConfig) -> None:
        self.name = f"health_radar_{name}"
        self.reads = {f"radar/{name}": All(MAX_SCANS), "odom": Latest()}
        self.writes = (f"health/radar_{name}",)
        self.runs = Every(round(config.health.period_s * 1e9))
        self._sensor, self._topic, self._radar, self._config = f"radar_{name}", f"radar/{name}", radar, config.health
        yaw, half = math.radians(radar.mount.rpy_deg[2]), math.radians(radar.field_of_view_deg) / 2
        self._edges = np.array([yaw - half, yaw + half])
        self._T_base_radar = radar.mount.T_base_sensor
        self._last_ns: int | None = None
        self._echo_ns: int | None = None  # last cycle with echoes, or at rest
        self._disagrees = False
        self._rejected_count = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The state now."""
        odom = inbox.latest("odom", Odometry)
        votes = [scan for scan in inbox.all(self._topic, RadarScan) if self._check(scan, odom)]
        if votes and odom is not None:
            self._disagrees = self._contradicts_odometry(votes[-1], odom)
        state, reason = self._state(now_ns, odom)
        range_m = np.array([0.0 if state is HealthState.BLIND else self._config.detection_range_m])
        health = SensorHealth(now_ns, self._sensor, state, reason, self._edges.copy(), range_m, self._rejected_count)
        return ((self.writes[0], health),)

    def _check(self, scan: RadarScan, odom: Odometry | None) -> bool:
        """Stores a cycle; true when it has enough echoes to check the odometry."""
        if not is_well_formed(scan):
            self._rejected_count += 1
            return False
        self._last_ns = scan.stamp_ns
        moves = odom is not None and abs(odom.speed_mps) > self._config.moving_mps
        echoes = int(np.count_nonzero(self._usable(scan)))
        if echoes or not moves or self._echo_ns is None:
            self._echo_ns = scan.stamp_ns
        return moves and echoes >= self._config.agree_echoes

    def _usable(self, scan: RadarScan) -> Bool:
        return usable(scan, self._radar.range_m, math.radians(self._radar.field_of_view_deg) / 2)

    def _contradicts_odometry(self, scan: RadarScan, odom: Odometry) -> bool:
        T = self._T_base_radar
        radial = to_base(scan, self._usable(scan), T, sensor_velocity(odom, T)).radial_mps
        return bool((np.abs(radial) <= self._config.agree_mps).mean() < self._config.agree_share)

    def _state(self, now_ns: int, odom: Odometry | None) -> tuple[HealthState, str]:
        config = self._config
        if self._last_ns is None or now_ns - self._last_ns > round(config.timeout_s * 1e9):
            return HealthState.BLIND, "no cycles any more" if self._last_ns is not None else "no cycle yet"
        if odom is None:
            return HealthState.BLIND, "no odometry: motion of targets unknown"
        if self._echo_ns is not None and self._last_ns - self._echo_ns > round(config.blocked_s * 1e9):
            return HealthState.BLIND, "no echo while moving: covered"
        if self._disagrees:
            return HealthState.DEGRADED, "Doppler does not fit the odometry"
        return HealthState.GOOD, ""

"""Lidar odometry node: motion of base between scans of one lidar."""

from collections.abc import Iterable, Mapping

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Vehicle
from geometry.arrays import Float64
from geometry.transforms import interpolate, invert
from localization.lidar.scan_matching import MatchingConfig, ScanMatcher, level_of
from localization.lidar.scan_preprocessing import ScanPreprocessor
from messages.errors import ConfigError
from messages.motion import LidarOdometry, odometry_at
from messages.node import All, At, Inbox, Node, On, Output, Read
from messages.perception import LidarGround
from messages.sensors import LidarScan


class LidarOdometryConfig(Config):
    """Section `lidar_odometry` of localization."""

    sensor: str = Field(description="key of `sensors.lidar` of the machine")
    matching: MatchingConfig
    period_s: float = Field(gt=0.0, le=2.0, description="scans that follow sooner are skipped")
    max_gap_s: float = Field(gt=0.0, le=10.0, description="a longer gap between scans starts a new map")
    margin_m: float = Field(ge=0.0, le=5.0, description="self filter about machine and implement")


class LidarOdometryNode(Node):
    """Matches scans without ground; results with weak geometry are invalid, with a reason.

    Raises ConfigError when the machine has no such lidar.
    """

    def __init__(self, vehicle: Vehicle, implement: Implement | None, config: LidarOdometryConfig) -> None:
        sensor = config.sensor
        lidar = vehicle.sensors.lidar.get(sensor)
        if lidar is None:
            known = ", ".join(vehicle.sensors.lidar) or "none"
            raise ConfigError(
                f"localization.lidar_odometry.sensor is {sensor!r}: "
                f"vehicle {vehicle.name!r} has no such sensors.lidar (known: {known})"
            )
        self.name = f"lidar_odometry_{sensor}"
        self._scan, self._ground, self._output = f"lidar/{sensor}", f"ground/{sensor}", f"lidar_odometry/{sensor}"
        self.reads: Mapping[str, Read] = {self._scan: All(4), self._ground: All(4), "odom": At(1.5)}
        self.writes = (self._output,)
        self.runs = On((self._ground,))
        self._config = config
        bounds = config.matching.range_m, config.margin_m, config.matching.voxel_m
        self._points = ScanPreprocessor(lidar, vehicle.body, implement, *bounds)
        self._matcher = ScanMatcher(config.matching, lidar.mount.T_base_sensor[:3, 3])
        self._previous_ns: int | None = None
        self._step, self._step_ns = np.eye(4), 1

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Matches the newest scan whose ground has arrived."""
        pair = self._points.pair(inbox.all(self._scan, LidarScan), inbox.all(self._ground, LidarGround))
        return [] if pair is None else [(self._output, motion) for motion in self._match(*pair, inbox)]

    def _match(self, scan: LidarScan, ground: LidarGround, inbox: Inbox) -> list[LidarOdometry]:
        stamp_ns, previous_ns = scan.stamp_ns, self._previous_ns
        if previous_ns is not None and 0 < stamp_ns - previous_ns < 0.95e9 * self._config.period_s:
            return []
        if previous_ns is None or not 0 < stamp_ns - previous_ns <= self._config.max_gap_s * 1e9:
            odom = odometry_at(inbox, stamp_ns)
            self._matcher.reset(None if odom is None else level_of(odom.T_odom_base))
            previous_ns, self._step = None, np.eye(4)
        guess = self._odom_between(inbox, previous_ns, stamp_ns) if previous_ns is not None else np.eye(4)
        before = self._matcher.T_local_body
        sweep = self._odom_between(inbox, stamp_ns - self._points.sweep_ns, stamp_ns)
        result = self._matcher.match(self._points.process(scan, ground, sweep).points_base_m, guess)
        self._step = np.asarray(invert(before) @ result.T_local_body)
        self._step_ns = stamp_ns - (previous_ns if previous_ns is not None else stamp_ns - 1)
        self._previous_ns = stamp_ns
        if previous_ns is None:
            return []
        covariance, reason = result.covariance.copy(), result.reason
        return [LidarOdometry(stamp_ns, previous_ns, self._step, covariance, not reason, reason, result.points)]

    def _odom_between(self, inbox: Inbox, start_ns: int, end_ns: int) -> Float64:
        """Motion by dead reckoning; extrapolates the previous step where that is not available."""
        start, end = odometry_at(inbox, start_ns), odometry_at(inbox, end_ns)
        if start is None or end is None:
            return interpolate(np.eye(4), self._step, (end_ns - start_ns) / self._step_ns)
        return np.asarray(invert(start.T_odom_base) @ end.T_odom_base)

"""Lidar odometry node: motion of base between scans of one lidar."""

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Vehicle
from geometry.arrays import Bool, Float64
from geometry.transforms import apply, interpolate, invert
from localization.lidar.scan_matching import MatchingConfig, ScanMatcher, deskew, level_of
from messages.errors import ConfigError
from messages.motion import LidarOdometry, Odometry
from messages.node import All, At, Inbox, Node, On, Output, Read
from messages.perception import LidarGround
from messages.sensors import LidarScan


class LidarOdometryConfig(Config):
    """Section `lidar_odometry` of localization."""

    sensor: str = Field(description="key of `sensors.lidar` of the machine")
    matching: MatchingConfig
    period_s: float = Field(gt=0.0, le=2.0, description="scans that follow sooner are skipped")
    max_gap_s: float = Field(gt=0.0, le=10.0, description="a longer gap between scans starts a new map")
    margin_m: float = Field(ge=0.0, le=5.0, description="self filter about the machine's body")
    implement_rear_m: float = Field(ge=0.0, le=30.0, description="self filter behind base, for the implement")
    implement_half_width_m: float = Field(ge=0.0, le=20.0, description="self filter to each side, for the implement")


class LidarOdometryNode(Node):
    """Matches scans without ground; results with weak geometry are invalid, with a reason.

    Raises ConfigError when the machine has no such lidar.
    """

    def __init__(self, vehicle: Vehicle, config: LidarOdometryConfig) -> None:
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
        self._config, self._body = config, vehicle.body
        self._T_base_lidar, self._sweep_s = lidar.mount.T_base_sensor, 1.0 / lidar.rate_hz
        self._matcher = ScanMatcher(config.matching, lidar.mount.T_base_sensor[:3, 3])
        self._waiting: dict[int, LidarScan] = {}
        self._previous_ns: int | None = None
        self._step, self._step_ns = np.eye(4), 1

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Matches each scan whose ground has arrived."""
        for scan in inbox.all(self._scan, LidarScan):
            self._waiting[scan.stamp_ns] = scan
        out: list[Output] = []
        for ground in inbox.all(self._ground, LidarGround):
            pair = self._waiting.pop(ground.scan_stamp_ns, None)
            if pair is not None and len(ground.is_obstacle_point) == len(pair.points_m):
                out += [(self._output, motion) for motion in self._match(pair, ground, inbox)]
        for stamp_ns in sorted(self._waiting)[:-4]:
            del self._waiting[stamp_ns]
        return out

    def _match(self, scan: LidarScan, ground: LidarGround, inbox: Inbox) -> list[LidarOdometry]:
        stamp_ns, previous_ns = scan.stamp_ns, self._previous_ns
        if previous_ns is not None and 0 < stamp_ns - previous_ns < 0.95e9 * self._config.period_s:
            return []
        if previous_ns is None or not 0 < stamp_ns - previous_ns <= self._config.max_gap_s * 1e9:
            odom = inbox.at("odom", Odometry, stamp_ns)
            self._matcher.reset(None if odom is None else level_of(odom.T_odom_base))
            previous_ns, self._step = None, np.eye(4)
        guess = self._odom_between(inbox, previous_ns, stamp_ns) if previous_ns is not None else np.eye(4)
        before = self._matcher.T_local_body
        sweep = self._odom_between(inbox, stamp_ns - round(self._sweep_s * 1e9), stamp_ns)
        result = self._matcher.match(self._points(scan, ground, sweep), guess)
        self._step = np.asarray(invert(before) @ result.T_local_body)
        self._step_ns = stamp_ns - (previous_ns if previous_ns is not None else stamp_ns - 1)
        self._previous_ns = stamp_ns
        if previous_ns is None:
            return []
        covariance, reason = result.covariance.copy(), result.reason
        return [LidarOdometry(stamp_ns, previous_ns, self._step, covariance, not reason, reason, result.points)]

    def _odom_between(self, inbox: Inbox, start_ns: int, end_ns: int) -> Float64:
        """Motion by dead reckoning; extrapolates the previous step where that is not available."""
        start, end = inbox.at("odom", Odometry, start_ns), inbox.at("odom", Odometry, end_ns)
        if start is None or end is None:
            return interpolate(np.eye(4), self._step, (end_ns - start_ns) / self._step_ns)
        return np.asarray(invert(start.T_odom_base) @ end.T_odom_base)

    def _points(self, scan: LidarScan, ground: LidarGround, sweep: Float64) -> Float64:
        """Points of obstacles outside the self filter, in base at the stamp."""
        obstacle = np.flatnonzero(ground.is_obstacle_point)
        near, far = self._config.matching.range_m
        measured = scan.points_m[obstacle].astype(np.float64)
        range2 = np.einsum("ni,ni->n", measured, measured)
        p = apply(self._T_base_lidar, measured)
        use = (range2 > near**2) & (range2 < far**2) & ~self._is_own(p)
        kept = p[use]
        return deskew(
            np.asarray(kept, np.float64), scan.point_offset_s[obstacle][use].astype(np.float64), sweep, self._sweep_s
        )

    def _is_own(self, p_base_m: npt.NDArray[np.floating]) -> Bool:
        cfg, body = self._config, self._body
        x, y = p_base_m[:, 0], np.abs(p_base_m[:, 1])
        on_body = (
            (x < body.front_m + cfg.margin_m)
            & (x > -body.rear_m - cfg.margin_m)
            & (y < 0.5 * body.width_m + cfg.margin_m)
        )
        behind = (x < 0.0) & (x > -cfg.implement_rear_m) & (y < cfg.implement_half_width_m)
        return np.asarray(on_body | behind)

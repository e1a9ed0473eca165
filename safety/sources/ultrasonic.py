"""Ultrasonic source: successive echoes that agree give an arc of the cone on which an obstacle lies.

An echo gives a range, not the position on the arc. Single echoes are cross-talk; three successive ones that fit the
machine's own motion are an obstacle (perception counts votes over a window of measurements instead). An echo that
entered the dead zone is held until the machine has left or the echo returns.
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from configs.vehicle import Ultrasonic
from geometry.arrays import Float64
from geometry.pose2 import to_frame
from messages.motion import Odometry
from messages.perception import Track, Tracks
from messages.sensors import UltrasonicRange
from safety.config import UltrasonicConfig

ARC_POINTS = 7
SUCCESSIVE = 3  # echoes that confirm an obstacle
NARROW_M = 1.0  # the centre of a wider box may be empty: two sides of a fence in one track


@dataclass(frozen=True)
class Echo:
    """A measurement with the distance the machine had travelled along the sensor's axis."""

    stamp_ns: int
    range_m: float
    travel_m: float


class UltrasonicSource:
    """Processes one sensor; `echo_arc_odom_m`: echo arc in odom (7, 2), (0, 2) without a confirmed echo."""

    def __init__(self, name: str, sensor: Ultrasonic, config: UltrasonicConfig) -> None:
        self.name = name
        self.stamp_ns: int | None = None
        self.echo_arc_odom_m: Float64 = np.empty((0, 2))
        self._sensor, self._config = sensor, config
        self._T = sensor.mount.T_base_sensor
        self._reach_m = min(sensor.range_m[1], config.ground_ratio * ground_range_m(self._T))
        self._measured: Echo | None = None
        self._echoes: deque[Echo] = deque(maxlen=SUCCESSIVE)
        self._confirmed: Echo | None = None

    def forget(self) -> None:
        """Drops the confirmed echo."""
        self._confirmed, self.echo_arc_odom_m = None, np.empty((0, 2))

    def update(self, message: UltrasonicRange, pose_odom: Float64, odom: Odometry) -> None:
        """Processes a measurement; `pose_odom` (3,) is base at its stamp."""
        before, travel_m = self._measured, 0.0
        if before is not None:
            travel_m = before.travel_m + self._axis_mps(odom) * (message.stamp_ns - before.stamp_ns) * 1e-9
        self._measured = echo = Echo(message.stamp_ns, message.range_m, travel_m)
        self.stamp_ns = message.stamp_ns
        if self._is_confirmed(echo):
            self._confirmed = echo
            self.echo_arc_odom_m = to_frame(pose_odom, cone_arc(echo.range_m, self._sensor, self._T))
        elif not self._is_held(echo):
            self._confirmed, self.echo_arc_odom_m = None, np.empty((0, 2))

    def _axis_mps(self, odom: Odometry) -> float:
        turn, (x, y) = odom.yaw_rate_radps, self._T[:2, 3]
        velocity = (odom.speed_mps - turn * y, odom.lateral_mps + turn * x)
        return float(self._T[0, 0] * velocity[0] + self._T[1, 0] * velocity[1])

    def _is_confirmed(self, echo: Echo) -> bool:
        """Whether the last three echoes, missing ones left out, fit an object at rest or up to walking speed."""
        near_m, _ = self._sensor.range_m
        if not near_m <= echo.range_m <= self._reach_m:
            return False
        self._echoes.append(echo)
        if len(self._echoes) < SUCCESSIVE or (echo.stamp_ns - self._echoes[0].stamp_ns) * 1e-9 > self._config.window_s:
            return False
        return all(
            abs(old.range_m + old.travel_m - new.range_m - new.travel_m)
            <= self._config.gate_m + self._config.max_object_speed_mps * (new.stamp_ns - old.stamp_ns) * 1e-9
            for old, new in pairwise(self._echoes)
        )

    def _is_held(self, echo: Echo) -> bool:
        """Whether the last confirmed echo still holds: recent, or by now in the dead zone."""
        if self._confirmed is None:
            return False
        age_s = (echo.stamp_ns - self._confirmed.stamp_ns) * 1e-9
        rest_m = self._confirmed.range_m + self._confirmed.travel_m - echo.travel_m
        is_in_dead_zone = rest_m <= self._sensor.range_m[0] + self._config.dead_zone_margin_m
        return age_s <= (self._config.dead_zone_hold_s if is_in_dead_zone else self._config.memory_s)


def cone_arc(range_m: float, sensor: Ultrasonic, T: Float64) -> Float64:
    """Points (7, 2) in base across the cone at a range."""
    half = math.radians(0.5 * sensor.cone_deg)
    angle = np.linspace(-half, half, ARC_POINTS)
    local = range_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(ARC_POINTS)])
    return np.asarray((local @ T[:3, :3].T + T[:3, 3])[:, :2])


def is_confirmed_by_track(echo_arc_odom_m: Float64, tracks: Tracks | None, near_m: float) -> bool:
    """Whether an echo on an arc (N, 2) in odom comes from a confirmed lidar track on the arc.

    The position on the arc is then known, and the lidar channel covers it: a fence beside the machine gives an echo
    from the far end of the cone.
    """
    x, y = echo_arc_odom_m.mean(axis=0).tolist()
    reach_m = float(np.hypot(*(echo_arc_odom_m - (x, y)).T).max()) + 2.0 * near_m  # above the diagonal of `near_m`
    for track in () if tracks is None else tracks.tracks:
        if is_beyond(track, x, y, reach_m) or not track.is_confirmed:
            continue
        is_narrow = float(np.min(track.size_m[:2])) <= NARROW_M
        if not is_narrow or not any(name.startswith("lidar") for name in track.sensors):
            continue
        c, s = math.cos(track.yaw_rad), math.sin(track.yaw_rad)
        away = echo_arc_odom_m - track.p_odom_m[:2]
        along, across = np.abs(away @ [c, s]), np.abs(away @ [-s, c])
        if ((along <= 0.5 * track.size_m[0] + near_m) & (across <= 0.5 * track.size_m[1] + near_m)).any():
            return True
    return False


def is_beyond(track: Track, x_m: float, y_m: float, reach_m: float) -> bool:
    """Whether the box of a track lies farther than `reach_m` from a position in odom, by distance alone."""
    (x, y), (length, width) = track.p_odom_m[:2].tolist(), track.size_m[:2].tolist()
    return math.hypot(x - x_m, y - y_m) > reach_m + math.hypot(length, width)


def ground_range_m(T: Float64) -> float:
    """Range at which the axis meets the plane through the wheels; infinite when it does not point down."""
    return float(T[2, 3] / -T[2, 0]) if T[2, 0] < -1e-6 else math.inf

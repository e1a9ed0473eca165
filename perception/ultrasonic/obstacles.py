"""Node: obstacles from the echoes of one ultrasonic sensor."""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Ultrasonic, Vehicle
from geometry.arrays import Float64
from messages.command import MachineState
from messages.motion import Odometry, odometry_at
from messages.node import All, At, Inbox, Latest, Node, On, Output
from messages.perception import ObstacleClass, Obstacles
from messages.sensors import UltrasonicRange
from perception.self_filter import is_folded, is_inside, own_outlines
from perception.ultrasonic.echoes import (
    Echo,
    EchoConfig,
    LastObject,
    axis_speed,
    held_range,
    is_valid_range,
    repeated_range,
)


class HealthConfig(Config):
    """Limits of ultrasonic health."""

    timeout_s: float = Field(gt=0.0, le=10.0)
    stuck_s: float = Field(gt=0.0, le=60.0, description="time of a constant value while moving")
    moving_mps: float = Field(gt=0.0, le=5.0)
    stray_share: float = Field(gt=0.0, le=1.0, description="of the last echoes without agreement: cross-talk")
    window: int = Field(ge=5, le=200)
    period_s: float = Field(gt=0.0, le=1.0)


class UltrasonicConfig(Config):
    """Processing from echoes to obstacles and health; the same for every ultrasonic sensor."""

    echoes: EchoConfig
    health: HealthConfig
    depth_m: float = Field(gt=0.0, le=2.0)
    height_m: float = Field(gt=0.0, le=3.0)
    ground_share: float = Field(
        gt=0.0, le=1.0, description="of the range at which the axis meets the ground; farther echoes are ground"
    )


class UltrasonicObstacles(Node):
    """Runs on every measurement of the sensor `name`; without odometry the machine counts as at rest."""

    def __init__(
        self, name: str, sensor: Ultrasonic, vehicle: Vehicle, implement: Implement | None, config: UltrasonicConfig
    ) -> None:
        self.name = f"ultrasonic_{name}"
        self.reads = {f"ultrasonic/{name}": All(config.echoes.window), "odom": At(1.0), "machine": Latest()}
        self.writes = (f"obstacles/ultrasonic_{name}",)
        self.runs = On((f"ultrasonic/{name}",))
        self._topic, self._sensor, self._config = f"ultrasonic/{name}", sensor, config
        self._own, self._T_base_sensor = own_outlines(vehicle, implement), sensor.mount.T_base_sensor
        self._reach_m = min(sensor.range_m[1], ground_range(sensor) * config.ground_share)
        self._echoes: deque[Echo] = deque(maxlen=config.echoes.window)
        self._last_object: LastObject | None = None

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Obstacle in the cone at the newest measurement."""
        messages = [m for m in inbox.all(self._topic, UltrasonicRange) if is_valid_range(m.range_m, self._sensor)]
        for message in messages:
            self._add(message, self._odom_at(message, inbox))
        own = self._own[is_folded(inbox.latest("machine", MachineState))]
        return ((self.writes[0], self._obstacles_message(own)),) if messages else ()

    def _odom_at(self, message: UltrasonicRange, inbox: Inbox) -> Odometry | None:
        """Odometry at a measurement; None without echoes and last object, where travel is not needed."""
        last, hold_ns = self._last_object, round(self._config.echoes.hold_s * 1e9)
        is_known = last is not None and message.stamp_ns - last.stamp_ns <= hold_ns
        if not is_known and math.isnan(message.range_m) and all(math.isnan(e.range_m) for e in self._echoes):
            return None
        return odometry_at(inbox, message.stamp_ns)

    def _add(self, message: UltrasonicRange, odom: Odometry | None) -> None:
        last = self._echoes[-1] if self._echoes else None
        if last is not None and message.stamp_ns <= last.stamp_ns:  # time ran back: another run
            self._echoes.clear()
            self._last_object, last = None, None
        speed = axis_speed(odom, self._T_base_sensor) if odom is not None else 0.0
        travel = last.travel_m + speed * (message.stamp_ns - last.stamp_ns) * 1e-9 if last is not None else 0.0
        echo = Echo(message.stamp_ns, message.range_m, travel)
        self._echoes.append(echo)
        confirmed = repeated_range(tuple(self._echoes), self._config.echoes)
        if confirmed is not None:
            self._last_object = LastObject(echo.stamp_ns, confirmed, travel)

    def _obstacles_message(self, outline: Float64) -> Obstacles:
        now, last = self._echoes[-1], self._last_object
        confirmed = last.range_m if last is not None and last.stamp_ns == now.stamp_ns else None
        range_m = confirmed if confirmed is not None else held_range(last, now, self._sensor, self._config.echoes)
        if range_m is None or range_m > self._reach_m:
            return boxes_message(now.stamp_ns, self.name, np.empty((0, 10)))
        box = cone_box(range_m, self._sensor, self._config)
        own = is_inside(box[None, :2], outline)[0]
        return boxes_message(now.stamp_ns, self.name, np.empty((0, 10)) if own else box[None])


def ground_range(sensor: Ultrasonic) -> float:
    """Range at which the axis meets the plane of the wheels; infinite without a downward tilt."""
    T = sensor.mount.T_base_sensor
    return float(T[2, 3] / -T[2, 0]) if T[2, 0] < -1e-6 else math.inf


def cone_box(range_m: float, sensor: Ultrasonic, config: UltrasonicConfig) -> Float64:
    """Box of an echo at `range_m`: centre, size, yaw, nearest x and y, sigma across, (10,).

    The position on the arc is unknown: the box spans its chord, with the sigma of a uniform distribution across.
    """
    T = sensor.mount.T_base_sensor
    azimuth = math.atan2(T[1, 0], T[0, 0])
    flat_m = math.hypot(T[0, 0], T[1, 0]) * range_m
    chord = max(2.0 * range_m * math.sin(math.radians(sensor.cone_deg) / 2), 0.1)
    near = T[:2, 3] + flat_m * np.array([math.cos(azimuth), math.sin(azimuth)])
    center = T[:2, 3] + (flat_m + config.depth_m / 2) * np.array([math.cos(azimuth), math.sin(azimuth)])
    size = (config.depth_m, chord, config.height_m)
    return np.array([*center, config.height_m / 2, *size, azimuth, *near, chord / math.sqrt(12.0)], np.float64)


def boxes_message(stamp_ns: int, sensor: str, boxes: Float64) -> Obstacles:
    """Message of boxes (K, 10) from `cone_box`, without class and velocity."""
    n = len(boxes)
    nearest = np.concatenate([boxes[:, 7:9], boxes[:, 2:3]], axis=1)
    sigma = np.stack([boxes[:, 3] / math.sqrt(12.0), boxes[:, 9]], axis=1)
    classes = np.full((n, len(ObstacleClass)), 1.0 / len(ObstacleClass))
    return Obstacles(
        stamp_ns, sensor, stamp_ns, boxes[:, :3].copy(), boxes[:, 3:6].copy(), boxes[:, 6].copy(), nearest,
        np.full((n, 2), np.nan), classes, np.zeros(n + 1, np.int32), np.empty(0, np.int32),
        np.empty((0, 3), np.float32), sigma,
    )  # fmt: skip

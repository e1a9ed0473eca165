"""The node that turns the echoes of one ultrasonic sensor into near obstacles."""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Implement, Ultrasonic, Vehicle
from messages.command import MachineState
from messages.message import Float64
from messages.motion import Odometry
from messages.node import All, At, Inbox, Latest, Node, On, Output
from messages.perception import ObstacleClass, Obstacles
from messages.sensors import UltrasonicRange
from perception.self_filter import is_folded, is_inside, own_outlines
from perception.ultrasonic.echoes import Echo, EchoConfig, Near, axis_speed, held_range, is_range, repeated_range


class HealthConfig(Config):
    """When an ultrasonic sensor is not to be trusted."""

    silent_s: float = Field(gt=0.0, le=10.0)
    stuck_s: float = Field(gt=0.0, le=60.0, description="the very same number for so long while moving")
    moving_mps: float = Field(gt=0.0, le=5.0)
    stray_share: float = Field(gt=0.0, le=1.0, description="of the last echoes, that agree with no other: cross-talk")
    votes: int = Field(ge=5, le=200)
    period_s: float = Field(gt=0.0, le=1.0)


class UltrasonicConfig(Config):
    """The whole way from echoes to obstacles and health; the same for every ultrasonic sensor."""

    echoes: EchoConfig
    health: HealthConfig
    depth_m: float = Field(gt=0.0, le=2.0)
    height_m: float = Field(gt=0.0, le=3.0)
    ground_share: float = Field(
        gt=0.0, le=1.0, description="of the range at which the axis meets the ground: beyond is ground"
    )


class UltrasonicObstacles(Node):
    """Runs on every measurement of the sensor `name`; without odometry the machine counts as standing."""

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
        self._near: Near | None = None

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """What stands in the cone at the newest measurement."""
        messages = [m for m in inbox.all(self._topic, UltrasonicRange) if is_range(m.range_m, self._sensor)]
        for message in messages:
            self._listen(message, self._odom_at(message, inbox))
        own = self._own[is_folded(inbox.latest("machine", MachineState))]
        return ((self.writes[0], self._tell(own)),) if messages else ()

    def _odom_at(self, message: UltrasonicRange, inbox: Inbox) -> Odometry | None:
        """The motion at a measurement; while nothing is heard nor remembered nobody asks how far the sensor came."""
        near, hold_ns = self._near, round(self._config.echoes.hold_s * 1e9)
        is_known = near is not None and message.stamp_ns - near.stamp_ns <= hold_ns
        if not is_known and math.isnan(message.range_m) and all(math.isnan(e.range_m) for e in self._echoes):
            return None
        return inbox.at("odom", Odometry, message.stamp_ns) or inbox.latest("odom", Odometry)

    def _listen(self, message: UltrasonicRange, odom: Odometry | None) -> None:
        last = self._echoes[-1] if self._echoes else None
        if last is not None and message.stamp_ns <= last.stamp_ns:  # time ran back: another run
            self._echoes.clear()
            self._near, last = None, None
        speed = axis_speed(odom, self._T_base_sensor) if odom is not None else 0.0
        travel = last.travel_m + speed * (message.stamp_ns - last.stamp_ns) * 1e-9 if last is not None else 0.0
        echo = Echo(message.stamp_ns, message.range_m, travel)
        self._echoes.append(echo)
        told = repeated_range(tuple(self._echoes), self._config.echoes)
        if told is not None:
            self._near = Near(echo.stamp_ns, told, travel)

    def _tell(self, outline: Float64) -> Obstacles:
        now, near = self._echoes[-1], self._near
        told = near.range_m if near is not None and near.stamp_ns == now.stamp_ns else None
        range_m = told if told is not None else held_range(near, now, self._sensor, self._config.echoes)
        if range_m is None or range_m > self._reach_m:
            return boxes_message(now.stamp_ns, self.name, np.empty((0, 10)))
        box = cone_box(range_m, self._sensor, self._config)
        own = is_inside(box[None, :2], outline)[0]
        return boxes_message(now.stamp_ns, self.name, np.empty((0, 10)) if own else box[None])


def ground_range(sensor: Ultrasonic) -> float:
    """Range at which the axis meets the plane through the wheels; infinite when it does not look down."""
    T = sensor.mount.T_base_sensor
    return float(T[2, 3] / -T[2, 0]) if T[2, 0] < -1e-6 else math.inf


def cone_box(range_m: float, sensor: Ultrasonic, config: UltrasonicConfig) -> Float64:
    """The part of the cone where an echo from `range_m` can stand: centre, size, yaw, nearest's x and y, sigma across.

    The echo says how far, not where on the arc: the box spans its chord, and its sigma across is that of an even share.
    """
    T = sensor.mount.T_base_sensor
    azimuth = math.atan2(T[1, 0], T[0, 0])
    level = math.hypot(T[0, 0], T[1, 0]) * range_m
    chord = max(2.0 * range_m * math.sin(math.radians(sensor.cone_deg) / 2), 0.1)
    near = T[:2, 3] + level * np.array([math.cos(azimuth), math.sin(azimuth)])
    center = T[:2, 3] + (level + config.depth_m / 2) * np.array([math.cos(azimuth), math.sin(azimuth)])
    size = (config.depth_m, chord, config.height_m)
    return np.array([*center, config.height_m / 2, *size, azimuth, *near, chord / math.sqrt(12.0)], np.float64)


def boxes_message(stamp_ns: int, sensor: str, boxes: Float64) -> Obstacles:
    """Boxes (K, 10) as `cone_box` gives them, as a message; the echo tells neither class nor velocity."""
    n = len(boxes)
    nearest = np.concatenate([boxes[:, 7:9], boxes[:, 2:3]], axis=1)
    sigma = np.stack([boxes[:, 3] / math.sqrt(12.0), boxes[:, 9]], axis=1)
    classes = np.full((n, len(ObstacleClass)), 1.0 / len(ObstacleClass))
    return Obstacles(
        stamp_ns, sensor, stamp_ns, boxes[:, :3].copy(), boxes[:, 3:6].copy(), boxes[:, 6].copy(), nearest,
        np.full((n, 2), np.nan), classes, np.zeros(n + 1, np.int32), np.empty(0, np.int32),
        np.empty((0, 3), np.float32), sigma,
    )  # fmt: skip

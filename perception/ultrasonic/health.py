"""Node: health of one ultrasonic sensor; a measurement without echo is valid, a missing measurement is not."""

import math
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from configs.vehicle import Ultrasonic
from messages.motion import Odometry
from messages.node import All, Every, Inbox, Latest, Node, Output
from messages.perception import HealthState, SensorHealth
from messages.sensors import UltrasonicRange
from perception.repeated_output import is_repeated
from perception.ultrasonic.echoes import EchoConfig, is_valid_range
from perception.ultrasonic.obstacles import UltrasonicConfig

MAX_ECHOES = 50


class UltrasonicHealth(Node):
    """Checks every measurement of the sensor `name` and publishes its state periodically."""

    def __init__(self, name: str, sensor: Ultrasonic, config: UltrasonicConfig) -> None:
        self.name = f"health_ultrasonic_{name}"
        self.reads = {f"ultrasonic/{name}": All(MAX_ECHOES), "odom": Latest()}
        self.writes = (f"health/ultrasonic_{name}",)
        self.runs = Every(round(config.health.period_s * 1e9))
        self._label, self._topic, self._sensor, self._config = (
            f"ultrasonic_{name}",
            f"ultrasonic/{name}",
            sensor,
            config,
        )
        yaw, half = math.radians(sensor.mount.rpy_deg[2]), math.radians(sensor.cone_deg) / 2
        self._edges = np.array([yaw - half, yaw + half])
        self._recent: deque[UltrasonicRange] = deque(maxlen=config.health.window)
        self._last_ns: int | None = None
        self._changed_ns = 0  # last change of the value, or last measurement at rest
        self._rejected_count = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The state now."""
        odom = inbox.latest("odom", Odometry)
        moves = odom is not None and abs(odom.speed_mps) > self._config.health.moving_mps
        for message in inbox.all(self._topic, UltrasonicRange):
            self._add(message, moves)
        state, reason = self._state(now_ns)
        range_m = np.array([0.0 if state is HealthState.BLIND else self._sensor.range_m[1]])
        health = SensorHealth(now_ns, self._label, state, reason, self._edges.copy(), range_m, self._rejected_count)
        return ((self.writes[0], health),)

    def _add(self, message: UltrasonicRange, moves: bool) -> None:
        if not is_valid_range(message.range_m, self._sensor):
            self._rejected_count += 1
            return
        last = self._recent[-1] if self._recent else None
        if last is None or not is_repeated((message.range_m, last.range_m)) or not moves:
            self._changed_ns = message.stamp_ns
        self._recent.append(message)
        self._last_ns = message.stamp_ns

    def _state(self, now_ns: int) -> tuple[HealthState, str]:
        config = self._config.health
        if self._last_ns is None or now_ns - self._last_ns > round(config.timeout_s * 1e9):
            return (
                HealthState.BLIND,
                "no measurements any more" if self._last_ns is not None else "no measurement yet",
            )
        if self._last_ns - self._changed_ns > round(config.stuck_s * 1e9):
            return HealthState.BLIND, "sends the same value again"
        if len(self._recent) == config.window and stray_share(self._recent, self._config.echoes) >= config.stray_share:
            return HealthState.DEGRADED, "echoes do not repeat: cross-talk"
        return HealthState.GOOD, ""


def stray_share(measurements: Sequence[UltrasonicRange], config: EchoConfig) -> float:
    """Share of measurements that are echoes without agreement with the previous or the next."""
    stray = 0
    for k, message in enumerate(measurements):
        neighbours = [measurements[i] for i in (k - 1, k + 1) if 0 <= i < len(measurements)]
        near = [
            abs(n.range_m - message.range_m)
            <= config.gate_m + config.max_target_speed_mps * abs(n.stamp_ns - message.stamp_ns) * 1e-9
            for n in neighbours
        ]
        stray += not math.isnan(message.range_m) and not any(near)
    return stray / max(len(measurements), 1)

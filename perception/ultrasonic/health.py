"""The node that says whether one ultrasonic sensor can be trusted: nothing heard is an answer, silence is not."""

import math
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from configs.vehicle import Ultrasonic
from messages.motion import Odometry
from messages.node import All, Every, Inbox, Latest, Node, Output
from messages.perception import HealthState, SensorHealth
from messages.sensors import UltrasonicRange
from perception.ultrasonic.echoes import EchoConfig, is_range
from perception.ultrasonic.obstacles import UltrasonicConfig

MOST_ECHOES = 50


class UltrasonicHealth(Node):
    """Listens to every measurement of the sensor `name` and tells its state several times a second."""

    def __init__(self, name: str, sensor: Ultrasonic, config: UltrasonicConfig) -> None:
        self.name = f"health_ultrasonic_{name}"
        self.reads = {f"ultrasonic/{name}": All(MOST_ECHOES), "odom": Latest()}
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
        self._heard: deque[UltrasonicRange] = deque(maxlen=config.health.votes)
        self._last_ns: int | None = None
        self._changed_ns = 0  # when the number last changed, or did not have to
        self._dropped = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The state now."""
        odom = inbox.latest("odom", Odometry)
        moves = odom is not None and abs(odom.speed_mps) > self._config.health.moving_mps
        for message in inbox.all(self._topic, UltrasonicRange):
            self._listen(message, moves)
        state, reason = self._judge(now_ns)
        proven = np.array([0.0 if state is HealthState.BLIND else self._sensor.range_m[1]])
        health = SensorHealth(now_ns, self._label, state, reason, self._edges.copy(), proven, self._dropped)
        return ((self.writes[0], health),)

    def _listen(self, message: UltrasonicRange, moves: bool) -> None:
        if not is_range(message.range_m, self._sensor):
            self._dropped += 1
            return
        last = self._heard[-1] if self._heard else None
        if last is None or last.range_m != message.range_m or not moves:  # NaN differs from NaN: nothing is no number
            self._changed_ns = message.stamp_ns
        self._heard.append(message)
        self._last_ns = message.stamp_ns

    def _judge(self, now_ns: int) -> tuple[HealthState, str]:
        config = self._config.health
        if self._last_ns is None or now_ns - self._last_ns > round(config.silent_s * 1e9):
            return (
                HealthState.BLIND,
                "sends no measurement any more" if self._last_ns is not None else "sends nothing yet",
            )
        if self._last_ns - self._changed_ns > round(config.stuck_s * 1e9):
            return HealthState.BLIND, "sends the same number again"
        if len(self._heard) == config.votes and stray_share(self._heard, self._config.echoes) >= config.stray_share:
            return HealthState.DEGRADED, "echoes do not repeat: cross-talk"
        return HealthState.GOOD, ""


def stray_share(heard: Sequence[UltrasonicRange], config: EchoConfig) -> float:
    """Share of all measurements that are echoes agreeing with neither the one before nor the one after."""
    stray = 0
    for k, message in enumerate(heard):
        neighbours = [heard[i] for i in (k - 1, k + 1) if 0 <= i < len(heard)]
        near = [
            abs(n.range_m - message.range_m)
            <= config.gate_m + config.fastest_mps * abs(n.stamp_ns - message.stamp_ns) * 1e-9
            for n in neighbours
        ]
        stray += not math.isnan(message.range_m) and not any(near)
    return stray / max(len(heard), 1)

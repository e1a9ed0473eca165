"""Sensor monitor: failures of radars, cameras and ultrasonic sensors that cover the direction of travel."""

import math
from dataclasses import dataclass

from configs.sensor_kinds import MONITORED_KINDS, sensors_of
from configs.vehicle import Mount, Sensors
from messages.perception import HealthState, SensorHealth
from messages.topics import spec_of
from safety.sources.detection_range import limit_by_health

AHEAD_RAD = math.radians(60.0)  # a sensor turned farther from the direction of travel is not required in it


@dataclass(frozen=True)
class MonitoredSensor:
    """A sensor other than a lidar: kind, name and mount."""

    kind: str
    name: str
    mount: Mount

    @property
    def topic(self) -> str:
        """Topic of its measurements."""
        return f"{self.kind}/{self.name}"

    @property
    def label(self) -> str:
        """Name in health and obstacle topics, such as `radar_front`."""
        return f"{self.kind}_{self.name}"

    @property
    def obstacles_topic(self) -> str:
        """Topic of the obstacles detected by it."""
        return f"obstacles/{self.label}"

    @property
    def max_output_age_s(self) -> float:
        """Maximum age of its obstacles: the larger of the sensor and obstacle limits."""
        return max(spec_of(self.topic).max_age_s, spec_of(self.obstacles_topic).max_age_s)

    @property
    def health_topic(self) -> str:
        """Topic of its health."""
        return f"health/{self.label}"

    def covers(self, direction: int) -> bool:
        """Whether it covers a direction of travel."""
        away = math.radians(self.mount.rpy_deg[2]) - (0.0 if direction > 0 else math.pi)
        return abs(math.remainder(away, 2.0 * math.pi)) <= AHEAD_RAD


@dataclass(frozen=True)
class SensorFailure:
    """Failure of a sensor of a kind; the code names the topic and the failure."""

    kind: str
    code: str
    text: str


def monitored_sensors(sensors: Sensors, idle: frozenset[str]) -> tuple[MonitoredSensor, ...]:
    """All sensors of monitored kinds except the idle ones (by label, such as `camera_front`)."""
    every = [
        MonitoredSensor(kind, name, one.mount)
        for kind in MONITORED_KINDS
        for name, one in sensors_of(sensors, kind).items()
    ]
    return tuple(one for one in every if one.label not in idle)


def failure_of(
    one: MonitoredSensor, is_received: bool, is_frozen: bool, has_output: bool, health: SensorHealth | None,
    direction: int, half_rad: float,
) -> SensorFailure | None:  # fmt: skip
    """Failure of a sensor in a direction, None if there is none; missing obstacles or health are failures."""
    if not one.covers(direction):
        return None
    if not is_received:
        return SensorFailure(one.kind, f"{one.topic}.silent", f"no message on {one.topic} within its greatest age")
    if is_frozen:
        return SensorFailure(one.kind, f"{one.topic}.frozen", f"{one.topic} repeats the same measurement")
    if not has_output:
        return SensorFailure(one.kind, f"{one.obstacles_topic}.silent", f"no obstacles from {one.topic}")
    if health is None:
        return SensorFailure(one.kind, f"{one.health_topic}.silent", f"no health of {one.topic}")
    if health.state is HealthState.BLIND or limit_by_health(math.inf, health, direction, half_rad) <= 0.0:
        return SensorFailure(one.kind, f"{one.topic}.blind", f"{one.topic} is blind: {health.reason}")
    return None

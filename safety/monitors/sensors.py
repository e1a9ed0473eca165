"""Radars, cameras and ultrasonic sensors beside the lidars: which of those that look ahead are lost, and how."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from configs.vehicle import Camera, Mount, Radar, Sensors, Ultrasonic
from messages.perception import HealthState, SensorHealth
from messages.topics import spec_of
from safety.sources.detection_range import limit_by_health

AHEAD_RAD = math.radians(60.0)  # a sensor turned farther away from the direction of travel is not missed there


@dataclass(frozen=True)
class MonitoredSensor:
    """A sensor beside the lidars, by kind and name, and where it is mounted."""

    kind: str
    name: str
    mount: Mount

    @property
    def topic(self) -> str:
        """Where its measurements are."""
        return f"{self.kind}/{self.name}"

    @property
    def label(self) -> str:
        """As health and obstacles name it."""
        return f"{self.kind}_{self.name}"

    @property
    def obstacles_topic(self) -> str:
        """Where what was made of its measurements is."""
        return f"obstacles/{self.label}"

    @property
    def max_output_age_s(self) -> float:
        """How old what was made of them may become: who measures seldom tells seldom."""
        return max(spec_of(self.topic).max_age_s, spec_of(self.obstacles_topic).max_age_s)

    @property
    def health_topic(self) -> str:
        """Where its health is."""
        return f"health/{self.label}"

    def covers(self, direction: int) -> bool:
        """Whether it looks in a direction of travel."""
        away = math.radians(self.mount.rpy_deg[2]) - (0.0 if direction > 0 else math.pi)
        return abs(math.remainder(away, 2.0 * math.pi)) <= AHEAD_RAD


@dataclass(frozen=True)
class SensorFailure:
    """A sensor of a kind that does not see the way; the code names it."""

    kind: str
    code: str
    text: str


def monitored_sensors(sensors: Sensors, idle: frozenset[str]) -> tuple[MonitoredSensor, ...]:
    """All radars, cameras and ultrasonic sensors but the idle ones (named like `camera_front`)."""
    kinds: dict[str, Mapping[str, Radar | Camera | Ultrasonic]] = {
        "radar": sensors.radar, "camera": sensors.camera, "ultrasonic": sensors.ultrasonic,
    }  # fmt: skip
    every = [MonitoredSensor(kind, name, one.mount) for kind, ones in kinds.items() for name, one in ones.items()]
    return tuple(one for one in every if one.label not in idle)


def failure_of(
    one: MonitoredSensor, is_heard: bool, is_frozen: bool, is_told: bool, health: SensorHealth | None, direction: int,
    half_rad: float,
) -> SensorFailure | None:  # fmt: skip
    """How a sensor is lost in a direction, if so; a sensor whose obstacles or health nobody tells is."""
    if not one.covers(direction):
        return None
    if not is_heard:
        return SensorFailure(one.kind, f"{one.topic}.silent", f"no message on {one.topic} within its greatest age")
    if is_frozen:
        return SensorFailure(one.kind, f"{one.topic}.frozen", f"{one.topic} repeats the same measurement")
    if not is_told:
        return SensorFailure(one.kind, f"{one.obstacles_topic}.silent", f"nobody tells what {one.topic} sees")
    if health is None:
        return SensorFailure(one.kind, f"{one.health_topic}.silent", f"nobody tells the health of {one.topic}")
    if health.state is HealthState.BLIND or limit_by_health(math.inf, health, direction, half_rad) <= 0.0:
        return SensorFailure(one.kind, f"{one.topic}.blind", f"{one.topic} is blind: {health.reason}")
    return None

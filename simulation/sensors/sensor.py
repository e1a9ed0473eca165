"""Interface of sensor models, and the state that they measure."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from configs.site import Site
from configs.vehicle import Implement, Vehicle
from messages.message import Message
from simulation.environment.scene import Scene
from simulation.machine.machine import Machine
from simulation.machine.pose_buffer import PoseBuffer
from simulation.randomness import generator
from simulation.scenario import Scenario


@dataclass(frozen=True)
class WorldState:
    """The world at one instant; `poses` ends there."""

    stamp_ns: int
    elapsed_s: float
    poses: PoseBuffer
    machine: Machine
    scene: Scene


class Sensor(Protocol):
    """One sensor: writes one topic at one period; `latency_ns` from measurement to delivery."""

    topic: str
    period_ns: int
    latency_ns: int

    def sample(self, state: WorldState) -> Message | None:
        """The measurement now, or None."""


@dataclass(frozen=True)
class SensorContext:
    """Inputs of the sensor models besides sensor and configuration."""

    site: Site
    vehicle: Vehicle
    implement: Implement
    scenario: Scenario
    seed: int

    def generator(self, topic: str) -> np.random.Generator:
        """Random generator of the sensor with this topic."""
        return generator(self.seed, topic)


def period_ns_of(rate_hz: float) -> int:
    """Period of a rate, rounded to nanoseconds."""
    return round(1e9 / rate_hz)

"""What every sensor model has in common, and what it may know."""

from dataclasses import dataclass
from typing import Protocol

from messages.message import Message
from simulation.environment.scene import Scene
from simulation.machine.machine import Machine
from simulation.machine.pose_buffer import PoseBuffer


@dataclass(frozen=True)
class WorldState:
    """The world at one instant; `track` ends there."""

    stamp_ns: int
    elapsed_s: float
    poses: PoseBuffer
    machine: Machine
    scene: Scene


class Sensor(Protocol):
    """One sensor: writes one topic at one period; the latency is from measurement to delivery."""

    topic: str
    period_ns: int
    latency_ns: int

    def sample(self, state: WorldState) -> Message | None:
        """What it measures now, or None when it says nothing."""


def period_ns_of(rate_hz: float) -> int:
    """The period of a rate, in whole nanoseconds."""
    return round(1e9 / rate_hz)

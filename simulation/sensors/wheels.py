"""Wheel sensors: wheel speed with slip, and the front-wheel angle with its constant zero error."""

import math

import numpy as np

from configs.vehicle import Wheels
from messages.message import Message
from messages.sensors import WheelSample
from simulation.sensors.sensor import WorldState, period_ns_of


class WheelModel:
    """Wheel encoder and angle sensor; at standstill the speed is exactly zero."""

    def __init__(self, wheels: Wheels, random: np.random.Generator) -> None:
        self.topic = "wheel"
        self.period_ns = period_ns_of(wheels.rate_hz)
        self.latency_ns = 0
        self._wheels, self._random = wheels, random

    def sample(self, state: WorldState) -> Message:
        """Circumferential wheel speed and measured angle."""
        white = self._random.standard_normal(2)
        speed = state.machine.wheel_speed_mps
        speed += float(white[0]) * self._wheels.speed_sigma_mps if speed != 0.0 else 0.0
        angle = state.machine.measured_angle_rad + float(white[1]) * math.radians(self._wheels.angle_sigma_deg)
        return WheelSample(state.stamp_ns, speed, angle)

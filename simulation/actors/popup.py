"""A person who appears suddenly, close before the machine: for measuring the braking reaction."""

import math

import numpy as np

from geometry.arrays import Float64
from simulation.actors.actors import Actor, ActorState
from simulation.environment.terrain import Terrain
from simulation.machine.machine import Machine
from simulation.objects.encountered import PERSON

ID = 900
STANDING_MPS = 0.02


class PopUp(Actor):
    """A person `ahead_m` before the front after straight driving for some time; removed when the machine stands."""

    def __init__(self, machine: Machine, terrain: Terrain, random: np.random.Generator, ahead_m: float) -> None:
        self._machine, self._terrain, self._random, self._ahead_m = machine, terrain, random, ahead_m
        self._ready_s: float | None = None
        self._still_s: float | None = None
        self.state: ActorState | None = None
        self.count = 0

    def update(self, elapsed_s: float, tip_map_m: Float64, heading_rad: float) -> ActorState | None:
        """The person, None while absent."""
        if self.state is None:
            self._wait(elapsed_s, tip_map_m, heading_rad)
        else:
            self._leave(elapsed_s)
        return self.state

    def _wait(self, elapsed_s: float, tip_map_m: Float64, heading_rad: float) -> None:
        machine = self._machine
        if machine.speed_mps < 2.4 or abs(machine.steering.angle_rad) > 0.03:
            self._ready_s = None
        elif self._ready_s is None:
            self._ready_s = elapsed_s + float(self._random.uniform(1.0, 2.0))
        elif elapsed_s >= self._ready_s:
            x = float(tip_map_m[0]) + self._ahead_m * math.cos(heading_rad)
            y = float(tip_map_m[1]) + self._ahead_m * math.sin(heading_rad)
            self.count += 1
            self.state = ActorState(
                ID + self.count, PERSON, "popup", (x, y, self._terrain.height_m(x, y)), heading_rad,
                (0.0, 0.0), -1.0,
            )  # fmt: skip
            self._ready_s = self._still_s = None

    def _leave(self, elapsed_s: float) -> None:
        if abs(self._machine.speed_mps) > STANDING_MPS:
            return
        self._still_s = elapsed_s if self._still_s is None else self._still_s
        if elapsed_s - self._still_s > 1.0:
            self.state = None

"""What the objects of a scenario react to at one instant, and the conditions they wait for."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from simulation.actors.actors import ActorState
from simulation.actors.outline import Outline
from simulation.actors.phases import PhaseName, PlanPosition, Situation
from simulation.environment.terrain import Terrain
from simulation.machine.machine import Machine
from simulation.scenario_objects import When
from simulation.scenario_values import draw


@dataclass(frozen=True)
class Surroundings:
    """Machine, plan and the other objects by name; `leading_end` is that in the direction of travel, with heading."""

    now: Situation
    machine: Machine
    phases: frozenset[PhaseName]
    outline: Outline
    plan: PlanPosition
    terrain: Terrain
    leading_end: tuple[Float64, float]
    others: Mapping[str, ActorState]


class Condition:
    """A drawn `When`; met once and for all."""

    def __init__(self, when: When, random: np.random.Generator) -> None:
        self._when, self._values = when, draw(when, random)
        self._met_s: float | None = None

    def is_met(self, around: Surroundings, own: ActorState | None) -> bool:
        """Whether it has been met `after_s` ago; `own` is the object that waits, if present."""
        elapsed_s = around.now.elapsed_s
        if self._met_s is None and self._holds(around, own):
            self._met_s = elapsed_s
        return self._met_s is not None and elapsed_s - self._met_s >= self._values["after_s"] - 1e-9

    def _holds(self, around: Surroundings, own: ActorState | None) -> bool:
        when, values = self._when, self._values
        if when.phase is not None:
            return when.phase in around.phases
        if when.path_m is not None:
            return around.now.path_m >= values["path_m"]
        if when.at_s is not None:
            return around.now.elapsed_s >= values["at_s"] - 1e-9
        if own is None:
            return False
        if when.near_m is not None:
            return around.outline.ground.distance(own.footprint) <= values["near_m"]
        other = around.others.get(when.meets or "")
        return other is not None and math.dist(own.p_map_m[:2], other.p_map_m[:2]) <= values["within_m"]

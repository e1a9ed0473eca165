"""Motions of scripted objects: standing, lying down, going straight or to another object, accompanying the machine."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulation.actors.actors import ActorState
from simulation.actors.surroundings import Condition, Surroundings
from simulation.scenario_environment import Birds
from simulation.scenario_objects import Accompany, Behaviour, Cross, LieDown, Stand, When
from simulation.scenario_values import draw

Pose = tuple[float, float, float]
REACHED_M = 0.6  # between the origins of two objects that meet
AT_ONCE = When(at_s=(0.0, 0.0))


@dataclass(frozen=True)
class Step:
    """Place, heading, course and speed of a body now; `lying`: share of the change to a posture."""

    p_map_m: tuple[float, float]
    heading_rad: float
    speed_mps: float = 0.0
    walked_m: float = 0.0
    course_rad: float = 0.0
    lying: tuple[float, str] | None = None


class Circling:
    """Flight on a circle from where a behaviour would stand: what flies cannot stop in the air."""

    def __init__(self, random: np.random.Generator) -> None:
        values = draw(Birds(gulls=1), random)
        self._radius_m, self._speed_mps = values["radius_m"], values["speed_mps"]
        self._since_s: float | None = None

    def step(self, at: Step, elapsed_s: float) -> Step:
        """The step now, for the behaviour's step, which is kept while that moves."""
        if at.speed_mps > 0.0:
            self._since_s = None
            return at
        if self._since_s is None:
            self._since_s = elapsed_s
        way = self._speed_mps * (elapsed_s - self._since_s)
        heading, radius = at.heading_rad + way / self._radius_m, self._radius_m
        x = at.p_map_m[0] + radius * (math.sin(heading) - math.sin(at.heading_rad))
        y = at.p_map_m[1] - radius * (math.cos(heading) - math.cos(at.heading_rad))
        return Step((x, y), heading, self._speed_mps, at.walked_m + way, heading)


class Motion(Protocol):
    """A behaviour over time."""

    def begin(self, start: Pose, elapsed_s: float) -> None:
        """Sets the pose of the appearance."""

    def step(self, around: Surroundings, own: ActorState | None) -> Step:
        """The step now; `own` is the last state, None at the appearance."""


def motion_of(behaviour: Behaviour, random: np.random.Generator) -> Motion:
    """The drawn motion of a behaviour."""
    values = draw(behaviour, random)
    when = behaviour.when or AT_ONCE
    if isinstance(behaviour, Cross):
        if behaviour.near_m is not None:
            when = When(near_m=(values["near_m"], values["near_m"]))
        return Going(behaviour, values, Condition(when, random))
    if isinstance(behaviour, Accompany):
        return Accompanying(behaviour, values, Condition(when, random))
    return Resting(behaviour, values, Condition(when, random))


class _Started:
    """A motion that begins when its condition is met."""

    def __init__(self, condition: Condition) -> None:
        self._condition = condition
        self._start: Pose = (0.0, 0.0, 0.0)
        self._last_s = 0.0
        self._since_s: float | None = None

    def begin(self, start: Pose, elapsed_s: float) -> None:
        """Sets the pose of the appearance."""
        self._start, self._last_s = start, elapsed_s

    def _elapsed_s(self, around: Surroundings, own: ActorState | None) -> tuple[float, float]:
        """Time since the start of the motion (negative: waits) and since the last step."""
        now_s = around.now.elapsed_s
        if self._since_s is None and self._condition.is_met(around, own):
            self._since_s = now_s
        change_s, self._last_s = now_s - self._last_s, now_s
        return -1.0 if self._since_s is None else now_s - self._since_s, change_s


class Resting(_Started):
    """Stands, or changes its posture."""

    def __init__(self, behaviour: Stand | LieDown, values: dict[str, float], condition: Condition) -> None:
        super().__init__(condition)
        self._behaviour, self._values = behaviour, values

    def step(self, around: Surroundings, own: ActorState | None) -> Step:
        """The step now."""
        x, y, heading = self._start
        since_s, _ = self._elapsed_s(around, own)
        if isinstance(self._behaviour, Stand) or since_s < 0.0:
            return Step((x, y), heading)
        share = min(1.0, since_s / max(self._values["over_s"], 1e-3))
        return Step((x, y), heading, lying=(share, self._behaviour.posture))


class Going(_Started):
    """Goes straight ahead, or to another object, at a constant speed, and then stands."""

    def __init__(self, behaviour: Cross, values: dict[str, float], condition: Condition) -> None:
        super().__init__(condition)
        self._to, self._values = behaviour.to, values
        self._walked_m = 0.0

    def step(self, around: Surroundings, own: ActorState | None) -> Step:
        """The step now."""
        since_s, change_s = self._elapsed_s(around, own)
        x, y, heading = self._start
        if since_s < 0.0:
            return Step((x, y), heading)
        speed = self._values["speed_mps"]
        if self._to is None:
            walked = min(speed * since_s, self._values["distance_m"])
            p = (x + walked * math.cos(heading), y + walked * math.sin(heading))
            is_there = walked >= self._values["distance_m"]
            return Step(p, heading, 0.0 if is_there else speed, walked, heading)
        other = around.others.get(self._to)
        if other is None:
            return Step((x, y), heading)
        away = math.dist((x, y), other.p_map_m[:2])
        way = min(speed * change_s, max(away - REACHED_M, 0.0)) if since_s > 0.0 else 0.0
        heading = math.atan2(other.p_map_m[1] - y, other.p_map_m[0] - x) if away > REACHED_M else heading
        self._walked_m += way
        self._start = (x + way * math.cos(heading), y + way * math.sin(heading), heading)
        is_there = away - way <= REACHED_M
        return Step(self._start[:2], heading, 0.0 if is_there else speed, self._walked_m, heading)


class Accompanying(_Started):
    """Moves towards a place beside the outline, as fast as it can, and stays there as the machine moves."""

    def __init__(self, behaviour: Accompany, values: dict[str, float], condition: Condition) -> None:
        super().__init__(condition)
        self._side, self._values = behaviour.side, values
        self._walked_m = 0.0

    def step(self, around: Surroundings, own: ActorState | None) -> Step:
        """The step now."""
        since_s, change_s = self._elapsed_s(around, own)
        x, y, heading = self._start
        if since_s <= 0.0 or own is None or change_s <= 0.0:
            return Step((x, y), heading)
        values = self._values
        vertices = own.solid.mesh(-1.0).vertices_m
        goal = around.outline.beside(self._side, values["gap_m"], values["along_m"], vertices, heading)
        away, course = math.dist((x, y), goal), math.atan2(goal[1] - y, goal[0] - x)
        way = min(values["speed_mps"] * change_s, away)
        self._walked_m += way
        if way > 1e-4:
            heading = course
        self._start = (x + way * math.cos(course), y + way * math.sin(course), heading)
        return Step(self._start[:2], heading, way / change_s, self._walked_m, course)

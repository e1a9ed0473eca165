"""Objects of a scenario over time: appearance, place, behaviour."""

import math
from dataclasses import replace

import numpy as np
from shapely import Point, Polygon

from configs.site import Site
from configs.vehicle import Vehicle
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from messages.plan import Path
from simulation.actors.actors import ActorState
from simulation.actors.background import height_to_pass_m
from simulation.actors.motion import Circling, Motion, Step, motion_of
from simulation.actors.outline import Outline
from simulation.actors.phases import PhaseTracker, PlanPosition, Situation
from simulation.actors.surroundings import Condition, Surroundings
from simulation.environment.terrain import Terrain
from simulation.machine.machine import Machine
from simulation.objects.catalogue import CATALOGUE, solid_of
from simulation.objects.people import PERSON_POSTURES, between
from simulation.objects.postures import STAND_TO_LIE_STEPS
from simulation.objects.solid import Solid
from simulation.randomness import generator
from simulation.scenario_objects import MapPlace, ObjectPlace, OutlinePlace, PathPlace, ScenarioObject
from simulation.scenario_values import draw

FIRST_ID = 100  # encounters count from 0, shed solids from -1 downwards
RUN_MPS, WALK_MPS = 2.2, 0.05  # slowest running and walking (Minetti 1998: transition at 2.0 to 2.2 m/s)


class Bodies:
    """Solids of one object: catalogue entry and drawn height, by posture."""

    def __init__(self, one: ScenarioObject, random: np.random.Generator) -> None:
        entry = CATALOGUE[one.object]
        self._one, self._is_person = one, entry.postures == PERSON_POSTURES
        self.height_m = round(float(random.uniform(*(one.height_m or entry.usual_m))), 3)
        self.posture = one.posture or entry.postures[0]
        self._changed: dict[Solid, Solid] = {}

    def of(self, step: Step) -> Solid:
        """The solid for a step of its motion."""
        kind = self._one.object
        if step.lying is not None and self._is_person:
            share, posture = step.lying
            number = round(share * STAND_TO_LIE_STEPS)
            if 0 < number < STAND_TO_LIE_STEPS:
                return self._with_override(between(kind, self.height_m, (self.posture, posture), number))
            return self._with_override(solid_of(kind, posture if number else self.posture, self.height_m))
        return self._with_override(solid_of(kind, self._gait(step.speed_mps), self.height_m))

    def _gait(self, speed_mps: float) -> str:
        if not self._is_person or speed_mps < WALK_MPS:
            is_standing = self._is_person and self.posture in ("walking", "running")
            return "standing" if is_standing else self.posture
        return "running" if speed_mps >= RUN_MPS else "walking"

    def _with_override(self, solid: Solid) -> Solid:
        must_avoid = self._one.must_avoid
        if must_avoid is None or must_avoid == solid.must_avoid:
            return solid
        if solid not in self._changed:
            self._changed[solid] = replace(solid, must_avoid=must_avoid, _meshes={})
        return self._changed[solid]


class ScriptedObject:
    """One object; draws everything from the generator of its name, before the drive."""

    def __init__(self, id: int, one: ScenarioObject, seed: int) -> None:
        random = generator(seed, f"object/{one.name}")
        self.name = one.name
        self._id, self._one = id, one
        self._place = draw(one.place, random)
        self._bodies = Bodies(one, random)
        self._appearance = Condition(one.when, random)
        self._motion: Motion = motion_of(one.behaviour, random)
        self._flight = Circling(random) if self._bodies.posture == "flying" else None
        self._last: ActorState | None = None

    def update(self, around: Surroundings) -> ActorState | None:
        """State now; None before the object appears."""
        if self._last is None:
            if not self._appearance.is_met(around, None):
                return None
            start = self._start(around)
            if start is None:
                return None
            self._motion.begin(start, around.now.elapsed_s)
        step = self._motion.step(around, self._last)
        up_m = 0.0
        if self._flight is not None:
            step = self._flight.step(step, around.now.elapsed_s)
            up_m = max(0.0, height_to_pass_m(around.machine, *step.p_map_m) - self._bodies.height_m)
        x, y = step.p_map_m
        solid = self._bodies.of(step)
        is_moving = step.speed_mps > WALK_MPS
        velocity = (step.speed_mps * math.cos(step.course_rad), step.speed_mps * math.sin(step.course_rad))
        gait = step.walked_m / solid.stride_m % 1.0 if is_moving and solid.stride_m is not None else -1.0
        state = ActorState(self._id, solid, self.name, (x, y, around.terrain.height_m(x, y) + up_m), step.heading_rad,
                           velocity if is_moving else (0.0, 0.0), gait, self._one.visible_to)  # fmt: skip
        if self._last is None or state != self._last:  # an unchanged state keeps its cached meshes
            self._last = state
        return self._last

    def _start(self, around: Surroundings) -> tuple[float, float, float] | None:
        """Pose of the appearance in `map`; None while the object it refers to is absent or without a plan."""
        place, values = self._one.place, self._place
        turn = math.radians(values["heading_deg"])
        if isinstance(place, MapPlace):
            return values["x_m"], values["y_m"], turn
        if isinstance(place, OutlinePlace):
            yaw = around.outline.base[2] + turn
            vertices = self._bodies.of(Step((0.0, 0.0), 0.0)).mesh(-1.0).vertices_m
            beside_m = around.outline.beside(place.side, values["gap_m"], values["along_m"], vertices, yaw)
            is_within = place.side.startswith("wheel")  # the width of the machine
            if is_within or values["gap_m"] < 0.0:  # meant to overlap
                return *beside_m, yaw
            return *around.outline.cleared(place.side, beside_m, vertices, yaw), yaw
        if isinstance(place, ObjectPlace):
            other = around.others.get(place.of)
            offset = Pose2(values["ahead_m"], values["left_m"], turn)
            return None if other is None else Pose2(*other.p_map_m[:2], other.yaw_rad) @ offset
        return self._on_path(place, around, turn)

    def _on_path(self, place: PathPlace, around: Surroundings, turn: float) -> tuple[float, float, float] | None:
        values, plan = self._place, around.plan
        if len(plan.path_m) == 0:  # without a plan: straight ahead
            if place.ahead_m is None:
                return None
            (x, y), heading = around.leading_end[0][:2], around.leading_end[1]
            return Pose2(float(x), float(y), heading) @ Pose2(values["ahead_m"], values["left_m"], turn)
        if place.ahead_m is None:
            at_m = values["path_m"]
        else:
            at_m = plan.path_m_of_leading_end(*around.outline.ends_m) + values["ahead_m"]
        return Pose2(*plan.pose_at(at_m)) @ Pose2(0.0, values["left_m"], turn)


class ScriptedObjects:
    """All objects of a scenario, in the order of the file."""

    def __init__(
        self, objects: tuple[ScenarioObject, ...], paths: tuple[Path, ...], site: Site, vehicle: Vehicle,
        terrain: Terrain, seed: int,
    ) -> None:  # fmt: skip
        self._all = [ScriptedObject(FIRST_ID + k, one, seed) for k, one in enumerate(objects)]
        self._plan, self._phases = PlanPosition(paths), PhaseTracker()
        self._vehicle, self._terrain, self._yard = vehicle, terrain, Polygon(site.yard.outline_m)
        self._hitch = 1.0
        self._states: dict[str, ActorState] = {}

    def update(
        self, elapsed_s: float, machine: Machine, is_horn_on: bool, leading_end: tuple[Float64, float]
    ) -> tuple[ActorState, ...]:
        """States of those present; each knows the states of the others, of this instant for earlier ones."""
        if not self._all:
            return ()
        around = self._surroundings(elapsed_s, machine, is_horn_on, leading_end)
        for one in self._all:
            state = one.update(around)
            if state is not None:
                self._states[one.name] = state
        return tuple(self._states.values())

    def _surroundings(
        self, elapsed_s: float, machine: Machine, is_horn_on: bool, leading_end: tuple[Float64, float]
    ) -> Surroundings:
        base = (machine.x_m, machine.y_m, machine.yaw_rad)
        path_m, section = self._plan.update(*base)
        is_lowering, self._hitch = machine.attached.hitch < self._hitch, machine.attached.hitch
        is_in_yard = bool(self._yard.intersects(Point(base[:2])))
        now = Situation(elapsed_s, base, machine.speed_mps, machine.steering.angle_rad, is_lowering, is_horn_on,
                        is_in_yard, path_m, section)  # fmt: skip
        outline = Outline.of(machine, self._vehicle)
        return Surroundings(
            now, machine, self._phases.update(now), outline, self._plan, self._terrain, leading_end, self._states
        )

"""Gulls and a neighbouring machine of a scenario's environment.

Gulls circle around the implement, where the soil is turned; a neighbour drives to and fro outside the field.
"""

import math

import numpy as np

from configs.site import Site
from configs.vehicle import MountedImplement, outlines
from geometry.arrays import Float64
from geometry.pose2 import Pose2, point_from_frame
from simulation.actors.actors import ActorState
from simulation.environment.terrain import Terrain, longest_edge_rad
from simulation.machine.implement import working_point_m
from simulation.machine.machine import Machine
from simulation.objects.catalogue import CATALOGUE, solid_of
from simulation.randomness import generator
from simulation.scenario_environment import Birds, Environment, Neighbour
from simulation.scenario_values import draw

FIRST_ID = 500  # objects of a scenario count from 100
NEIGHBOUR_ID = 499
FLAP_HZ = 3.0  # of Larus argentatus in flapping flight (Pennycuick 1990: 2.8 to 3.4 Hz)
BOB_M, BOB_S = 0.3, 2.0
CLIMB_M, SPAN_M, OVER_M = 2.5, 0.7, 0.4  # way on which a gull climbs, half of its span, space beneath it over a machine


class Gull:
    """One gull: a circle about the implement, in either direction."""

    def __init__(self, number: int, birds: Birds, seed: int) -> None:
        random = generator(seed, f"environment/gull/{number}")
        values = draw(birds, random)
        low, high = CATALOGUE["gull"].height_m
        self._height_m = min(max(values["height_m"], low), high)
        self._radius_m = max(values["radius_m"], 0.5)
        turn = 1.0 if random.random() < 0.5 else -1.0
        self._rate_radps = turn * values["speed_mps"] / self._radius_m
        self._phase, self._bob = random.uniform(0.0, 2.0 * math.pi, 2)
        self._id, self._name = FIRST_ID + number, f"gull {number + 1}"

    def state(
        self, elapsed_s: float, center: Float64, velocity: tuple[float, float], terrain: Terrain, machine: Machine
    ) -> ActorState:
        """State about a moving centre (2,); it climbs to pass over machine and implement."""
        angle = self._phase + self._rate_radps * elapsed_s
        c, s = math.cos(angle), math.sin(angle)
        x, y = float(center[0]) + self._radius_m * c, float(center[1]) + self._radius_m * s
        v = self._radius_m * self._rate_radps
        heading = angle + math.copysign(0.5 * math.pi, self._rate_radps)
        up_m = BOB_M * math.sin(2.0 * math.pi * elapsed_s / BOB_S + self._bob)
        up_m = max(up_m, height_to_pass_m(machine, x, y) - self._height_m)
        z = terrain.height_m(x, y) + up_m
        course = (velocity[0] - v * s, velocity[1] + v * c)
        solid = solid_of("gull", "flying", round(self._height_m, 3))
        return ActorState(self._id, solid, self._name, (x, y, z), heading, course, FLAP_HZ * elapsed_s % 1.0)


def height_to_pass_m(machine: Machine, x_m: float, y_m: float) -> float:
    """Least height at a place for a gull that passes over machine and implement, at which it climbs and sinks."""
    x, y = point_from_frame(Pose2(machine.x_m, machine.y_m, machine.yaw_rad), x_m, y_m)
    body, implement = machine.vehicle.body, machine.attached.implement
    height_m, implement_m = 0.0, implement.height_m if isinstance(implement, MountedImplement) else body.height_m
    for outline, top_m in zip(outlines(body, implement), (body.height_m, implement_m), strict=True):
        along_m, across_m = max(outline.rear_m - x, x - outline.front_m, 0.0), max(abs(y) - outline.half_width_m, 0.0)
        share = (CLIMB_M + SPAN_M - math.hypot(along_m, across_m)) / CLIMB_M
        height_m = max(height_m, min(max(share, 0.0), 1.0) * (top_m + OVER_M))
    return height_m


class NeighbourMachine:
    """A tractor with trailer that drives to and fro along the longest edge."""

    def __init__(self, neighbour: Neighbour, site: Site, seed: int) -> None:
        random = generator(seed, "environment/neighbour")
        values = draw(neighbour, random)
        axis = longest_edge_rad(site.boundary_m)
        self._along = np.array([math.cos(axis), math.sin(axis)])
        left = np.array([-self._along[1], self._along[0]])
        field = np.array(site.boundary_m)
        v, u = field @ left, field @ self._along
        is_left = np.mean(site.yard.outline_m, axis=0) @ left < 0.5 * (v.min() + v.max())
        across = v.max() + values["distance_m"] if is_left else v.min() - values["distance_m"]
        self._from, self._length_m = u.min() * self._along + across * left, float(u.max() - u.min())
        self._speed_mps, self._start_m = values["speed_mps"], random.uniform(0.0, 2.0 * self._length_m)
        self._axis_rad = axis

    def state(self, elapsed_s: float, terrain: Terrain) -> ActorState:
        """State now; it turns at once at the ends."""
        way = (self._start_m + self._speed_mps * elapsed_s) % (2.0 * self._length_m)
        is_back = way > self._length_m
        x, y = self._from + (2.0 * self._length_m - way if is_back else way) * self._along
        speed = -self._speed_mps if is_back else self._speed_mps
        velocity = (float(speed * self._along[0]), float(speed * self._along[1]))
        p = (float(x), float(y), terrain.height_m(float(x), float(y)))
        solid = solid_of("tractor_with_trailer", "parked", 2.8)
        return ActorState(NEIGHBOUR_ID, solid, "neighbour", p, self._axis_rad + math.pi * is_back, velocity, -1.0)


class Background:
    """All of a run; none without an environment."""

    def __init__(self, environment: Environment | None, site: Site, terrain: Terrain, seed: int) -> None:
        birds = None if environment is None else environment.birds
        neighbour = None if environment is None else environment.neighbour
        self._terrain = terrain
        self._gulls = [] if birds is None else [Gull(k, birds, seed) for k in range(birds.gulls)]
        self._neighbour = None if neighbour is None else NeighbourMachine(neighbour, site, seed)

    def update(self, elapsed_s: float, machine: Machine) -> list[ActorState]:
        """States now."""
        states = []
        if self._gulls:
            base = (machine.x_m, machine.y_m, machine.yaw_rad)
            center = working_point_m(machine.attached.implement, base, machine.attached.yaw_rad)
            velocity = (machine.speed_mps * math.cos(machine.yaw_rad), machine.speed_mps * math.sin(machine.yaw_rad))
            states = [gull.state(elapsed_s, center, velocity, self._terrain, machine) for gull in self._gulls]
        if self._neighbour is not None:
            states.append(self._neighbour.state(elapsed_s, self._terrain))
        return states

"""Actors of a scenario: place, gait and presence of each encounter over time."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from shapely import MultiPoint
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Float32, Float64
from geometry.transforms import apply, planar
from simulation.actors.encounter import NO_SWATH, Walk, WalkState, distance_to, walk_state_at
from simulation.actors.placement import ParkedVehicle, PlacedEncounter
from simulation.environment.meshes import Mesh
from simulation.environment.terrain import Terrain
from simulation.objects.encountered import ENCOUNTERED
from simulation.objects.solid import Solid
from simulation.scenario import Encounter
from simulation.scenario_values import ALL_SENSORS

APPEAR_MARGIN_M = 12.0  # before the trigger: visible while waiting, absent while the machine works nearby before
APPROACH_MARGIN_M = (
    6.0  # before the trigger: the machine must have come along this path, not from a detour on the next one
)
DESPAWN_DISTANCE_M = 12.0  # from the machine, after the end of the exit path


@dataclass(frozen=True)
class ActorState:
    """An actor at one instant; `gait` is the gait phase, negative when standing."""

    id: int
    solid: Solid
    role: str
    p_map_m: tuple[float, float, float]
    yaw_rad: float
    velocity_mps: tuple[float, float]
    gait: float
    visible_to: tuple[str, ...] = ALL_SENSORS

    @cached_property
    def local_mesh(self) -> Mesh:
        """Mesh about the actor's own origin."""
        return self.solid.mesh(self.gait)

    def mesh_at(self, ago_s: float) -> Mesh:
        """Mesh in `map`, `ago_s` before this instant."""
        T = planar(
            self.p_map_m[0] - ago_s * self.velocity_mps[0], self.p_map_m[1] - ago_s * self.velocity_mps[1], self.yaw_rad
        )
        T[2, 3] = self.p_map_m[2]
        return self.local_mesh.transformed(T)

    @cached_property
    def vertices_map_m(self) -> Float32:
        """Vertices in `map`, (N, 3)."""
        return self.mesh_at(0.0).vertices_m

    @cached_property
    def footprint(self) -> BaseGeometry:
        """Convex hull on the ground, `map`."""
        return MultiPoint(self.vertices_map_m[:, :2].astype(float)).convex_hull

    @cached_property
    def ball_m(self) -> tuple[Float64, float]:
        """Bounding sphere: centre in `map` (3,) and radius."""
        corners = self.vertices_map_m.astype(np.float64)
        center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        return center, float(np.linalg.norm(corners - center, axis=1).max())

    def box_m(self) -> tuple[Float64, Float64]:
        """Bounding box: centre in `map` and size along the actor's axes, (3,) each."""
        vertices = self.local_mesh.vertices_m.astype(float)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        T = planar(self.p_map_m[0], self.p_map_m[1], self.yaw_rad)
        T[2, 3] = self.p_map_m[2]
        return apply(T, 0.5 * (low + high)[None])[0].astype(float), high - low


class Actor:
    """One encounter over time."""

    def __init__(self, id: int, encounter: Encounter, placed: PlacedEncounter, terrain: Terrain) -> None:
        self._id, self._encounter, self._placed, self._terrain = id, encounter, placed, terrain
        self._start_s: float | None = None
        self._is_present = isinstance(placed, ParkedVehicle)
        self._is_gone = False
        self._max_approach_m = 0.0  # largest distance before the point since the machine is on this path
        self._last: ActorState | None = None

    def update(self, elapsed_s: float, tip_map_m: Float64, heading_rad: float) -> ActorState | None:
        """State at this time, None while absent; `tip_map_m` and `heading_rad` of the machine's leading end."""
        if isinstance(self._placed, ParkedVehicle):
            return self._state(WalkState(self._placed.p_map_m, self._placed.heading_rad, 0.0, 0.0))
        self._update_presence(self._placed, elapsed_s, tip_map_m, heading_rad)
        if not self._is_present or self._is_gone:
            return None
        walk_state = walk_state_at(self._placed, -1.0 if self._start_s is None else elapsed_s - self._start_s)
        is_out = self._start_s is not None and elapsed_s - self._start_s >= self._placed.exit_end_s
        self._is_gone = is_out and math.dist(walk_state.p_map_m, tip_map_m[:2]) > DESPAWN_DISTANCE_M
        return None if self._is_gone else self._state(walk_state)

    def _update_presence(self, walk: Walk, elapsed_s: float, tip_map_m: Float64, heading_rad: float) -> None:
        path_m = distance_to(walk.point, tip_map_m, heading_rad)
        self._max_approach_m = max(self._max_approach_m, path_m) if math.isfinite(path_m) else 0.0
        if self._max_approach_m < walk.trigger_m + APPROACH_MARGIN_M and walk.point.line != NO_SWATH:
            return
        if self._start_s is None and path_m <= walk.trigger_m:
            self._start_s = elapsed_s
        self._is_present = self._is_present or path_m <= walk.trigger_m + APPEAR_MARGIN_M

    def _state(self, walk_state: WalkState) -> ActorState:
        solid, (x, y) = ENCOUNTERED[self._encounter.label], walk_state.p_map_m
        speed, heading = walk_state.speed_mps, walk_state.heading_rad
        velocity = (speed * math.cos(heading), speed * math.sin(heading))
        is_walking = solid.stride_m is not None and speed > 0.0
        gait = walk_state.walked_m / (solid.stride_m or 1.0) % 1.0 if is_walking else -1.0
        p = (x, y, self._terrain.height_m(x, y))
        name, visible_to = self._encounter.name, self._encounter.visible_to
        state = ActorState(self._id, solid, name, p, walk_state.heading_rad, velocity, gait, visible_to)
        # an unchanged state keeps its object, and with it its cached meshes
        if self._last is None or state != self._last:
            self._last = state
        return self._last

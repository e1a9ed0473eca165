"""Who acts the scenario: each encounter's figure with its place, gait and whether it is there at all."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from shapely import MultiPoint
from shapely.geometry.base import BaseGeometry

from geometry.transforms import apply, planar
from messages.message import Float32, Float64
from messages.perception import ObstacleClass
from simulation.actors.actor_meshes import STRIDE_M, actor_mesh
from simulation.actors.encounter import NO_SWATH, Walk, WalkState, distance_to, walk_state_at
from simulation.actors.placement import ParkedVehicle, PlacedEncounter
from simulation.environment.meshes import Mesh
from simulation.environment.terrain import Terrain
from simulation.scenario import ALL_SENSORS, Encounter

APPEAR_MARGIN_M = 12.0  # before the trigger: seen waiting, but not standing where the machine worked before
APPROACH_MARGIN_M = (
    6.0  # before the trigger the machine must be on this way: one that drives round something on the next is not
)
DESPAWN_DISTANCE_M = 12.0  # they are outside the field by then, or far off on a large one


@dataclass(frozen=True)
class ActorState:
    """A figure at a moment; `gait` is negative when it stands."""

    id: int
    label: ObstacleClass
    role: str
    p_map_m: tuple[float, float, float]
    yaw_rad: float
    velocity_mps: tuple[float, float]
    gait: float
    visible_to: tuple[str, ...] = ALL_SENSORS

    @cached_property
    def local_mesh(self) -> Mesh:
        """The mesh about the figure's own origin."""
        return actor_mesh(self.label, self.gait)

    def mesh_at(self, ago_s: float) -> Mesh:
        """The mesh in `map` a moment ago."""
        T = planar(
            self.p_map_m[0] - ago_s * self.velocity_mps[0], self.p_map_m[1] - ago_s * self.velocity_mps[1], self.yaw_rad
        )
        T[2, 3] = self.p_map_m[2]
        return self.local_mesh.transformed(T)

    @cached_property
    def vertices_map_m(self) -> Float32:
        """All corners in `map`, (N, 3)."""
        return self.mesh_at(0.0).vertices_m

    @cached_property
    def footprint(self) -> BaseGeometry:
        """Ground under the figure."""
        return MultiPoint(self.vertices_map_m[:, :2].astype(float)).convex_hull

    @cached_property
    def ball_m(self) -> tuple[Float64, float]:
        """Centre in `map` (3,) and radius of a ball round the figure."""
        corners = self.vertices_map_m.astype(np.float64)
        center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        return center, float(np.linalg.norm(corners - center, axis=1).max())

    def box_m(self) -> tuple[Float64, Float64]:
        """Centre in `map` and size along its own axes, (3,) each."""
        vertices = self.local_mesh.vertices_m.astype(float)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        T = planar(self.p_map_m[0], self.p_map_m[1], self.yaw_rad)
        T[2, 3] = self.p_map_m[2]
        return apply(T, 0.5 * (low + high)[None])[0].astype(float), high - low


class Actor:
    """One encounter as it is played."""

    def __init__(self, id: int, encounter: Encounter, drawn: PlacedEncounter, terrain: Terrain) -> None:
        self._id, self._encounter, self._drawn, self._terrain = id, encounter, drawn, terrain
        self._start_s: float | None = None
        self._is_present = isinstance(drawn, ParkedVehicle)
        self._is_gone = False
        self._max_approach_m = 0.0  # how far before the place the machine came on to this way
        self._last: ActorState | None = None

    def update(self, elapsed_s: float, tip_map_m: Float64, heading_rad: float) -> ActorState | None:
        """The figure at this time, or None while it is not there; a machine's tip comes from a heading."""
        if isinstance(self._drawn, ParkedVehicle):
            return self._state(WalkState(self._drawn.p_map_m, self._drawn.heading_rad, 0.0, 0.0))
        self._update_presence(self._drawn, elapsed_s, tip_map_m, heading_rad)
        if not self._is_present or self._is_gone:
            return None
        stance = walk_state_at(self._drawn, -1.0 if self._start_s is None else elapsed_s - self._start_s)
        is_out = self._start_s is not None and elapsed_s - self._start_s >= self._drawn.exit_end_s
        self._is_gone = is_out and math.dist(stance.p_map_m, tip_map_m[:2]) > DESPAWN_DISTANCE_M
        return None if self._is_gone else self._state(stance)

    def _update_presence(self, walk: Walk, elapsed_s: float, tip_map_m: Float64, heading_rad: float) -> None:
        way_m = distance_to(walk.place, tip_map_m, heading_rad)
        self._max_approach_m = max(self._max_approach_m, way_m) if math.isfinite(way_m) else 0.0
        if self._max_approach_m < walk.trigger_m + APPROACH_MARGIN_M and walk.place.line != NO_SWATH:
            return
        if self._start_s is None and way_m <= walk.trigger_m:
            self._start_s = elapsed_s
        self._is_present = self._is_present or way_m <= walk.trigger_m + APPEAR_MARGIN_M

    def _state(self, stance: WalkState) -> ActorState:
        label, (x, y) = self._encounter.label, stance.p_map_m
        velocity = (stance.speed_mps * math.cos(stance.heading_rad), stance.speed_mps * math.sin(stance.heading_rad))
        gait = stance.walked_m / STRIDE_M[label] % 1.0 if stance.speed_mps > 0.0 else -1.0
        p = (x, y, self._terrain.height_m(x, y))
        name, visible_to = self._encounter.name, self._encounter.visible_to
        state = ActorState(self._id, label, name, p, stance.heading_rad, velocity, gait, visible_to)
        # one that stands stays the same figure, whose shapes are known already
        if self._last is None or state != self._last:
            self._last = state
        return self._last

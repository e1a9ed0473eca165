"""Scene for ray casting: static pieces, built once, and actors, built for every scan."""

from collections.abc import Callable
from functools import cached_property

from simulation.actors.actors import ActorState
from simulation.environment.media import Media
from simulation.environment.raycast import RaycastScene
from simulation.environment.scenery import SURFACE_KINDS, Piece


class Scene:
    """Surroundings of the machine; `actors` are those present now, `media` None without an environment."""

    def __init__(self, build: Callable[[], list[Piece]], media: Media | None = None) -> None:
        self.actors: tuple[ActorState, ...] = ()
        self.media = media
        self._build = build

    @cached_property
    def pieces(self) -> list[Piece]:
        """Static pieces, built at first use."""
        return self._build()

    @cached_property
    def static(self) -> RaycastScene:
        """Solid static pieces for ray casting."""
        solid = [p for p in self.pieces if p.is_solid]
        kinds = tuple(SURFACE_KINDS.index(p.name) for p in solid)
        return RaycastScene([p.mesh for p in solid], [p.reflectivity for p in solid], kinds)

    def visible_to(self, kind: str) -> list[ActorState]:
        """Actors that sensors of a kind detect."""
        return [f for f in self.actors if kind in f.visible_to]

    def actor_scene(self, actors: list[ActorState], ago_s: float) -> RaycastScene:
        """Actors as they were `ago_s` before."""
        return RaycastScene([f.mesh_at(ago_s) for f in actors], [f.solid.reflectivity for f in actors])

"""Route pieces, and a cached search for free connections between poses."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geometry.arrays import Float64
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.coverage.headland import HeadlandPass
from planning.field.drivable_area import DrivableArea, describe
from planning.rig import Rig
from planning.turns.free_space import FreeSpace
from planning.turns.headland_transit import along_headland
from planning.turns.sampling import sampled_connection
from planning.turns.turn import ConnectionRequest, dubins_connection, is_free


@dataclass(frozen=True)
class RoutePiece:
    """Part of a route: points of `base` (N, 2) before smoothing; `is_working`: the implement works on all of it."""

    section_type: PathSectionType
    line: int
    points_m: Float64
    is_working: bool


@dataclass
class PathConnector:
    """Finds free connections between poses; each request is searched once."""

    drivable: DrivableArea
    rig: Rig
    headland_passes: list[HeadlandPass]
    seed: int
    cache: dict[tuple[ConnectionRequest, bool], Float64 | None] = field(default_factory=dict)

    def find(
        self, request: ConnectionRequest, is_thorough: bool = True, before: Float64 | None = None
    ) -> Float64 | None:
        """Free connection (N, 2) or None; a thorough search also tries the headland passes and sampling.

        `before` are the points driven up to the start where these are no straight line: the joint is then checked too.
        """
        key = (request, is_thorough)
        if key not in self.cache:
            self.cache[key] = self._search(request, is_thorough, before)
        return self.cache[key]

    @cached_property
    def space(self) -> FreeSpace:
        """Free space of this plan."""
        return FreeSpace(self.drivable.allowed, self.rig.bodies, self.rig.radius_m, self.rig.config.smoothing_m)

    def _search(self, request: ConnectionRequest, is_thorough: bool, before: Float64 | None) -> Float64 | None:
        connection = dubins_connection(request, self.space, before=before)
        if connection is not None or not is_thorough:
            return connection
        connection = along_headland(request, self.space, [r.points_m for r in self.headland_passes])
        if connection is None:
            connection = sampled_connection(request, self.space, self.seed, self.rig.config.sampling_iterations)
        if connection is not None and before is not None and not is_free(np.vstack([before, connection]), self.space):
            return None
        return connection

    def require(self, request: ConnectionRequest, purpose: str) -> Float64:
        """Free connection; raises FieldError that names both positions."""
        connection = self.find(request)
        if connection is None:
            a, b = (describe(self.drivable.site, p.x_m, p.y_m) for p in (request.start, request.goal))
            raise FieldError(
                f"no path {purpose} from {a} to {b} for a rig {self.rig.width_m:g} m wide: widen gate, lane or headland"
            )
        return connection

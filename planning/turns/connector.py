"""Finds free ways between poses for one plan and remembers them; and the pieces a drive is made of."""

from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float64
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.coverage.headland import Round
from planning.field.drivable_area import Ground, describe
from planning.rig import Rig
from planning.sampling import sampled
from planning.turns.headland_transit import along_rounds
from planning.turns.turn import Space, Wanted, curve_between, is_free


@dataclass(frozen=True)
class Piece:
    """A part of the drive of `base` (N, 2), not yet smoothed; `is_working` the implement works on all of it."""

    section_type: PathSectionType
    line: int
    points_m: Float64
    is_working: bool


@dataclass
class Ways:
    """Finds ways between poses and remembers them."""

    ground: Ground
    rig: Rig
    rounds: list[Round]
    seed: int
    known: dict[tuple[Wanted, bool], Float64 | None] = field(default_factory=dict)

    def find(self, wanted: Wanted, is_thorough: bool = True, before: Float64 | None = None) -> Float64 | None:
        """A free way or None; a thorough search goes along the rounds and then samples.

        `before` leads to the start where that is no straight line: the joint is checked as it will be smoothed.
        """
        key = (wanted, is_thorough)
        if key not in self.known:
            self.known[key] = self._search(wanted, is_thorough, before)
        return self.known[key]

    @property
    def space(self) -> Space:
        """Where the rig may be in this plan."""
        return Space(self.ground.allowed, self.rig.bodies, self.rig.radius_m, self.rig.config.smoothing_m)

    def _search(self, wanted: Wanted, is_thorough: bool, before: Float64 | None) -> Float64 | None:
        way = curve_between(wanted, self.space, before=before)
        if way is not None or not is_thorough:
            return way
        way = along_rounds(wanted, self.space, [r.points_m for r in self.rounds])
        if way is None:
            way = sampled(wanted, self.space, self.seed, self.rig.config.sampling_iterations)
        if way is not None and before is not None and not is_free(np.vstack([before, way]), self.space):
            return None
        return way

    def demand(self, wanted: Wanted, what: str) -> Float64:
        """A free way; raises FieldError that names both places."""
        way = self.find(wanted)
        if way is None:
            a, b = (describe(self.ground.site, p.x_m, p.y_m) for p in (wanted.start, wanted.goal))
            raise FieldError(
                f"no way {what} from {a} to {b} for a rig {self.rig.width_m:g} m wide: widen gate, lane or headland"
            )
        return way

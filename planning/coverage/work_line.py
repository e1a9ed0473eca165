"""Lines to be worked one after the other: swaths and open headland passes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.pose2 import Pose2
from messages.plan import PathSectionType
from planning.coverage.headland import HeadlandPass
from planning.coverage.interior import AnySwath
from planning.turns.search import STEP_M, Leg


@dataclass(frozen=True)
class WorkLine:
    """A line to be worked: its leg from a to b and from b to a, None where it cannot be driven."""

    section_type: PathSectionType
    number: int
    legs: tuple[Leg | None, Leg | None]
    source: AnySwath | HeadlandPass

    @property
    def length_m(self) -> float:
        """Length in the direction in which it is longer."""
        return max(len(leg.p_map_m) for leg in self.legs if leg is not None) * STEP_M

    def straight_m(self, is_reversed: bool) -> float:
        """Length in one direction of a straight line, 0 of others."""
        leg = self.legs[is_reversed]
        return (
            float(np.hypot(*(leg.p_map_m[-1] - leg.p_map_m[0])))
            if leg is not None and not leg.curvature_radpm.any()
            else 0.0
        )

    def ends(self, is_reversed: bool) -> tuple[Pose2, Pose2] | None:
        """Poses of `base` at start and end of work."""
        leg = self.legs[is_reversed]
        return None if leg is None else (leg.pose(0), leg.pose(-1))


def lines_of(swaths: Sequence[AnySwath], passes: Sequence[HeadlandPass], lead_m: float) -> list[WorkLine]:
    """Swaths and open passes as lines; `lead_m` is the distance of `base` ahead of the working line."""
    found = [WorkLine(PathSectionType.SWATH, swath.number, swath.legs(lead_m), swath) for swath in swaths]
    for p in passes:
        leg = Leg(1, p.points_m, p.heading_rad, p.curvature_radpm)
        found.append(WorkLine(PathSectionType.HEADLAND, p.number, (leg, leg.back if p.is_two_way else None), p))
    return found

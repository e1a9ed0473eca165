"""Ways of the folded rig from a pose to others and back."""

import numpy as np
import pytest
import shapely
from shapely.geometry import box
from shapely.geometry.base import BaseGeometry

from geometry.footprint import footprints
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from planning.turns.free_space import FreeSpace
from planning.turns.search import TurnTimes
from planning.turns.transport import TransportWays

BODIES = (Rectangle(-2.0, 3.5, 2.5),)
AREA = shapely.union_all([box(0, 0, 60, 60), box(60, 12, 100, 17), box(100, 0, 160, 60)])
HUB, GOALS = Pose2(20.0, 30.0, 0.0), (Pose2(120.0, 40.0, 1.0), Pose2(130.0, 20.0, -2.0), Pose2(40.0, 50.0, 3.0))


def ways_of(area: BaseGeometry = AREA, has_reverse: bool = False) -> TransportWays:
    return TransportWays(HUB, FreeSpace(area, BODIES, 5.0, 1.8), TurnTimes(2.0, 1.0, 5.0, 0.5, has_reverse))


@pytest.mark.parametrize("goal", GOALS)
def test_ways_lead_there_and_back_inside(goal: Pose2) -> None:
    ways = ways_of()
    for way, (start, end) in ((ways.to(goal), (HUB, goal)), (ways.back(goal), (goal, HUB))):
        assert way is not None
        p, heading = (np.concatenate([getattr(leg, name) for leg in way]) for name in ("p_map_m", "heading_rad"))
        assert np.hypot(*(p[0] - start[:2])) < 0.01
        assert np.hypot(*(p[-1] - end[:2])) < 0.01
        assert AREA.buffer(0.01).covers(footprints(BODIES, p, heading)).all()


def test_a_way_does_not_depend_on_those_before() -> None:
    shared = ways_of()
    for goal in GOALS:
        for found, alone in ((shared.to(goal), ways_of().to(goal)), (shared.back(goal), ways_of().back(goal))):
            assert found is not None
            assert alone is not None
            assert all((a.p_map_m == b.p_map_m).all() for a, b in zip(found, alone, strict=True))


def test_ways_that_begin_alike_share_turns() -> None:
    shared, alone = ways_of(), ways_of()
    first, second = GOALS[:2]
    shared.to(first)
    before = len(shared._turns)
    shared.to(second)
    alone.to(second)
    assert len(shared._turns) - before < 0.6 * len(alone._turns)


def test_no_way_through_a_closed_passage() -> None:
    closed = AREA.difference(box(80, 0, 81, 60))
    assert ways_of(closed, True).to(GOALS[0]) is None

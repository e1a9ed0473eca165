"""What is drawn on the map: corners by clicks, or the edge along which the machine drives."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from geometry.pose2 import Pose2, to_frame
from hmi.page_state import PageState
from messages.motion import MapPose, Odometry

Kind = Literal["", "outline", "driven", "no_go", "gate", "lane", "ab", "a_plus", "swaths_from", "margin", "refill"]
Point = tuple[float, float]
Ring = tuple[Point, ...]
MAX_POINTS, MIN_CORNERS, MIN_LANE = 500, 3, 2
STEP_M = 1.0  # between two points of a driven edge
STRAIGHT_M, SIDE_M = 0.05, 50.0  # a point so near to the line of its neighbours is left out, on sides up to this length
MAX_LEVEL_M = 0.5  # protection level of a position that is recorded


@dataclass
class Drawing:
    """Corners in `map` so far; `side` of the implement follows the edge: `left`, `right`, else its middle.

    `heading_deg` is that of an A+ line, clockwise from north. `amount` and `reason`: of a margin (m) or refill (m²).
    """

    kind: Kind = ""
    side: str = ""
    points_m: list[Point] = field(default_factory=list)
    heading_deg: float = 0.0
    amount: float = 0.0
    reason: str = ""

    @property
    def least_points(self) -> int:
        """Fewest points of what is drawn."""
        return MIN_LANE if self.kind == "lane" else MIN_CORNERS

    def add(self, x_m: float, y_m: float) -> None:
        """Adds a corner, up to `MAX_POINTS`."""
        if self.kind and len(self.points_m) < MAX_POINTS:
            self.points_m.append((round(x_m, 2), round(y_m, 2)))

    def follow(self, state: PageState) -> None:
        """Adds the place of the outer end of the implement when it is `STEP_M` further; nothing without a position."""
        pose, seen = state.pose, state.fresh("map_pose", MapPose)
        is_known = seen is not None and seen.protection_level_m <= MAX_LEVEL_M
        if self.kind != "driven" or pose is None or not is_known or state.fresh("odom", Odometry) is None:
            return
        x_m, y_m = edge_of(pose, state, self.side)
        if self.points_m and math.dist(self.points_m[-1], (x_m, y_m)) < STEP_M:
            return
        if len(self.points_m) > 1 and _is_between(self.points_m[-2], self.points_m[-1], (x_m, y_m)):
            self.points_m.pop()
        self.add(x_m, y_m)


def edge_of(pose: Pose2, state: PageState, side: str) -> Point:
    """Outer end of the implement at its working point, in `map`."""
    half_m = 0.5 * state.scene.implement.width_m
    left_m = {"left": half_m, "right": -half_m}.get(side, 0.0)
    x_m, y_m = to_frame(pose, np.array([[state.scene.working_point_m, left_m]]))[0].tolist()
    return x_m, y_m


def _is_between(before: Point, point: Point, after: Point) -> bool:
    """Whether a point is on the straight line between two others."""
    length_m = math.dist(before, after)
    if not 0.0 < length_m <= SIDE_M:
        return False
    (x, y), (dx, dy) = (point[0] - before[0], point[1] - before[1]), (after[0] - before[0], after[1] - before[1])
    return abs(dx * y - dy * x) / length_m <= STRAIGHT_M

r"""Timing of encounters: trigger distance and motion, so that each encounter causes exactly one stop.

     lateral                       D = trigger distance of the machine's front
start├── o waiting                 approach time  t_in = walk length / walk speed
     │    \                        unslowed at v the machine arrives at t_arr = D / v ≥ t_in + margin: contact
 0 ──┼─────o stands ────── path    at the edge of the swept width D − v·t_edge ≥ stopping gap: it can still stop
     │      \                      the actor leaves at delay factor·t_arr + extra: after the stop
     └───────o exit
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from shapely import LineString, Polygon

from configs.site import PoseConfig
from geometry.arrays import Float64
from messages.errors import FieldError
from simulation.scenario import Bystander, Crossing

SWEPT_MARGIN_M = 1.0  # clearance beside the implement
MIN_STOPPING_GAP_M = 12.0  # front to swept width at entry; the stack needs less at 10 km/h
MAX_DELAY_FACTOR = 1.15  # latest arrival of an unslowed machine against the plan
EXIT_MARGIN_M = 3.0  # beyond the field's edge: no later swath meets them
BYSTANDER_EXIT_M = 8.0  # lateral exit from the path of a docking machine
NO_SWATH = -1  # line of a point on no swath
MAX_EXIT_S = 25.0  # longest exit walk, on a large field


@dataclass(frozen=True)
class EncounterPoint:
    """Point on the planned path: position and driving direction in `map`, and the speed planned there."""

    p_map_m: tuple[float, float]
    heading_rad: float
    speed_mps: float
    line: int


@dataclass(frozen=True)
class EncounterSite:
    """Site data for drawing encounters: field outline in `map`, half the swept width, and dock poses by bay."""

    field: Polygon
    half_width_m: float
    docks: Mapping[str, PoseConfig] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class Walk:
    """A drawn crossing: start, standing and exit point in `map`, speeds, standing time and trigger distance."""

    point: EncounterPoint
    start_map_m: tuple[float, float]
    exit_map_m: tuple[float, float]
    walk_mps: float
    leave_mps: float
    stand_s: float
    trigger_m: float

    @property
    def arrival_s(self) -> float:
        """Time from the trigger to the standing point."""
        return math.dist(self.start_map_m, self.point.p_map_m) / self.walk_mps

    @property
    def exit_end_s(self) -> float:
        """Time from the trigger to the exit point."""
        return self.departure_s + math.dist(self.point.p_map_m, self.exit_map_m) / self.leave_mps

    @property
    def departure_s(self) -> float:
        """Time from the trigger to leaving the standing point."""
        return self.arrival_s + self.stand_s


@dataclass(frozen=True)
class WalkState:
    """Position and heading in `map`, speed, and distance walked (gait phase)."""

    p_map_m: tuple[float, float]
    heading_rad: float
    speed_mps: float
    walked_m: float


def trigger_distance_m(speed_mps: float, walk_m: float, edge_m: float, walk_mps: float, margin_s: float) -> float:
    """Distance of the machine's front that starts the walk: arrival before the machine, which can still stop.

    `walk_m` is the length to the standing point, `edge_m` its part within the swept width.
    """
    stands_before = speed_mps * (walk_m / walk_mps + margin_s)
    can_stop = speed_mps * (walk_m - edge_m) / walk_mps + MIN_STOPPING_GAP_M
    return max(stands_before, can_stop)


def draw_crossing(crossing: Crossing, point: EncounterPoint, site: EncounterSite, random: np.random.Generator) -> Walk:
    """A crossing at a point.

    The side is drawn; the shorter exit is taken when the drawn one lasts longer than `MAX_EXIT_S`.
    """
    half_width_m = site.half_width_m
    lateral = half_width_m + random.uniform(*crossing.start_lateral_m)
    skew = math.radians(random.uniform(*crossing.skew_deg))
    walk, leave = random.uniform(*crossing.walk_speed_mps), random.uniform(*crossing.leave_speed_mps)
    margin, extra = random.uniform(*crossing.arrival_margin_s), random.uniform(*crossing.extra_stand_s)
    walk_length, edge = lateral / math.cos(skew), (half_width_m + SWEPT_MARGIN_M) / math.cos(skew)
    trigger = trigger_distance_m(point.speed_mps, walk_length, edge, walk, margin)
    stand = MAX_DELAY_FACTOR * trigger / point.speed_mps + extra - walk_length / walk
    exit_lengths = {side: exit_distance_m(point, -side * (0.5 * math.pi - skew), site.field) for side in (1.0, -1.0)}
    side = 1.0 if random.random() < 0.5 else -1.0
    if exit_lengths[side] > leave * MAX_EXIT_S:
        side = min(exit_lengths, key=lambda s: exit_lengths[s])
    start = offset_point(point, -walk_length * math.sin(skew), side * lateral)
    exit_length = min(exit_lengths[side], leave * MAX_EXIT_S)
    exit_point = offset_point(point, exit_length * math.sin(skew), -side * exit_length * math.cos(skew))
    return Walk(point, start, exit_point, walk, leave, stand, trigger)


def draw_bystander(bystander: Bystander, site: EncounterSite, random: np.random.Generator) -> Walk:
    """A bystander before a bay, on the path of a reversing machine; raises FieldError for an unknown bay."""
    dock = site.docks.get(bystander.bay)
    if dock is None:
        raise FieldError(f"encounter {bystander.name!r}: the site has no bay {bystander.bay!r}")
    heading = math.radians(dock.heading_deg)
    at_dock = EncounterPoint((dock.x_m, dock.y_m), heading, 0.0, NO_SWATH)
    p = offset_point(at_dock, random.uniform(*bystander.dock_distance_m), random.uniform(*bystander.lateral_m))
    point = EncounterPoint(p, heading + math.pi, 0.0, NO_SWATH)  # the path leads into the bay
    side = 1.0 if random.random() < 0.5 else -1.0
    walk, stand = random.uniform(*bystander.walk_speed_mps), random.uniform(*bystander.stand_s)
    start = offset_point(point, 0.0, side * random.uniform(*bystander.start_lateral_m))
    return Walk(point, start, offset_point(point, 0.0, -side * BYSTANDER_EXIT_M), walk, walk, stand,
                random.uniform(*bystander.trigger_distance_m))  # fmt: skip


def exit_distance_m(point: EncounterPoint, turned_rad: float, field: Polygon) -> float:
    """Distance from a point to outside the field, at an angle to the path."""
    far_m = 2.0 * field.length
    angle = point.heading_rad + turned_rad
    x, y = point.p_map_m
    ray = LineString([(x, y), (x + far_m * math.cos(angle), y + far_m * math.sin(angle))])
    return float(ray.intersection(field.buffer(EXIT_MARGIN_M, join_style="mitre")).length)


def offset_point(point: EncounterPoint, ahead_m: float, left_m: float) -> tuple[float, float]:
    """Point in `map` at an offset from a point, along and left of its heading."""
    c, s = math.cos(point.heading_rad), math.sin(point.heading_rad)
    return point.p_map_m[0] + ahead_m * c - left_m * s, point.p_map_m[1] + ahead_m * s + left_m * c


def walk_state_at(walk: Walk, since_s: float) -> WalkState:
    """State at a time after the trigger (negative: waiting)."""
    middle = walk.point.p_map_m
    if since_s < walk.departure_s:
        return _on_line(walk.start_map_m, middle, since_s, walk.walk_mps)
    return _on_line(middle, walk.exit_map_m, since_s - walk.departure_s, walk.leave_mps)


def _on_line(a: tuple[float, float], b: tuple[float, float], since_s: float, speed_mps: float) -> WalkState:
    """State between a and b at a constant speed; standing at a before and at b after."""
    length = math.dist(a, b)
    walk_length = min(max(since_s, 0.0) * speed_mps, length)
    heading = math.atan2(b[1] - a[1], b[0] - a[0])
    p = (a[0] + walk_length * math.cos(heading), a[1] + walk_length * math.sin(heading))
    return WalkState(p, heading, speed_mps if 0.0 < walk_length < length else 0.0, walk_length)


def distance_to(point: EncounterPoint, tip_map_m: Float64, heading_rad: float) -> float:
    """Distance of the machine's foremost point to a point along its path; infinite when not on this path."""
    c, s = math.cos(point.heading_rad), math.sin(point.heading_rad)
    dx, dy = point.p_map_m[0] - float(tip_map_m[0]), point.p_map_m[1] - float(tip_map_m[1])
    ahead, lateral = dx * c + dy * s, dy * c - dx * s
    is_same_direction = math.cos(heading_rad - point.heading_rad) > math.cos(math.radians(20.0))
    return ahead if is_same_direction and abs(lateral) < 1.5 and ahead > 0.0 else math.inf

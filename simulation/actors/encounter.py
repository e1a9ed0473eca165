"""The arithmetic of encounters: when somebody starts, where they are at a time, and that each run forces one stop.

     lateral                       D = trigger distance of the machine's front
from ├── o waiting                 walk-in time  t_in = way / walk
     │    \\                        machine unslowed at v arrives at t_arr = D / v ≥ t_in + slack: it would hit them
 0 ──┼─────o stands ────── way     when they reach the swept edge, D − v·t_edge ≥ needed: it can still stop
     │      \\                      they leave at slowest·t_arr + wait: it must have stopped, and has
     └───────o out
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from shapely import LineString, Polygon

from configs.site import PoseConfig
from messages.errors import FieldError
from messages.message import Float64
from simulation.scenario import Bystander, Crossing

SWEPT_MARGIN_M = 1.0  # beside the implement: what a careful machine keeps free
MIN_STOPPING_GAP_M = 12.0  # from the front when they step into the swept width; the stack needs less at 10 km/h
MAX_DELAY_FACTOR = 1.15  # how much later than planned a machine that nobody slows may come
EXIT_MARGIN_M = 3.0  # they leave the field by this much, so that no later swath finds them
BYSTANDER_EXIT_M = 8.0  # so far aside of a docking machine they go
NO_SWATH = -1  # line of a place on no swath
MAX_EXIT_S = 25.0  # or, on a large field, go as far as they come in this time


@dataclass(frozen=True)
class EncounterPoint:
    """Where on the way: point and driving direction in `map`, and the speed driven there."""

    p_map_m: tuple[float, float]
    heading_rad: float
    speed_mps: float
    line: int


@dataclass(frozen=True)
class EncounterSite:
    """Where encounters are drawn: the field's outline in `map`, half the width that the machine sweeps, and bays."""

    field: Polygon
    half_width_m: float
    docks: Mapping[str, PoseConfig] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class Walk:
    """One crossing, drawn: three points in `map`, and times and distances that follow."""

    place: EncounterPoint
    start_map_m: tuple[float, float]
    exit_map_m: tuple[float, float]
    walk_mps: float
    leave_mps: float
    stand_s: float
    trigger_m: float

    @property
    def arrival_s(self) -> float:
        """Time from the start to the middle of the way."""
        return math.dist(self.start_map_m, self.place.p_map_m) / self.walk_mps

    @property
    def exit_end_s(self) -> float:
        """Time from the start to the end of the way out."""
        return self.departure_s + math.dist(self.place.p_map_m, self.exit_map_m) / self.leave_mps

    @property
    def departure_s(self) -> float:
        """Time from the start to leaving the middle."""
        return self.arrival_s + self.stand_s


@dataclass(frozen=True)
class WalkState:
    """Somebody at a moment: place and heading in `map`, speed, and way walked (for the gait)."""

    p_map_m: tuple[float, float]
    heading_rad: float
    speed_mps: float
    walked_m: float


def trigger_distance_m(speed_mps: float, way_m: float, edge_m: float, walk_mps: float, slack_s: float) -> float:
    """Distance of the machine's front at which they start: they stand before it could come, and it can still stop.

    `way_m` is walked to the middle; `edge_m` of it lies within the swept width.
    """
    stands_before = speed_mps * (way_m / walk_mps + slack_s)
    can_stop = speed_mps * (way_m - edge_m) / walk_mps + MIN_STOPPING_GAP_M
    return max(stands_before, can_stop)


def draw_crossing(
    crossing: Crossing, place: EncounterPoint, setting: EncounterSite, random: np.random.Generator
) -> Walk:
    """One crossing at a place.

    The side is drawn, unless one way out takes too long for the machine's next pass.
    """
    half_width_m = setting.half_width_m
    lateral = half_width_m + random.uniform(*crossing.start_lateral_m)
    oblique = math.radians(random.uniform(*crossing.skew_deg))
    walk, leave = random.uniform(*crossing.walk_speed_mps), random.uniform(*crossing.leave_speed_mps)
    slack, wait = random.uniform(*crossing.arrival_margin_s), random.uniform(*crossing.extra_stand_s)
    way, edge = lateral / math.cos(oblique), (half_width_m + SWEPT_MARGIN_M) / math.cos(oblique)
    trigger = trigger_distance_m(place.speed_mps, way, edge, walk, slack)
    stand = MAX_DELAY_FACTOR * trigger / place.speed_mps + wait - way / walk
    out_ways = {side: exit_distance_m(place, -side * (0.5 * math.pi - oblique), setting.field) for side in (1.0, -1.0)}
    side = 1.0 if random.random() < 0.5 else -1.0
    if out_ways[side] > leave * MAX_EXIT_S:
        side = min(out_ways, key=lambda s: out_ways[s])
    start = offset_point(place, -way * math.sin(oblique), side * lateral)
    out_way = min(out_ways[side], leave * MAX_EXIT_S)
    out = offset_point(place, out_way * math.sin(oblique), -side * out_way * math.cos(oblique))
    return Walk(place, start, out, walk, leave, stand, trigger)


def draw_bystander(bystander: Bystander, setting: EncounterSite, random: np.random.Generator) -> Walk:
    """Somebody before a bay, on the way of a machine that backs in; raises FieldError when there is no such bay."""
    dock = setting.docks.get(bystander.bay)
    if dock is None:
        raise FieldError(f"encounter {bystander.name!r}: the site has no bay {bystander.bay!r}")
    heading = math.radians(dock.heading_deg)
    at_dock = EncounterPoint((dock.x_m, dock.y_m), heading, 0.0, NO_SWATH)
    p = offset_point(at_dock, random.uniform(*bystander.dock_distance_m), random.uniform(*bystander.lateral_m))
    place = EncounterPoint(p, heading + math.pi, 0.0, NO_SWATH)  # the way leads into the bay
    side = 1.0 if random.random() < 0.5 else -1.0
    walk, stand = random.uniform(*bystander.walk_speed_mps), random.uniform(*bystander.stand_s)
    start = offset_point(place, 0.0, side * random.uniform(*bystander.start_lateral_m))
    return Walk(place, start, offset_point(place, 0.0, -side * BYSTANDER_EXIT_M), walk, walk, stand,
                random.uniform(*bystander.trigger_distance_m))  # fmt: skip


def exit_distance_m(place: EncounterPoint, turned_rad: float, field: Polygon) -> float:
    """How far it is from a place to outside the field, in a direction against that of the way."""
    far_m = 2.0 * field.length
    angle = place.heading_rad + turned_rad
    x, y = place.p_map_m
    ray = LineString([(x, y), (x + far_m * math.cos(angle), y + far_m * math.sin(angle))])
    return float(ray.intersection(field.buffer(EXIT_MARGIN_M, join_style="mitre")).length)


def offset_point(place: EncounterPoint, ahead_m: float, left_m: float) -> tuple[float, float]:
    """The point in `map` at an offset from a place."""
    c, s = math.cos(place.heading_rad), math.sin(place.heading_rad)
    return place.p_map_m[0] + ahead_m * c - left_m * s, place.p_map_m[1] + ahead_m * s + left_m * c


def walk_state_at(walk: Walk, since_s: float) -> WalkState:
    """Where they are, a time after the start (negative: waiting)."""
    middle = walk.place.p_map_m
    if since_s < walk.departure_s:
        return _on_line(walk.start_map_m, middle, since_s, walk.walk_mps)
    return _on_line(middle, walk.exit_map_m, since_s - walk.departure_s, walk.leave_mps)


def _on_line(a: tuple[float, float], b: tuple[float, float], since_s: float, pace_mps: float) -> WalkState:
    """From a to b at a pace; standing at a before and at b after."""
    length = math.dist(a, b)
    way = min(max(since_s, 0.0) * pace_mps, length)
    heading = math.atan2(b[1] - a[1], b[0] - a[0])
    p = (a[0] + way * math.cos(heading), a[1] + way * math.sin(heading))
    return WalkState(p, heading, pace_mps if 0.0 < way < length else 0.0, way)


def distance_to(place: EncounterPoint, tip_map_m: Float64, heading_rad: float) -> float:
    """How far a machine's foremost end still has to the place along this very way; infinite when it is not on it."""
    c, s = math.cos(place.heading_rad), math.sin(place.heading_rad)
    dx, dy = place.p_map_m[0] - float(tip_map_m[0]), place.p_map_m[1] - float(tip_map_m[1])
    ahead, aside = dx * c + dy * s, dy * c - dx * s
    is_along = math.cos(heading_rad - place.heading_rad) > math.cos(math.radians(20.0))
    return ahead if is_along and abs(aside) < 1.5 and ahead > 0.0 else math.inf

"""Connections between poses: turns, then along a headland pass, then by sampling."""

from dataclasses import dataclass, field, replace

import numpy as np

from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.coverage.headland import HeadlandPass
from planning.field.drivable_area import DrivableArea, describe
from planning.rig import Rig
from planning.turns.free_space import FreeSpace
from planning.turns.search import Connection, ConnectionRequest, Leg, find_turn
from planning.turns.transit import Track, along_passes, both_ways

HOME_STRAIGHT_M = 1.0
AT_ONCE = 10  # points, 1 m
BEGINNING = 300  # points of a line, 30 m: then a trailed implement has forgotten its angle


@dataclass(frozen=True)
class RoutePiece:
    """Part of a route in one direction.

    `is_working`: the implement works on all of it. `is_transport`: it is folded. `continues`: it belongs to the same
    line as the piece before it.
    """

    section_type: PathSectionType
    line: int
    leg: Leg
    is_working: bool
    is_transport: bool = False
    continues: bool = False


@dataclass
class PathConnector:
    """Finds free connections between poses; each request is searched once.

    With a trailed implement a connection counts only where the implement, as it arrives, is free on the line that
    begins at its goal. `hitch_rad`: hitch angles at ends of curved lines, at others it is in line; `beginnings`: curved
    lines, closed ones without their last point, with the index where they begin; `departed`: ends of departures,
    which a turn to the left, or none, follows at once.
    """

    drivable: DrivableArea
    rig: Rig
    headland_passes: list[HeadlandPass]
    seed: int
    space: FreeSpace
    tracks: list[Track] = field(default_factory=list)
    turns: dict[ConnectionRequest, Connection | None] = field(default_factory=dict)
    transits: dict[ConnectionRequest, Connection | None] = field(default_factory=dict)
    hitch_rad: dict[Pose2, float] = field(default_factory=dict)
    beginnings: dict[Pose2, tuple[Leg, int]] = field(default_factory=dict)
    departed: set[Pose2] = field(default_factory=set)

    def __post_init__(self) -> None:
        for p in self.headland_passes:
            self.tracks += both_ways(p.points_m, p.heading_rad, p.curvature_radpm, p.is_closed)

    def turn(self, request: ConnectionRequest) -> Connection | None:
        """Fastest free turn, or None."""
        if request not in self.turns:
            self.turns[request] = self._onto_line(request, find_turn(request, self.space, self.rig.turn_times))
        return self.turns[request]

    def find(self, request: ConnectionRequest) -> Connection | None:
        """Free connection or None, thoroughly: also along the headland passes."""
        return self.turn(request) or self.along(request)

    def along(self, request: ConnectionRequest) -> Connection | None:
        """Free connection along the headland passes, or None."""
        if request not in self.transits:
            way = along_passes(request, self.space, self.rig.turn_times, self.tracks)
            self.transits[request] = self._onto_line(request, way)
        return self.transits[request]

    def request(self, a: Pose2, b: Pose2, behind_m: float = 0.0, ahead_m: float = 0.0) -> ConnectionRequest:
        """From the end of one line, `behind_m` long, to the beginning of the next, `ahead_m` long."""
        run_out_m = 0.0 if a in self.departed else self.rig.config.run_out_m
        hitch_rad = self.hitch_rad.get(a, 0.0)
        return ConnectionRequest(
            a, b, run_out_m, self.rig.line_up_m, behind_m, ahead_m, hitch_rad, self.rig.tolerance_rad
        )

    def home_request(self, a: Pose2, home: Pose2, behind_m: float = 0.0) -> ConnectionRequest:
        """From the end of a line, `behind_m` long, to the lane, on which a trailed implement is in line."""
        straight_m = HOME_STRAIGHT_M if self.rig.trailer is None else self.rig.line_up_m
        return replace(self.request(a, home, behind_m), line_up_m=straight_m)

    def start_request(self, start: Pose2, lane: Pose2) -> ConnectionRequest:
        """From the start to the lane, on which a trailed implement is in line."""
        return ConnectionRequest(start, lane, 0.0, 0.0, most_hitch_rad=self.rig.tolerance_rad)

    def follow(self, leg: Leg) -> None:
        """Keeps a curved line with the hitch angle at its end; the implement is in line where it begins."""
        if self.rig.trailer is not None and leg.curvature_radpm.any():
            self.hitch_rad[leg.pose(-1)] = float(self.rig.hitch_angles(leg.p_map_m, leg.heading_rad)[-1])
            self.beginnings[leg.pose(0)] = leg, 0

    def _onto_line(self, request: ConnectionRequest, found: Connection | None) -> Connection | None:
        if found is None or (request.start in self.departed and found.legs[0].curvature_radpm[:AT_ONCE].min() < 0.0):
            return None
        if request.goal not in self.beginnings:
            return found
        leg, first = self.beginnings[request.goal]
        index = (first + np.arange(min(BEGINNING, len(leg.heading_rad)))) % len(leg.heading_rad)
        return found if self.space.is_free(leg.p_map_m[index], leg.heading_rad[index], found.hitch_rad) else None

    def require(self, request: ConnectionRequest, purpose: str) -> Connection:
        """Free connection; raises FieldError that names both positions."""
        connection = self.find(request)
        if connection is None:
            a, b = (describe(self.drivable.site, p.x_m, p.y_m) for p in (request.start, request.goal))
            raise FieldError(
                f"no path {purpose} from {a} to {b} for a rig {self.rig.width_m:g} m wide: widen gate, lane or headland"
            )
        return connection

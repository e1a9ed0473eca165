"""Machine with implement for planning: bodies, turning radius, working line and speeds."""

import math
from dataclasses import dataclass, replace

import numpy as np
from shapely.geometry.base import BaseGeometry

from configs.mission import Work
from configs.vehicle import Implement, TrailedImplement, Vehicle, deg, kmh, outlines, steering_rate
from geometry.arrays import Float64
from geometry.drawbar import Drawbar, Trailer, curvature_of, hitch_poses, run_in_m, steady_angle
from geometry.footprint import Bodies, place
from geometry.rectangle import Rectangle
from messages.errors import FieldError
from planning.config import PlannerConfig
from planning.turns.free_space import FreeSpace
from planning.turns.search import TurnTimes

IN_LINE_M = 0.003  # of the rear end: a trailed implement counts as in line at the end of a line


@dataclass(frozen=True)
class Rig:
    """Parameters of machine with implement, SI; `working_x_m` is the position of the working line along x of `base`.

    `bodies` are rigid to `base`; a trailed implement is the `trailer` and follows its hitch, at an angle of at most
    `max_hitch_rad` (infinite if mounted). `has_reverse`: turns between lines may reverse.
    """

    bodies: Bodies
    trailer: Trailer | None
    max_hitch_rad: float
    working_x_m: float
    working_width_m: float
    radius_m: float
    max_curvature_radpm: float
    wheelbase_m: float
    steer_rate_radps: float
    acceleration_mps2: float
    work_mps: float
    turn_mps: float
    lane_mps: float
    has_reverse: bool
    config: PlannerConfig

    @property
    def straight_bodies(self) -> Bodies:
        """All bodies in `base`, a trailed implement in line with the machine."""
        if self.trailer is None:
            return self.bodies
        body, hitch_m = self.trailer.body, self.trailer.drawbar.hitch_m
        return (*self.bodies, Rectangle(body.rear_m + hitch_m, body.front_m + hitch_m, body.width_m))

    @property
    def width_m(self) -> float:
        """Width of the widest body."""
        return max(b.width_m for b in self.straight_bodies)

    @property
    def front_m(self) -> float:
        """Front end along x of `base`."""
        return max(b.front_m for b in self.straight_bodies)

    @property
    def rear_m(self) -> float:
        """Rear end along x of `base` (negative), a trailed implement in line."""
        return min(b.rear_m for b in self.straight_bodies)

    @property
    def working_length_m(self) -> float:
        """Distance of the working line behind the hitch of a trailed implement."""
        return 0.0 if self.trailer is None else self.trailer.drawbar.hitch_m - self.working_x_m

    @property
    def tolerance_rad(self) -> float:
        """Largest hitch angle where work begins: the working line is within `line_tolerance_m`; infinite if mounted."""
        if self.trailer is None:
            return math.inf
        return math.asin(min(1.0, self.config.line_tolerance_m / self.working_length_m))

    @property
    def line_up_m(self) -> float:
        """Straight before a line; a trailed implement is within its tolerance then, after the tightest turn."""
        if self.trailer is None:
            return self.config.line_up_m
        drawbar = self.trailer.drawbar
        steady_rad = abs(steady_angle(drawbar, 1.0 / self.radius_m))
        return max(self.config.line_up_m, run_in_m(drawbar, steady_rad, self.tolerance_rad))

    @property
    def min_swath_m(self) -> float:
        """Length of the shortest line; a trailed implement is in line at its end."""
        if self.trailer is None:
            return self.config.min_swath_m
        last_rad = min(self.tolerance_rad, -IN_LINE_M / self.trailer.body.rear_m)
        return max(self.config.min_swath_m, run_in_m(self.trailer.drawbar, self.tolerance_rad, last_rad))

    def headland_passes(self, work: Work) -> int:
        """Number of headland passes: that of the mission, or more where turns forwards beside swaths need it."""
        if self.has_reverse:
            return work.headland_passes
        if self.trailer is None:
            out_m = self.config.run_out_m - self.working_x_m, self.config.line_up_m + self.working_x_m
            depth_m = max(out_m) + corner_reach_m(self)
        else:
            depth_m = self.line_up_m + self.working_x_m + self.radius_m + 0.5 * self.width_m
        return max(work.headland_passes, math.ceil(depth_m / max(self.working_width_m - work.overlap_m, 0.1)))

    def space(self, allowed: BaseGeometry, wider_m: float = 0.0) -> FreeSpace:
        """Free space of the rig in an area, a trailed implement widened to either side."""
        trailer = self.trailer
        if trailer is not None:
            trailer = replace(trailer, body=replace(trailer.body, width_m=trailer.body.width_m + 2.0 * wider_m))
        return FreeSpace(allowed, self.bodies, self.radius_m, self.config.smoothing_m, trailer)

    @property
    def askew_m(self) -> float:
        """Most that the end of a trailed implement is beside its place where work begins, 0 if mounted."""
        return 0.0 if self.trailer is None else -self.trailer.body.rear_m * math.sin(self.tolerance_rad)

    @property
    def turn_times(self) -> TurnTimes:
        """Speeds of turns and their changes of direction."""
        reverse_mps = min(kmh(self.config.reverse_kmh), self.turn_mps)
        return TurnTimes(self.turn_mps, reverse_mps, self.config.cusp_s, self.config.stop_gap_m, self.has_reverse)

    def carriers(
        self, p_map_m: Float64, heading_rad: Float64, hitch_rad: float = 0.0, is_closed: bool = False
    ) -> tuple[Float64, Float64]:
        """Positions (N, 2) and headings (N,) of what carries the working line: `base`, or the hitch with the implement.

        The poses of `base` are in driving order; `hitch_rad` is the hitch angle at the first one.
        """
        if self.trailer is None:
            return p_map_m, heading_rad
        found = hitch_poses(self.trailer.drawbar, p_map_m, heading_rad, hitch_rad, is_closed)
        return found[:, :2], found[:, 2]

    def hitch_angles(
        self, p_map_m: Float64, heading_rad: Float64, hitch_rad: float = 0.0, is_closed: bool = False
    ) -> Float64:
        """Heading of the implement relative to the machine at poses of `base` in driving order, (N,)."""
        if self.trailer is None:
            return np.zeros(len(heading_rad))
        turned = self.carriers(p_map_m, heading_rad, hitch_rad, is_closed)[1] - heading_rad
        return np.asarray(np.angle(np.exp(1j * turned)), np.float64)

    def working_edges(self, p_m: Float64, heading_rad: Float64) -> tuple[Float64, Float64]:
        """Left and right ends of the working line at N poses of its carrier, (N, 2) each."""
        h = self.working_width_m / 2.0
        x_m = self.working_x_m if self.trailer is None else -self.working_length_m
        ends = place(np.array([[x_m, h], [x_m, -h]]), p_m, heading_rad)
        return ends[:, 0], ends[:, 1]


def rig_of(vehicle: Vehicle, implement: Implement, work: Work | None, config: PlannerConfig) -> Rig:
    """Rig of a mission, at the maximum speed without work; raises FieldError for a trailed implement that reverses."""
    has_reverse, limit = work is not None and work.turns == "reverse", vehicle.drivetrain.max_curvature_radpm
    trailer, max_hitch_rad = None, math.inf
    if isinstance(implement, TrailedImplement):
        if has_reverse:
            raise FieldError(f"implement {implement.name!r} is trailed and does not reverse: set turns: forward")
        trailer = Trailer(
            Rectangle(-implement.total_length_m, 0.0, implement.width_m),
            Drawbar(implement.hitch_m, implement.axle_length_m),
        )
        max_hitch_rad = deg(implement.max_hitch_deg)
        limit = min(limit, curvature_of(trailer.drawbar, max_hitch_rad))
        working_x_m = implement.hitch_m - implement.working_length_m
    else:
        working_x_m = implement.working_point_m
    top = kmh(vehicle.max_speed_kmh)
    speeds = (work.work_speed_kmh, work.turn_speed_kmh, work.lane_speed_kmh) if work is not None else (math.inf,) * 3
    work_mps, turn_mps, lane_mps = (min(kmh(speed_kmh), top) for speed_kmh in speeds)
    return Rig(
        outlines(vehicle.body, None if trailer else implement), trailer, max_hitch_rad, working_x_m,
        implement.working_width_m, 1.0 / (limit * config.curvature_share), limit, vehicle.drivetrain.wheelbase_m,
        steering_rate(vehicle) * config.steering_rate_share, vehicle.acceleration_mps2,
        work_mps, turn_mps, lane_mps, has_reverse, config,
    )  # fmt: skip


def corner_reach_m(rig: Rig) -> float:
    """Maximum distance of a point of the rig from the centre of the tightest turn."""
    return max(math.hypot(rig.radius_m + b.width_m / 2.0, max(b.front_m, -b.rear_m)) for b in rig.bodies)

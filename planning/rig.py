"""Machine with implement for planning: bodies, turning radius, working line and speeds."""

import math
from dataclasses import dataclass

import numpy as np

from configs.mission import Work
from configs.vehicle import Implement, MountedImplement, Vehicle, kmh, outlines, steering_rate
from geometry.arrays import Float64
from geometry.footprint import Bodies, place
from messages.errors import FieldError
from planning.config import PlannerConfig
from planning.turns.search import TurnTimes


@dataclass(frozen=True)
class Rig:
    """Parameters of machine with implement, SI; `working_x_m` is the position of the working line along x of `base`.

    `has_reverse`: turns between lines may reverse.
    """

    bodies: Bodies
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
    def width_m(self) -> float:
        """Width of the widest body."""
        return max(b.width_m for b in self.bodies)

    @property
    def front_m(self) -> float:
        """Front end along x of `base`."""
        return max(b.front_m for b in self.bodies)

    @property
    def rear_m(self) -> float:
        """Rear end along x of `base` (negative)."""
        return min(b.rear_m for b in self.bodies)

    @property
    def turn_times(self) -> TurnTimes:
        """Speeds of turns and their changes of direction."""
        reverse_mps = min(kmh(self.config.reverse_kmh), self.turn_mps)
        return TurnTimes(self.turn_mps, reverse_mps, self.config.cusp_s, self.config.stop_gap_m, self.has_reverse)

    def working_edges(self, p_map_m: Float64, heading_rad: Float64) -> tuple[Float64, Float64]:
        """Left and right ends of the working line at N poses, (N, 2) each."""
        h = self.working_width_m / 2.0
        ends = place(np.array([[self.working_x_m, h], [self.working_x_m, -h]]), p_map_m, heading_rad)
        return ends[:, 0], ends[:, 1]


def rig_of(vehicle: Vehicle, implement: Implement, work: Work | None, config: PlannerConfig) -> Rig:
    """Rig of a mission, at the maximum speed without work; raises FieldError for an unsupported implement."""
    if not isinstance(implement, MountedImplement):
        raise FieldError(f"implement {implement.name!r} is {implement.kind}: only mounted implements are supported")
    top = kmh(vehicle.max_speed_kmh)
    speeds = (work.work_speed_kmh, work.turn_speed_kmh, work.lane_speed_kmh) if work is not None else (math.inf,) * 3
    work_mps, turn_mps, lane_mps = (min(kmh(speed_kmh), top) for speed_kmh in speeds)
    limit = vehicle.drivetrain.max_curvature_radpm
    return Rig(
        outlines(vehicle.body, implement), implement.working_point_m, implement.working_width_m,
        1.0 / (limit * config.curvature_share), limit, vehicle.drivetrain.wheelbase_m,
        steering_rate(vehicle) * config.steering_rate_share, vehicle.acceleration_mps2,
        work_mps, turn_mps, lane_mps, work is not None and work.turns == "reverse", config,
    )  # fmt: skip


def corner_reach_m(rig: Rig) -> float:
    """Maximum distance of a point of the rig from the centre of the tightest turn."""
    return max(math.hypot(rig.radius_m + b.width_m / 2.0, max(b.front_m, -b.rear_m)) for b in rig.bodies)

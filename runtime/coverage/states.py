"""States in which a machine drives: pose of the implement, direction, and the speed and curvature of the mission."""

from dataclasses import dataclass

from configs.mission import Mission
from configs.vehicle import Implement, TrailedImplement, Vehicle, kmh
from planning.config import PlanningConfig


@dataclass(frozen=True)
class DriveState:
    """One state; curvatures up to `max_curvature_radpm` to either side."""

    name: str
    speed_mps: float
    max_curvature_radpm: float
    direction: int = 1
    is_raised: bool = True
    is_folded: bool = False


def states_of(
    mission: Mission, vehicle: Vehicle, implement: Implement | None, planning: PlanningConfig
) -> tuple[DriveState, ...]:
    """States of a mission, each once; the curvature is what planning drives at the speed."""

    def state(
        name: str, speed_kmh: float, direction: int = 1, is_raised: bool = True, is_folded: bool = False
    ) -> DriveState:
        speed_mps = kmh(min(speed_kmh, vehicle.max_speed_kmh))
        sharpest = planning.planner.lateral_acceleration_mps2 / speed_mps**2
        curvature = min(vehicle.drivetrain.max_curvature_radpm, sharpest)
        return DriveState(name, speed_mps, curvature, direction, is_raised, is_folded)

    found, reverse_kmh = list[DriveState](), planning.mission.reverse_kmh
    if mission.work is not None:
        work = mission.work
        found = [
            state("working", work.work_speed_kmh, is_raised=False),
            state("raised", work.lane_speed_kmh),
            state("turning", work.turn_speed_kmh),
        ]
    if mission.line is not None:
        line, reverse_kmh = mission.line, max(reverse_kmh, mission.line.reverse_kmh)
        if any(leg.is_working for leg in line.legs):
            found.append(state("working", line.speed_kmh, is_raised=False))
        found.append(state("raised", line.speed_kmh))
    if isinstance(implement, TrailedImplement):
        return tuple(found)  # it does not reverse, and has no bay
    if found:
        found.append(state("reversing", reverse_kmh, direction=-1))
    if mission.bay is not None:
        docking = planning.docking
        lane_kmh = docking.yard_kmh if mission.work is None else max(docking.yard_kmh, mission.work.lane_speed_kmh)
        found.append(state("folded", lane_kmh, is_folded=True))
        found.append(state("folded, reversing", docking.yard_reverse_kmh, direction=-1, is_folded=True))
    return tuple(one for one in found if implement is not None or one.is_raised)

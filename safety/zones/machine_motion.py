"""Motion of the machine now: where its bodies are, and what they sweep."""

from dataclasses import dataclass, replace

from geometry.arrays import Float64
from safety.stopping_distance import Braking
from safety.zones.swept_area import SweptArea


@dataclass(frozen=True)
class MachineMotion:
    """Area that is swept, pose of base (3,) in odom, speed along the area, yaw rate, and braking on this grade."""

    area: SweptArea
    pose_odom: Float64
    speed_mps: float
    yaw_rate_radps: float
    braking: Braking

    def at_speed(self, speed_mps: float) -> "MachineMotion":
        """The same with another speed."""
        return replace(self, speed_mps=speed_mps)

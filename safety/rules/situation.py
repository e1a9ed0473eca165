"""All that the rules may know, at one moment."""

from dataclasses import dataclass

from messages.command import ControlCommand, MachineState, Mode
from messages.faults import Fault
from messages.motion import MapPose, Odometry
from safety.config import SafetyConfig
from safety.monitors.brake_test import Phase
from safety.monitors.sensors import Lost
from safety.stopping_distance import Braking
from safety.zones.protective_field import Gap
from safety.zones.tracked_obstacles import Threat


@dataclass(frozen=True)
class Situation:
    """Everything is a value: a message that is missing or stale is None, and a rule must say what follows from that.

    `direction` is that of travel (+1 forward), `speed_mps` ≥ 0 the highest that any source measures, `braking` that on
    this grade. `gap` is None when no lidar has looked yet; `proven_m` is the proven range ahead, `blind` the lidars
    that look there and prove nothing; `fence_m` the way that stays inside (None: not known; below 0: outside now).
    Times of held conditions are in seconds, 0 when the condition does not hold. `fold` of an implement that
    `is_foldable` is None when it is not known; `clock_step_s` is by how much the clock jumped since the last step.
    `lost` are sensors beside the lidars that do not see the way. `is_docking`: the docking field counts, whose values
    `config` then has; `survey_m` is the way that stays clear of surveyed walls.
    """

    now_ns: int
    config: SafetyConfig
    mode: Mode
    direction: int
    speed_mps: float
    is_speed_known: bool
    max_speed_mps: float
    braking: Braking
    allowance_m: float
    odom: Odometry | None
    machine: MachineState | None
    map_pose: MapPose | None
    control_command: ControlCommand | None
    silent: tuple[str, ...]
    frozen: tuple[str, ...]
    faults: tuple[Fault, ...]
    gap: Gap | None
    is_planned: bool
    threat: Threat
    proven_m: float
    blind: tuple[str, ...]
    fence_m: float | None
    position_sigma_m: float
    hand_forced_s: float
    steering_off_s: float
    steering_lost_s: float
    brake_weak_s: float
    is_foldable: bool
    fold: float | None
    clock_step_s: float
    brake_test: Phase
    lost: tuple[Lost, ...]
    is_docking: bool
    is_under_roof: bool
    survey_m: float

    @property
    def is_moving(self) -> bool:
        """Whether any source says that the machine moves, or said so last."""
        return self.speed_mps > self.config.modes.standstill_mps

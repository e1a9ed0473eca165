"""All that the rules may know, at one moment."""

from dataclasses import dataclass

from messages.command import ControlCommand, MachineState, Mode
from messages.faults import Fault
from messages.motion import MapPose, Odometry
from safety.config import SafetyConfig
from safety.monitors.brake_test import Phase
from safety.monitors.sensors import SensorFailure
from safety.stopping_distance import Braking
from safety.zones.protective_field import Clearance
from safety.zones.tracked_obstacles import CriticalObject


@dataclass(frozen=True)
class Situation:
    """Everything is a value: a message that is missing or stale is None, and a rule must say what follows from that.

    `direction` is that of travel (+1 forward), `speed_mps` ≥ 0 the highest that any source measures, `braking` that on
    this grade. `clearance` is None when no lidar has looked yet; `detection_range_m` is the proven range ahead,
    `blind` the lidars that look there and prove nothing; `geofence_distance_m` the way that stays inside (None: not
    known; below 0: outside now). Times of held conditions are in seconds, 0 when the condition does not hold. `fold`
    of an implement that `is_foldable` is None when it is not known; `clock_step_s` is by how much the clock jumped
    since the last step. `sensor_failures` are sensors beside the lidars that do not see the way. `is_docking`: the
    docking field counts, whose values `config` then has; `wall_distance_m` is the way that stays clear of surveyed
    walls.
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
    timed_out_topics: tuple[str, ...]
    frozen: tuple[str, ...]
    faults: tuple[Fault, ...]
    clearance: Clearance | None
    is_planned: bool
    critical_object: CriticalObject
    detection_range_m: float
    blind: tuple[str, ...]
    geofence_distance_m: float | None
    position_sigma_m: float
    driver_override_s: float
    steering_deviation_s: float
    steering_unavailable_s: float
    brake_ineffective_s: float
    is_foldable: bool
    fold: float | None
    clock_step_s: float
    brake_test: Phase
    sensor_failures: tuple[SensorFailure, ...]
    is_docking: bool
    is_under_roof: bool
    wall_distance_m: float

    @property
    def is_moving(self) -> bool:
        """Whether any source says that the machine moves, or said so last."""
        return self.speed_mps > self.config.modes.standstill_mps

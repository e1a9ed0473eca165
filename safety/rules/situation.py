"""The input of the rules at one moment."""

from dataclasses import dataclass

from configs.mission import Consent
from configs.strict import Config
from messages.command import MachineState
from messages.faults import Fault
from safety.collision_monitor import MonitorInputs
from safety.config import SafetyConfig
from safety.monitors.brake_test import Phase
from safety.monitors.sensors import SensorFailure
from safety.monitors.vehicle import VehicleState
from safety.stopping_distance import Braking
from safety.zones.protective_field import Clearance
from safety.zones.standing_bodies import StandingBody
from safety.zones.tracked_obstacles import CriticalObject


@dataclass(frozen=True)
class Situation:
    """All values of one step; what is missing or stale is None, and each rule states what follows from that.

    `config` has the docking field while `is_docking`; `rule_limits` is its section `rules`. `timed_out` are topics,
    `frozen` the lidars that repeat one scan, `blind` those that look in the direction of travel and detect nothing,
    `lost` the failed sensors of other kinds, `proven_m` the detection range. `gap` is None before the first scan.
    `geofence_m` is the distance to drive inside the geofence (None: position unknown; below 0: outside), `survey_m`
    that clear of surveyed walls, `clock_step_s` the jump of the clock since the last step, `has_pose_jumped`: the pose
    in odom did. `is_departure_unresolved`: what blocked the path was lost from view in it, or a bystander has not been
    seen leaving; `is_somebody_near`: the same without what is seen in the path. `lidar_failures`: lidars that measure
    wrongly. `vegetation_m`: height of the plants around the machine.
    """

    now_ns: int
    config: SafetyConfig
    rule_limits: Config
    inputs: MonitorInputs
    machine: MachineState | None
    vehicle: VehicleState
    max_speed_mps: float
    allowance_m: float
    timed_out_topics: tuple[str, ...]
    frozen: tuple[str, ...]
    faults: tuple[Fault, ...]
    clearance: Clearance | None
    critical_object: CriticalObject
    standing_body: StandingBody
    detection_range_m: float
    blind: tuple[str, ...]
    geofence_distance_m: float | None
    is_foldable: bool
    clock_step_s: float
    has_pose_jumped: bool
    brake_test: Phase
    sensor_failures: tuple[SensorFailure, ...]
    is_departure_unresolved: bool
    is_somebody_near: bool
    lidar_failures: tuple[SensorFailure, ...]
    vegetation_m: float
    consent: Consent | None
    is_docking: bool
    is_under_roof: bool
    wall_distance_m: float

    @property
    def speed_mps(self) -> float:
        """The highest speed that any source measures, or measured last, ≥ 0."""
        return self.vehicle.fastest_mps

    @property
    def braking(self) -> Braking:
        """The braking on this grade."""
        return self.vehicle.braking

    @property
    def is_moving(self) -> bool:
        """Whether the machine moves, as far as known."""
        return self.speed_mps > self.config.modes.standstill_mps

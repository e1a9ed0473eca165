"""Configuration of planning (`configs/stack/planning.yaml`)."""

from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config
from configs.vehicle import Kmh

Metres = Annotated[float, Field(gt=0.0, le=50.0)]


class PlannerConfig(Config):
    """Limits of a plan."""

    curvature_share: float = Field(gt=0.3, le=1.0, description="share of the machine's maximum curvature")
    steering_rate_share: float = Field(gt=0.05, le=1.0, description="share of the actuator's maximum rate")
    lateral_acceleration_mps2: float = Field(gt=0.1, le=5.0)
    deceleration_mps2: float = Field(gt=0.1, le=3.0, description="planned; below the brakes' capability")
    smoothing_m: float = Field(ge=0.3, le=6.0, description="averaging window; makes curvature continuous")
    run_out_m: float = Field(ge=0.0, le=20.0, description="straight after the implement has left the line")
    line_up_m: float = Field(ge=0.5, le=20.0, description="straight before the implement reaches the line")
    line_tolerance_m: float = Field(
        gt=0.0, le=0.5, description="distance of a trailed implement from its line where work begins"
    )
    min_swath_m: Metres
    reverse_kmh: Kmh = Field(description="in turns")
    cusp_s: float = Field(ge=0.0, le=60.0, description="time of a change of direction: stop, steer, start")
    stop_gap_m: float = Field(ge=0.0, le=5.0, description="to an edge ahead of the rig where it changes direction")
    corner_fill_m2: float = Field(ge=0.0, le=1000.0, description="smaller bare corners of a pass are not filled")
    small_remains_share: float = Field(
        ge=0.0, le=1.0, description="planned share below which also small remains are worked"
    )
    edge_slack_m: float = Field(
        ge=0.0, le=0.5, description="added to the margin of the first headland pass, for tail swing"
    )
    sampling_iterations: int = Field(
        ge=100, le=1_000_000, description="OMPL iterations per query; a count keeps results reproducible"
    )


class MissionConfig(Config):
    """Reaction of the mission node to a persistent obstacle."""

    blocked_s: float = Field(gt=0.0, le=600.0, description="duration of an obstacle stop before a detour is planned")
    blocked_unknown_s: float = Field(gt=0.0, le=600.0, description="the same before an obstacle without a class")
    static_speed_mps: float = Field(gt=0.0, le=1.0, description="slower objects and machines count as static")
    clearance_m: Metres = Field(description="to an obstacle passed; above the supervisor's lateral margin")
    rear_clearance_m: Metres = Field(description="behind the implement when reversing to the point where work resumes")
    min_obstacle_depth_m: float = Field(ge=0.0, le=20.0, description="assumed of an obstacle observed from one side")
    merge_distance_m: Metres = Field(description="static obstacles closer to each other are merged")
    search_distance_m: Metres = Field(description="path length ahead in which the cause of a stop is searched")
    max_reverse_m: Metres
    reverse_kmh: Kmh
    max_detours: int = Field(ge=0, le=100)
    min_remaining_m: float = Field(ge=0.0, le=100.0, description="no reversing for a shorter remainder of a line")
    max_shift_m: float = Field(ge=0.0, le=0.3, description="largest sideways shift of the driven line by the operator")


class DockingConfig(Config):
    """Docking into a bay of the shed and undocking."""

    speed_kmh: Kmh = Field(le=1.8, description="near the shed; upper bound of the supervisor's docking field")
    yard_kmh: Kmh = Field(description="forward, farther than `yard_speed_from_m` from the roof")
    yard_reverse_kmh: Kmh = Field(description="reverse, farther than `yard_speed_from_m` from the roof")
    yard_speed_from_m: float = Field(ge=0.0, le=50.0, description="above that of the supervisor's docking field")
    bay_clearance_m: float = Field(ge=0.02, le=2.0, description="to each side on the run-in")
    clearance_m: float = Field(ge=0.02, le=5.0, description="to shed and yard edge outside the run-in")
    obstacle_clearance_m: float = Field(ge=0.02, le=5.0, description="to obstacles in the yard; at least clearance_m")
    start_slack_m: float = Field(ge=0.0, le=0.2, description="loss of clearance allowed at a start near a bound")
    run_in_m: float = Field(ge=0.0, le=20.0, description="straight section before the rear end reaches the roof")
    ramp_m: float = Field(gt=0.1, le=5.0, description="length over which a curvature step is spread while driving")
    ramp_slack_m: float = Field(
        ge=0.0, le=1.0, description="tolerance of the first collision check, before ramps are corrected"
    )
    min_run_m: float = Field(ge=0.0, le=10.0, description="distance between cusps")
    cusp_cost_m: float = Field(ge=0.0, le=50.0, description="cost of a cusp as distance")
    sampling_iterations: int = Field(ge=100, le=1_000_000, description="OMPL iterations per query")
    max_uwb_age_s: float = Field(
        gt=0.0, le=10.0, description="age of the last UWB range above which docking does not start"
    )
    uwb_wait_s: float = Field(ge=0.0, le=60.0, description="wait at standstill for UWB before aborting")
    uwb_lost_s: float = Field(gt=0.0, le=60.0, description="age of the last UWB range that aborts an active docking")
    blocked_timeout_s: float = Field(
        gt=0.0, le=600.0, description="obstacle stop without alternative path before aborting"
    )

    @model_validator(mode="after")
    def _check_obstacle_clearance(self) -> "DockingConfig":
        if self.obstacle_clearance_m < self.clearance_m:
            raise ValueError(f"obstacle_clearance_m {self.obstacle_clearance_m} < clearance_m {self.clearance_m}")
        return self


class PlanningConfig(Config):
    """Section `planning` of the stack configuration."""

    planner: PlannerConfig
    docking: DockingConfig
    mission: MissionConfig

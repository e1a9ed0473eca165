"""What the planner may ask of machine and ground."""

from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config
from configs.vehicle import Kmh

Metres = Annotated[float, Field(gt=0.0, le=50.0)]


class PlannerConfig(Config):
    """Limits of a plan; section `planner` of `configs/stack/planning.yaml`."""

    curvature_share: float = Field(gt=0.3, le=1.0, description="of the machine's tightest curvature that a plan uses")
    steering_rate_share: float = Field(gt=0.05, le=1.0, description="of the actuator's rate that a plan uses")
    lateral_acceleration_mps2: float = Field(gt=0.1, le=5.0)
    deceleration_mps2: float = Field(gt=0.1, le=3.0, description="planned slowing; the brakes can do more")
    smoothing_m: float = Field(ge=0.3, le=6.0, description="window of the smoothing that makes curvature continuous")
    run_out_m: float = Field(ge=0.0, le=20.0, description="straight way after the implement has left the line")
    line_up_m: float = Field(ge=0.5, le=20.0, description="straight way before the implement reaches the line")
    least_swath_m: Metres
    edge_slack_m: float = Field(ge=0.0, le=0.5, description="more than the margin for the first round, for tail swing")
    sampling_iterations: int = Field(ge=100, le=1_000_000, description="of OMPL for one way, a count and never a time")


class MissionConfig(Config):
    """What the mission node does when something stays in the way."""

    blocked_s: float = Field(
        gt=0.0, le=600.0, description="stop before something that stands, until it is driven round"
    )
    blocked_alive_s: float = Field(gt=0.0, le=600.0, description="the same before a person or animal")
    standing_mps: float = Field(gt=0.0, le=1.0)
    clearance_m: Metres = Field(description="beside what is driven round; more than the supervisor's lateral margin")
    rear_clearance_m: Metres = Field(description="behind the implement when backing up to where work goes on")
    unseen_depth_m: float = Field(ge=0.0, le=20.0, description="least depth of what is seen from one side")
    join_m: Metres = Field(description="standing things nearer to each other than this are one")
    look_m: Metres = Field(description="how far ahead on the path the cause of a stop is looked for")
    most_reverse_m: Metres
    reverse_kmh: Kmh
    most_detours: int = Field(ge=0, le=100)
    least_rest_m: float = Field(ge=0.0, le=100.0, description="a shorter rest of a line is not worth going back to")


class DockingConfig(Config):
    """The way into a bay of the shed and out of it."""

    speed_kmh: Kmh = Field(le=1.8, description="at the shed; design.md: docking is no faster")
    yard_kmh: Kmh = Field(description="forward, farther than `yard_m` from the roof")
    yard_reverse_kmh: Kmh = Field(description="the same in reverse")
    yard_m: float = Field(ge=0.0, le=50.0, description="more than that of the supervisor's docking field")
    bay_clearance_m: float = Field(ge=0.02, le=2.0, description="to either side in the bay, on the run-in")
    clearance_m: float = Field(ge=0.02, le=5.0, description="from shed and edge of the yard everywhere else")
    apart_m: float = Field(ge=0.02, le=5.0, description="from what stands in the yard; no less than clearance_m")
    standing_slack_m: float = Field(ge=0.0, le=0.2, description="what a start near a bound may lose of its clearance")
    run_in_m: float = Field(ge=0.0, le=20.0, description="straight before the rear end reaches the roof")
    ramp_m: float = Field(gt=0.1, le=5.0, description="over which a step of curvature is spread while driving")
    ramp_slack_m: float = Field(ge=0.0, le=1.0, description="by which the ramps may move a way, for the first look")
    least_run_m: float = Field(ge=0.0, le=10.0, description="way from one cusp to the next")
    cusp_cost_m: float = Field(ge=0.0, le=50.0, description="way that a cusp less is worth")
    sampling_iterations: int = Field(ge=100, le=1_000_000, description="of OMPL, a count and never a time")
    uwb_age_s: float = Field(gt=0.0, le=10.0, description="older ranges: the machine does not dock")
    uwb_wait_s: float = Field(ge=0.0, le=60.0, description="standing, until that is given up")
    uwb_lost_s: float = Field(gt=0.0, le=60.0, description="silence on the way into the bay, until that is given up")
    blocked_s: float = Field(gt=0.0, le=600.0, description="stop before what no other way leads round, until given up")

    @model_validator(mode="after")
    def _keeps_more_from_what_stands(self) -> "DockingConfig":
        if self.apart_m < self.clearance_m:
            raise ValueError(f"apart_m {self.apart_m} is less than clearance_m {self.clearance_m}")
        return self


class PlanningConfig(Config):
    """`configs/stack/planning.yaml`."""

    planner: PlannerConfig
    docking: DockingConfig
    mission: MissionConfig
